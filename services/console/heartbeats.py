"""What the processes of a site report of themselves."""

from __future__ import annotations

import math
import re
import time
from dataclasses import dataclass
from typing import Any

from rodeo.bus.messages import Status
from rodeo.bus.session import heard_status
from rodeo.host.instance import HEARTBEAT_S
from rodeo.person.pace import Pace
from rodeo.site.config import Site
from rodeo.site.names import BRIDGE
from rodeo.site.processes import processes_of
from rodeo.text.strict_json import Json

_ADDRESS = re.compile(r"http://[\w.:\[\]-]+:\d{1,5}")
_LOST_S = 3 * HEARTBEAT_S
_MOST = 500
"""Far more processes than a site has: on an open bus anybody may claim to be another one."""


@dataclass(frozen=True)
class ProcessState:
    name: str
    job: str
    state: str
    """ready, not ready, lost (its heartbeat stopped) or silent (never heard)"""
    doing: str = ""
    progress: float | None = None
    eta_s: float | None = None
    """Site time until it has finished its activity, where it reports that."""
    soc: float | None = None
    task_id: int | None = None
    """The task that it works on."""
    trouble: bool = False
    """What it is doing says why work is not done."""
    warnings: tuple[str, ...] = ()
    """What an operator should know although the process works."""
    clock_off_s: float | None = None
    """How far its clock is off the site's time, to 10 ms; None on a simulated clock."""


class Heartbeats:
    """The newest status of each process; `processes` shows them in the order of the site file."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._jobs = {process.name: process.job for process in processes_of(site)}
        self._statuses: dict[str, tuple[Status, float]] = {}
        self.processes: list[ProcessState] = []

    def hear(self, key: str, data: Json) -> None:
        """A heartbeat, from the bus's thread. Raises InvalidRequest on another process's key."""
        status = heard_status(key, data)
        known = status.process in self._statuses or status.process in self._jobs
        if known or len(self._statuses) < _MOST:
            self._statuses[status.process] = status, time.monotonic()

    @property
    def pace(self) -> Pace | None:
        """How fast the site's time goes; None while nobody reports it."""
        status, heard_s = self._statuses.get("robot_sim", (None, -math.inf))
        silent = status is None or time.monotonic() - heard_s > _LOST_S
        return Pace.of(self._site, {} if status is None or silent else status.details)

    @property
    def metrics(self) -> dict[str, str]:
        """Host and port of the metrics of each process that the site file names."""
        known = {
            name: status.metrics_url for name, (status, _) in self._statuses.items() if name in self._jobs
        }
        return {name: url.removeprefix("http://") for name, url in known.items() if _ADDRESS.fullmatch(url)}

    @property
    def bridge(self) -> str:
        """State of the bridge."""
        return next((one.state for one in self.processes if one.name == BRIDGE), "")

    def look(self) -> bool:
        """Whether `processes` changed: statuses came, or did not come in time."""
        names = [*self._jobs, *(name for name in sorted(self._statuses) if name not in self._jobs)]
        before = self.processes
        self.processes = [self._process(name, self._jobs.get(name, "")) for name in names]
        return self.processes != before

    def _process(self, name: str, job: str) -> ProcessState:
        if name not in self._statuses:
            return ProcessState(name, job, "silent")
        status, heard_s = self._statuses[name]
        if time.monotonic() - heard_s > _LOST_S:
            return ProcessState(name, job, "lost", "its heartbeat stopped")
        return ProcessState(
            name,
            job,
            "ready" if status.ready else "not ready",
            status.reason or status.activity,
            status.progress,
            number(status.details.get("eta_s")),
            number(status.details.get("soc")),
            found if isinstance(found := status.details.get("task_id"), int) else None,
            status.details.get("trouble") is True,
            tuple(status.warnings),
            None if status.clock is None else round(status.clock.off_s, 2),
        )


def number(value: Any) -> float | None:
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if known else None
