"""A process of the nursery is for tests what `python -m` starts."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from rodeo.host.instance import lock_holder
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support import command
from tests.support.nursery import Fork, Nursery
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def nursery() -> Iterator[Nursery]:
    with Nursery() as nursery:
        yield nursery


def start(nursery: Nursery, log: Path, module: str, *arguments: str) -> Fork:
    with open(log, "ab") as output:
        return nursery.start(module, list(arguments), output, os.environ)


def test_it_gets_its_arguments_and_its_exit_status_and_output_are_its_own(
    nursery: Nursery, tmp_path: Path
) -> None:
    refused = start(nursery, tmp_path / "refused.log", "deploy.router", "--sight", "lab.toml")
    helped = start(nursery, tmp_path / "helped.log", "services.charger", "--help")
    assert (refused.wait(HANG_S), helped.wait(HANG_S)) == (2, 0)
    assert "required: --site" in (tmp_path / "refused.log").read_text()
    assert "usage: charger" in (tmp_path / "helped.log").read_text()


@pytest.mark.parametrize("folder", [ROOT, ROOT / "docs"])
@pytest.mark.parametrize("arguments", [("site", "check"), ("wallet", "--site", "none.toml"), ("tasks",)])
def test_a_command_says_what_it_says_when_it_is_started_anew(
    nursery: Nursery, folder: Path, arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Its folder decides which site is meant where none is named, and that while it is imported.
    env = {name: value for name, value in os.environ.items() if name != "RODEO_SITE"}
    said = []
    for forks in (None, nursery):
        monkeypatch.setattr(RunningSite, "nursery", forks)
        done = command.rodeo(*arguments, env=env, timeout_s=HANG_S, folder=folder)
        said.append((done.returncode, done.stdout, done.stderr))
    anew, fork = said
    assert fork == anew and any(anew)


def test_it_has_its_folder_and_its_session_and_is_gone_once_killed(
    nursery: Nursery, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    child = start(nursery, tmp_path / "log", "http.server", "--bind", "127.0.0.1", "0")
    assert child.poll() is None
    # It has them before it runs its module, and that is soon.
    process = Path(f"/proc/{child.pid}")
    wait_until(lambda: os.getsid(child.pid) == child.pid and (process / "cwd").readlink() == tmp_path)
    child.kill()
    assert child.wait(HANG_S) == child.poll() == child.returncode == -signal.SIGKILL
    child.terminate()  # nobody has its number any more, or somebody else


def test_waiting_ends_with_the_time_that_was_given_for_it(nursery: Nursery, tmp_path: Path) -> None:
    child = start(nursery, tmp_path / "log", "http.server", "--bind", "127.0.0.1", "0")
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.05)
    child.terminate()
    assert child.wait(HANG_S) == -signal.SIGTERM


def test_what_comes_after_a_start_that_nobody_waited_for_is_told_its_own_number(
    nursery: Nursery, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def give_up(_fork: Fork, news: int) -> None:
        os.close(news)
        raise TimeoutError

    with monkeypatch.context() as patched, pytest.raises(TimeoutError):
        patched.setattr(Fork, "__init__", give_up)
        start(nursery, tmp_path / "given_up.log", "deploy.router", "--help")
    child = start(nursery, tmp_path / "log", "deploy.router", "--help")
    assert child.wait(HANG_S) == 0
    assert "usage: router" in (tmp_path / "log").read_text()


def test_a_sites_processes_end_with_the_nursery(tmp_path: Path) -> None:
    running = RunningSite(write_site(tmp_path), wallets=False)
    with Nursery() as running.nursery:  # type: ignore[misc]
        running.start("router")
        router = running.children["router"]
        assert lock_holder(running.site.data_dir / "router") == router.pid
        running.bus.close()
    wait_until(lambda: lock_holder(running.site.data_dir / "router") is None, lambda: running.log("router"))
    assert router.poll() == -signal.SIGTERM
