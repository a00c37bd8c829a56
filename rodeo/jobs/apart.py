"""One verification in a process of its own: what a hostile proof breaks, it breaks there.

The child writes its report to a file and says so; the parent reads it, or learns from the child's end that
there is none. Nothing is shared, so a crash, a hang or a full memory costs one proof its verdict and nobody
else. An oracle, whose verdict pays, has a child for each proof. Where nobody is paid, `Children` spare what
is computed anew in each: a child verifies the next proof, too, as long as it accepts them.

What a proof may cost is bounded by counts that every judge finds the same (`rodeo.checks.counts`). What
the limits here allow differs from machine to machine, so they never reject: a verification that meets one is
tried once more and then given up, which fines nobody and pays nobody.
"""

from __future__ import annotations

import gc
import logging
import math
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from rodeo.bus.messages import Task
from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Check, Report, given_up, undecided
from rodeo.errors import DiskFull, RodeoError, snake_case
from rodeo.evidence.errors import (
    EvidenceError,
    ProofHashMismatch,
    ProofNotFound,
    ProofTooLarge,
    ProofUriNotAllowed,
    StoreUnavailable,
)
from rodeo.evidence.store import Store
from rodeo.host.files import is_full, replace_file, writing
from rodeo.kinds import KindError, kinds_of
from rodeo.runtime.process import die_with
from rodeo.site.config import Site
from rodeo.site.sections import OracleConfig
from rodeo.text.strict_json import plain, read_json, write_json

log = logging.getLogger(__name__)

MEMORY_BYTES = 6 << 30
"""Address space of one verification: twice what the largest allowed proof was measured to need."""
ATTEMPTS = 2
"""A verification that ended without a report is tried once more: the machine may have been the reason."""
ENDED = "verification_ended"
"""Name of the check that fails where a verification gave no report."""
PROOFS = 100
"""Proofs that one of `Children` verifies at most: what it gathers meanwhile never meets a limit."""
FAULT = "the oracle"
"""The party at fault for an undecided verdict: this oracle failed, neither the parties nor the store."""


class VerifierEnded(RodeoError):
    """There is no process to verify in."""


class VerificationFailed(RodeoError):
    """A verification ended without a report, and may be tried once more."""


_PROGRAMS = "services.oracle.process", "rodeo_cli.commands"
"""What the main modules of programs that verify import."""
_NOT_STARTED = (EOFError, OSError)
"""Errors when the fork server has ended, or does not start."""
_STOP_SLICE_S = 0.2
"""Longest wait before a stop is noticed."""
_SIGNAL_GRACE_S = 1.0
"""Between the end of a child and our own signal, when both got one; and for a child to end by itself."""


def start(site: Site) -> dict[str, str | None]:
    """Start the process that verifications are forked from; returns when it has loaded what they need.

    Returns the rules that it judges by: kind -> hash, None if the kind's checks cannot be imported, or a
    model that they use cannot be read. Raises VerifierEnded.
    """
    context = _context_of(site)
    told, teller = context.Pipe(duplex=False)
    child = context.Process(target=_tell_rules, args=(site, teller), name="first child", daemon=True)
    try:
        child.start()
    except _NOT_STARTED as error:
        # The kinds' checks that it loads may raise anything.
        raise VerifierEnded("the process that verifies did not start", reason=repr(error)[:200]) from error
    teller.close()
    try:
        rules: dict[str, str | None] = told.recv()
    except EOFError:
        child.join()
        raise VerifierEnded(
            "the process that verifies ended before it named its rules", exit_status=child.exitcode
        ) from None
    child.join()
    return rules


