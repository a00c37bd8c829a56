"""Checks of how robot, arm and item moved, from the recorded motion and what witnesses signed of it.

What a device's statement counts for is in `rodeo.checks.signed`; stages and report are in `rodeo.checks`.
"""
