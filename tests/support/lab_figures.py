"""How long the lab's drivers take, what they cost, and what is lost while they are away."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from rodeo.site import topics
from rodeo.site.names import bin_process, dock_process
from rodeo.site.providers import MOTION_CAPTURE
from rodeo.witness.motion import track
from rodeo.witness.statement import Drop, MeterRecord, Motion, Statement, parse
from rodeo_kinds.battery_charging.readings import unpack
from tests.support.reallab import RealLab

NATNET, MODBUS, BIN = "natnet", "modbus", "bin"


class Heard(NamedTuple):
    time_s: float
    """When it arrived."""
    statement: Statement

    @property
    def stamps_s(self) -> dict[str, float]:
        """By figure: the device's own stamp of the newest that it says, and of the oldest."""
        said = self.statement
        if isinstance(said, Motion):
            return {NATNET: said.end_us * 1e-6}
        if isinstance(said, Drop):
            return {BIN: said.settled_s}
        if isinstance(said, MeterRecord) and len(times_s := unpack(said.since_ms, said.readings).time_s):
            return {MODBUS: float(times_s[-1]), f"{MODBUS}_oldest": float(times_s[0])}
        return {}


def _cpu_s(pid: int) -> float:
    """Processor time that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Listener:
    """Hears what the lab's devices sign. Use as a context manager."""

    def __init__(self, lab: RealLab) -> None:
        self._lab = lab
        site, children = lab.site, lab.running.children
        names = {
            NATNET: MOTION_CAPTURE,
            MODBUS: dock_process(site, site.docks[0].name),
            BIN: bin_process(site, site.bins[0].name),
        }
        self._pids = {driver: children[name].pid for driver, name in names.items()}
        self._lock = threading.Lock()
        self._heard: list[Heard] = []

    def __enter__(self) -> Self:
        key = topics.WITNESS_STATEMENT.pattern(org=self._lab.site.org)
        self._began_s = time.monotonic()
        self._cpu_s = {driver: _cpu_s(pid) for driver, pid in self._pids.items()}
        self._subscriber = self._lab.running.bus.subscribe_json(key, self._on_statement)
        return self

    def __exit__(self, *_: object) -> None:
        self._subscriber.undeclare()

    def _on_statement(self, _key: str, data: dict[str, Any]) -> None:
        heard = Heard(time.time(), parse(data["payload"]))
        with self._lock:
            self._heard.append(heard)

    def heard(self, since_s: float = 0.0) -> list[Heard]:
        with self._lock:
            return [one for one in self._heard if one.time_s >= since_s]

    def figures(self) -> dict[str, float]:
        """From a device's own stamp to the arrival of the signed statement about it, and the share of a core
        that its driver's process took, until now."""
        passed_s = time.monotonic() - self._began_s
        found = {
            f"lab_{driver}_cpu": round((_cpu_s(pid) - self._cpu_s[driver]) / passed_s, 3)
            for driver, pid in self._pids.items()
        }
        delays_s: dict[str, list[float]] = {}
        for one in self.heard():
            for name, stamp_s in one.stamps_s.items():
                delays_s.setdefault(name, []).append(one.time_s - stamp_s)
        for name, values_s in delays_s.items():
            for share in (50, 99):
                found[f"lab_{name}_delay_p{share}_ms"] = round(1e3 * float(np.percentile(values_s, share)), 1)
        return found

    def lost_s(self, driver: str, since_s: float) -> float:
        """The longest time since then of which nothing is signed: the robot, or what the meter reads."""
        times_s: list[float] = []
        for one in (heard.statement for heard in self.heard(since_s)):
            if driver == MODBUS and isinstance(one, MeterRecord):
                times_s += unpack(one.since_ms, one.readings).time_s.tolist()
            elif driver == NATNET and isinstance(one, Motion):
                times_s += self._seen_s(one)
        return float(np.diff(times_s).max(initial=0.0))

    def _seen_s(self, said: Motion) -> list[float]:
        """The last moment of a statement at which the robot was seen; none if it was not."""
        robot = self._lab.site.robots[0].name
        signed = track([said], robot)
        if signed is not None:
            return [float(signed.time_us[-1]) * 1e-6]
        return [(said.end_us - said.unseen_us.get(robot, 0)) * 1e-6] if robot in said.resting else []
