"""No submission is forgotten, whatever the bridge says of it first."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent, Task
from rodeo.bus.queries import A, Query
from rodeo.checks.acts import Submission, Wait
from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Report
from rodeo.errors import DiskFull, RemoteError
from rodeo.evidence.errors import ProofHashMismatch, ProofNotFound, StoreUnavailable
from rodeo.host.clock import WallClock
from rodeo.jobs import apart
from rodeo.runtime.state import Notices
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing import answers
from rodeo_testing.recordings import Take
from rodeo_testing.waiting import HANG_S, wait_until
from services.oracle import process, reports, rules
from services.oracle.away import ProofAway, due_s
from services.oracle.process import Oracle
from services.oracle.reports import Reports


class HeldClock(WallClock):
    """Knows how many works hold it, and can be set forward, as a simulated clock."""

    def __init__(self) -> None:
        super().__init__()
        self.held = 0
        self.ahead_s = 0.0
        """By how much it is ahead of the machine's clock."""
        self._lock = threading.Lock()
        self._actors: set[int] = set()

    @contextmanager
    def hold(self, within: bool = False) -> Iterator[None]:
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

    def now_s(self) -> float:
        return super().now_s() + self.ahead_s

    def wait_for(
        self, done: Callable[[], bool], *args: Any, until_s: float | None = None, **more: Any
    ) -> bool:
        def over() -> bool:
            return done() or (until_s is not None and self.now_s() >= until_s)

        releases = threading.get_ident() in self._actors
        self._count(-releases)
        try:
            return super().wait_for(over, *args, **more) and done()
        finally:
            self._count(releases)

    def _count(self, more: int) -> None:
        with self._lock:
            self.held += more


RULES = "0x" + "77" * 32
REFUSED = Report(
    kind="waste_disposal",
    task_id=1,
    attempt=1,
    proof_sha256=None,
    outcome="rejected",
    reason="fetched",
    rules_sha256=RULES,
    checks=[],
)
ACCEPTED = REFUSED.model_copy(
    update={"outcome": "accepted", "reason": "accepted", "acts": ["bin/itrash/drop/7"]}
)


class Bridge:
    """What the oracle asks and tells; its index may be behind its own events."""

    def __init__(self, task: Task) -> None:
        self.current = task
        self.others: dict[int, Task] = {}
        self.behind = 0
        """Questions that are still answered as before the submission."""
        self.broken = False
        self.refuses: str | None = None
        """Code of the error by which each command is refused."""
        self.refused = 0
        self.hearers: list[Callable[[DaoEvent], None]] = []
        self.verdicts: list[Any] = []
        self.posted = threading.Event()

    def task(self, task_id: int) -> Task:
        if self.behind > 0:
            self.behind -= 1
            return self.current.model_copy(update={"state": "assigned"})
        return self.others.get(task_id, self.current)

    def other(self, **changed: Any) -> Task:
        """One more task that waits for its verdict."""
        task = self.current.model_copy(update={"id": self.current.id + 1 + len(self.others), **changed})
        self.others[task.id] = task
        return task

    def ask(self, query: Query[A], **_filters: Any) -> A:
        return answers.answered(query, _ANSWERS)

    def command(self, _name: str, request: Any) -> None:
        if self.refuses is not None:
            self.refused += 1
            raise RemoteError(self.refuses, "no", {})
        if self.broken:
            self.broken = False
            raise RuntimeError("what nobody thought of")
        self.verdicts.append(request)
        passed_on = request.ruling == "undecided"
        said = {"ruling": "void" if passed_on else request.ruling, "report": request.report_sha256}
        happened: list[tuple[str, dict[str, Any]]] = [
            ("Reported", {"report_uri": "", "reason": ""}),
            *([("PassedOn", {})] if passed_on else []),
            ("Ruled", said),
            *([] if passed_on else [("TaskSettled", {})]),
        ]
        for tell in self.hearers:
            task = self.others.get(request.task_id, self.current)
            for number, (name, args) in enumerate(happened):
                seq = 1000 + 10 * len(self.verdicts) + number
                tell(event(task, seq, name, attempt=request.attempt, **args))
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
    changed |= {"judge": "oracle", "state": "submitted"}
    return Bridge(chain_record.task.model_copy(update=changed))


