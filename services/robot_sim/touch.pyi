"""See touch.pyx."""

import mujoco
import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.int_]

class Touch:
    def __init__(
        self,
        data: mujoco.MjData,
        items: Numbers,
        bases: Numbers,
        hands: Numbers,
        item_dofs: Numbers,
        base_dofs: Numbers,
        fingers: Numbers,
        rest: NDArray[np.float64],
        still: NDArray[np.float64],
        *,
        reach_m: float,
        hand_near_m: float,
        held_m: float,
        base_near_m: float,
        standing_speed: float,
        holds_below_m: float,
    ) -> None: ...
    def rests(self) -> bool: ...
    def state(self) -> tuple[bool, bool]: ...
