"""The smart bin as the robot knows it: signed statements about what it was shown and what fell."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from typing import Any, Literal

from pydantic import ValidationError

from rodeo import topics
from rodeo.bus import Bus
from rodeo.config import Site
from rodeo.errors import BusError, RemoteError
from rodeo.evidence import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation
from services.robot_agent.body import Checkpoint
from services.robot_agent.errors import NoAnswer

log = logging.getLogger(__name__)

Kind = Literal["classification", "disposal"]

_TELLING: dict[Kind, str] = {"classification": "class", "disposal": "expected_compartment"}
"""A field that only statements of this kind have."""
_ASK_PERIOD_S = 2.0
"""Wall time after which the bin is asked in case its message was lost (a router that restarts loses it)."""
_ANSWER_WALL_S = 2.0
"""Bin and bridge answer at once, or not at all."""
_KNOWN_WALL_S = 60.0
"""After this the bridge is asked again who may sign: devices are revoked."""
_STRANGER_WALL_S = 1.0
"""The same for a signer that it did not name: the bin may have a new key, but anybody may publish."""
_SLICE_S = 0.1


class SmartBin:
    """Keeps the bin's last attestation of each kind; `on_attestation` gets every new one.

    What a statement is about is told by its time. Its number cannot: it begins anew with the bin's journal,
    and the number before it is unknown when the bin did not answer.
    """

    def __init__(self, bus: Bus, site: Site, on_attestation: Callable[[dict[str, Any]], None]) -> None:
        names = {"org": site.org, "bin": site.bin.name}
        self._bus = bus
        self._name = site.bin.name
        self._on_attestation = on_attestation
        self._state_key = topics.BIN_STATE.name(**names)
        self._devices_key = topics.STATE.name(org=site.org, what="devices")
        self._signers: set[str] = set()
        """Lower-case addresses that may sign as a bin."""
        self._signers_asked_s = -math.inf
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
            attestation = self._verified(kind, data)
        except (BadAttestation, ValidationError, KeyError, TypeError, ValueError) as error:
            log.warning("left out what is not the bin's %s: %s", kind, error)
            return
        with self._changed:
            last = self._last.get(kind)
            if last is not None and _moment(attestation) <= _moment(last):
                if attestation.payload != last.payload:
                    order = _moment(attestation), _moment(last)
                    log.info("left out a %s of (time, seq) %s: the last one is of %s", kind, *order)
                return
            self._last[kind] = attestation
            self._on_attestation(attestation.model_dump())
            self._changed.notify_all()

    def _verified(self, kind: Kind, data: dict[str, Any]) -> Attestation:
        """What this bin signed of this kind. Raises BadAttestation, and what parsing `data` raises."""
        attestation = Attestation.model_validate(data)
        if not self._may_sign(verify_attestation(attestation)):
            raise BadAttestation("its signer is not registered as a bin", signer=attestation.signer)
        if attestation.payload["bin"] != self._name or _TELLING[kind] not in attestation.payload:
            raise BadAttestation("it is of another bin or kind", bin=attestation.payload["bin"])
        _moment(attestation)  # a statement without a time is none
        return attestation

    def _may_sign(self, signer: str) -> bool:
        """Whether the organization has `signer` for a bin; while the bridge is away, whether it had."""
        known = signer.lower() in self._signers
        now_s = time.monotonic()
        if now_s - self._signers_asked_s >= (_KNOWN_WALL_S if known else _STRANGER_WALL_S):
            self._signers_asked_s = now_s
            try:
                devices = self._bus.query(self._devices_key, timeout_s=_ANSWER_WALL_S)["devices"]
            except (BusError, RemoteError) as error:
                log.info("cannot ask who may sign as a bin: %s", error)
            else:
                self._signers = {
                    d["address"].lower() for d in devices if d["role"] == "bin" and d["revoked"] is None
                }
        return signer.lower() in self._signers

    def _ask(self) -> None:
        try:
            state = self._bus.query(self._state_key, timeout_s=_ANSWER_WALL_S)
        except (BusError, RemoteError) as error:
            log.info("the bin does not answer: %s", error)
            return
        for kind in _TELLING:
            if state.get(kind) is not None:
                self._accept(kind, state[kind])

    def _said_after(self, kind: Kind, time_s: float) -> Attestation | None:
        last = self._last.get(kind)
        return last if last is not None and _moment(last)[0] > time_s else None

    def said_after(self, kind: Kind, time_s: float) -> dict[str, Any] | None:
        """The bin's last statement of this kind, as attested, if it is newer than `time_s` (site time)."""
        self._ask()
        with self._changed:
            said = self._said_after(kind, time_s)
        return None if said is None else said.model_dump()

    def wait_for(
        self, kind: Kind, after_s: float, checkpoint: Checkpoint, timeout_wall_s: float
    ) -> dict[str, Any]:
        """A statement about what was later than `after_s` (site time).

        Raises NoAnswer after `timeout_wall_s`. Wall time, because another process has to work, however fast
        the site's clock runs.
        """
        deadline_s = time.monotonic() + timeout_wall_s
        ask_s = time.monotonic() + _ASK_PERIOD_S
        while True:
            with self._changed:
                said = self._said_after(kind, after_s)
                if said is not None:
                    return said.payload
                self._changed.wait(_SLICE_S)
            checkpoint()
            now_s = time.monotonic()
            if now_s >= deadline_s:
                last = self._last.get(kind)
                raise NoAnswer(
                    f"the bin sent no {kind}",
                    timeout_s=timeout_wall_s,
                    after_s=after_s,
                    last_s=None if last is None else _moment(last)[0],
                )
            if now_s >= ask_s:
                self._ask()
                ask_s = now_s + _ASK_PERIOD_S

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()


def _moment(attestation: Attestation) -> tuple[float, int]:
    """Site time and number of a statement: what is greater was said later."""
    return float(attestation.payload["time_s"]), int(attestation.payload["seq"])
