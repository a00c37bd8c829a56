"""An organization's history as the chain's events tell it: no bridge is asked, and no key is opened."""

from __future__ import annotations

import math
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

from sqlalchemy.exc import DBAPIError

from rodeo.bus.messages import DaoEvent, Device, Root, Task
from rodeo.chain.client import connect, require_chain
from rodeo.chain.contracts.types import ZERO_ADDRESS
from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import RpcFailed
from rodeo.checks.acts import Submission, submissions_of
from rodeo.checks.case import ChainRecord
from rodeo.errors import RequestError
from rodeo.site.config import Site
from rodeo.witness.days import day_of
from services.bridge.contradiction import contradiction
from services.bridge.errors import IndexUnusable
from services.bridge.follower import Follower
from services.bridge.index import UNDONE, Index, sqlite_url
from services.bridge.names import judge_at
from services.bridge.node import Node
from services.bridge.queries import task_json
from services.bridge.reading import Page
from services.oracle.chain_view import as_of

_PAGE = 2_000
_ENDS = frozenset({"TaskSettled", "TaskRequeued", "TaskFailed", "TaskCancelled"})


@dataclass(slots=True)
class Attempt:
    """One attempt at a task, from its assignment to its end."""

    task_id: int
    number: int
    executor: str
    assigned: dict[str, object]
    """Fields of `Task` that the assignment sets."""
    submitted_s: float = math.inf
    place: tuple[int, int] = (0, 0)
    """Place of the submission in the chain: earlier ones are smaller."""
    proof_sha256: str = ""
    proof_uri: str = ""
    ruling: str = ""
    """The last of a judge; empty where nobody ruled."""
    amount_iec: Decimal = Decimal(0)
    """That the ruling grants."""
    reason: str = ""
    report_sha256: str = ""
    report_uri: str = ""
    block: int = 0
    """Block of the ruling."""
    ruled: tuple[int, int] = (0, 0)
    """Place of the ruling in the chain."""
    time_s: float = 0.0
    """Site time of the ruling."""
    passed_on: bool = False
    """Its judge could not decide, so that people could."""
    by_people: bool = False
    """Auditors or the judges of a challenge made the last ruling, or its judge was removed."""
    judge: str = ""
    """Judge of its kind, as `judge_at` names it."""
    ended: str = ""
    """Name of the event that ended it."""
    end_block: int = 0
    payout: str = ""
    paid_iec: Decimal = Decimal(0)
    received_iec: Decimal = Decimal(0)
    """What the payout account got in the transaction that paid it, or may collect."""


@dataclass
class _Reading:
    """Attempts that have not ended, and those that ended in the transaction that is being read."""

    running: dict[int, Attempt] = field(default_factory=dict)
    reported: DaoEvent | None = None
    ended: list[Attempt] = field(default_factory=list)
    received: Counter[str] = field(default_factory=Counter)
    tx_hash: str = ""


class Owners:
    """Participants by their address, as the chain has them: a robot's wallet owns the device of that name."""

    def __init__(self, devices: list[Device], organization: str, site: Site) -> None:
        self._names = {one.address: one.name for one in site.participants if one.address is not None}
        self._names |= {one.owner: one.name for one in devices if one.role == "robot"}
        self._names[organization] = "organization"

    def name(self, address: str | None) -> str | None:
        return None if address is None else self._names.get(address)


