"""Compiled code calls the functions of the MuJoCo that Python uses."""

import ctypes

import mujoco
import pytest

from rodeo.lab.mujoco_library import address


def test_a_function_is_that_of_the_loaded_mujoco() -> None:
    version = ctypes.CFUNCTYPE(ctypes.c_int)(address("mj_version"))
    assert version() == mujoco.mj_version()


def test_mujoco_has_no_other_functions() -> None:
    with pytest.raises(AttributeError, match="mj_nonsense"):
        address("mj_nonsense")
