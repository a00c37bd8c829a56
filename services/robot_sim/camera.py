"""Cameras. The bin's: rendered where OpenGL is, otherwise a stored rendering of what is in front of it."""

import logging
import math
from pathlib import Path
from typing import Protocol

import mujoco

from rodeo.errors import RodeoError
from rodeo.lab.config import BinConfig
from rodeo.lab.layout import BinLayout
from rodeo.lab.render import Camera, RendererUnavailable, encode
from services.robot_sim.simulation import Simulation

log = logging.getLogger(__name__)

RENDERINGS = Path(__file__).with_name("renderings")
_SHOWN_M = 0.12
"""An item closer to the show point than this is in the picture."""


class NoRendering(RodeoError):
    """There is no stored rendering of what is in front of the camera."""


class BinCamera(Protocol):
    def jpeg(self) -> bytes:
        """What the camera sees now. Call it from the simulation's thread."""
        ...


class RenderedCamera:
    def __init__(self, simulation: Simulation, bin_: BinConfig) -> None:
        self._simulation = simulation
        self._camera = Camera(simulation.model, f"{bin_.name}/camera")

    def jpeg(self) -> bytes:
        return encode(self._camera.image(self._simulation.data))


class StoredCamera:
    """Shows the kind of the item that is really there, not how it is held."""

    def __init__(self, simulation: Simulation, bin_: BinConfig) -> None:
        self._simulation = simulation
        self._show_point = BinLayout(bin_).show_point

    def jpeg(self) -> bytes:
        name = "empty"
        for item in self._simulation.site.items:
            position_m, _ = self._simulation.things.item_pose(item.id)
            if math.dist(position_m, self._show_point) <= _SHOWN_M:
                name = f"{item.item_class}_{item.shape}"
        path = RENDERINGS / f"{name}.jpg"
        if not path.is_file():
            raise NoRendering("no stored rendering of this item", name=name)
        return path.read_bytes()


def open_camera(simulation: Simulation, bin_: BinConfig) -> BinCamera:
    try:
        return RenderedCamera(simulation, bin_)
    except RendererUnavailable as error:
        log.warning(
            "NO OPENGL DRIVER: the camera of %s shows stored renderings of the items (%s)", bin_.name, error
        )
        return StoredCamera(simulation, bin_)


class WristCamera:
    """The robot's own colour camera. Its OpenGL context belongs to the thread that first asks for one."""

    def __init__(self, model: mujoco.MjModel, name: str) -> None:
        self._model, self._name = model, name
        self._camera: Camera | None = None
        self._unavailable = False

    def jpeg(self, data: mujoco.MjData) -> bytes | None:
        """What it sees now; None where there is no OpenGL driver."""
        if self._camera is None and not self._unavailable:
            try:
                self._camera = Camera(self._model, self._name)
            except RendererUnavailable as error:
                self._unavailable = True
                log.warning("NO OPENGL DRIVER: %s publishes no images (%s)", self._name, error)
        return None if self._camera is None else encode(self._camera.image(data))
