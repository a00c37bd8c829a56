"""Nodes as a user writes them: `examples/ros2` as processes, on a stand-in for rclpy."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

from rodeo.host.instance import PARENT_VARIABLE
from rodeo.site.config import Site
from rodeo_cli.ros2 import session_file
from rodeo_testing.waiting import HANG_S

TESTS = Path(__file__).parents[1]
EXAMPLES = TESTS.parent / "examples" / "ros2"
STAND_IN = TESTS / "ros2_stand_in"


class RosNode:
    """The process of one example.

    Args:
        participant: whose node it is: its certificate and its namespace.
        router: where it finds the site's router, by default where that is.
        parameters: its ROS parameters.
    """

    def __init__(
        self, site: Site, name: str, participant: str, router: str = "", **parameters: object
    ) -> None:
        session = session_file(site, participant)
        session["connect"]["endpoints"] = [router or site.bus.router]
        files = [site.data_dir / f"{name}.{end}" for end in ("json5", "out", "log")]
        files[0].write_text(json.dumps(session))
        self._out, self._log = files[1], files[2]
        rules = [f"{key}:={json.dumps(value)}" for key, value in parameters.items()]
        with self._out.open("wb") as out, self._log.open("wb") as log:
            self.process = subprocess.Popen(
                [
                    *(sys.executable, str(STAND_IN / "run.py"), str(EXAMPLES / f"{name}.py"), "--ros-args"),
                    *("-r", f"__ns:=/{site.org}/{participant}"),
                    *(word for rule in rules for word in ("-p", rule)),
                ],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=log,
                start_new_session=True,
                cwd=site.data_dir,
                env={
                    **{name: value for name, value in os.environ.items() if name != PARENT_VARIABLE},
                    "PYTHONPATH": str(STAND_IN),
                    "RMW_ZENOH_SESSION_CONFIG_URI": str(files[0]),
                },
            )

    @property
    def log(self) -> str:
        return self._log.read_text(errors="replace")

    @property
    def modules(self) -> set[str]:
        """Top-level names of what it had imported at its end."""
        (said,) = (line for line in self._out.read_text().splitlines() if line.startswith("modules "))
        return set(json.loads(said.removeprefix("modules ")))

    def interrupt(self) -> int:
        """Ctrl-C; the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(HANG_S)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
