"""What several checks compute of one proof: each result is computed once and kept as long as its case."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

from rodeo.checks.case import Case

Result = TypeVar("Result")
Args = ParamSpec("Args")


def once_per_case(
    compute: Callable[Concatenate[Case, Args], Result],
) -> Callable[Concatenate[Case, Args], Result]:
    """`compute`, which is not called again for the same case and arguments. What it raises is not kept.

    The result must not refer to the case, or neither is ever freed. Arguments are hashable, and not named.
    """
    kept: WeakKeyDictionary[Case, dict[tuple[Hashable, ...], Result]] = WeakKeyDictionary()

    @wraps(compute)
    def result_of(case: Case, *args: Args.args, **kwargs: Args.kwargs) -> Result:
        results = kept.setdefault(case, {})
        if args not in results:
            results[args] = compute(case, *args, **kwargs)
        return results[args]

    return result_of
