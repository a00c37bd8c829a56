"""What an experiment keeps of a run while it goes, for one that continues after it was interrupted."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from rodeo.charging.tariff import price_at
from rodeo.host.files import replace_file
from rodeo.ros2 import readings
from rodeo.ros2.readings import Unknown, power
from rodeo.site.config import Site
from rodeo_experiments.record import Arrival, Flow, Heard, Reading, Sent

_GAUGE_S = 300.0
_GAP_S = 30.0
"""Power of a dock that stops for so long is another flow."""


class Progress(BaseModel):
    """What a run that continues must know, and nothing on chain tells."""

    prepared: bool = False
    next_arrival: int = 0
    items: dict[str, str] = {}
    """Item -> `away`, `bin`, or the number of the arrival that left it on the floor."""
    arrivals: list[Arrival] = []
    planned: tuple[str, float, float] | None = None
    """The arrival that is being posted: item and place."""
    emptyings: int = 0
    started_s: float = 0.0
    wall_s: float = 0.0
    """How long the run has taken until now."""
    last_seq: int = 0
    """Number of the last event in `events`."""
    events: list[Heard] = []
    sent: list[Sent] = []
    battery: list[Reading] = []
    flows: list[Flow] = []
    notes: list[str] = []


@dataclass
class Meters:
    """What gauges and docks tell, from Zenoh's threads."""

    site: Site
    battery: list[Reading] = field(default_factory=list)
    flows: list[Flow] = field(default_factory=list)
    _last: dict[str, tuple[float, float]] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def on_gauge(self, robot: str, message: Any, _info: Any) -> None:
        full = self.site.robot(robot).battery.percentage_full
        try:
            (time_s, voltage_v, current_a), soc = power(message), readings.battery(message, full).soc
        except Unknown:
            return
        with self.lock:
            before = next((one for one in reversed(self.battery) if one.robot == robot), None)
            if before is None or time_s - before.time_s >= _GAUGE_S:
                power_w = round(voltage_v * current_a, 1)
                self.battery.append(Reading(robot=robot, time_s=time_s, soc=round(soc, 4), power_w=power_w))

    def on_output(self, dock: str, message: Any, _info: Any) -> None:
        try:
            time_s, voltage_v, current_a = power(message)
        except Unknown:
            return
        power_w = voltage_v * current_a
        with self.lock:
            last_s, last_w = self._last.get(dock, (time_s, 0.0))
            self._last[dock] = time_s, power_w
            if power_w <= 0 and last_w <= 0:
                return
            flow = next((one for one in reversed(self.flows) if one.dock == dock), None)
            if flow is None or last_s - flow.end_s > _GAP_S:
                flow = Flow(dock=dock, begin_s=last_s, end_s=last_s, energy_wh=0.0)
                self.flows.append(flow)
            # As a meter does: what flowed since the last reading, by the mean of both.
            energy_wh = (power_w + last_w) / 2 * (time_s - last_s) / 3600
            flow.energy_wh += energy_wh
            flow.cost_eur += energy_wh / 1000 * float(price_at(self.site.economy.electricity, time_s))
            flow.end_s = time_s


class Journal:
    """The run's progress, its meters, and the file that holds both."""

    def __init__(self, path: Path, site: Site) -> None:
        self._path = path
        self.progress = Progress(items=dict.fromkeys((one.id for one in (*site.items, *site.things)), "away"))
        if path.exists():
            self.progress = Progress.model_validate_json(path.read_text())
        self._begun_wall_s = time.monotonic() - self.progress.wall_s
        self.meters = Meters(site, self.progress.battery, self.progress.flows)

    @property
    def wall_s(self) -> float:
        """How long the run has taken until now."""
        return time.monotonic() - self._begun_wall_s

    def save(self) -> None:
        self.progress.wall_s = round(self.wall_s, 1)
        with self.meters.lock:
            text = self.progress.model_dump_json()
        replace_file(self._path, text + "\n")
