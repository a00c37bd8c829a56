"""How long the lab's drivers take, and what they cost."""

from __future__ import annotations

import os
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any, Self

import numpy as np

from rodeo.site import topics
from rodeo.site.names import bin_process, dock_process
from rodeo.site.providers import MOTION_CAPTURE
from rodeo.witness.statement import Drop, MeterRecord, Motion, parse
from rodeo_kinds.battery_charging.readings import unpack
from tests.support.reallab import RealLab

DRIVERS = {"mocap": "natnet", "meter": "modbus", "bin": "bin"}


def _stamps_s(said: Any) -> tuple[str, float] | None:
    """The driver that measured, and the newest of the device's own stamps in a statement."""
    if isinstance(said, Motion):
        return DRIVERS["mocap"], said.end_us * 1e-6
    if isinstance(said, MeterRecord):
        times_s = unpack(said.since_ms, said.readings).time_s
        return (DRIVERS["meter"], float(times_s[-1])) if len(times_s) else None
    if isinstance(said, Drop):
        return DRIVERS["bin"], said.settled_s
    return None


def _cpu_s(pid: int) -> float:
    """Processor time that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Delays:
    """From a device's own stamp to the arrival of the signed statement about it, and the processor's share of
    its driver's process. Use as a context manager."""

    def __init__(self, lab: RealLab) -> None:
        self._lab = lab
        self._delays_s: dict[str, list[float]] = defaultdict(list)
        site = lab.site
        names = (MOTION_CAPTURE, dock_process(site, site.docks[0].name), bin_process(site, site.bins[0].name))
        children = lab.running.children
        self._pids = {
            driver: children[name].pid for driver, name in zip(DRIVERS.values(), names, strict=True)
        }
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        lab = self._lab
        key = topics.WITNESS_STATEMENT.pattern(org=lab.site.org)
        self._began_s = time.monotonic()
        self._cpu_s = {driver: _cpu_s(pid) for driver, pid in self._pids.items()}
        self._heard = lab.running.bus.subscribe_json(key, self._on_statement)
        return self

    def __exit__(self, *_: object) -> None:
        self._heard.undeclare()
        passed_s = time.monotonic() - self._began_s
        self._share = {
            driver: (_cpu_s(pid) - self._cpu_s[driver]) / passed_s for driver, pid in self._pids.items()
        }

    def _on_statement(self, _key: str, data: dict[str, Any]) -> None:
        found = _stamps_s(parse(data["payload"]))
        if found is not None:
            with self._lock:
                self._delays_s[found[0]].append(time.time() - found[1])

    def figures(self) -> dict[str, float]:
        found = {f"lab_{driver}_cpu": round(share, 3) for driver, share in self._share.items()}
        for driver, delays_s in self._delays_s.items():
            for share in (50, 99):
                delay_ms = 1e3 * float(np.percentile(delays_s, share))
                found[f"lab_{driver}_delay_p{share}_ms"] = round(delay_ms, 1)
        return found
