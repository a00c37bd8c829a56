"""Texts from outside, and texts for outside: addresses, JSON, charsets, what a site file says wrong.

Functions on texts, without a bus, a disk or a site. Words for people are in `rodeo.display`.
"""
