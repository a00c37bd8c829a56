"""Which services of this bridge's participants are put into line again, and which bonds are fetched.

A provider that is not proven waits or works with one service at a time, and rests after work that it gave
back or missed. The contracts let its other services stand back until it activates one again. The bond of one
that it withdrew meanwhile stays locked for a day."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from services.bridge.index import Index

Row = Mapping[str, Any]


class Update(NamedTuple):
    """A service that its provider sends `update_service` for."""

    wallet: str
    service_id: int
    state: Literal["active", "retired"]

    @property
    def command(self) -> str:
        return "update_service"

    @property
    def data(self) -> dict[str, Any]:
        return {"service_id": self.service_id, "state": self.state}

    @property
    def task_id(self) -> None:
        """It is about none."""


def due_updates(
    index: Index, here: Mapping[str, str], can_do: Callable[[str, str], bool], now_s: float
) -> tuple[list[Update], float | None]:
    """What `here` (address -> name) send now, and when the next is due. `can_do(name, kind)`: whether a
    participant can do such work."""
    providers, engaged = index.providers(), index.engaged()
    due: list[Update] = []
    ends_s: list[float] = []

    def is_over(until_s: float | None) -> bool:
        """Whether the block time has come; if not, when it comes is noted."""
        if until_s is None or until_s < now_s:
            return True
        ends_s.append(until_s)
        return False

    for service in index.stood_back():
        name, provider = here.get(service["provider"]), providers[service["provider"]]
        if name is None or not can_do(name, service["kind"]):
            continue
        if provider["earned"] or provider["vouched"]:
            due.append(Update(name, service["id"], "active"))
        elif service["provider"] not in engaged and is_over(provider["rests_until"]):
            engaged.add(service["provider"])
            due.append(Update(name, service["id"], "active"))
    for service in index.locked_bonds():
        name = here.get(service["provider"])
        if name is not None and is_over(providers[service["provider"]]["bond_locked_until"]):
            due.append(Update(name, service["id"], "retired"))
    return due, min(ends_s, default=None)
