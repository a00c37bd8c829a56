"""Amounts of the organization's token, and the strategies that set prices and rewards.

What electricity costs is in `rodeo.charging`; who earned what is in `rodeo.display`.
"""
