"""The programs of examples/ against one running site: as they stand there, they see a task paid."""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from rodeo.access.accounts import Accounts, accounts_path
from rodeo.access.roles import Role
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.errors import RodeoError
from rodeo.runtime.process import is_transient, repeated
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, PAUSE_S
from tests.support.dao import Dao
from tests.support.site import LAB, RunningSite, free_port

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).parents[2] / "examples"


class Robot:
    """Hands in a proof of each task that it is assigned at once; the oracle rules as `ruling` says."""

    def __init__(self, dao: Dao) -> None:
        self._dao = dao
        self._todo: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self.may_work = threading.Event()
        self.may_work.set()
        self.ruling = "accepted"
        self.failure: RodeoError | None = None
        """For what its thread has ended."""
        self._stop = threading.Event()
        dao.command("panther1", "register_service", kind="waste_disposal", price_iec="90")
        self._thread = threading.Thread(target=self._work)
        self._thread.start()
        self._events = DaoEvents(dao.running.bus, dao.site.org, self._on_event)

    def _on_event(self, event: DaoEvent) -> None:
        if event.name == "TaskAssigned":
            self._todo.put(event.task_id)

    def _work(self) -> None:
        try:
            while (task_id := self._todo.get()) is not None:
                self.may_work.wait(timeout=HANG_S)
                repeated(partial(self._do, task_id), self._again, self._stop)
        except RodeoError as error:
            self.failure = error

    def _do(self, task_id: int) -> None:
        """What is left to do of the task: an answer of the bridge may have been lost."""
        if self._dao.task(task_id)["state"] == "assigned":
            self._dao.prove(task_id)
        if self._dao.task(task_id)["state"] == "submitted":
            if self.ruling == "accepted":
                self._dao.judge(task_id, True)
            else:
                self._dao.verdict(task_id, self.ruling, "it was not there")

    def _again(self, error: RodeoError) -> None:
        if not is_transient(error):
            raise error
        self._stop.wait(PAUSE_S)

    def stop(self) -> None:
        self._events.close()
        self._stop.set()
        self._todo.put(None)
        self._thread.join(timeout=HANG_S)


class Lab:
    """examples/site.toml on free ports, and what a program is given to reach it."""

    def __init__(self, folder: Path, chain_backend: str) -> None:
        text = (EXAMPLES / "site.toml").read_text()
        for written, meant in {
            '"../deploy/sites/lab.toml"': json.dumps(str(EXAMPLES.parent / "deploy/sites/lab.toml")),
            '"../var/example"': json.dumps(str(folder / "data")),
            "8089": str(free_port()),
            "8546": str(free_port()),
            "http_port = 8091": "",  # a free one
        }.items():
            assert written in text
            text = text.replace(written, meant)
        text = text.replace("[chain]", f"[chain]\nbackend = {json.dumps(chain_backend)}")
        (folder / "site.toml").write_text(text)
        self.running = RunningSite(folder / "site.toml")
        self.dao = Dao(self.running)

    def start(self) -> None:
        self.dao.start()
        self.running.start("console")
        self.url = str(self.running.status("console").details["http"])
        accounts = Accounts(accounts_path(self.running.site), self.running.site.console)
        accounts.add_user("ada", "correct horse battery", [Role.OPERATOR])
        self.token = accounts.issue_token("ada", "examples")
        accounts.close()
        self.robot = Robot(self.dao)

    @property
    def environment(self) -> dict[str, str]:
        return {**os.environ, "RODEO_TOKEN": self.token, "PYTHONPATH": str(EXAMPLES.parent)}

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        assert self.robot.failure is None, self.robot.failure
        return subprocess.run(
            words,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=HANG_S,
            check=False,
            stdin=subprocess.DEVNULL,
        )


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Lab]:
    lab = Lab(tmp_path_factory.mktemp("examples"), chain_backend)
    try:
        lab.start()
        yield lab
        lab.robot.stop()
    finally:
        lab.dao.close()
        lab.running.stop()


def program(lab: Lab, name: str) -> list[str]:
    """The words that start it, without the item and the ID of the request."""
    path, site = str(EXAMPLES / name), lab.running.site
    return {
        "post_and_wait.py": [sys.executable, path, str(lab.running.path)],
        "post_and_wait_zenoh.py": [sys.executable, path, site.bus.router, site.org],
        "post_and_wait.sh": ["sh", path, lab.url],
        "post_and_wait.mjs": ["node", path, lab.url],
    }[name]


PROGRAMS = ["post_and_wait.py", "post_and_wait_zenoh.py", "post_and_wait.sh", "post_and_wait.mjs"]


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_posts_a_task_and_waits_until_it_is_paid(lab: Lab, name: str) -> None:
    words = program(lab, name)
    if shutil.which(words[0]) is None:
        pytest.skip(f"{words[0]} is not installed")
    done = lab.run(*words, "item1", f"one of {name}")
    assert done.returncode == 0, done.stdout + done.stderr
    task_id = int(done.stdout.split()[1])
    task = lab.dao.task(task_id)
    assert (task["state"], task["params"]["item_id"], task["paid_iec"]) == ("settled", "item1", "90")
    # After a restart it sends the same request: nothing is posted twice.
    again = lab.run(*words, "item1", f"one of {name}")
    assert again.returncode == 0, again.stdout + again.stderr
    assert f"task {task_id} is posted" in again.stdout
    assert lab.dao.state("tasks", limit=1)["tasks"][0]["id"] == task_id


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_ends_badly_where_the_work_was_not_done(lab: Lab, name: str) -> None:
    words = program(lab, name)
    if shutil.which(words[0]) is None:
        pytest.skip(f"{words[0]} is not installed")
    lab.robot.ruling = "impossible"
    try:
        done = lab.run(*words, "item1", f"nothing of {name}")
    finally:
        lab.robot.ruling = "accepted"
    task = lab.dao.task(int(done.stdout.split()[1]))
    assert (task["state"], task["verdict"]) == ("settled", "impossible")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "impossible" in done.stdout


@pytest.mark.parametrize("name", ["post_and_wait.sh", "post_and_wait.mjs"])
def test_a_program_waits_for_a_console_that_starts_again(lab: Lab, name: str) -> None:
    words = program(lab, name)
    if shutil.which(words[0]) is None:
        pytest.skip(f"{words[0]} is not installed")
    lab.robot.may_work.clear()
    words += ["item1", f"long wait of {name}"]
    with subprocess.Popen(
        words,
        env=lab.environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as running:
        assert running.stdout is not None
        try:
            assert "is posted" in running.stdout.readline()
            lab.running.kill("console")
            lab.running.start("console")
            lab.robot.may_work.set()
            assert "ettled" in running.communicate(timeout=HANG_S)[0]
        finally:
            lab.robot.may_work.set()
            running.kill()
    assert running.returncode == 0


def test_the_site_shares_no_port_and_no_folder_with_the_lab() -> None:
    def taken(site: Site) -> set[str]:
        bins = {str(one.http_port) for one in site.bins}
        return {str(site.console.port), site.chain.url, str(site.data_dir), *bins}

    assert taken(Site.load(EXAMPLES / "site.toml")).isdisjoint(taken(Site.load(LAB)))


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_says_why_a_task_was_refused(lab: Lab, name: str) -> None:
    words = program(lab, name)
    if shutil.which(words[0]) is None:
        pytest.skip(f"{words[0]} is not installed")
    done = lab.run(*words, "item99", f"wrong of {name}")
    assert done.returncode != 0
    assert "invalid_request" in done.stdout + done.stderr and "x_m" in done.stdout + done.stderr