class History:
    """What happened in an organization. It is read into `folder`, and continued there the next time.

    Args:
        deployment: which contracts.
        tell: called with (block, newest block) while the chain is read.

    Raises ChainError, IndexUnusable.
    """

    def __init__(
        self, site: Site, deployment: Deployment, folder: Path, tell: Callable[[int, int], None]
    ) -> None:
        w3 = connect(site.chain.url)
        require_chain(w3, site.chain)
        deployment.verify(w3)
        self._site, self._deployment = site, deployment
        self._node = Node(site.chain.url, currency=deployment.currency)
        try:
            self._index = self._read(folder, tell)
        except DBAPIError as error:  # of a full disk, for one
            raise IndexUnusable(
                "the chain's index cannot be written", folder=str(folder), problem=str(error.orig)
            ) from error
        self.devices = [Device.model_validate(dict(one)) for one in self._index.rules.devices()]
        self._owners: dict[str, list[tuple[int, str]]] = defaultdict(list)
        """Key -> its owners, each with the block from which it was."""
        for one in self._events(("DeviceRegistered", "DeviceOwnerChanged")):
            self._owners[str(one.args["device"])].append((one.block, str(one.args["owner"])))
        self._numbers = self._index.rules.numbers()
        self._removed: dict[int, tuple[int, int]] = {}
        """Number of a judge of a kind -> the place of its removal, which may be said again."""
        for one in self._events(("JudgeRemoved",)):
            self._removed.setdefault(int(one.args["number"]), (one.block, one.log_index))
        self._keys = self._key_blocks()
        self.roots = [Root.model_validate(dict(one)) for one in self._pages_of_roots()]
        self._by_day: dict[int, list[Root]] = defaultdict(list)
        robots = {one.address.lower() for one in self.devices if one.role == "robot"}
        for root in self.roots:
            if root.device.lower() not in robots:  # no check asks what robots signed of a day
                self._by_day[root.day].append(root)

    def _read(self, folder: Path, tell: Callable[[int, int], None]) -> Index:
        deployment = self._deployment
        index = Index(
            sqlite_url(folder / f"{deployment.chain_id}-{deployment.genesis_hash[2:18]}.sqlite"),
            deployment.chain_id,
            deployment.genesis_hash,
            deployment.contracts,
            currency=deployment.currency,
        )
        follower = Follower(
            self._node, deployment, index, self._site.chain.confirmations, lambda _event: True
        )
        while follower.step([]):
            tell(index.position.block, follower.head)
        return index

    def close(self) -> None:
        self._index.close()
        self._node.close()

    @property
    def block(self) -> int:
        """The newest block that was read."""
        return self._index.position.block

    def last_of(self, first: int, last: int | None) -> int:
        """The last of the blocks from `first` to `last`, or to the newest. Raises RequestError where there
        are none."""
        newest = self.block if last is None else min(last, self.block)
        if first > newest:
            raise RequestError("there are no blocks in this range", first=first, last=newest)
        return newest

    def block_hash(self, block: int) -> str:
        """Raises ChainError."""
        header = self._node.call("eth_getBlockByNumber", hex(block), False)
        if header is None:
            raise RpcFailed("the node lacks a block", block=block)
        return str(header["hash"])

    def contradiction(self) -> str | None:
        """What the contracts say otherwise than their events: a balance, or a count. Raises ChainError."""
        return contradiction(self._index, self._node, self._deployment)

    def attempts(self, first: int, last: int) -> Iterator[Attempt]:
        """Attempts that ended in these blocks, and on which a judge had ruled."""
        reading = _Reading()
        for event in self._events():
            if event.block > last:
                break
            if event.tx_hash != reading.tx_hash:
                yield from self._ended(reading, first)
                reading.tx_hash = event.tx_hash
            _read(reading, event)
        yield from self._ended(reading, first)

    def _ended(self, reading: _Reading, first: int) -> Iterator[Attempt]:
        """Those that ended in the transaction that was read, with what it transferred."""
        for attempt in reading.ended:
            attempt.received_iec = Decimal(reading.received[attempt.payout])
            if attempt.ruling and attempt.end_block >= first:
                self._name_judge(attempt)
                yield attempt
        reading.ended.clear()
        reading.received.clear()

    def _name_judge(self, attempt: Attempt) -> None:
        row = self._index.tasks.get(attempt.task_id)
        assert row is not None  # its events were applied
        known = self._numbers.get(row["number"]) or {"judge": ZERO_ADDRESS}
        attempt.judge = judge_at(self._deployment.contracts, known["judge"])
        is_removed = attempt.ruled > self._removed.get(row["number"], attempt.ruled)
        attempt.by_people |= is_removed or attempt.judge == "auditor"

    def submission(
        self, task_id: int, attempt: int, before: tuple[int, int] = (sys.maxsize, 0)
    ) -> Submission | None:
        """What was submitted for a task in an attempt, as it was before a place in the chain."""
        events = (one for one in self._events((), task_id) if (one.block, one.log_index) < before)
        return next((one for one in submissions_of(events) if one.attempt == attempt), None)

    def chain_record(self, attempt: Attempt) -> ChainRecord:
        """What the chain said when the attempt was judged, with today's roots of its days."""
        row = self._index.tasks.get(attempt.task_id)
        assert row is not None  # its events were applied
        devices = self._owned(attempt.block)
        owners = Owners(devices, str(self._deployment.address("Organization")), self._site)
        task = Task.model_validate(task_json(row, owners, self._deployment.currency))
        task = Task.model_validate(task.model_dump() | _WITHOUT_END | attempt.assigned).model_copy(
            update={
                "executor_name": owners.name(attempt.executor),
                "proof_submitted": attempt.submitted_s,
                "proof_sha256": attempt.proof_sha256,
                "proof_uri": attempt.proof_uri,
                "verdict_deadline": attempt.submitted_s + task.verdict_window_s,
            }
        )
        record = ChainRecord(
            chain_id=self._deployment.chain_id,
            task_manager=self._deployment.address("TaskManager"),
            organization=self._deployment.address("Organization"),
            task=task,
            devices=devices,
        )
        days = range(day_of(task.assigned or 0.0) - 1, day_of(attempt.submitted_s) + 2)
        roots = [root for day in days for root in self._by_day.get(day, ())]
        return as_of(record, attempt.block, self._keys).chain_record.model_copy(update={"roots": roots})

    def _owned(self, block: int) -> list[Device]:
        """The devices, with the owners that they had in a block."""
        found = []
        for one in self.devices:
            owners = [owner for since, owner in self._owners[one.address] if since <= block]
            found.append(one.model_copy(update={"owner": owners[-1]}) if owners else one)
        return found

    def _events(self, names: tuple[str, ...] = (), task_id: int | None = None) -> Iterator[DaoEvent]:
        """Those that are on the chain, in its order; of all names and tasks, unless some are asked for."""
        undone = {int(one.args["undone_seq"]) for one in self._pages((UNDONE,), task_id)}
        for event in self._pages(names, task_id):
            if event.name != UNDONE and event.seq not in undone:
                yield event

    def _pages(self, names: tuple[str, ...], task_id: int | None = None) -> Iterator[DaoEvent]:
        after = 0
        while events := self._index.events_after(after, _PAGE, names, task_id):
            yield from events
            after = events[-1].seq

    def _pages_of_roots(self) -> Iterator[dict[str, object]]:
        offset = 0
        while rows := self._index.rules.roots(None, Page(_PAGE, offset))[0]:
            yield from map(dict, rows)
            offset += len(rows)

    def _key_blocks(self) -> dict[str, tuple[float, float]]:
        """Key -> block in which it was registered, and revoked."""
        blocks: dict[str, tuple[float, float]] = {}
        for event in self._events(("DeviceRegistered", "DeviceRevoked")):
            key = str(event.args["device"]).lower()
            registered, _ = blocks.get(key, (0, math.inf))
            is_new = event.name == "DeviceRegistered"
            blocks[key] = (event.block, math.inf) if is_new else (registered, event.block)
        return blocks