def verify_apart(
    site: Site,
    chain_record: ChainRecord | None,
    scratch: Path,
    stop: threading.Event,
    *,
    limits: OracleConfig | None = None,
    memory_bytes: int = MEMORY_BYTES,
    copy: Path | None = None,
    failed: int = 0,
    submitted: bool = True,
    log_to: Path | None = None,
    children: Children | None = None,
) -> Report | None:
    """The report on a submitted proof; None when `stop` was set. `limits` are the site's own by default,
    `copy` is the proof itself where it was fetched already, `failed` counts its failed verifications. What
    was not `submitted` is any file at `copy`, which may be a bag, or of no chain. The child's log is this
    process's, or the file `log_to`; it is one of the site's `children`, or one for this proof alone.

    A verification that uses up its CPU time, hangs, crashes or runs out of memory raises VerificationFailed,
    the second such is given up, unless no chain is asked. If it cannot be started twice, the report is
    undecided. Its folder, which is removed, goes into `scratch`. Raises EvidenceError when the proof could
    not be fetched, in time either, and DiskFull: both are for the caller to wait for.
    """
    limits = limits or site.oracle
    what = What(chain_record, copy, submitted, limits.cpu_limit_s, memory_bytes, log_to)
    once = _once(what, scratch, stop, limits.time_limit_s, children or Children(site, proofs=1))
    # Signals that end the oracle may reach the child first, which is no fault of the proof.
    if once.report is not None or stop.wait(_SIGNAL_GRACE_S):
        return once.report
    if chain_record is None:
        raise VerificationFailed(once.ended)
    task = chain_record.task
    log.warning("task %d attempt %d: %s", task.id, task.attempt, once.ended)
    if failed + 1 < ATTEMPTS:
        raise VerificationFailed(once.ended, task_id=task.id, attempt=task.attempt)
    source = "the oracle's own process"
    found = undecided(f"{once.ended}, {ATTEMPTS} times", FAULT, source)
    if once.began:  # without how it ended: other judges find the same, and only equal reports get their votes
        found = given_up(f"the verification ended without a report, {ATTEMPTS} times", source, FAULT)
    return report_on(task, Check.of(ENDED, found), once.acts)


class _Once(NamedTuple):
    """What came of one child."""

    report: Report | None
    ended: str = ""
    """Why there is no report."""
    began: bool = True
    acts: tuple[str, ...] = ()
    """The proof's claims, as far as the child got."""


class What(NamedTuple):
    """What a child is asked."""

    chain_record: ChainRecord | None
    copy: Path | None
    submitted: bool
    cpu_limit_s: float
    memory_bytes: int
    log_to: Path | None


class Children:
    """Children that wait for a proof of `site`: each has accepted all that it verified, at most `proofs`. One
    whose proof came to anything else has ended, so that none breaks on what another proof left."""

    def __init__(self, site: Site, proofs: int = PROOFS) -> None:
        self._site, self._proofs = site, proofs
        self._waiting: SimpleQueue[_Child] = SimpleQueue()
        """Threads take them and give them back at the same time."""

    def take(self) -> _Child:
        """One that lives. Raises EOFError or OSError where none can be started."""
        with suppress(Empty):
            while not (child := self._waiting.get_nowait()).is_alive:
                child.end()
            return child
        return _Child(self._site)

    def give_back(self, child: _Child, accepted: bool) -> None:
        if accepted and child.asked < self._proofs and child.is_ready():
            self._waiting.put(child)
        else:
            child.end()

    def end(self) -> None:
        """End those that wait."""
        with suppress(Empty):
            while True:
                self._waiting.get_nowait().end()


class _Child:
    """A process that verifies. Raises EOFError or OSError where it cannot be started."""

    def __init__(self, site: Site) -> None:
        self.asked = 0
        context = _context_of(site)
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(_child, site, theirs), name="verification", daemon=True
        )
        with theirs:
            self._process.start()

    @property
    def is_alive(self) -> bool:
        return self._process.is_alive()

    def ask(self, what: What, folder: Path) -> None:
        self.asked += 1
        with suppress(BrokenPipeError):  # it ended, and its exit status says how
            self._pipe.send((what, folder))

    def is_done(self, longest_s: float) -> bool:
        """Whether it says that it has written what it found, or has ended."""
        return bool(wait([self._pipe, self._process.sentinel], longest_s))

    def is_ready(self) -> bool:
        """Whether it can be asked again. What it says is neither unpickled nor waited for: a proof may have
        taken it over."""
        try:
            return self._pipe.poll() and os.read(self._pipe.fileno(), len(_DONE) + 1) == _DONE
        except OSError:
            return False

    def end(self, at_once: bool = False) -> int:
        """End it; the exit status."""
        self._pipe.close()  # it ends when nobody can ask it
        self._process.join(0.0 if at_once else _SIGNAL_GRACE_S)
        self._process.kill()
        self._process.join()
        assert self._process.exitcode is not None
        return self._process.exitcode


