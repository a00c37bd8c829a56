"""Pictures of the lab: `python -m rodeo.lab.render --site FILE --out FILE.png`."""

import argparse
from pathlib import Path

import cv2
import mujoco
import numpy as np

from rodeo.errors import RodeoError


class RendererUnavailable(RodeoError):
    """No OpenGL driver on this machine."""


class Camera:
    """Renders one fixed camera of a world. Use it from the thread that made it."""

    def __init__(self, model: mujoco.MjModel, name: str, width_px: int = 320, height_px: int = 240) -> None:
        self.name = name
        try:
            self._renderer = mujoco.Renderer(model, height_px, width_px)
        except Exception as error:  # MuJoCo's GL back ends raise whatever their loader raises.
            raise RendererUnavailable("cannot make an OpenGL context", reason=repr(error)) from error

    def image(self, data: mujoco.MjData) -> np.ndarray:
        """What the camera sees: (height, width, 3) uint8, RGB."""
        self._renderer.update_scene(data, self.name)
        return self._renderer.render()

    def close(self) -> None:
        self._renderer.close()


def encode(image: np.ndarray, extension: str = ".jpg", quality: int = 90) -> bytes:
    """An RGB image as a file's bytes."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if extension == ".jpg" else []
    ok, data = cv2.imencode(extension, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    if not ok:
        raise RodeoError("cannot encode the image", extension=extension, shape=image.shape)
    return data.tobytes()


def main() -> None:
    from rodeo.config import Site
    from rodeo.lab.world import begin, build_world

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", required=True, type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--camera", default="overview")
    parser.add_argument("--size", type=int, nargs=2, default=(1600, 900), metavar=("WIDTH", "HEIGHT"))
    arguments = parser.parse_args()
    site = Site.load(arguments.site)
    model = build_world(site)
    camera = Camera(model, arguments.camera, *arguments.size)
    arguments.out.write_bytes(encode(camera.image(begin(model, site)), arguments.out.suffix))
    camera.close()


if __name__ == "__main__":
    main()
