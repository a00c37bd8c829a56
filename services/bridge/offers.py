"""What this bridge's participants send so that their services have work, and to have their bonds back.

A provider that is not proven waits or works with one service at a time, and rests after work that it gave
back or missed. The contracts let its other services stand back until it activates one again. The bond of one
that it withdrew meanwhile stays locked for a day.

A match on chain looks at the first few tasks and services only, and a task that several providers gave back
waits for a proven one. What is overlooked so the provider of a service that fits gives to that service."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from rodeo.bus.messages import PATIENCE_S, PROVEN_FROM
from rodeo.judging.rulings import GRACE_S
from services.bridge.index import Index

Row = Mapping[str, Any]

_MOST_TURNS = 8
"""Services in line that are waited for at most: anybody may put any number of them there."""


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
    """Updates that the participants `here` (address -> name) send now, and the time at which the next one is
    due. `can_do(name, kind)`: whether a participant can do such work."""
    providers, engaged = index.services.providers(), index.services.engaged()
    due: list[Update] = []
    ends_s: list[float] = []

    def is_over(until_s: float | None) -> bool:
        """Whether the block time has come; if not, when it comes is noted."""
        if until_s is None or until_s < now_s:
            return True
        ends_s.append(until_s)
        return False

    for service in index.services.idle():
        if service["place"]:
            continue
        name, provider = here.get(service["provider"]), providers[service["provider"]]
        if name is None or not can_do(name, service["kind"]):
            continue
        if provider["earned"] or provider["vouched"]:
            due.append(Update(name, service["id"], "active"))
        elif service["provider"] not in engaged and is_over(provider["rests_until"]):
            engaged.add(service["provider"])
            due.append(Update(name, service["id"], "active"))
    for service in index.services.locked_bonds():
        name = here.get(service["provider"])
        if name is not None and is_over(providers[service["provider"]]["bond_locked_until"]):
            due.append(Update(name, service["id"], "retired"))
    return due, min(ends_s, default=None)


class Match(NamedTuple):
    """A task that its sender's service fits, and that waits."""

    wallet: str
    task_id: int
    service_id: int

    @property
    def command(self) -> str:
        return "match_task"

    @property
    def data(self) -> dict[str, Any]:
        return {"task_id": self.task_id, "service_id": self.service_id}


def due_matches(
    index: Index, here: Mapping[str, str], can_do: Callable[[str, str], bool], now_s: float
) -> tuple[list[Match], float | None]:
    """What `here` (address -> name) send now for their services that wait, and when the next is due. Where
    the contracts match by themselves they have done so after GRACE_S; then the services in line have their
    turns, GRACE_S each, so that of several bridges one sends."""
    line = sorted((one for one in index.services.idle() if one["place"]), key=lambda one: int(one["place"]))
    waiting = [one for one in line if one["provider"] in here and can_do(here[one["provider"]], one["kind"])]
    if not waiting:
        return [], None
    anybody = (
        one
        for one in index.tasks.in_state("open")
        if one["requested_service_id"] is None and one["requested_provider"] is None
    )
    providers = index.services.providers()
    due: list[Match] = []
    starts_s: list[float] = []
    for task in sorted(anybody, key=lambda one: int(one["id"])):
        passed = {one["provider"] for one in task["passed"]}
        for service in waiting:
            provider = service["provider"]
            if not _fits(service, task) or provider in passed:
                continue
            proven = providers[provider]["earned"] or providers[provider]["vouched"]
            before = sum(
                one["place"] < service["place"] and one["provider"] not in passed | here.keys()
                for one in line
                if _fits(one, task)
            )
            wait_s = GRACE_S if proven or len(passed) < PROVEN_FROM else PATIENCE_S
            wait_s += min(before, _MOST_TURNS) * GRACE_S
            if task["opened"] + wait_s < now_s:
                due.append(Match(here[provider], task["id"], service["id"]))
                waiting.remove(service)
                break
            starts_s.append(task["opened"] + wait_s)
        if not waiting:
            break
    return due, min(starts_s, default=None)


def _fits(service: Row, task: Row) -> bool:
    return bool(service["number"] == task["number"] and service["price"] <= task["reward"])
