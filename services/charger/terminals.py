"""The dock's meter and contactor behind one interface: on the bus (`BusTerminals`) or on Modbus
(`services.charger.modbus`).

What the terminals report are voltage and current at the dock's contacts, in a sensor_msgs/msg/BatteryState
about once a second, whose `present` says whether a robot is on the contacts. Another meter is one more class
with these six members, chosen in `open_terminals`.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

from rodeo.errors import RodeoError
from rodeo.lab.config import DockConfig
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.plain import PlainNode, new
from rodeo.ros2.readings import power, why_unknown
from rodeo.site import topics
from services.charger.lies import MeterLie

log = logging.getLogger(__name__)

_SILENCE_S = 10.0
"""Wall time without a reading after which the dock counts as missing."""

OnReading = Callable[[Any, MessageInfo], None]
"""Gets each reading that can be used, with its bytes, in the receiving thread."""


class Terminals(Protocol):
    """A dock's meter and contactor."""

    @property
    def silence(self) -> str:
        """Why nothing can be metered now; empty while readings arrive."""

    @property
    def lie(self) -> MeterLie | None:
        """How the meter or the contactor contradicts itself, None while it does not. It hands out no reading
        then, and nothing is sold."""

    @property
    def shown(self) -> dict[str, Any]:
        """What the meter itself shows, for people."""

    @property
    def least_order_wh(self) -> float:
        """Smallest order for which the meter can show that it does not lie; 0 where it need not."""

    def command(self, closed: bool) -> bool:
        """Close or open the contactor; whether it confirmed."""

    def close(self) -> None:
        """Let go of the devices."""


def open_terminals(dock: DockConfig, node: PlainNode, on_reading: OnReading) -> Terminals:
    """The terminals that the site file chose for `dock`."""
    if dock.meter.source == "modbus":
        # Imported here: few docks have one.
        from services.charger.modbus import ModbusTerminals

        return ModbusTerminals.of(dock, node, on_reading)
    return BusTerminals(node, dock.name, on_reading)


class BusTerminals:
    """Terminals that somebody else publishes on the bus, and a contactor that is served there."""

    lie = None
    least_order_wh = 0.0
    shown: ClassVar[dict[str, Any]] = {}

    def __init__(self, node: PlainNode, dock: str, on_reading: OnReading) -> None:
        output, enable = topics.DOCK_OUTPUT, topics.DOCK_ENABLE
        self._on_reading = on_reading
        self._dock = dock
        self._heard_s = -math.inf
        """Wall (monotonic) time of the last reading."""
        self._unusable = ""
        """Why the newest reading cannot be used."""
        self._enable = node.client(enable.name(dock=dock), enable.type)
        # In the receiving thread: when a simulated clock's mark is there, so is what was read before.
        node.subscription(output.name(dock=dock), output.type, self._on_output, inline=True)

    def _on_output(self, message: Any, info: MessageInfo) -> None:
        self._unusable = why_unknown(power, message)
        if not self._unusable:
            self._heard_s = time.monotonic()
            self._on_reading(message, info)

    @property
    def silence(self) -> str:
        if time.monotonic() - self._heard_s <= _SILENCE_S:
            return ""
        why = f" can be used: {self._unusable}" if self._unusable else ""
        return f"no readings from {topics.DOCK_OUTPUT.name(dock=self._dock)}{why}"

    def command(self, closed: bool) -> bool:
        try:
            answer = self._enable.call(new("std_srvs/srv/SetBool_Request", data=closed))
        except RodeoError as error:
            log.warning("the dock does not answer: %s", error)
            return False
        if not answer.success:
            log.warning("the dock refused to %s: %s", "close" if closed else "open", answer.message)
        return bool(answer.success)

    def close(self) -> None:
        """The node that carries them is closed by its owner."""
