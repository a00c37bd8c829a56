"""See rows.pyx."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
Numbers = NDArray[np.intc]

class Rows:
    def __init__(self, template: bytes, stamps: Sequence[int], places: Sequence[int]) -> None: ...
    def encode(self, time_ns: NDArray[np.int64], *blocks: tuple[int, Doubles]) -> list[bytes]: ...

def reckoned_poses(reckoned: Doubles) -> tuple[Doubles, Doubles]: ...
def odom_in_map(base_m: Doubles, base_quat: Doubles, reckoned: Doubles) -> Doubles: ...
def poses_in_parents(
    places_m: Doubles, quaternions: Doubles, turns: Doubles, bodies: Numbers, parents: Numbers
) -> Doubles: ...
