"""Runs cases, each in a process of its own, and counts."""

from __future__ import annotations

import importlib
import json
import math
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing.process import BaseProcess
from pathlib import Path

from bench.faults.case import CASES, Case
from bench.faults.lab import PARTICIPANTS, Lab, NotSurvived
from rodeo.errors import RodeoError
from rodeo.runtime.process import die_with
from tests.support.site import RunningSite, write_site

AREAS = (
    "disks",
    "files",
    "stops",
    "partitions",
    "reorganizations",
    "doubles",
    "starts",
    "judge",
    "dock",
    "robot",
)
AT_ONCE = 2
"""Cases that keep the machine busy, at the same time."""
WAITING_AT_ONCE = 3
"""Cases that only wait, beside them."""
CASE_S = 3600.0
"""Wall time after which a case hangs."""
_FORK = multiprocessing.get_context("fork")


@dataclass(frozen=True)
class Result:
    name: str
    survived: bool
    why: str = ""
    """Why not."""
    how: str = ""
    """What stood for the fault, where there is a choice."""
    recovery_s: float = math.nan
    took_s: float = 0.0


def selected(words: Sequence[str] = ()) -> list[Case]:
    """The cases whose name or area contains one of the words, or is it; all without words."""
    for area in AREAS:
        importlib.import_module(f"bench.faults.{area}")
    found = [
        one
        for one in CASES.values()
        if not words
        or any(one.name == word if word in CASES else word in f"{one.area} {one.name}" for word in words)
    ]
    # The longest first, so that none is left alone at the end.
    return sorted(found, key=lambda one: -one.held_s)


def figures_of(results: Sequence[Result]) -> dict[str, float]:
    recoveries_s = sorted(one.recovery_s for one in results if one.survived)
    figures: dict[str, float] = {"faults_cases": len(results), "faults_survived": len(recoveries_s)}
    if recoveries_s:
        figures["faults_recovery_s_p95"] = recoveries_s[math.ceil(0.95 * len(recoveries_s)) - 1]
    return figures


def run_cases(cases: Sequence[Case], at_once: int = AT_ONCE) -> list[Result]:
    """All of them, in the order in which they end; a line is printed for each."""
    with tempfile.TemporaryDirectory(prefix="rodeo-faults-") as name:
        folder = Path(name)
        template = folder / "template"
        _in_a_process(lambda: _prepare(template))
        lanes = [
            (deque(one for one in cases if not one.waits), at_once),
            (deque(one for one in cases if one.waits), WAITING_AT_ONCE),
        ]
        running: dict[str, tuple[BaseProcess, Case, float]] = {}
        results: list[Result] = []
        pause = threading.Event()
        try:
            while running or any(queue for queue, _room in lanes):
                for waits, (queue, room) in enumerate(lanes):
                    while queue and sum(one.waits == waits for _p, one, _s in running.values()) < room:
                        one = queue.popleft()
                        process: BaseProcess = _FORK.Process(
                            target=_run, args=(one, folder, template / "data", os.getpid())
                        )
                        process.start()
                        running[one.name] = process, one, time.monotonic()
                for process, one, started_s in list(running.values()):
                    took_s = time.monotonic() - started_s
                    if process.is_alive() and took_s <= CASE_S:
                        continue
                    results.append(_ended(process, one, folder, took_s))
                    del running[one.name]
                    _print(results[-1])
                pause.wait(0.1)
        finally:
            for process, _one, _started_s in running.values():
                _kill(process)
        print(f"{sum(one.survived for one in results)} of {len(results)} survived", flush=True)
        return results


def _prepare(template: Path) -> None:
    """The data directory of a site with its contracts deployed, from which the others are copied."""
    template.mkdir()
    with RunningSite(write_site(template, extra=PARTICIPANTS)) as running:
        running.start("router", "chain")
        running.deploy_contracts()
    shutil.rmtree(template / "data" / "logs")


def _in_a_process(body: Callable[[], None]) -> None:
    """No bus may be opened in the process that the cases are forked from."""
    process = _FORK.Process(target=body)
    process.start()
    process.join(CASE_S)
    if process.exitcode != 0:
        _kill(process)
        raise NotSurvived("no site could be prepared")


def _run(one: Case, folder: Path, template: Path, parent: int) -> None:
    """The body of a case's process."""
    os.setsid()
    die_with(parent, signal.SIGKILL)
    own = folder / one.name
    own.mkdir()
    with (
        (own / "output.txt").open("w", buffering=1) as output,
        redirect_stdout(output),
        redirect_stderr(output),
    ):
        _write(own, _tried(one, own, template))
    # Threads of a bus that does not end must not keep the process.
    os._exit(0)


def _tried(one: Case, own: Path, template: Path) -> Result:
    started_s = time.monotonic()
    try:
        lab = Lab(one, own, template if one.backend == "eth-tester" else None)
    except RodeoError as error:
        return Result(one.name, False, str(error))
    found: list[Result] = []

    def script() -> None:
        try:
            recovery_s = lab.run()
            how = "" if lab.disk is None else "tmpfs" if lab.disk.mounted else "limited file size"
            result = Result(one.name, True, how=how, recovery_s=recovery_s)
        except NotSurvived as error:
            result = Result(one.name, False, f"{error}; {lab.not_ready()}")
        except Exception as error:  # noqa: BLE001 - whatever it is, the next case is run
            traceback.print_exc()
            result = Result(one.name, False, f"{type(error).__name__}: {error}")
        # Kept before anything is closed, which may take its time.
        found.append(result)
        _write(own, result)
        lab.close()

    thread = threading.Thread(target=script, name=one.name, daemon=True)
    thread.start()
    lab.serve()
    thread.join(5.0)
    result = found[0]
    return replace(result, took_s=time.monotonic() - started_s)


def _write(own: Path, result: Result) -> None:
    (own / "result.json").write_text(json.dumps(asdict(result)))


def _ended(process: BaseProcess, one: Case, folder: Path, took_s: float) -> Result:
    in_time = not process.is_alive()
    _kill(process)
    own = folder / one.name
    try:
        result = Result(**json.loads((own / "result.json").read_text()))
    except FileNotFoundError:
        result = Result(one.name, False, "it ended without a word" if in_time else "not done in time")
    if not in_time and result.survived:
        result = Result(one.name, False, "it did not stop")
    kept = os.environ.get("RODEO_FAULTS_KEEP")
    if kept and not result.survived:
        shutil.copytree(
            own, Path(kept) / one.name, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.sock")
        )
    shutil.rmtree(own, ignore_errors=True)
    return replace(result, took_s=took_s)


def _kill(process: BaseProcess) -> None:
    if process.pid is not None:
        # It has ended, as it should, where there is none.
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.join()


def _print(result: Result) -> None:
    how = (
        f"survived, again at work after {result.recovery_s:.1f} s{result.how and f', {result.how}'}"
        if result.survived
        else f"NOT: {result.why}"
    )
    print(f"{result.name:34} {how} ({result.took_s:.0f} s)", flush=True)