@pytest.fixture
def oracle(
    site: Site, tmp_path: Path, bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Oracle]]:
    monkeypatch.setattr(process, "RETRY_S", 0.01)
    monkeypatch.setattr(process, "SWEEP_S", 0.05)
    monkeypatch.setattr(rules, "_LOOK_S", 0.01)
    monkeypatch.setattr(apart, "verify_apart", lambda *_, **__: REFUSED)
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
            notices=Notices(),
        )
        made = Oracle(service, "oracle", bridge)  # type: ignore[arg-type]
        made.judging.begin({"waste_disposal": rules_sha256})
        bridge.hearers.append(made.on_event)
        loops = made.loops()
        for name in ("turns", "words", "sweep", "rules"):
            threads.append(threading.Thread(target=loops[name], daemon=True))
            threads[-1].start()
        return made

    yield start
    stop.set()
    for thread in threads:
        thread.join(HANG_S)


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
        chain="0x" + "99" * 32,
    )


def submit(oracle: Oracle, task: Task, executor: str = "panther1") -> None:
    seq = 2 * task.id
    oracle.on_event(event(task, seq, "TaskRegistered", kind=task.kind, rules=task.rules_sha256))
    said = {"attempt": task.attempt, "executor": executor, "proof_hash": task.proof_sha256}
    oracle.on_event(event(task, seq + 1, "ProofSubmitted", **said))


