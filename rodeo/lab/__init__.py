"""The lab: its description, its geometry and its MuJoCo model, shared by simulator, agent and oracle.

Nothing here moves by itself (`services.robot_sim`) or decides (`rodeo.robot`).
"""

import os
from ctypes.util import find_library

# MuJoCo picks its OpenGL back end when it is first imported, and fails to import with one that is not there.
# EGL renders without a display.
if "MUJOCO_GL" not in os.environ and find_library("EGL"):
    os.environ["MUJOCO_GL"] = "egl"
