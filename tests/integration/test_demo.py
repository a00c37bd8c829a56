"""The demo as its user runs it: two settled tasks, a summary that adds up, and nothing left behind."""

import json
import os
import select
import shlex
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from rodeo_cli.demo import DEMO_SOC_ABOVE
from rodeo_testing.waiting import HANG_S
from tests.support.site import LAB_PROCESSES


def start_demo(out: Path, chain_backend: str, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "rodeo_cli", "demo", "--out", str(out), "--chain", chain_backend, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def wait_for_logs(demo: subprocess.Popen[str], out: Path, count: int) -> None:
    """Return once `count` processes were started by the demo."""
    logs = out / "data" / "logs"
    pause = threading.Event()
    while not (count == 0 or (logs.exists() and len(list(logs.iterdir())) >= count)):
        assert demo.poll() is None, demo.communicate()[0]
        pause.wait(0.02)


def left_behind(out: Path) -> list[str]:
    """Command lines of processes that still work on the demo's site."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            try:
                command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if str(out) in command:
                found.append(command)
    return found


def opens(link: str) -> bool:
    """Whether a link of the demo's logs somebody in to the console, as the page's script would use it."""
    page, _, token = link.partition("#")
    with httpx.Client(headers={"origin": page.removesuffix("/login/link")}, timeout=HANG_S) as browser:
        answer = browser.post(page, data={"token": token})
        assert answer.status_code in (303, 401), answer.text
        return answer.status_code == 303 and browser.get(page.removesuffix("login/link")).status_code == 200


@pytest.mark.long
def test_a_demo_that_is_kept_is_looked_at_while_it_runs_and_afterwards(
    tmp_path: Path, chain_backend: str
) -> None:
    demo = start_demo(tmp_path / "demo", chain_backend, "--keep")
    assert demo.stdout is not None
    lines, links = [], []
    for line in demo.stdout:
        lines.append(line)
        if "/login/link#" in line:
            links.append(line.strip())
            assert opens(links[-1]) and not opens(links[-1]), "it is for once"
    # The command has ended, and the site has not.
    output = "".join(lines)
    assert demo.wait(HANG_S) == 0 and len(links) == 2, output
    assert left_behind(tmp_path) != []
    tried = [shlex.split(line) for line in lines[-3:]]
    assert ["create" in tried[0], "list" in tried[1], "down" in tried[2]] == [True] * 3, output
    for words in tried:
        done = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S)
        assert done.returncode == 0, done.stderr
    assert left_behind(tmp_path) == []


@pytest.mark.long
def test_the_demo_settles_both_tasks_and_its_summary_adds_up(tmp_path: Path, chain_backend: str) -> None:
    demo = start_demo(tmp_path / "demo", chain_backend)
    output, _ = demo.communicate()
    assert demo.returncode == 0, output
    assert left_behind(tmp_path) == []

    summary = json.loads((tmp_path / "demo" / "summary.json").read_text())
    tasks = {task["kind"]: task for task in summary["tasks"]}
    assert len(summary["tasks"]) == 2
    cleaning, charging = tasks["waste_disposal"], tasks["battery_charging"]
    assert (cleaning["creator"], cleaning["executor"]) == ("organization", "panther1")
    assert (charging["creator"], charging["executor"]) == ("panther1", "organization")
    assert (cleaning["reward_iec"], cleaning["paid_iec"]) == (100, 100)
    assert (charging["reward_iec"], charging["paid_iec"]) == (200, 200)
    for task in summary["tasks"]:
        assert (task["state"], task["verdict"], task["attempts"]) == ("settled", "accepted", 1)
        times = [task[name] for name in ("registered", "assigned", "proof_submitted", "settled")]
        assert times == sorted(times)
        assert task["proof_uri"].endswith(f"{task['proof_sha256'].removeprefix('0x')}.mcap")
    assert summary["wallets"] == {
        "organization": {"before_iec": 2000, "after_iec": 2100},
        "panther1": {"before_iec": 2000, "after_iec": 1900},
    }
    assert summary["supply_iec"]["before"] == summary["supply_iec"]["after"]
    # The site's clock stood until the task was posted, however long the start took.
    assert summary["soc_when_posted"] == pytest.approx(0.5 + DEMO_SOC_ABOVE, abs=0.0005)


@pytest.mark.parametrize(
    ("running", "number", "options"),
    [
        (0, signal.SIGINT, ()),
        pytest.param(1, signal.SIGHUP, (), marks=pytest.mark.long),
        (4, signal.SIGTERM, ("--keep",)),
        pytest.param(len(LAB_PROCESSES), signal.SIGINT, (), marks=pytest.mark.long),
    ],
)
def test_a_demo_that_is_stopped_leaves_no_process_behind_and_can_be_run_again(
    tmp_path: Path, chain_backend: str, running: int, number: signal.Signals, options: tuple[str, ...]
) -> None:
    """Stop the demo when `running` processes have begun to log: by Ctrl-C, a closed terminal, or `kill`."""
    out = tmp_path / "demo"
    for logs in (running, 1):
        demo = start_demo(out, chain_backend, *options)
        wait_for_logs(demo, out, logs)
        os.kill(demo.pid, number)
        output, _ = demo.communicate(timeout=HANG_S)
        # While it is still being imported the process just ends by the signal.
        assert demo.returncode == 130 or (running == 0 and demo.returncode == -number), output
        assert "Traceback" not in output
        assert left_behind(tmp_path) == []
        shutil.rmtree(out / "data" / "logs", ignore_errors=True)


@pytest.mark.long
def test_processes_end_with_a_launcher_that_was_killed(tmp_path: Path, chain_backend: str) -> None:
    out = tmp_path / "demo"
    demo = start_demo(out, chain_backend)
    # The contracts' log is one more, and each log is there shortly before its process.
    wait_for_logs(demo, out, len(LAB_PROCESSES) + 1)
    children = _children(demo.pid)
    assert len(children) >= len(LAB_PROCESSES)
    demo.kill()
    demo.communicate(timeout=HANG_S)
    for child in children:
        assert select.select([child], [], [], HANG_S)[0], left_behind(tmp_path)
        os.close(child)


def _children(pid: int) -> list[int]:
    """A descriptor of each child, which becomes readable when the child has ended."""
    descriptors = []
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        with suppress(ProcessLookupError):  # ended just now
            descriptors.append(os.pidfd_open(int(child)))
    return descriptors
