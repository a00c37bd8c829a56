"""Prints docs/reference/forgeries.md: `python -m tests.forgeries > docs/reference/forgeries.md`."""

from tests.forgeries.catalogue import listed

print(listed(), end="")
