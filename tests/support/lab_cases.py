"""The cases of `tests/reallab/cases.toml`, each brought about in a running lab."""

from __future__ import annotations

import threading
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from rodeo.bus.messages import Status
from rodeo.errors import BusError
from rodeo_testing.waiting import HANG_S
from tests.support.reallab import PROGRAMS, RealLab

UNPLUGGED_S = 10.0
AHEAD_S = 1.5
HUNGRY = 0.6
"""State of charge with which a charge of a minute begins: ten seconds of it can be missed."""


class Case(BaseModel):
    """A line of the table; its comments say what the fields mean."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    device: str
    fault: Literal["unplugged", "lying", "clock"]
    work: Literal["cleaning", "charge"] | None = None
    when: str = ""
    order: tuple[str, str, Any] | None = None
    back: Any = None
    clock: str = ""
    must: Literal["paid", "void", "not_ready"]
    process: str = ""
    names: str = ""

    @property
    def id(self) -> str:
        return f"{self.device}, {self.fault}"


CASES = [Case.model_validate(one) for one in tomllib.loads((PROGRAMS / "cases.toml").read_text())["cases"]]


def outcomes(lab: RealLab) -> Iterator[tuple[Case, str]]:
    """Each case, and what became of it instead of what must; empty if it ended so. The second robot is sent
    away before: it would take tasks of the first.

    Cases without work come first, those of different processes at once, but for the robot, which lacks what
    others lack. A meter that lied is not believed again, so the charges come last, in the order of the table.
    """
    lab.send_away()
    idle = [case for case in CASES if case.work is None]
    while idle:
        of_processes = {case.process: case for case in reversed(idle)}
        together = [case for case in of_processes.values() if case.process != lab.agents[0]] or idle[:1]
        yield from zip(together, _not_ready(lab, together), strict=True)
        idle = [case for case in idle if case not in together]
    for work in ("cleaning", "charge"):
        for case in CASES:
            if case.work == work:
                yield case, _worked(lab, case)


@contextmanager
def _fault(lab: RealLab, case: Case) -> Iterator[None]:
    if case.clock:
        with lab.clock_ahead(case.clock, AHEAD_S):
            yield
        return
    assert case.order is not None
    device, what, value = case.order
    lab.order(device, what, value)
    try:
        yield
    finally:
        lab.order(device, what, case.back)


def _not_ready(lab: RealLab, cases: list[Case]) -> list[str]:
    """The same of cases of different processes that are brought about at once."""

    def found(case: Case) -> str:
        def said(status: Status) -> bool:
            return not status.ready and case.names in status.reason

        return "" if lab.sees(case.process, said, HANG_S) else f"{case.process} says nothing of it"

    try:
        with ExitStack() as faults:
            for case in cases:
                faults.enter_context(_fault(lab, case))
            outcome = [found(case) for case in cases]
        lab.running.wait_ready(*(case.process for case in cases))
    except (AssertionError, BusError) as error:
        return [_broken(error)] * len(cases)
    return outcome


def _worked(lab: RealLab, case: Case) -> str:
    """The same of a case in which the robot works."""
    try:
        lab.tidy()
        if case.work == "charge":
            lab.order("power", "soc", HUNGRY)
        return _judged(lab, case, _task_with_fault(lab, case))
    except (AssertionError, BusError) as error:
        return _broken(error)


def _broken(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error)[:2000]}"


def _task_with_fault(lab: RealLab, case: Case) -> int:
    """The number of the task during which the fault was there."""
    if not case.when:
        with _fault(lab, case):
            task = _post(lab, case)
            lab.ended(task, HANG_S)
        return task
    task = _post(lab, case)
    process = case.process or lab.agents[0]
    begun = lab.sees(process, lambda status: case.when in status.activity, HANG_S)
    assert begun, f"{process} is never {case.when}"
    with _fault(lab, case):
        if case.fault == "unplugged":
            threading.Event().wait(UNPLUGGED_S)
        else:
            lab.ended(task, HANG_S)
    return task


def _post(lab: RealLab, case: Case) -> int:
    return lab.charge() if case.work == "charge" else lab.clean(lab.site.items[0].id)


def _judged(lab: RealLab, case: Case, task_id: int) -> str:
    ended = lab.ended(task_id, HANG_S)
    if ended is None:
        return f"task {task_id} does not end: {lab.task(task_id)['state']}"
    task = lab.task(task_id)
    said = lab.said(task_id)
    if case.must == "paid":
        right = ended.name == "TaskSettled" and (task["verdict"], task["attempt"]) == ("accepted", 1)
    else:
        right = ended.name != "TaskSettled" and case.names in said
    return "" if right else f"{ended.name}, {task['verdict']}: {said[:1500]}"
