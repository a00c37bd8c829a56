"""What every command imports before it does anything."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rodeo_testing.waiting import HANG_S


def test_a_command_starts_without_what_only_some_need() -> None:
    # eth_account brings a second's worth of elliptic curves, rosbags the types of every release of ROS 2.
    slow = {"eth_account", "rosbags", "mujoco", "cv2", "onnxruntime", "web3", "numpy", "nicegui"}
    code = f"import sys, rodeo_cli.commands; print(sorted({slow!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANG_S
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "start", [["-m", "rodeo_cli"], ["-c", "from rodeo_cli.__main__ import main; main()"]]
)
def test_ctrl_c_while_the_commands_are_imported_ends_without_a_traceback(
    tmp_path: Path, start: list[str]
) -> None:
    # The first of them that is imported presses Ctrl-C.
    (tmp_path / "typer.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGINT)")
    paths = os.pathsep.join([str(tmp_path), *sys.path[1:]])
    done = subprocess.run(
        [sys.executable, *start], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths}
    )
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
