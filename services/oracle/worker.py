"""One verification in a process of its own: what a hostile proof breaks, it breaks there.

The child writes its report to a file and ends; the parent reads it, or learns from the exit that there is
none. Nothing is shared, so a crash, a hang or a full memory costs one proof its verdict and nobody else.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import resource
import signal
import tempfile
import threading
import time
from functools import cache
from multiprocessing.context import ForkServerContext
from pathlib import Path

from rodeo.config import Site
from rodeo.service import die_with
from services.oracle.case import Ledger
from services.oracle.report import Check, Report

MEMORY_BYTES = 4 << 30
"""Address space of one verification: several times what the largest allowed proof needs."""

_STOP_SLICE_S = 0.2
"""Longest wait before a stop is noticed."""
_SIGNAL_GRACE_S = 1.0
"""Between the end of a child and our own signal, when both got one."""


def verify_apart(
    site: Site,
    ledger: Ledger,
    scratch: Path,
    time_limit_s: float,
    stop: threading.Event,
    memory_bytes: int = MEMORY_BYTES,
) -> Report | None:
    """The report on a submitted proof, in at most `time_limit_s` of wall time; None when `stop` was set.

    A verification that takes longer, crashes or runs out of memory is a report that says so. `scratch` is
    where its folder goes, which is removed.
    """
    scratch.mkdir(parents=True, exist_ok=True)
    # A folder of its own: a child that outlived a killed oracle must not answer for another proof.
    with tempfile.TemporaryDirectory(dir=scratch, ignore_cleanup_errors=True) as folder:
        path = Path(folder, "report.json")
        process = _context().Process(
            target=_child,
            args=(site, ledger, Path(folder), path, memory_bytes),
            name=f"verify task {ledger.task.id}",
            daemon=True,
        )
        process.start()
        deadline_s = time.monotonic() + time_limit_s
        while process.is_alive() and time.monotonic() < deadline_s and not stop.is_set():
            process.join(min(_STOP_SLICE_S, max(0.0, deadline_s - time.monotonic())))
        hung = process.is_alive()
        if hung:
            process.kill()
            process.join()
        if path.exists():
            return Report.model_validate_json(path.read_bytes())
        # Signals that end the oracle may reach the child first: that is no fault of the proof.
        if stop.wait(_SIGNAL_GRACE_S):
            return None
        return _without_report(ledger, process.exitcode, time_limit_s if hung else None)


def _without_report(ledger: Ledger, exit_status: int | None, time_limit_s: float | None) -> Report:
    """`time_limit_s` if that is what ended the verification."""
    if time_limit_s is not None:
        check = Check(
            name="verification_ended",
            passed=False,
            limit=time_limit_s,
            unit="s",
            source="the oracle's own time limit",
            detail=f"the verification took longer than {time_limit_s:g} s",
        )
    else:
        check = Check(
            name="verification_ended",
            passed=False,
            measured=exit_status,
            limit=0,
            source="exit status",
            detail="the verification crashed",
        )
    task = ledger.task
    return Report.of(
        [check], kind=task.kind, task_id=task.id, attempt=task.attempt, proof_sha256=task.proof_sha256
    )


@cache
def _context() -> ForkServerContext:
    """Children come from a process that has loaded MuJoCo already, and nothing else of ours."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["services.oracle.verify", "services.oracle.replay"])
    return context


def _child(site: Site, ledger: Ledger, folder: Path, path: Path, memory_bytes: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    die_with(os.getppid(), signal.SIGKILL)  # the fork server, which ends with the oracle
    gc.disable()  # it ends soon, and looking for garbage among all those messages takes a tenth of its time
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    # Imported here: the oracle itself has no use for MuJoCo.
    from services.oracle.verify import verify_submission

    report = verify_submission(site, ledger, folder)
    part = path.with_suffix(".part")
    part.write_bytes(report.to_bytes())
    part.replace(path)
