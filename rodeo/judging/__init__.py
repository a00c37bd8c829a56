"""Rulings after the proof: votes on them, their conclusion, and how people read them.

How a proof is verified is in `rodeo.checks`; the commands are in `rodeo.commands.judging`.
"""
