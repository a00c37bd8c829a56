"""By whose rules tasks are judged: how many are open under which, and who answers where nobody has them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent, Task
from rodeo.host.clock import WallClock
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, wait_until
from services.oracle import rules
from services.oracle.rules import Judging
from tests.support.tasks import task

KIND = "waste_disposal"
MINE, OTHER = "0x" + "11" * 32, "0x" + "22" * 32


class Clock(WallClock):
    time_s = 0.0

    def now_s(self) -> float:
        return self.time_s


class Oracle:
    """One that has the rules MINE."""

    def __init__(self, site: Site) -> None:
        self.clock = Clock()
        self.found: list[tuple[int, int]] = []
        self.found_some = threading.Event()
        self.waits = True
        self.judging = Judging(site, self.clock, self._on_found, lambda *_: self.waits)
        self.judging.begin({KIND: MINE})
        self.stop = threading.Event()
        self._thread = threading.Thread(target=self.judging.run, args=(self.stop,))
        self._thread.start()
        self._seq = 0

    def _on_found(self, task_id: int, attempt: int) -> None:
        self.found.append((task_id, attempt))
        self.found_some.set()

    def hear(self, name: str, task_id: int = 1, chain: str = "0xc", **args: Any) -> None:
        self._seq += 1
        self.judging.on_event(
            DaoEvent(
                seq=self._seq,
                name=name,
                block=1,
                log_index=0,
                tx_hash="0x00",
                time_s=0.0,
                task_id=task_id,
                args=args,
                chain=chain,
            )
        )

    def register(self, task_id: int, rules_sha256: str) -> None:
        self.hear("TaskRegistered", task_id, kind=KIND, rules=rules_sha256)

    def open(self) -> dict[str, int]:
        return {str(one["rules_sha256"]): int(one["open_tasks"]) for one in self.judging.open_tasks()}

    def close(self) -> None:
        self.stop.set()
        self._thread.join()


@pytest.fixture
def oracle(site: Site, monkeypatch: pytest.MonkeyPatch) -> Iterator[Oracle]:
    monkeypatch.setattr(rules, "_LOOK_S", 0.01)
    made = Oracle(site)
    yield made
    made.close()


def submitted() -> Task:
    return task("submitted").model_copy(update={"verdict_deadline": 3600.0, "rules_sha256": OTHER})


def test_open_tasks_are_counted_by_their_rules_until_they_end(oracle: Oracle) -> None:
    for task_id, one in ((1, MINE), (2, MINE), (3, OTHER)):
        oracle.register(task_id, one)
    assert oracle.open() == {MINE: 2, OTHER: 1}
    assert oracle.judging.summary() == [f"2 open tasks of {KIND} under its rules {MINE}"]
    assert oracle.judging.lacking().startswith(
        f"1 open task of {KIND} under rules {OTHER}, which this oracle"
    )
    oracle.hear("AuditRequested", 3)  # rejected by people, it would be the oracle's again
    oracle.hear("TaskSettled", 1)
    oracle.hear("TaskCancelled", 2)
    assert oracle.open() == {OTHER: 1}
    assert oracle.judging.summary() == []
    oracle.hear("TaskFailed", 3)
    assert oracle.judging.lacking() == ""


def test_what_a_reorganization_undoes_is_counted_as_before(oracle: Oracle) -> None:
    oracle.register(1, MINE)
    oracle.hear("TaskSettled", 1)
    oracle.hear("EventUndone", 1, undone_name="TaskSettled")
    assert oracle.open() == {MINE: 1}
    oracle.hear("EventUndone", 1, undone_name="TaskRegistered", kind=KIND, rules=MINE)
    assert oracle.open() == {}
    oracle.register(1, OTHER)
    assert oracle.open() == {OTHER: 1}
    oracle.hear("TaskRegistered", 1, chain="0xd", kind=KIND, rules=MINE)
    assert oracle.open() == {MINE: 1}


def test_a_task_of_other_rules_is_left_to_others_and_said_once(
    oracle: Oracle, caplog: pytest.LogCaptureFixture
) -> None:
    assert oracle.judging.has(KIND, MINE) and not oracle.judging.has(KIND, OTHER)
    assert not oracle.judging.has(KIND, None) and not oracle.judging.has("sweeping", MINE)
    assert oracle.judging.leave(submitted()) is None
    assert oracle.judging.leave(submitted()) is None
    assert [OTHER in one.message and MINE in one.message for one in caplog.records] == [True]
    assert oracle.judging.keys() == {(1, 1)} and oracle.found == []


def test_what_nobody_has_judged_when_its_verdict_is_due_is_left_to_people(oracle: Oracle) -> None:
    assert oracle.judging.leave(submitted()) is None
    oracle.clock.time_s = 3599.0
    assert oracle.found_some.wait(HANG_S)
    assert oracle.found == [(1, 1)]
    report = oracle.judging.leave(submitted())
    assert report is not None
    assert (report.outcome, report.fault, report.rules_sha256) == ("undecided", "the oracle", OTHER)
    (check,) = report.checks
    assert (check.name, check.measured, check.limit) == ("rules", MINE, OTHER)


def test_an_oracle_that_has_the_rules_goes_first(oracle: Oracle, site: Site) -> None:
    """Its own patience ends earlier than that of the one that speaks for it."""
    one = submitted()
    own = rules.due_s(one, site)
    its = rules.due_s(one, site, rules.PATIENCE)
    assert own is not None and its is not None and own < its < 3600.0


def test_what_another_oracle_has_judged_is_forgotten(oracle: Oracle) -> None:
    assert oracle.judging.leave(submitted()) is None
    oracle.waits = False
    oracle.clock.notify()
    wait_until(lambda: not oracle.judging.keys())
    assert oracle.found == []
