"""What ends a motion or a wait early: an operator's word, the end of the assignment, a lost item."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Check = Callable[[], None]
"""Returns, or raises the error that ends what the robot does."""


class Interrupts:
    """The reasons to end what the robot does. One thread; a wait calls `check` at least every 0.1 s."""

    def __init__(self, check: Check = lambda: None) -> None:
        self._checks = [check]

    def check(self) -> None:
        """Raises what the first check raises that finds a reason to end."""
        for check in self._checks:
            check()

    @contextmanager
    def also(self, check: Check) -> Iterator[None]:
        """Within this, `check` too can end a motion or a wait."""
        self._checks.append(check)
        try:
            yield
        finally:
            self._checks.pop()
