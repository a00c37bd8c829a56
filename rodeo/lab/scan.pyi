"""See scan.pyx."""

import mujoco
import numpy as np
from numpy.typing import NDArray

class Scanner:
    def __init__(
        self,
        model: mujoco.MjModel,
        geoms: NDArray[np.int_],
        beams: int,
        farthest_m: float,
        ray_geom: int,
        ray_mesh: int,
        ray_hfield: int,
    ) -> None: ...
    def ranges(
        self,
        data: mujoco.MjData,
        eye: NDArray[np.float64],
        axes: NDArray[np.float64],
        rays: NDArray[np.float64],
    ) -> NDArray[np.float64]: ...
