"""The bin of examples/my_bin.py, run as it stands there, until a robot is paid."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from rodeo.host.instance import PARENT_VARIABLE
from tests.support.live import LiveDao
from tests.support.site import NewSite, RunningSite

pytestmark = pytest.mark.long

PROGRAM = Path(__file__).parents[2] / "examples" / "my_bin.py"
SITE = "clock.speed = 4\nagent.explore_when_idle = false\nlab.furniture = []"


def test_the_foreign_bin_imports_nothing_of_the_services() -> None:
    for node in ast.walk(ast.parse(PROGRAM.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith(("services", "deploy", "tests")), node.module


@pytest.fixture
def running(new_site: NewSite) -> Iterator[RunningSite]:
    with RunningSite(new_site(SITE)) as running:
        logs = running.site.data_dir / "logs"
        running.start_founded()
        running.start("robot_sim", "bridge", "oracle")
        with (logs / "itrash.log").open("ab") as output:
            running.children["itrash"] = subprocess.Popen(
                [sys.executable, str(PROGRAM), "--site", str(running.path)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, PARENT_VARIABLE: str(os.getpid())},
            )
        running.wait_ready("itrash")
        running.start("robot_agent")
        yield running


def test_a_robot_is_paid_on_the_word_of_a_bin_of_another_make(running: RunningSite) -> None:
    with closing(LiveDao(running)) as organization:
        organization.wait_for_event("TaskSettled", organization.clean(running.site.items[0].id))