def _once(what: What, scratch: Path, stop: threading.Event, time_limit_s: float, children: Children) -> _Once:
    """Raises EvidenceError, DiskFull."""
    with writing(scratch), _folder_in(scratch) as folder:
        path, away = Path(folder, _REPORT), Path(folder, _AWAY)
        try:
            child = children.take()
        except _NOT_STARTED as error:
            return _Once(None, f"the process to verify in did not start: {error!r}", began=False)
        child.ask(what, Path(folder))
        deadline_s, is_done = time.monotonic() + time_limit_s, False
        is_here = what.copy is not None
        while not is_done and time.monotonic() < deadline_s and not stop.is_set():
            is_done = child.is_done(min(_STOP_SLICE_S, max(0.0, deadline_s - time.monotonic())))
            if not is_here and Path(folder, _FETCHED).exists():  # what a store takes is not the proof's
                is_here, deadline_s = True, time.monotonic() + time_limit_s
        if path.exists():
            report = Report.model_validate_json(path.read_bytes())
            children.give_back(child, report.accepted)
            return _Once(report)
        exit_status = child.end(at_once=not is_done)
        if away.exists():
            said = read_json(away.read_bytes())
            raise _AWAY_FOR[said["code"]](said["message"], **said["details"])
        if exit_status == _NO_ROOM:
            raise DiskFull("no space left to verify the proof", folder=str(scratch))
        ended = f"the verification crashed with exit status {exit_status}"
        if not is_done:
            if not is_here and not stop.is_set():
                raise StoreUnavailable("the store did not send the proof in time", limit_s=time_limit_s)
            ended = f"the verification hung for {time_limit_s:g} s"
        elif exit_status == -signal.SIGXCPU:
            ended = f"the verification used more than {what.cpu_limit_s:g} s of CPU time"
        acts = Path(folder, _ACTS)
        return _Once(None, ended, acts=tuple(read_json(acts.read_bytes())["acts"]) if acts.exists() else ())


def report_on(task: Task, check: Check, acts: Sequence[str] = ()) -> Report:
    """The report on a submission that was not verified to its end: `check` decides."""
    return Report.of(
        [check],
        kind=task.kind,
        task_id=task.id,
        attempt=task.attempt,
        proof_sha256=task.proof_sha256,
        rules_sha256=task.rules_sha256,
        acts=acts,
    )


@cache
def _context(loaded: tuple[str, ...]) -> ForkServerContext:
    """Children are forked from a process that has loaded what they need."""
    context = multiprocessing.get_context("forkserver")
    # Each child runs the main module of its program again.
    programs = [name for name in _PROGRAMS if name in sys.modules]
    context.set_forkserver_preload(
        [
            "rodeo.jobs.undisturbed",
            "rodeo.jobs.apart",
            *programs,
            "rodeo.checks.verify",
            *loaded,
            "rodeo.jobs.preload",
        ]
    )
    return context


def _context_of(site: Site) -> ForkServerContext:
    """Loaded are each kind's checks, what a module `preload` beside them loads, and the stores' clients."""
    checks = [kind.checks.partition(":")[0] for kind in kinds_of(site).values() if kind.checks]
    # The fork server skips modules that it cannot import: few kinds have a `preload`.
    preloads = [f"{name}.preload" for name in checks]
    return _context((*checks, *preloads, *sorted(Store(site).clients)))


