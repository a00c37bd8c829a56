"""Any process may be killed in the middle of the work: it is started again and both tasks finish.

The agent with an item in its gripper is in test_agent.py.
"""

import json
import os
import signal
import threading
from pathlib import Path

import pytest

from rodeo.host.instance import lock_holder
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S
from tests.integration.test_demo import start_demo

pytestmark = pytest.mark.long

ASSIGNED, PROOF, CHARGING = "assigned to panther1", "proof submitted", "assigned to organization"


@pytest.mark.parametrize(
    "kills",
    [
        {ASSIGNED: ["robot_sim", "itrash"], PROOF: ["oracle"], CHARGING: ["charger"]},
        {ASSIGNED: ["router"], PROOF: ["bridge", "chain"], CHARGING: ["robot_agent"]},
    ],
    ids=["body and judges", "bus, chain and mind"],
)
def test_the_tasks_finish_although_processes_are_killed(
    tmp_path: Path, chain_backend: str, kills: dict[str, list[str]]
) -> None:
    out = tmp_path / "demo"
    demo = start_demo(out, chain_backend)
    assert demo.stdout is not None
    lines = []
    waiting = dict(kills)
    for line in demo.stdout:
        lines.append(line)
        for text in [text for text in waiting if text in line]:
            for number, name in enumerate(waiting.pop(text), 1):
                # In the middle of what follows, not at its very start.
                threading.Timer(2.0 * number, _kill, (out, name)).start()
    assert demo.wait(timeout=HANG_S) == 0, "".join(lines)
    assert waiting == {}
    tasks = json.loads((out / "summary.json").read_text())["tasks"]
    assert [task["state"] for task in tasks] == ["settled", "settled"]


def _kill(out: Path, name: str) -> None:
    pid = lock_holder(Site.load(out / "site.toml").data_dir / name)
    assert pid is not None, f"{name} does not run"
    os.kill(pid, signal.SIGKILL)
