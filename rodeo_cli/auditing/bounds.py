"""What a sample says of all verdicts."""

from __future__ import annotations

from collections.abc import Iterable
from random import Random
from typing import TypeVar

CONFIDENCE = 0.95

T = TypeVar("T")


def sampled(items: Iterable[T], size: int, seed: str) -> tuple[list[T], int]:
    """`size` of the items, each as likely as any other, in their order, and how many there are.

    Reservoir sampling (Vitter 1985, algorithm R): no more than `size` are held.
    """
    random, kept, count = Random(seed), list[tuple[int, T]](), 0
    for count, item in enumerate(items, start=1):
        if count <= size:
            kept.append((count, item))
        elif (place := random.randrange(count)) < size:
            kept[place] = (count, item)
    return [item for _, item in sorted(kept, key=lambda one: one[0])], count


def upper_bound(wrong: int, size: int) -> float:
    """The largest share of wrong verdicts with which a sample of `size` has at most `wrong` of them in one of
    twenty cases (Clopper and Pearson 1934, one-sided): at 95 % the share is no larger."""
    # Imported here: only samples need it.
    from scipy.special import betaincinv

    return 1.0 if wrong >= size else float(betaincinv(wrong + 1, size - wrong, CONFIDENCE))