_REPORT, _AWAY = "report.json", "away.json"
"""Files of which a child leaves one in its folder."""
_FETCHED = "fetched"
"""Left once the proof is here."""
_ACTS = "acts.json"
"""Left earlier: people may accept a proof whose verification gave no report, and then these acts are paid
for."""
_DONE = b"done"
"""What a child says when it has left its file."""
_NO_ROOM = 74
"""Exit status of a child that could not write its report because the disk is full: EX_IOERR of sysexits.h."""
_AWAY_FOR: dict[str, type[RodeoError]] = {
    snake_case(cls.__name__): cls
    for cls in (
        StoreUnavailable,
        ProofNotFound,
        ProofHashMismatch,
        ProofUriNotAllowed,
        ProofTooLarge,
        DiskFull,
    )
}
"""Errors while a proof may be unavailable, by code."""


@contextmanager
def _folder_in(scratch: Path) -> Iterator[str]:
    scratch.mkdir(parents=True, exist_ok=True)
    # A folder of its own: a child that outlived a killed oracle must not answer for another proof.
    with tempfile.TemporaryDirectory(dir=scratch, ignore_cleanup_errors=True) as folder:
        yield folder


def _tell_rules(site: Site, teller: Connection) -> None:
    """Sent by the first child: all others have the same modules, and so the same rules."""
    from rodeo.checks.rules import rules_hash

    found: dict[str, str | None] = {}
    for kind in kinds_of(site).values():
        if not kind.by_people:
            try:
                found[kind.name] = rules_hash(kind)
            except KindError as error:
                log.error("proofs of %s are left to other oracles: %s", kind.name, error)
                found[kind.name] = None
    teller.send(found)


def _serve(verifies: Callable[[Site, What, Path], None], site: Site, asked: Connection) -> None:
    """What a child does until nobody can ask it any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    die_with(os.getppid(), signal.SIGKILL)  # the fork server, which ends with the oracle
    # Looking for garbage among all those messages takes a tenth of the time.
    gc.disable()
    gc.freeze()
    while True:
        try:
            question = asked.recv()
        except (EOFError, ConnectionResetError):  # a reset where what was said last was not read
            return
        verifies(site, *question)
        with suppress(BrokenPipeError):
            os.write(asked.fileno(), _DONE)
        gc.collect()


def limit(what: What) -> None:
    """Limit this process to what the next proof may use."""
    used_s = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    most_s = resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_AS, (what.memory_bytes, what.memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(used_s + what.cpu_limit_s), most_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _child(site: Site, what: What, folder: Path) -> None:
    limit(what)
    if what.log_to is not None:
        with what.log_to.open("ab") as file:
            os.dup2(file.fileno(), sys.stdout.fileno())
            os.dup2(file.fileno(), sys.stderr.fileno())
    try:
        try:
            report = verify_claiming(site, what, folder)
            name, data = _REPORT, report.to_bytes()
        except (EvidenceError, DiskFull) as error:
            name, data = _AWAY, write_json(plain(error.to_json()))
        replace_file(folder / name, data)
    except (OSError, DiskFull) as error:
        if not is_full(error):
            raise
        sys.exit(_NO_ROOM)


def verify_claiming(site: Site, what: What, folder: Path, **options: Any) -> Report:
    """The verification, which leaves the proof's claims in `folder` before they are checked."""
    # Imported here: the oracle itself has no use for MuJoCo.
    from rodeo.checks.verify import verify_file, verify_submission

    def claims(acts: list[str]) -> None:
        replace_file(folder / _ACTS, write_json({"acts": acts}))

    chain_record, copy = what[:2]
    if what.submitted and chain_record is not None:
        return verify_submission(
            site,
            chain_record,
            folder,
            copy,
            may_wait=True,
            claims=claims,
            fetched=(folder / _FETCHED).touch,
            **options,
        )
    assert copy is not None
    return verify_file(copy, site, chain_record, claims=claims, **options)
