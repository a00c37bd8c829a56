"""No submission is forgotten, whatever the bridge says of it first."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.clock import WallClock
from rodeo.config import Site
from rodeo.dao import CLEANING
from rodeo.messages import DaoEvent, Task
from services.oracle import app, worker
from services.oracle.app import Oracle
from services.oracle.report import Report
from tests.support.assignments import cleaning_ledger
from tests.support.recordings import Take

WAIT_S = 20.0


class Bridge:
    """What the oracle asks and tells; its index may be behind its own events."""

    def __init__(self, task: Task) -> None:
        self.current = task
        self.behind = 0
        """Questions that are still answered as before the submission."""
        self.broken = False
        self.tell: Callable[[DaoEvent], None] = lambda _event: None
        self.verdicts: list[Any] = []
        self.posted = threading.Event()

    def task(self, _task_id: int) -> Task:
        if self.behind > 0:
            self.behind -= 1
            return self.current.model_copy(update={"state": "assigned"})
        return self.current

    def state(self, what: str, **_filters: Any) -> dict[str, Any]:
        contracts = {"TaskManager": "0x" + "11" * 20, "Organization": "0x" + "22" * 20}
        return {
            "chain": {"chain_id": 1, "contracts": contracts},
            "organization": {"kinds": [{"kind": CLEANING, "review": "oracle"}]},
            "devices": {"devices": []},
            "roots": {"roots": [], "next": None},
        }[what]

    def command(self, _name: str, request: Any) -> None:
        if self.broken:
            self.broken = False
            raise RuntimeError("what nobody thought of")
        self.verdicts.append(request)
        said = {
            "attempt": request.attempt,
            "verdict": request.outcome,
            "report_hash": "0x00",
            "report_uri": "",
        }
        self.tell(event(self.current, 9, "VerdictPosted", **said))
        self.posted.set()


@pytest.fixture
def bridge(cleaning: Take) -> Bridge:
    ledger = cleaning_ledger(cleaning)
    return Bridge(ledger.task.model_copy(update={"proof_uri": "file:///x", "proof_sha256": "0x" + "33" * 32}))


@pytest.fixture
def oracle(
    site: Site, tmp_path: Path, bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[], Oracle]]:
    monkeypatch.setattr(app, "RETRY_S", 0.01)
    monkeypatch.setattr(app, "SWEEP_S", 0.05)
    refused = Report(
        kind=CLEANING,
        task_id=1,
        attempt=1,
        proof_sha256=None,
        outcome="rejected",
        reason="fetched",
        checks=[],
    )
    monkeypatch.setattr(worker, "verify_apart", lambda *_, **__: refused)
    stop = threading.Event()
    own = site.model_copy(update={"data_dir": tmp_path})
    service = SimpleNamespace(
        site=own,
        stop=stop,
        bus=None,
        clock=WallClock(),
        data_dir=tmp_path,
        activity=lambda *_, **__: None,
        concern=lambda *_: None,
    )
    threads: list[threading.Thread] = []

    def start() -> Oracle:
        made = Oracle(service)  # type: ignore[arg-type]
        made._wallet = bridge  # type: ignore[assignment]
        bridge.tell = made._on_event
        for target, args in ((made._work, (0,)), (made._sweep, ())):
            threads.append(threading.Thread(target=target, args=args, daemon=True))
            threads[-1].start()
        stopped.append(made)
        return made

    stopped: list[Oracle] = []
    yield start
    stop.set()
    for one in stopped:
        one._submissions.put(None)
    for thread in threads:
        thread.join(WAIT_S)


def event(task: Task, seq: int, name: str, **args: Any) -> DaoEvent:
    return DaoEvent(
        seq=seq,
        name=name,
        block=seq,
        log_index=0,
        tx_hash="0x" + "44" * 32,
        time_s=float(seq),
        task_id=task.id,
        args=args,
    )


def submit(oracle: Oracle, task: Task) -> None:
    oracle._on_event(event(task, 1, "TaskRegistered", kind=task.kind))
    oracle._on_event(event(task, 2, "ProofSubmitted", attempt=task.attempt, executor="panther1"))


def test_a_submission_that_the_index_does_not_know_yet_gets_its_verdict_when_it_does(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.behind = 3
    submit(oracle(), bridge.current)
    assert bridge.posted.wait(WAIT_S)
    assert bridge.behind == 0 and [one.attempt for one in bridge.verdicts] == [bridge.current.attempt]


def test_a_submission_that_was_undone_while_the_index_is_behind_is_waited_for_no_longer(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.behind = 10**9
    judge = oracle()
    submit(judge, bridge.current)
    undone = {"undone_seq": 2, "undone_name": "ProofSubmitted", "attempt": bridge.current.attempt}
    judge._on_event(event(bridge.current, 3, "EventUndone", **undone))
    done = threading.Event()
    for _ in range(int(WAIT_S / 0.02)):
        if not judge._in_work:
            break
        done.wait(0.02)
    assert not judge._in_work and not bridge.verdicts


def test_a_submission_whose_verdict_failed_for_an_unknown_reason_is_looked_at_again(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.broken = True
    submit(oracle(), bridge.current)
    assert bridge.posted.wait(WAIT_S)
    assert len(bridge.verdicts) == 1
