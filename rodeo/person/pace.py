"""People live by the wall clock, and a simulated site's time goes faster: until when they have to act, and
how much time that leaves them by both.

While a person has something to do, `robot_sim` keeps the clock slow enough for `people.min_window_s`
(`services.robot_sim.people`) and says in its status how fast it goes; everybody else reads it there.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rodeo.bus.messages import Task
from rodeo.display.formatting import span
from rodeo.kinds import Kinds
from rodeo.site.config import Site

STANDS = 1e-3
"""Share of real time: a clock that is slower than this stands."""
_MEASURED_S = 5.0
"""Wall time in which a clock that runs is measured again, and that is heard."""
_REAL = 0.05
"""Share by which a clock that keeps real time may look faster or slower than that when it is measured."""


def deadline_s(task: Task, kinds: Kinds) -> float | None:
    """Until when, in site time, a person has to act on the task; None where none has to.

    A person accepts it in its grace period and then does it, or judges it: an auditor also what the oracle
    passed on, or a removed judge has not ended. A challenged ruling waits for its judges.
    """
    if task.state == "assigned" and kinds.by_people(task.kind):
        return running_out_s(task)
    by_auditors = task.judge == "auditor" or task.passed_on or task.judge_removed
    if task.state == "submitted" and by_auditors:
        return task.verdict_deadline
    challenged = task.dispute is not None and task.dispute.challenger is not None
    return task.standing.until if task.standing and (by_auditors or challenged) else None


def running_out_s(task: Task) -> float | None:
    """The deadline, in site time, of the task's state, whoever has to act; None where nobody has to.
    A ruling stands until its time is over."""
    by_state = {
        "assigned": task.execution_deadline if task.accepted else task.grace_ends_s,
        "submitted": task.verdict_deadline,
        "ruled": None if task.standing is None else task.standing.until,
    }
    return by_state.get(task.state)


def runs_fast(site: Site) -> bool:
    """Whether the site's time may go faster than the wall clock."""
    clock = site.clock
    return clock.source == "sim" and any(speed == 0 or speed > 1 for speed in (clock.speed, clock.idle_speed))


@dataclass(frozen=True)
class Pace:
    """How fast the site's time goes, as it was measured when it was `at_s`."""

    speed: float
    """Seconds of site time per second of wall time."""
    at_s: float
    """Site time."""
    measured_s: float
    """Wall time of that."""

    @classmethod
    def of(cls, site: Site, details: Mapping[str, Any]) -> Pace | None:
        """What the details of robot_sim's status say; None while they say nothing. A site without a simulated
        clock needs none."""
        if site.clock.source == "wall":
            return cls(1.0, time.time(), time.time())
        values = [details.get(name) for name in ("speed", "site_time_s", "measured_s")]
        if not all(isinstance(value, int | float) for value in values):
            return None
        return cls(*map(float, values))  # type: ignore[arg-type]

    @property
    def now_s(self) -> float:
        """Site time now, as far as it continues like this: a fast clock that is not measured any more stands,
        because somebody holds it."""
        passed_s = max(0.0, time.time() - self.measured_s)
        return self.at_s + self.speed * (passed_s if self.is_real else min(passed_s, _MEASURED_S))

    def continues(self, before: Pace | None) -> bool:
        """Whether a clock that continues as `before` said shows this, by half a second of the wall's."""
        if before is None:
            return False
        off_s = abs(self.now_s - before.now_s)
        return off_s <= 0.5 * max(1.0, self.speed) and abs(self.speed - before.speed) <= _REAL * before.speed

    @property
    def is_real(self) -> bool:
        return abs(self.speed - 1) < _REAL

    def left(self, deadline_s: float) -> str:
        """How much time there is until then, by the site's clock and by the wall's."""
        left_s = deadline_s - self.now_s
        if left_s <= 0:
            return "its time is over"
        if self.is_real:
            return f"{span(left_s)} left"
        if self.speed <= STANDS:
            return f"{span(left_s)} of site time left; the site's clock is stopped"
        return (
            f"{span(left_s)} of site time left, {span(left_s / self.speed)} on the wall clock "
            f"at the present speed ({self.speed:.3g} times real time)"
        )


def time_left(pace: Pace | None, deadline_s: float) -> str:
    """The same where it may not be known how fast the site's time goes."""
    if pace is None:
        return "how much time is left is not known: robot_sim is silent"
    return pace.left(deadline_s)


def warning(site: Site) -> str:
    """What people who work for this site should know of its time; empty where it is theirs."""
    if not runs_fast(site):
        return ""
    speeds = (site.clock.speed, site.clock.idle_speed)
    fast = (
        "as fast as the machine can"
        if 0 in speeds
        else f"up to {max(speeds):g} times as fast as the wall clock"
    )
    least_s = site.people.min_window_s
    care = (
        f" While a person has a task or a proof to judge, it runs slower, so that they have {span(least_s)} "
        "on the wall clock for it, or all of a shorter window."
        if least_s
        else ""
    )
    return f"This site is simulated: its time, and with it every window, runs {fast}.{care}"