_WITHOUT_END: dict[str, object] = {
    "state": "submitted",
    "paid_iec": Decimal(0),
    "refunded_iec": Decimal(0),
    "accepted": True,
    "passed": [],
    "passed_on": False,
    **dict.fromkeys(("settled", "verdict", "fault", "reason", "report_sha256", "report_uri", "standing")),
    **dict.fromkeys(("case_end", "dispute")),
}
"""Fields of a task that waits for its verdict, whatever became of it later."""


def _read(reading: _Reading, event: DaoEvent) -> None:
    args, running = event.args, reading.running.get(event.task_id or 0)
    if event.name == "Transfer":
        reading.received[str(args["to"])] += Decimal(args["value_iec"])  # type: ignore[assignment]
    elif event.name == "PaymentDeferred":
        reading.received[str(args["account"])] += Decimal(args["amount_iec"])  # type: ignore[assignment]
    elif event.name == "TaskAssigned" and event.task_id is not None:
        reading.running[event.task_id] = _assigned(event)
    elif event.name == "Reported":
        reading.reported = event
    elif running is None:
        return
    elif event.name == "ProofSubmitted":
        running.submitted_s, running.place = event.time_s, (event.block, event.log_index)
        running.proof_sha256, running.proof_uri = str(args["proof_hash"]).lower(), str(args["uri"])
    elif event.name == "PassedOn":
        running.passed_on = True
    elif event.name == "Ruled":
        _ruled(running, event, reading.reported)
        reading.reported = None
    elif event.name == "InstanceRuled":
        running.by_people |= int(args["instance"]) > 0
    elif event.name in _ENDS:
        del reading.running[running.task_id]
        running.ended, running.end_block = event.name, event.block
        if event.name == "TaskSettled":
            running.payout, running.paid_iec = str(args["payout"]), Decimal(args["paid_iec"])
        reading.ended.append(running)


def _assigned(event: DaoEvent) -> Attempt:
    args = event.args
    fields = {
        "attempt": int(args["attempt"]),
        "executor": str(args["executor"]),
        "service_id": int(args["service_id"]),
        "price_iec": Decimal(args["price_iec"]),
        "nonce": str(args["nonce"]),
        "execution_deadline": float(args["deadline"]),
        "assigned": event.time_s,
    }
    return Attempt(event.task_id or 0, int(args["attempt"]), str(args["executor"]), fields)


def _ruled(attempt: Attempt, event: DaoEvent, reported: DaoEvent | None) -> None:
    is_reported = reported is not None and reported.tx_hash == event.tx_hash
    is_silent = not is_reported and not int(str(event.args["report"]), 16)
    if is_silent and not attempt.ruling:
        return  # nobody ruled: it ended with its window
    sha256 = str(event.args["report"]).lower()
    if not is_reported and (attempt.ruling, attempt.report_sha256) == (event.args["ruling"], sha256):
        return  # a challenge: the same ruling stands longer
    # Whoever could not decide makes the first ruling with that.
    is_next = attempt.passed_on and attempt.ruling != ""
    attempt.ruling = str(event.args["ruling"])
    attempt.amount_iec = Decimal(event.args["amount_iec"])
    attempt.block, attempt.time_s = event.block, event.time_s
    attempt.ruled = event.block, event.log_index
    if is_silent:
        return  # its judge was removed, and what it had said with it
    if is_reported and reported is not None:
        attempt.reason, attempt.report_uri = str(reported.args["reason"]), str(reported.args["report_uri"])
        attempt.by_people |= is_next
    elif sha256 != attempt.report_sha256:
        attempt.reason = attempt.report_uri = ""
    attempt.report_sha256 = sha256
