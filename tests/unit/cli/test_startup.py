"""What every command imports before it does anything."""

import subprocess
import sys

from rodeo_testing.waiting import HANG_S


def test_a_command_starts_without_what_only_some_need() -> None:
    # eth_account brings a second's worth of elliptic curves, rosbags the types of every release of ROS 2.
    slow = {"eth_account", "rosbags", "mujoco", "cv2", "onnxruntime", "web3", "numpy", "nicegui"}
    code = f"import sys, rodeo_cli; print(sorted({slow!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANG_S
    )
    assert done.stdout.strip() == "[]"
