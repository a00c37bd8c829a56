"""No submission is forgotten, whatever the bridge says of it first."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.checks.report import Report
from rodeo.clock import WallClock
from rodeo.config import Site
from rodeo.messages import DaoEvent, Task
from rodeo.queries import A, Query
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing import answers
from rodeo_testing.recordings import Take
from services.oracle import process, rules, worker
from services.oracle.process import Oracle

WAIT_S = 20.0


class HeldClock(WallClock):
    """Knows how many works hold it, as a simulated clock does."""

    def __init__(self) -> None:
        super().__init__()
        self.held = 0
        self._lock = threading.Lock()
        self._actors: set[int] = set()

    @contextmanager
    def hold(self) -> Iterator[None]:
        self._count(1)
        try:
            yield
        finally:
            self._count(-1)

    @contextmanager
    def acting(self) -> Iterator[None]:
        with self.hold():
            self._actors.add(threading.get_ident())
            yield

    def wait_for(self, *args: Any, **more: Any) -> bool:
        releases = threading.get_ident() in self._actors
        self._count(-releases)
        try:
            return super().wait_for(*args, **more)
        finally:
            self._count(releases)

    def _count(self, more: int) -> None:
        with self._lock:
            self.held += more


RULES = "0x" + "77" * 32


class Bridge:
    """What the oracle asks and tells; its index may be behind its own events."""

    def __init__(self, task: Task) -> None:
        self.current = task
        self.behind = 0
        """Questions that are still answered as before the submission."""
        self.broken = False
        self.hearers: list[Callable[[DaoEvent], None]] = []
        self.verdicts: list[Any] = []
        self.posted = threading.Event()

    def task(self, _task_id: int) -> Task:
        if self.behind > 0:
            self.behind -= 1
            return self.current.model_copy(update={"state": "assigned"})
        return self.current

    def ask(self, query: Query[A], **_filters: Any) -> A:
        return answers.answered(query, _ANSWERS)

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
        for tell in self.hearers:
            tell(event(self.current, 9, "VerdictPosted", **said))
        self.posted.set()


_ANSWERS = {
    "chain": answers.chain(chain_id=1),
    "organization": answers.organization(measured=["waste_disposal"]),
    "devices": {"devices": []},
    "roots": answers.roots(),
}


@pytest.fixture
def bridge(cleaning: Take) -> Bridge:
    chain_record = cleaning_chain_record(cleaning)
    changed = {"proof_uri": "file:///x", "proof_sha256": "0x" + "33" * 32, "rules_sha256": RULES}
    return Bridge(chain_record.task.model_copy(update=changed))


@pytest.fixture
def oracle(
    site: Site, tmp_path: Path, bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Oracle]]:
    monkeypatch.setattr(process, "RETRY_S", 0.01)
    monkeypatch.setattr(process, "SWEEP_S", 0.05)
    monkeypatch.setattr(rules, "_LOOK_S", 0.01)
    refused = Report(
        kind="waste_disposal",
        task_id=1,
        attempt=1,
        proof_sha256=None,
        outcome="rejected",
        reason="fetched",
        rules_sha256=RULES,
        checks=[],
    )
    monkeypatch.setattr(worker, "verify_apart", lambda *_, **__: refused)
    stop = threading.Event()
    own = site.model_copy(update={"data_dir": tmp_path})
    threads: list[threading.Thread] = []

    def start(rules_sha256: str = RULES) -> Oracle:
        service = SimpleNamespace(
            site=own,
            stop=stop,
            bus=None,
            clock=HeldClock(),
            data_dir=tmp_path / rules_sha256,
            activity=lambda *_, **__: None,
            concern=lambda *_: None,
        )
        made = Oracle(service, "oracle")  # type: ignore[arg-type]
        made._judging.begin({"waste_disposal": rules_sha256})
        made._wallet = bridge  # type: ignore[assignment]
        bridge.hearers.append(made._on_event)
        for target in (made._take_turns, made._sweep, lambda: made._judging.run(stop)):
            threads.append(threading.Thread(target=target, daemon=True))
            threads[-1].start()
        return made

    yield start
    stop.set()
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
    oracle._on_event(event(task, 1, "TaskRegistered", kind=task.kind, rules=task.rules_sha256))
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


def test_a_verdict_holds_the_clock_until_it_is_posted_and_nothing_afterwards(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge = oracle()
    clock = judge._clock
    assert isinstance(clock, HeldClock)
    held: list[int] = []
    monkeypatch.setattr(bridge, "task", lambda _id: (held.append(clock.held), bridge.current)[1])
    submit(judge, bridge.current)
    assert bridge.posted.wait(WAIT_S)
    assert held and min(held) > 0
    wait_until(lambda: clock.held == 0)


def test_who_waits_for_the_bridge_holds_no_clock(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it waits for may be that something becomes due."""
    monkeypatch.setattr(process, "RETRY_S", WAIT_S)
    bridge.behind = 10**9
    judge = oracle()
    clock = judge._clock
    assert isinstance(clock, HeldClock)
    submit(judge, bridge.current)
    wait_until(lambda: bridge.behind < 10**9 and clock.held == 0)
    assert judge._in_work == {(bridge.current.id, bridge.current.attempt)}


def test_a_report_by_other_rules_than_the_tasks_is_no_verdict(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the checks were updated under a running oracle: people decide, its window being over here."""
    other = Report(
        kind="waste_disposal",
        task_id=1,
        attempt=1,
        proof_sha256=None,
        outcome="accepted",
        reason="accepted",
        rules_sha256="0x" + "88" * 32,
        checks=[],
    )
    monkeypatch.setattr(worker, "verify_apart", lambda *_, **__: other)
    bridge.current = bridge.current.model_copy(update={"verdict_deadline": 1.0})
    submit(oracle(), bridge.current)
    assert bridge.posted.wait(WAIT_S)
    (verdict,) = bridge.verdicts
    assert (verdict.outcome, verdict.amount_iec) == ("undecided", None)
    assert verdict.reason.startswith("rules: no oracle that has the rules of this task has judged it")


def test_of_two_oracles_with_different_rules_the_one_that_has_the_tasks_judges_it(
    oracle: Callable[..., Oracle], bridge: Bridge
) -> None:
    bridge.current = bridge.current.model_copy(update={"verdict_deadline": time.time() + 3600})
    updated, judge = oracle("0x" + "88" * 32), oracle(RULES)
    submit(updated, bridge.current)
    wait_until(lambda: updated._judging.keys() == {(bridge.current.id, bridge.current.attempt)})
    assert "which this oracle lacks" in updated._judging.lacking() and not bridge.verdicts
    submit(judge, bridge.current)
    assert bridge.posted.wait(WAIT_S)
    wait_until(lambda: not updated._judging.keys() and not judge._in_work)
    assert [(one.outcome, one.reason) for one in bridge.verdicts] == [("rejected", "fetched")]
    assert (judge._decided, updated._decided) == (1, 0)


def wait_until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline_s
        threading.Event().wait(0.01)
