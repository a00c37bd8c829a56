"""Prints docs/forgeries.md: `python -m tests.forgeries > docs/forgeries.md`."""

from tests.forgeries import listed

print(listed(), end="")
