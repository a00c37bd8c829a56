"""What several checks compute of one proof: each result is computed once and kept as long as its case, with
the sources that it rests on."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

from rodeo.checks.case import Case

Result = TypeVar("Result")
Args = ParamSpec("Args")

Source = tuple[str, str]
"""Role and name of a witness. The executor's own file is always there, and what stands on chain is beyond
doubt: neither is named."""
_reading: ContextVar[set[Source] | None] = ContextVar("sources that are read", default=None)


def reads(*sources: Source) -> None:
    """To be called where the word of a witness is looked up."""
    if (found := _reading.get()) is not None:
        found.update(sources)


@contextmanager
def sources_read() -> Iterator[set[Source]]:
    """The witnesses whose words are read in this context, also by results that are kept."""
    found: set[Source] = set()
    token = _reading.set(found)
    try:
        yield found
    finally:
        _reading.reset(token)
        reads(*found)


def once_per_case(
    compute: Callable[Concatenate[Case, Args], Result],
) -> Callable[Concatenate[Case, Args], Result]:
    """`compute`, which is not called again for the same case and arguments. What it raises is not kept.

    The result must not refer to the case, or neither is ever freed. Arguments are hashable, and not named.
    """
    kept: WeakKeyDictionary[Case, dict[tuple[Hashable, ...], tuple[Result, set[Source]]]]
    kept = WeakKeyDictionary()

    @wraps(compute)
    def result_of(case: Case, *args: Args.args, **kwargs: Args.kwargs) -> Result:
        results = kept.setdefault(case, {})
        if args not in results:
            with sources_read() as read:
                result = compute(case, *args, **kwargs)
            results[args] = result, read
        result, read = results[args]
        reads(*read)
        return result

    return result_of
