"""`state/<what>`: answers from the index."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import Field

from rodeo.bus import Request, validate
from rodeo.chain import Deployment
from rodeo.messages import Id, Kind, Message, TaskState
from services.bridge.amounts import iec
from services.bridge.errors import UnknownQuery, UnknownTask
from services.bridge.index import Index
from services.bridge.names import Names

Json = dict[str, Any]

MAX_PAGE = 500


class TaskFilters(Message):
    """Parameters of `state/tasks`; creator and executor by name or address."""

    state: TaskState | None = None
    kind: Kind | None = None
    creator: str | None = None
    executor: str | None = None
    limit: Annotated[int, Field(ge=1, le=MAX_PAGE)] = 100
    offset: Id = 0


class EventRange(Message):
    """Parameters of `state/events`."""

    after: Id = 0
    limit: Annotated[int, Field(ge=1, le=MAX_PAGE)] = MAX_PAGE


class Queries:
    """Answers questions about the organization."""

    def __init__(self, index: Index, names: Names, deployment: Deployment, url: str) -> None:
        self._index = index
        self._names = names
        self._deployment = deployment
        self._url = url
        self._table: Mapping[str, Callable[[Request], Json]] = {
            "tasks": self._tasks,
            "services": self._services,
            "wallets": self._wallets,
            "devices": self._devices,
            "chain": self._chain,
            "events": self._events,
        }

    def answer(self, what: str, request: Request) -> Json:
        """The answer to `state/<what>`. Raises RequestError."""
        if what.startswith("task/"):
            return self._task(what.removeprefix("task/"))
        if what not in self._table:
            raise UnknownQuery("no such question", what=what, known=[*self._table, "task/<id>"])
        return self._table[what](request)

    def _tasks(self, request: Request) -> Json:
        filters = validate(TaskFilters, request.parameters)
        wanted = filters.model_dump(exclude={"limit", "offset"}, exclude_none=True)
        for role in ("creator", "executor"):
            if role in wanted:
                wanted[role] = self._names.address(wanted[role])
        rows, total = self._index.tasks(wanted, filters.limit, filters.offset)
        return {"tasks": [self._task_json(row) for row in rows], "total": total}

    def _task(self, text: str) -> Json:
        # 18 digits fit into an Id.
        row = self._index.task(int(text)) if text.isdecimal() and len(text) <= 18 else None
        if row is None:
            raise UnknownTask("no such task", task_id=text)
        return self._task_json(row)

    def _services(self, _request: Request) -> Json:
        return {
            "services": [
                {
                    **{key: value for key, value in row.items() if key != "price"},
                    "provider_name": self._names.name(row["provider"]),
                    "price_iec": iec(row["price"]),
                }
                for row in self._index.services()
            ]
        }

    def _wallets(self, _request: Request) -> Json:
        balances = self._index.balances()
        return {
            "wallets": [
                {"name": name, "address": address, "balance_iec": iec(balances.get(address, 0))}
                for name, address in self._names.addresses.items()
            ],
            "supply_iec": iec(sum(balances.values())),
        }

    def _devices(self, _request: Request) -> Json:
        return {
            "devices": [
                {**row, "owner_name": self._names.name(row["owner"])} for row in self._index.devices()
            ]
        }

    def _chain(self, _request: Request) -> Json:
        position = self._index.position
        return {
            "chain_id": self._deployment.chain_id,
            "genesis_hash": self._deployment.genesis_hash,
            "url": self._url,
            "head": position.block,
            "time_s": position.block_time_s,
            "contracts": self._deployment.contracts,
            "organization": self._deployment.address("Organization"),
            "kinds": self._index.kinds(),
            "last_seq": self._index.last_seq(),
        }

    def _events(self, request: Request) -> Json:
        wanted = validate(EventRange, request.parameters)
        events = self._index.events_after(wanted.after, wanted.limit)
        return {"events": [event.model_dump(mode="json") for event in events]}

    def _task_json(self, row: Mapping[str, Any]) -> Json:
        """`rodeo.messages.Task`."""
        amounts = {"reward", "price", "paid"}
        return {
            **{key: value for key, value in row.items() if key not in amounts},
            **{f"{key}_iec": None if row[key] is None else iec(row[key]) for key in sorted(amounts)},
            "creator_name": self._names.name(row["creator"]),
            "executor_name": self._names.name(row["executor"]),
        }
