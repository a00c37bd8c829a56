"""Prints docs/forgeries.md: `python -m tests.forgeries > docs/forgeries.md`."""

from tests.forgeries.catalogue import listed

print(listed(), end="")
