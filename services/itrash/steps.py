"""The bin's state machine between its sensors and the main thread, which carries out what it asks for."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from rodeo.host.clocked import ClockedEvent
from rodeo.host.stamps import stamp_s
from rodeo.lab.config import BinConfig
from rodeo.ros2 import readings
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.node import Node
from rodeo.ros2.readings import Unknown
from rodeo.runtime.process import Process
from rodeo.site import topics
from services.itrash.behaviour import Action, Attest, Bin

_TELL_S = 0.5
"""Wall time between two looks at what is missing."""
_READING_S = 0.1
"""Site time between two looks while the bin is attentive: its sensors publish at 10 Hz
(rodeo.site.topics)."""
_SILENCE_S = 3.0
"""Wall time without a reading after which a sensor counts as missing."""


class Steps:
    """Feeds `bin_`, and queues its actions. `lock` guards the state machine and the journal."""

    def __init__(self, bin_: Bin, process: Process) -> None:
        self.bin = bin_
        self.lock = threading.Lock()
        self._process = process
        self._actions: queue.SimpleQueue[Action | None] = queue.SimpleQueue()
        self.arrived = ClockedEvent(process.clock, lambda: not self._actions.empty())
        for record in bin_.memory.unsigned:  # decided before the process ended
            self._actions.put(Attest(record))
        self._presence = ""
        self._heard_s: dict[str, float] = {}
        """Wall (monotonic) time of each sensor's last reading."""

    def listen(self, node: Node, config: BinConfig) -> set[str]:
        """Subscribe to the sensors of the bin; their topics."""
        presence, load = topics.BIN_PRESENCE, topics.BIN_LOAD
        self._presence = presence.name(bin=config.name)
        sensors = {self._presence}
        # In the receiving thread: when a simulated clock's mark is there, so is what was sensed before.
        node.subscription(self._presence, presence.type, self._on_presence, inline=True)
        for compartment in config.compartments:
            name = load.name(bin=config.name, compartment=compartment)
            sensors.add(name)
            node.subscription(name, load.type, self._load_callback(compartment, name), inline=True)
        return sensors

    def _on_presence(self, message: Any, _info: MessageInfo) -> None:
        with suppress(Unknown):  # an erroneous reading says nothing, not even "empty"
            distance_m = readings.distance_m(message)
            self.feed(self._presence, lambda: self.bin.presence(distance_m, stamp_s(message.header.stamp)))

    def _load_callback(self, compartment: str, sensor: str) -> Callable[[Any, MessageInfo], None]:
        def on_load(message: Any, _info: MessageInfo) -> None:
            with suppress(Unknown):  # a broken cell weighs nothing
                force_n = readings.force_n(message)
                self.feed(sensor, lambda: self.bin.load(compartment, force_n, stamp_s(message.header.stamp)))

        return on_load

    def feed(self, sensor: str, step: Callable[[], list[Action]]) -> None:
        with self.lock:
            self._heard_s[sensor] = time.monotonic()
            before = self._remembered()
            actions = step()
            changed = self._remembered() != before
        for action in actions:
            self._actions.put(action)
        if changed and not actions:
            self._actions.put(None)  # nothing to do but to remember
        if changed or actions:
            self.arrived.set()

    def _remembered(self) -> tuple[Any, ...]:
        memory = self.bin.memory
        # A caller that waits at rest has to see each reading once the next one may decide.
        decides = self.bin.decides
        loads_n = [cell.settled_n for cell in memory.cells.values()]
        return memory.state, memory.since_s, memory.pending, decides, loads_n

    def await_action(self) -> bool:
        """Whether there is one before the next report is due. While something is shown or falls, each reading
        may be the one that decides: a simulated clock waits after it. A simulator that skips a charge
        continues to show readings, also while something is awaited."""
        attentive, decides = self.bin.attentive, self.bin.decides
        self.arrived.wait(
            self._process.stop,
            wall_s=_TELL_S,
            every_s=_READING_S if decides else math.inf,
            resting=not attentive,
        )
        return not self._actions.empty() and not self._process.stop.is_set()

    def next(self) -> Action | None:
        """The next action; None when there is nothing to do but to remember."""
        return self._actions.get()

    def silent(self, sensors: Iterable[str]) -> list[str]:
        """Those without a reading in the last seconds."""
        now_s = time.monotonic()
        with self.lock:
            return sorted(s for s in sensors if now_s - self._heard_s.get(s, -math.inf) > _SILENCE_S)
