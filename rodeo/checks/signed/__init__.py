"""Statements of devices as evidence: whose keys count, what was signed, which numbers are missing.

How statements are made is in `rodeo.witness`; what they say about motion is in `rodeo.checks.motion`.
"""
