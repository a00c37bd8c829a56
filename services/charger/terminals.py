"""The dock's driver: what its meter reads, and the command to its contactor."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any

from rodeo.errors import RodeoError
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.plain import PlainNode, new
from rodeo.ros2.readings import power, why_unknown
from rodeo.site import topics

log = logging.getLogger(__name__)

_SILENCE_S = 10.0
"""Wall time without a reading after which the dock counts as missing."""


class Terminals:
    """The terminals of `dock`. `on_reading` gets each reading that can be used, in the receiving thread."""

    def __init__(self, node: PlainNode, dock: str, on_reading: Callable[[Any, MessageInfo], None]) -> None:
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
        """Why nothing can be metered now; empty while readings arrive."""
        if time.monotonic() - self._heard_s <= _SILENCE_S:
            return ""
        why = f" can be used: {self._unusable}" if self._unusable else ""
        return f"no readings from {topics.DOCK_OUTPUT.name(dock=self._dock)}{why}"

    def command(self, closed: bool) -> bool:
        """Close or open the contactor; whether the dock did."""
        try:
            answer = self._enable.call(new("std_srvs/srv/SetBool_Request", data=closed))
        except RodeoError as error:
            log.warning("the dock does not answer: %s", error)
            return False
        if not answer.success:
            log.warning("the dock refused to %s: %s", "close" if closed else "open", answer.message)
        return bool(answer.success)
