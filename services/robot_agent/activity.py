"""What the robot does, as people see it; and how it waits after something failed."""

from __future__ import annotations

import logging
from typing import Any

from rodeo.bus.messages import Task
from rodeo.robot.ros_body import RosBody
from rodeo.runtime.process import Process
from services.robot_agent.news import News
from services.robot_agent.upkeep import Upkeep


class Activity:
    """The line of the robot in `rodeo status`, and its answer to an operator."""

    def __init__(self, process: Process, body: RosBody, upkeep: Upkeep) -> None:
        self._process, self._body, self._upkeep = process, body, upkeep
        self._doing: dict[str, Any] = {"activity": "starting"}
        self.attempt: Task | None = None
        self.expected_s = 0.0
        """How long the attempt is expected to take."""

    def report(
        self, text: str, progress: float | None = None, left_s: float | None = None, trouble: bool = False
    ) -> None:
        """`trouble`: the text says why the work is not done."""
        if self.attempt is not None and progress is not None:
            left_s = self.expected_s * (1 - progress)
        eta = {} if left_s is None else {"eta_s": round(left_s)}
        self._doing = {"activity": text, "progress": progress, **eta}
        vitals = self._body.vitals()
        self._process.notices.concern("body", self._body.unknown)
        about = {"task_id": self.attempt and self.attempt.id, "trouble": trouble}
        self._process.activity(text, progress, **eta, **about, **vitals, **self._upkeep.state())

    def state(self) -> dict[str, Any]:
        attempt = self.attempt
        return {
            "task_id": attempt and attempt.id,
            "attempt": attempt and attempt.attempt,
            **self._doing,
            **self._body.vitals(),
            **self._upkeep.state(),
        }


log = logging.getLogger(__name__)

RETRY_WALL_S = 1.0
"""Pause before asking again what just failed: the bridge, the store, the body."""
REFUSED_WALL_S, _REFUSED_S = 10.0, 100.0
"""Pause after the organization refused a request: wall time on a site that runs on it, or while the chain is
away, and simulated time, where news end it."""
_NEWS_AFTER_S = 1.0
"""Simulated time that passes after a refusal even with news: a mind that repeats itself must not stop the
clock."""


class Patience:
    """Waits, and reports once for what."""

    def __init__(self, process: Process, news: News, activity: Activity) -> None:
        self._keeps_wall_time = process.site.clock.keeps_wall_time
        self._clock, self._stop = process.clock, process.stop
        self.wake, self._activity = news.wake, activity
        self._complaint = ""
        """Reason of the last wait; reported once."""

    def wait_out(self, activity: str, wall_s: float, error: Exception) -> None:
        """Wait `wall_s`, in which what is away may come back."""
        self._complain(activity, error)
        self.wake.pause(self._stop, wall_s=wall_s)

    def wait_refused(self, activity: str, wall_s: float, error: Exception) -> None:
        """Wait until something happens on chain, or for long: nothing else changes a refusal. A simulated
        clock continues meanwhile, or jumps, and the time of the retry does not depend on the machine."""
        if self._keeps_wall_time:
            self.wait_out(activity, wall_s, error)
            return
        self._complain(activity, error)
        now_s = self._clock.now_s()
        self.wake.pause(self._stop, until_s=now_s + _NEWS_AFTER_S, resting=True)
        self.wake.wait(self._stop, until_s=now_s + _REFUSED_S, resting=True)

    def _complain(self, activity: str, error: Exception) -> None:
        if str(error) != self._complaint:
            log.warning("%s", error)
        self._complaint = str(error)
        self._activity.report(activity)