class Verifications:
    """Each lasts until the test ends it, and says the same of every proof."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self.begun: list[int] = []
        """Tasks."""
        self.ended: defaultdict[int, threading.Event] = defaultdict(threading.Event)

    def __call__(
        self, _site: Site, chain_record: ChainRecord, _scratch: Path, stop: threading.Event, **_: Any
    ) -> Report | None:
        task_id = chain_record.task.id
        end = self.ended[task_id]
        self.begun.append(task_id)
        while not end.wait(0.01):
            if stop.is_set():
                return None
        return self._report.model_copy(update={"task_id": task_id})


def test_a_submission_that_the_index_does_not_know_yet_gets_its_verdict_when_it_does(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.behind = 3
    submit(oracle(), bridge.current)
    assert bridge.posted.wait(HANG_S)
    assert bridge.behind == 0 and [one.attempt for one in bridge.verdicts] == [bridge.current.attempt]


def test_a_submission_that_was_undone_while_the_index_is_behind_is_waited_for_no_longer(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.behind = 10**9
    judge = oracle()
    submit(judge, bridge.current)
    undone = {
        "undone_seq": 2 * bridge.current.id + 1,
        "undone_name": "ProofSubmitted",
        "attempt": bridge.current.attempt,
    }
    judge.on_event(event(bridge.current, 1000, "EventUndone", **undone))
    wait_until(lambda: not judge.line.keys())
    assert not bridge.verdicts


def test_a_submission_whose_verdict_failed_for_an_unknown_reason_is_looked_at_again(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.broken = True
    submit(oracle(), bridge.current)
    assert bridge.posted.wait(HANG_S)
    assert len(bridge.verdicts) == 1


@pytest.mark.parametrize("code", ["bridge_not_ready", "chain_reorganized", "transaction_dropped"])
def test_a_ruling_is_sent_again_when_the_bridge_or_the_chain_only_cannot_take_it_now(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    monkeypatch.setattr(process, "SWEEP_S", HANG_S)
    bridge.refuses = code
    submit(oracle(), bridge.current)
    wait_until(lambda: bridge.refused > 1)
    bridge.refuses = None
    assert bridge.posted.wait(HANG_S) and len(bridge.verdicts) == 1


def test_a_bridge_that_fails_at_one_task_keeps_no_other_from_its_turn(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "SWEEP_S", HANG_S)
    bridge.refuses = "internal"
    judge = oracle()
    submit(judge, bridge.current)
    wait_until(lambda: bridge.refused == 1 and not judge.line.keys())


@pytest.mark.parametrize("code", ["case_over", "not_judge", "passed_on_before"])
def test_a_submission_that_this_oracle_may_not_rule_on_any_more_is_not_looked_at_again(
    oracle: Callable[[], Oracle], bridge: Bridge, code: str
) -> None:
    bridge.refuses = code
    judge = oracle()
    submit(judge, bridge.current)
    wait_until(lambda: bridge.refused == 1 and not judge.line.keys())
    (waiting,) = judge.acts.waiting()
    assert judge.status.for_auditors == {waiting.key}  # which the sweep leaves out


def test_a_submission_on_which_nobody_ruled_in_time_is_ruled_on_until_its_case_ends(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.current = bridge.current.model_copy(update={"state": "ruled", "case_end": 2e9})
    judge, one = oracle(), bridge.current
    judge.on_event(event(one, 1, "TaskRegistered", kind=one.kind, rules=one.rules_sha256))
    judge.on_event(event(one, 2, "ProofSubmitted", attempt=one.attempt, executor="panther1"))
    silent = {"attempt": one.attempt, "ruling": "void", "report": "0x" + "00" * 32}
    judge.on_event(event(one, 3, "Ruled", **silent))
    assert bridge.posted.wait(HANG_S) and [said.ruling for said in bridge.verdicts] == ["rejected"]


def test_a_task_whose_judge_was_removed_is_left_to_the_auditors(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    bridge.current = bridge.current.model_copy(update={"judge_removed": True})
    judge = oracle()
    submit(judge, bridge.current)
    wait_until(lambda: bool(judge.status.for_auditors) and not judge.line.keys())
    assert not bridge.verdicts


def test_a_verdict_holds_the_clock_until_it_is_posted_and_nothing_afterwards(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge = oracle()
    clock = judge.process.clock
    assert isinstance(clock, HeldClock)
    held: list[int] = []
    monkeypatch.setattr(bridge, "task", lambda _id: (held.append(clock.held), bridge.current)[1])
    submit(judge, bridge.current)
    assert bridge.posted.wait(HANG_S)
    assert held and min(held) > 0
    wait_until(lambda: clock.held == 0)


def test_who_waits_for_the_bridge_holds_no_clock(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it waits for may be that something becomes due."""
    monkeypatch.setattr(process, "RETRY_S", HANG_S)
    bridge.behind = 10**9
    judge = oracle()
    clock = judge.process.clock
    assert isinstance(clock, HeldClock)
    submit(judge, bridge.current)
    wait_until(lambda: bridge.behind < 10**9 and clock.held == 0)
    assert judge.line.keys() == {(bridge.current.id, bridge.current.attempt)}


