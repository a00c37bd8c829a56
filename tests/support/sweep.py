"""One behaviour at many values: some of them in `make test`, all in `make test-long`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def sweep(values: Iterable[Any], every: int) -> list[Any]:
    """`values` for `parametrize`, each `every`th of them not marked `long`; a tuple for several arguments."""
    return [
        value
        if number % every == 0
        else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.long)
        for number, value in enumerate(values)
    ]
