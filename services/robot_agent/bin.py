"""The smart bin as the robot knows it: signed statements about what it was shown and what fell."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Literal

from pydantic import ValidationError

from rodeo import topics
from rodeo.bus import Bus
from rodeo.config import Site
from rodeo.errors import BusError
from rodeo.evidence import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation
from services.robot_agent.body import Checkpoint
from services.robot_agent.errors import NoAnswer

log = logging.getLogger(__name__)

Kind = Literal["classification", "disposal"]

_ASK_PERIOD_S = 2.0
"""Wall time after which the bin is asked in case its message was lost (a router that restarts loses it)."""
_SLICE_S = 0.1


class SmartBin:
    """Keeps the bin's last attestation of each kind; `on_attestation` gets every new one."""

    def __init__(self, bus: Bus, site: Site, on_attestation: Callable[[dict[str, Any]], None]) -> None:
        names = {"org": site.org, "bin": site.bin.name}
        self._bus = bus
        self._on_attestation = on_attestation
        self._state_key = topics.BIN_STATE.name(**names)
        self._last: dict[Kind, Attestation] = {}
        self._changed = threading.Condition()
        self._subscribers = [
            bus.subscribe_json(topics.CLASSIFICATION.name(**names), self._receiver("classification")),
            bus.subscribe_json(topics.DISPOSAL.name(**names), self._receiver("disposal")),
        ]

    def _receiver(self, kind: Kind) -> Callable[[str, dict[str, Any]], None]:
        return lambda _key, data: self._accept(kind, data)

    def _accept(self, kind: Kind, data: dict[str, Any]) -> None:
        try:
            attestation = Attestation.model_validate(data)
            verify_attestation(attestation)
            seq = int(attestation.payload["seq"])
        except (BadAttestation, ValidationError, KeyError, TypeError, ValueError) as error:
            log.warning("left out what is not the bin's %s: %s", kind, error)
            return
        with self._changed:
            if seq <= self._last_seq(kind):
                return
            self._last[kind] = attestation
            self._on_attestation(attestation.model_dump())
            self._changed.notify_all()

    def _last_seq(self, kind: Kind) -> int:
        return int(self._last[kind].payload["seq"]) if kind in self._last else 0

    def _ask(self) -> None:
        try:
            state = self._bus.query(self._state_key, timeout_s=2.0)
        except BusError as error:
            log.info("the bin does not answer: %s", error)
            return
        for kind in ("classification", "disposal"):
            if state.get(kind) is not None:
                self._accept(kind, state[kind])

    def last_seq(self, kind: Kind) -> int:
        """Number of the bin's last statement of this kind, 0 if it never made one."""
        self._ask()
        with self._changed:
            return self._last_seq(kind)

    def said_since(self, time_s: float) -> list[dict[str, Any]]:
        """The last classification and the last disposal, as attested, unless they are older than `time_s`."""
        self._ask()
        with self._changed:
            last = [self._last[kind] for kind in ("classification", "disposal") if kind in self._last]
        return [a.model_dump() for a in last if float(a.payload["time_s"]) >= time_s]

    def wait_for(
        self,
        kind: Kind,
        wanted: Callable[[dict[str, Any]], bool],
        checkpoint: Checkpoint,
        timeout_wall_s: float,
    ) -> dict[str, Any]:
        """The first statement that is `wanted`. Raises NoAnswer after `timeout_wall_s` wall seconds.

        Wall time, because another process has to work, however fast the site's clock runs.
        """
        deadline_s = time.monotonic() + timeout_wall_s
        ask_s = time.monotonic() + _ASK_PERIOD_S
        while True:
            with self._changed:
                last = self._last.get(kind)
                if last is not None and wanted(last.payload):
                    return last.payload
                self._changed.wait(_SLICE_S)
            checkpoint()
            now_s = time.monotonic()
            if now_s >= deadline_s:
                raise NoAnswer(f"the bin sent no {kind}", timeout_s=timeout_wall_s)
            if now_s >= ask_s:
                self._ask()
                ask_s = now_s + _ASK_PERIOD_S

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()
