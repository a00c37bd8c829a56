"""From which confidence on a class is named: the share of ordinary items that are called unknown is a risk
that is chosen, not an outcome.

Split conformal prediction (Vovk et al., 2005; Angelopoulos and Bates, 2023, arXiv:2107.07511): of n items
that the network has not seen, a further one is as likely to have any rank. So it lies below the k-th least
confidence with a probability of at most k / (n + 1), whatever the confidences mean.

    RodeoError
    └── TooFewItems           so few items cannot tell so small a risk
"""

from __future__ import annotations

import math

import numpy as np

from rodeo.errors import RodeoError

RISK = 0.01
"""Of ordinary waste this share may be called unknown."""


class TooFewItems(RodeoError):
    """Of so few items each one's rank is more probable than the risk."""


def threshold(confidence: np.ndarray, risk: float = RISK) -> float:
    """Below it is unknown. `confidence` (n,) are of items that the network did not learn from, and that
    measure nothing. Raises TooFewItems."""
    rank = math.floor(risk * (len(confidence) + 1))
    if rank < 1:
        raise TooFewItems("too few items for the risk", items=len(confidence), risk=risk)
    # Rounded down: rounding up would make an item of just that confidence unknown.
    return math.floor(float(np.sort(confidence)[rank - 1]) * 1e4) / 1e4