@pytest.mark.parametrize("waits", [True, False])
def test_a_proof_that_is_found_before_the_turn_ends_in_which_it_was_missing_is_verified_then(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    monkeypatch.setattr(process, "SWEEP_S", 2 * HANG_S)  # it is not left to the next sweep
    verified: list[int] = []
    forgotten = threading.Event()

    def verify(*_: Any, **__: Any) -> Report:
        verified.append(1)
        if len(verified) == 1:
            raise ProofNotFound("lost", uri="file:///x")
        return REFUSED

    def find(_task: Task, _away: ProofAway) -> None:
        if not waits:
            judge.on_event(event(bridge.current, 1000, "TaskRequeued"))
        judge.line.put(*key)

    monkeypatch.setattr(apart, "verify_apart", verify)
    judge, key = oracle(), (bridge.current.id, bridge.current.attempt)
    monkeypatch.setattr(judge.missing, "seek", find)
    monkeypatch.setattr(judge.missing, "forget", lambda _key: forgotten.set())
    submit(judge, bridge.current)
    assert forgotten.wait(HANG_S)  # in the last turn
    assert (len(verified), len(bridge.verdicts)) == ((2, 1) if waits else (1, 0))
    wait_until(lambda: not judge.line.keys())


def test_a_last_word_that_is_due_before_the_turn_ends_that_left_it_to_others_is_said_as_one(
    oracle: Callable[..., Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "SWEEP_S", 2 * HANG_S)
    monkeypatch.setattr(rules, "_LOOK_S", 2 * HANG_S)
    bridge.current = bridge.current.model_copy(update={"verdict_deadline": time.time() + 3600})
    judge = oracle("0x" + "88" * 32)
    leave, put, words = judge.judging.leave, judge.line.words.put, []

    def leave_late(task: Task) -> Report | None:
        said = leave(task)
        if said is None:
            bridge.current = bridge.current.model_copy(update={"verdict_deadline": 1.0})
            judge.line.put(task.id, task.attempt, word=True)
        return said

    def noted(key: tuple[int, int], *args: Any, **more: Any) -> None:
        words.append(key)
        put(key, *args, **more)

    monkeypatch.setattr(judge.judging, "leave", leave_late)
    monkeypatch.setattr(judge.line.words, "put", noted)
    submit(judge, bridge.current)
    assert bridge.posted.wait(HANG_S)
    assert [one.ruling for one in bridge.verdicts] == ["undecided"]
    assert words == [(bridge.current.id, bridge.current.attempt)]


@pytest.mark.parametrize("away", ["bridge", "store"])
def test_while_something_is_away_no_clock_jumps_but_to_a_verdict_that_is_due(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch, away: str
) -> None:
    """A bridge that does not answer does not say either when that is."""
    monkeypatch.setattr(process, "RETRY_S", HANG_S)
    bridge.current = bridge.current.model_copy(update={"verdict_deadline": time.time() + 3600})
    judge = oracle()
    clock, waits = judge.process.clock, []
    wait_for = clock.wait_for

    def noted(*args: Any, **more: Any) -> bool:
        if more.get("wall_s") == HANG_S:
            waits.append((more.get("until_s"), more.get("resting")))
        return wait_for(*args, **more)

    def put(_path: Path) -> str:
        raise StoreUnavailable("the store does not answer", url="file:///store")

    monkeypatch.setattr(clock, "wait_for", noted)
    monkeypatch.setattr(judge.reports.store, "put", put)
    bridge.behind = 10**9 if away == "bridge" else 0
    submit(judge, bridge.current)
    wait_until(lambda: bool(waits))
    due = due_s(bridge.current, judge.process.site)
    assert waits == [(None, False) if away == "bridge" else (due, True)]


def test_once_a_verdict_is_due_no_clock_jumps_to_the_windows_end_while_a_report_is_missing(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, task, waits = oracle(), bridge.current, list[tuple[float | None, bool]]()
    stop = threading.Event()

    def noted(*_: Any, until_s: float | None, resting: bool) -> bool:
        waits.append((until_s, resting))
        stop.set()
        return False

    clock = SimpleNamespace(now_s=time.time, wait_for=noted)
    process = SimpleNamespace(
        site=judge.process.site, clock=clock, stop=stop, data_dir=judge.process.data_dir
    )
    reports = Reports(process, judge.acts)  # type: ignore[arg-type]
    judge.acts.on_event(event(task, 1, "TaskRegistered", kind=task.kind, rules=RULES))
    judge.acts.on_event(event(task, 2, "ProofSubmitted", attempt=task.attempt, executor="panther1"))
    other = Submission(task.id - 1, 1, task.kind, "panther1", 1, 0)
    monkeypatch.setattr(judge.acts, "spent", lambda *_, **__: Wait(other, "its report is missing"))
    for deadline_s in (time.time() + 3600, time.time()):
        stop.clear()
        due = task.model_copy(update={"verdict_deadline": deadline_s})
        reports.unspent(due, [], lambda: 0, lambda _why: None)
    assert [(until_s is None, resting) for until_s, resting in waits] == [(False, True), (True, False)]


def test_a_report_by_other_rules_than_the_tasks_is_no_verdict(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the checks were updated under a running oracle: people decide, its window being over here."""
    other = ACCEPTED.model_copy(update={"rules_sha256": "0x" + "88" * 32})
    monkeypatch.setattr(apart, "verify_apart", lambda *_, **__: other)
    bridge.current = bridge.current.model_copy(update={"verdict_deadline": 1.0})
    submit(oracle(), bridge.current)
    assert bridge.posted.wait(HANG_S)
    (verdict,) = bridge.verdicts
    assert (verdict.ruling, verdict.fault, verdict.amount_iec) == ("undecided", "oracle", None)
    assert verdict.reason.startswith("rules: no oracle that has the rules of this task has judged it")


def test_of_two_oracles_with_different_rules_the_one_that_has_the_tasks_judges_it(
    oracle: Callable[..., Oracle], bridge: Bridge
) -> None:
    bridge.current = bridge.current.model_copy(update={"verdict_deadline": time.time() + 3600})
    updated, judge = oracle("0x" + "88" * 32), oracle(RULES)
    submit(updated, bridge.current)
    wait_until(lambda: updated.judging.keys() == {(bridge.current.id, bridge.current.attempt)})
    assert "which this oracle lacks" in updated.judging.lacking() and not bridge.verdicts
    submit(judge, bridge.current)
    assert bridge.posted.wait(HANG_S)
    wait_until(lambda: not updated.judging.keys() and not judge.line.keys())
    assert [(one.ruling, one.reason) for one in bridge.verdicts] == [("rejected", "fetched")]
    assert (judge.status.decided, updated.status.decided) == (1, 0)


# -- providers take turns ---------------------------------------------------------------------------------


def test_eight_heavy_proofs_of_one_provider_keep_nobody_elses_waiting(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "SIDE_BY_SIDE", 1)
    monkeypatch.setattr(apart, "verify_apart", verifications := Verifications(REFUSED))
    judge = oracle()
    heavy = [bridge.current, *(bridge.other() for _ in range(7))]
    for task in heavy:
        submit(judge, task, "many")
    submit(judge, honest := bridge.other(), "honest")
    wait_until(lambda: verifications.begun == [heavy[0].id])
    verifications.ended[heavy[0].id].set()
    wait_until(lambda: verifications.begun == [heavy[0].id, honest.id])
    verifications.ended[honest.id].set()
    wait_until(lambda: {one.task_id for one in bridge.verdicts} == {heavy[0].id, honest.id})
    wait_until(lambda: verifications.begun == [heavy[0].id, honest.id, heavy[1].id])


def test_a_verification_that_failed_is_tried_again_after_the_first_attempts_at_others(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "SIDE_BY_SIDE", 1)
    tried: list[tuple[int, int]] = []
    others_submitted = threading.Event()

    def verify(_site: Site, chain_record: ChainRecord, *_: Any, failed: int, **__: Any) -> Report:
        task_id = chain_record.task.id
        tried.append((task_id, failed))
        assert others_submitted.wait(HANG_S)
        if task_id == bridge.current.id and not failed:
            raise apart.VerificationFailed("used up its CPU time", task_id=task_id, attempt=1)
        return REFUSED.model_copy(update={"task_id": task_id})

    monkeypatch.setattr(apart, "verify_apart", verify)
    judge = oracle()
    others = [bridge.other(), bridge.other()]
    submit(judge, bridge.current, "one")
    wait_until(lambda: bool(tried))
    for task in others:
        submit(judge, task, "many")
    others_submitted.set()
    wait_until(lambda: len(bridge.verdicts) == 3)
    assert tried == [(bridge.current.id, 0), *((task.id, 0) for task in others), (bridge.current.id, 1)]


def test_a_verdict_that_is_due_waits_for_no_proof_that_others_have_in_line(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """People decide on one of those that claims the same act."""
    monkeypatch.setattr(apart, "verify_apart", verifications := Verifications(ACCEPTED))
    judge = oracle()
    clock, waits = judge.process.clock, f"task {bridge.current.id + 1} waiting for task {bridge.current.id} "
    assert isinstance(clock, HeldClock)
    activities: list[str] = []
    judge.process.activity = lambda text, *_, **__: activities.append(text)  # type: ignore[method-assign]
    honest = bridge.other(verdict_deadline=time.time() + 3600)
    submit(judge, bridge.current, "many")
    submit(judge, honest, "honest")
    verifications.ended[honest.id].set()
    wait_until(lambda: bridge.verdicts or any(waits in text for text in activities))
    assert not bridge.verdicts, "it waits for the earlier one until its verdict is due"
    clock.ahead_s = 3600.0
    assert bridge.posted.wait(HANG_S)
    assert [(one.task_id, one.ruling) for one in bridge.verdicts] == [(honest.id, "accepted")]
    verifications.ended[bridge.current.id].set()
    wait_until(lambda: len(bridge.verdicts) == 2)
    assert bridge.verdicts[1].ruling == "undecided"
    assert "the oracle, which decided a later submission first" in bridge.verdicts[1].reason


def test_who_waits_for_the_store_keeps_no_place(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "SIDE_BY_SIDE", 1)
    monkeypatch.setattr(apart, "verify_apart", verifications := Verifications(REFUSED))
    judge = oracle()
    put, stored = judge.reports.store.put, threading.Event()

    def put_later(path: Path) -> str:
        if not stored.is_set():
            raise StoreUnavailable("the store does not answer", url="file:///store")
        return put(path)

    monkeypatch.setattr(judge.reports.store, "put", put_later)
    bridge.current = bridge.current.model_copy(update={"verdict_deadline": time.time() + 3600})
    submit(judge, bridge.current)
    submit(judge, other := bridge.other())
    verifications.ended[bridge.current.id].set()
    wait_until(lambda: verifications.begun == [bridge.current.id, other.id])
    verifications.ended[other.id].set()
    assert not bridge.verdicts
    stored.set()
    wait_until(lambda: {one.task_id for one in bridge.verdicts} == {bridge.current.id, other.id})


@pytest.mark.parametrize("full", [DiskFull("no space left"), OSError(28, "No space left on device")])
def test_a_disk_that_is_full_while_a_report_is_read_keeps_no_later_one_from_being_read(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch, full: Exception
) -> None:
    monkeypatch.setattr(reports, "RETRY_S", 0.01)
    judge, task, tried, report = oracle(), bridge.current, list[str](), "0x" + "55" * 32

    def fetch(uri: str, _sha256: str, _most: int, folder: Path) -> Path:
        tried.append(uri)
        if len(tried) == 1:
            raise full
        (path := folder / "report.json").write_bytes(ACCEPTED.to_bytes())
        return path

    monkeypatch.setattr(judge.reports.store, "fetch", fetch)
    judge.acts.on_event(event(task, 1, "TaskRegistered", kind=task.kind, rules=RULES))
    judge.acts.on_event(event(task, 2, "ProofSubmitted", attempt=task.attempt, executor="panther1"))
    judge.acts.on_event(event(task, 3, "Reported", report_uri="file:///x", reason=""))
    judge.acts.on_event(event(task, 4, "Ruled", attempt=task.attempt, ruling="accepted", report=report))
    reading = threading.Thread(target=judge.reports.run)
    reading.start()
    wait_until(lambda: judge.acts.is_read(report))
    judge.process.stop.set()
    judge.process.clock.notify()
    reading.join()
    assert len(tried) == 2


@pytest.mark.parametrize("error", [ProofHashMismatch("other bytes"), StoreUnavailable("it is away")])
def test_a_report_that_the_store_does_not_keep_costs_nobody_its_verdict(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    tried = list[Path]()

    def put(path: Path) -> str:
        tried.append(path)
        raise error

    bridge.current = bridge.current.model_copy(update={"verdict_deadline": time.time() + 3600})
    judge = oracle()
    clock = judge.process.clock
    assert isinstance(clock, HeldClock)
    monkeypatch.setattr(judge.reports.store, "put", put)
    submit(judge, bridge.current)
    wait_until(lambda: len(tried) > 1)
    assert not bridge.verdicts
    clock.ahead_s = 3600.0
    assert bridge.posted.wait(HANG_S)


def test_what_may_be_paid_for_is_promised_to_nobody_else_after_a_restart(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The ruling on the later one is on its way to the chain when its oracle ends. Then the proof of the
    earlier one, which claims the same drop, turns up."""
    first, second = bridge.current, bridge.other()
    missing = {first.id}

    def verify(_site: Site, chain_record: ChainRecord, *_: Any, **__: Any) -> Report:
        task_id = chain_record.task.id
        if task_id in missing:
            raise ProofNotFound("lost", uri="file:///x")
        return ACCEPTED.model_copy(update={"task_id": task_id})

    monkeypatch.setattr(process, "SWEEP_S", 2 * HANG_S)
    monkeypatch.setattr(apart, "verify_apart", verify)
    judge = oracle()
    monkeypatch.setattr(judge.missing, "seek", lambda *_: None)
    bridge.refuses = "bridge_not_ready"  # what it was told may be done later
    submit(judge, first, "first")
    wait_until(lambda: not judge.line.keys())
    submit(judge, second, "second")
    wait_until(lambda: bridge.refused > 0)

    missing = {second.id}
    again = oracle()
    monkeypatch.setattr(again.missing, "seek", lambda *_: None)
    told: list[str] = []
    again.process.activity = lambda text, *_, **__: told.append(text)  # type: ignore[method-assign]
    submit(again, second, "second")
    wait_until(lambda: not again.line.keys())
    submit(again, first, "first")
    waits = f"task {first.id} waiting for task {second.id} attempt {second.attempt}: it may be paid for it"
    wait_until(lambda: bridge.verdicts or any(waits in text for text in told))
    bridge.refuses = None
    wait_until(lambda: bridge.verdicts)
    again.acts.read(bridge.verdicts[0].report_sha256, ACCEPTED.acts)
    wait_until(lambda: len(bridge.verdicts) == 2)
    assert [(one.task_id, one.ruling) for one in bridge.verdicts] == [
        (second.id, "accepted"),
        (first.id, "undecided"),
    ]


def test_nothing_is_paid_for_before_all_was_heard_that_the_index_has(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An oracle that starts hears of a submission before it hears who was paid for the same act meanwhile."""
    monkeypatch.setattr(apart, "verify_apart", lambda *_, **__: ACCEPTED)
    monkeypatch.setitem(_ANSWERS, "chain", answers.chain(chain_id=1, last_seq=900))
    judge, paid = oracle(), bridge.other()
    told: list[str] = []
    judge.process.activity = lambda text, *_, **__: told.append(text)  # type: ignore[method-assign]
    submit(judge, bridge.current, "first")
    wait_until(lambda: bridge.verdicts or any("waiting for events" in text for text in told))
    assert not bridge.verdicts
    said = {"attempt": paid.attempt, "ruling": "accepted", "report": "0x" + "55" * 32}
    judge.acts.read(said["report"], ACCEPTED.acts)
    submit(judge, paid, "second")
    for seq, name in ((898, "Reported"), (899, "Ruled"), (900, "TaskSettled")):
        judge.on_event(event(paid, seq, name, report_uri="", reason="", **said))
    assert bridge.posted.wait(HANG_S)
    assert [(one.task_id, one.ruling) for one in bridge.verdicts] == [(bridge.current.id, "undecided")]


def test_a_last_word_waits_for_no_verification(
    oracle: Callable[[], Oracle], bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "SIDE_BY_SIDE", 1)
    monkeypatch.setattr(apart, "verify_apart", verifications := Verifications(REFUSED))
    judge = oracle()
    left = bridge.other(rules_sha256="0x" + "88" * 32, verdict_deadline=time.time() + 3600)
    submit(judge, left)
    wait_until(lambda: judge.judging.keys() == {(left.id, left.attempt)} and not judge.line.keys())
    submit(judge, bridge.current)
    wait_until(lambda: verifications.begun == [bridge.current.id])
    due = left.model_copy(update={"verdict_deadline": 1.0})
    bridge.others[left.id] = due
    judge.judging._left[left.id, left.attempt] = due
    assert bridge.posted.wait(HANG_S)
    assert [(one.task_id, one.ruling) for one in bridge.verdicts] == [(left.id, "undecided")]


def test_what_is_due_before_its_turn_is_a_warning(
    oracle: Callable[[], Oracle],
    bridge: Bridge,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(process, "SIDE_BY_SIDE", 1)
    monkeypatch.setattr(apart, "verify_apart", verifications := Verifications(REFUSED))
    judge = oracle()
    submit(judge, bridge.current)
    wait_until(lambda: verifications.begun == [bridge.current.id])
    late = bridge.other(verdict_deadline=1.0)
    submit(judge, late)
    submit(judge, bridge.other(verdict_deadline=time.time() + 3600))
    shown = judge.process.notices.texts
    wait_until(lambda: any(one.startswith("1 of 2 proofs in line are due") for one in shown()))
    assert f"task {late.id} attempt 1 is due, and its turn to be verified has not come" in caplog.text
    judge.on_event(event(late, 1000, "TaskRequeued"))
    wait_until(lambda: not shown())
    assert f"task {late.id} attempt 1: its window ended before it was verified" in caplog.text
    assert verifications.begun == [bridge.current.id]


class Door:
    """A lock that knows who came to it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.came: list[str] = []
        """Names of threads."""

    def __enter__(self) -> None:
        self.came.append(threading.current_thread().name)
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def test_an_older_account_of_open_tasks_does_not_stay(oracle: Callable[[], Oracle], bridge: Bridge) -> None:
    """A verdict has ended, and a task is posted while the oracle says what is open."""
    judge = oracle()
    told: list[str] = []
    judge.status._publishing = telling = Door()  # type: ignore[assignment]

    def tell(text: str, *_: object, **__: object) -> None:
        if threading.current_thread().name == "first":
            open_task = event(bridge.current, 1, "TaskRegistered", kind="waste_disposal", rules=RULES)
            judge.on_event(open_task)
            second.start()
            # The second one waits for its turn, or it has wrongly told already.
            wait_until(lambda: "second" in telling.came or told)
        told.append(text)

    judge.process.activity = tell  # type: ignore[method-assign]
    first = threading.Thread(target=judge.status.publish, args=((1, 1),), name="first")
    second = threading.Thread(target=judge.status.publish, name="second")
    first.start()
    first.join(HANG_S)
    second.join(HANG_S)
    assert [text.partition(" of ")[0] for text in told] == ["idle", "1 open task"]


def test_a_task_that_is_posted_right_after_another_ended_is_told_of(
    oracle: Callable[[], Oracle], bridge: Bridge
) -> None:
    """What is open is the same at both looks, and between them it was told that nothing is."""
    judge = oracle()
    told: list[str] = []
    judge.process.activity = lambda text, *_, **__: told.append(text)  # type: ignore[method-assign]
    judge.process.ready = lambda: None  # type: ignore[method-assign]

    def tell(seq: int, name: str, task: Task, **args: Any) -> None:
        judge.on_event(event(task, seq, name, **args))

    terms = {"kind": "waste_disposal", "rules": RULES}
    tell(1, "TaskRegistered", bridge.current, **terms)
    judge.status.update()
    tell(2, "TaskSettled", bridge.current)
    judge.status.publish((bridge.current.id, 1))
    tell(3, "TaskRegistered", bridge.other(), **terms)
    judge.status.update()
    judge.status.update()
    assert [text.partition(" of ")[0] for text in told] == ["1 open task", "idle", "1 open task"]
