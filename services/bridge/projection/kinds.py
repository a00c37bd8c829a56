"""Kinds of work, their rules and judges; devices and their roots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rodeo.chain.contracts import events
from rodeo.chain.contracts.types import ZERO_ADDRESS
from services.bridge import schema
from services.bridge.projection import At, Table, hex_of
from services.bridge.rows import Rows


class Kinds:
    """Rows of kinds, and events about them and about devices."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def get(self, kind: str) -> Mapping[str, Any]:
        lists = ("rules_sha256", "seats", "challenge_stakes")
        numbers = [column.name for column in schema.kinds.columns if column.name not in ("kind", *lists)]
        unknown = {
            **dict.fromkeys(numbers, 0),
            **{name: [] for name in lists},
            "kind": kind,
            "allowed": False,
        }
        return self._rows.find(schema.kinds, kind) or unknown

    def change(self, kind: str, **values: Any) -> None:
        self._rows.put(schema.kinds, **{**self.get(kind), **values})

    def number(self, number: int) -> Mapping[str, Any]:
        """The judge, and whether it still judges."""
        return self._rows.find(schema.numbers, number) or {"judge": ZERO_ADDRESS, "removed": False}

    def table(self) -> Table:
        rows = self._rows
        return {
            events.KindAllowed: self._allowed,
            events.RulesRetired: lambda one, _: self._rules(one.kind, one.rules, current=False),
            events.KindDisallowed: lambda one, _: self.change(one.kind, allowed=False),
            events.JudgeRemoved: lambda one, _: rows.change(schema.numbers, one.number, removed=True),
            events.WindowsChanged: self._windows_changed,
            events.DeviceRegistered: self._device_registered,
            events.DeviceOwnerChanged: lambda one, _: rows.change(
                schema.devices, one.device, owner=one.owner
            ),
            events.DeviceRevoked: lambda one, at: rows.change(
                schema.devices, one.device, revoked=at.time_s, revoked_because=one.reason.name.lower()
            ),
            events.WitnessRoot: self._witness_root,
        }

    def _allowed(self, event: events.KindAllowed, at: At) -> None:
        self._rows.put(schema.numbers, number=event.number, kind=event.kind, judge=event.judge, removed=False)
        asked = {"judges_window_s": event.judges_window, "max_case_s": event.max_case}
        self.change(event.kind, allowed=True, number=event.number, **asked)
        self._rules(event.kind, event.rules, current=any(event.rules))

    def _rules(self, kind: str, rules: bytes, *, current: bool) -> None:
        """Mark rules of a kind as the newest, or as current no longer."""
        others = [one for one in self.get(kind)["rules_sha256"] if one != hex_of(rules)]
        self.change(kind, rules_sha256=[*others, hex_of(rules)] if current else others)

    def _windows_changed(self, event: events.WindowsChanged, at: At) -> None:
        windows = {f"{name}_s": value for name, value in vars(event.windows).items()}
        self.change(event.kind, **windows, reference_price=event.reference_price)

    def _device_registered(self, event: events.DeviceRegistered, at: At) -> None:
        self._rows.add(
            schema.devices,
            address=event.device,
            role=event.role,
            name=event.device_name,
            owner=event.owner,
            registrar=event.registrar,
            registered=at.time_s,
        )

    def _witness_root(self, event: events.WitnessRoot, at: At) -> None:
        self._rows.add(
            schema.roots,
            device=event.device,
            day=event.day,
            root=hex_of(event.root),
            uri=event.uri,
            block=at.log.block,
            time_s=at.time_s,
            tx_hash=at.log.tx_hash,
        )
