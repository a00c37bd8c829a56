"""Pictures of the lab, by MuJoCo's own renderer."""

import cv2
import mujoco
import numpy as np

from rodeo.errors import RodeoError


class RendererUnavailable(RodeoError):
    """No OpenGL driver on this machine."""


class Camera:
    """Renders what one camera of a world sees, or a view that its owner moves. Use it from the thread that
    made it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        view: str | mujoco.MjvCamera,
        width_px: int = 320,
        height_px: int = 240,
    ) -> None:
        self._view = view
        # MuJoCo makes buffers of the model's size, with eight samples for each pixel, whatever the picture's.
        size = model.vis.global_
        models_px = size.offwidth, size.offheight
        size.offwidth, size.offheight = width_px, height_px
        try:
            self._renderer = mujoco.Renderer(model, height_px, width_px)
        except Exception as error:  # MuJoCo's GL back ends raise whatever their loader raises.
            raise RendererUnavailable("cannot make an OpenGL context", reason=repr(error)) from error
        finally:
            size.offwidth, size.offheight = models_px

    def image(self, data: mujoco.MjData) -> np.ndarray:
        """What the camera sees: (height, width, 3) uint8, RGB."""
        self._renderer.update_scene(data, self._view)
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
