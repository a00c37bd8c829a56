"""A graph of ROS 1 for tests: a real master, the relay, and nodes, with a Noetic robot's Zenoh client."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from rodeo.host.instance import PARENT_VARIABLE
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import free_port

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv-noetic" / "bin" / "python"
PACKAGE = ROOT / "rodeo_ros1" / "rodeo_ros1"
ROBOT = ROOT / "tests" / "noetic_robot"

needs_ros1 = pytest.mark.skipif(
    not (PYTHON.parents[1] / "whole").exists() or not Path("/usr/bin/rosmaster").exists(),
    reason="ROS 1 and the Zenoh client of a Noetic robot are missing: make system",
)


def generate(folder: Path) -> Path:
    """A folder for PYTHONPATH with the packages that Debian has not, rodeo_msgs among them."""
    words = [
        "/usr/bin/python3",
        str(ROBOT / "generate.py"),
        str(folder),
        str(ROOT / "rodeo_ros1" / "rodeo_msgs"),
    ]
    subprocess.run(words, check=True, timeout=HANG_S, env=_environment())
    return folder / "python"


def _environment(**more: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", PARENT_VARIABLE)}
    return kept | more


class Graph:
    """Processes around one master."""

    def __init__(self, folder: Path, generated: Path) -> None:
        self._folder = folder
        self._port = free_port()
        self._environment = _environment(
            PYTHONPATH=f"{generated}:{PACKAGE / 'src'}",
            ROS_MASTER_URI=f"http://127.0.0.1:{self._port}",
            ROS_IP="127.0.0.1",
            ROS_HOME=str(folder / "ros"),
        )
        self._running: dict[str, subprocess.Popen[str]] = {}

    def start_master(self) -> None:
        self._start("master", "/usr/bin/rosmaster", "--core", "-p", str(self._port))

    def start_relay(self, name: str, config: dict[str, Any]) -> None:
        path = self._folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(config))
        self._start(name, str(PYTHON), str(PACKAGE / "scripts" / "relay"), str(path), f"__name:={name}")

    def start_node(self, name: str, script: str, *arguments: str) -> None:
        self._start(name, str(PYTHON), str(ROBOT / script), *arguments)

    def _start(self, name: str, *words: str) -> None:
        with open(self._path(name), "ab") as output:
            self._running[name] = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                cwd=self._folder,
                env=self._environment,
                text=True,
            )

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.log"

    def say(self, name: str, line: str) -> None:
        """A line on the standard input of a node."""
        told = self._running[name].stdin
        assert told is not None
        told.write(f"{line}\n")
        told.flush()

    def log(self, name: str) -> str:
        return self._path(name).read_text(errors="replace")

    def wait_for(self, name: str, text: str, after: int = 0) -> str:
        """The line of its log with this text, after so many characters."""

        def found() -> str:
            return next((line for line in self.log(name)[after:].splitlines() if text in line), "")

        return wait_until(found, lambda: f"{name} did not say {text!r}:\n{self.log(name)[-4000:]}")

    def terminate(self, name: str) -> int:
        """Its exit status after SIGTERM."""
        child = self._running[name]
        child.terminate()
        status = child.wait(HANG_S)
        self.kill(name)
        return status

    def kill(self, name: str) -> None:
        child = self._running.pop(name)
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        if child.stdin is not None:
            child.stdin.close()

    def stop(self) -> None:
        for name in list(self._running):
            self.kill(name)
