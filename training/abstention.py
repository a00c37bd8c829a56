"""From which confidence on a class is named: the share of ordinary items that are called unknown is a risk
that is chosen, not an outcome.

Split conformal prediction: of the items that are still to come, the share below the k-th least confidence of
n items that the network has not seen is distributed as Beta(k, n + 1 - k), whatever the confidences mean. So
it is within the risk with the probability that of n items at least k are, each by the risk (Vovk, 2012,
arXiv:1209.2673). k is the largest for which that is as good as certain: with as much on the average as is
allowed (Angelopoulos and Bates, 2023, arXiv:2107.07511), every second network would exceed it.

    RodeoError
    └── TooFewItems           so few items cannot tell so small a risk
"""

from __future__ import annotations

import math

import numpy as np

from rodeo.errors import RodeoError

RISK = 0.01
"""Share of ordinary waste that may be called unknown."""
SURE = 0.95
"""With this probability no more of it is."""


class TooFewItems(RodeoError):
    """So few items cannot tell so small a risk."""


def threshold(confidence: np.ndarray, risk: float = RISK) -> float:
    """Below it is unknown. `confidence` (n,) are of items that the network did not learn from, and that
    measure nothing. Raises TooFewItems."""
    found = rank(len(confidence), risk)
    if found < 1:
        raise TooFewItems("too few items for the risk", items=len(confidence), risk=risk)
    # Rounded down: rounding up would make an item of just that confidence unknown.
    return math.floor(float(np.sort(confidence)[found - 1]) * 1e4) / 1e4


def rank(items: int, risk: float) -> int:
    """The largest k for which of so many items k or more are unknown with the probability `SURE`, each by the
    risk; 0 if there is none."""
    fewer = 0.0
    for k in range(items + 1):
        ways = math.lgamma(items + 1) - math.lgamma(k + 1) - math.lgamma(items - k + 1)
        fewer += math.exp(ways + k * math.log(risk) + (items - k) * math.log1p(-risk))
        if fewer > 1 - SURE:
            return k
    return 0
