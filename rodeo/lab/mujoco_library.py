"""MuJoCo's own functions, for compiled code that calls them without Python in between."""

import ctypes
from functools import cache
from pathlib import Path

import mujoco


@cache
def _library() -> ctypes.CDLL:
    """The one that Python's package has loaded, which is the only one that knows its models."""
    (path,) = Path(mujoco.__file__).parent.glob("libmujoco.*")
    return ctypes.CDLL(str(path))


def address(function: str) -> int:
    """Of a function that mujoco.h declares. Raises AttributeError for another one."""
    return ctypes.cast(getattr(_library(), function), ctypes.c_void_p).value or 0
