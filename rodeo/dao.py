"""A participant's view of the organization: its commands to the bridge, and what it asks the index."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from decimal import Decimal
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

from rodeo.bus import queries
from rodeo.bus.messages import (
    LIVE_STATES,
    ORGANIZATION,
    Broadcast,
    Message,
    Mined,
    Prepare,
    Prepared,
    SignedRequest,
    Task,
)
from rodeo.bus.queries import A, Offer, Query
from rodeo.bus.session import Bus, validate
from rodeo.chain import signed_requests
from rodeo.commands import Command
from rodeo.commands.judging import Conclude
from rodeo.commands.relaying import Sign, Signable
from rodeo.commands.services import Agree, RegisterService, SetPayout, UpdateService
from rodeo.commands.tasks import AbandonTask, AcceptTask, CancelTask, RaiseReward, SubmitProof
from rodeo.errors import (
    BusError,
    MalformedAnswer,
    NoResponder,
    QueryTimeout,
    RemoteError,
    TaskNotDone,
    TaskUnfinished,
)
from rodeo.evidence.seal import Binding
from rodeo.judging.rulings import LOST_RACES, STATES, due_s
from rodeo.kinds import Kind, kinds_of
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import oracle_names

if TYPE_CHECKING:
    from eth_account.signers.local import LocalAccount

_LOOK_WALL_S = 2.0
"""Wall time after which the index is asked for a task again without an event."""


def cannot_do(site: Site, participant: str, kind: str) -> str:
    """Why `participant` of the site cannot do work of this kind, as a sentence; empty where it can.

    A robot's mind does what has a behaviour, the organization's dock sells energy, and the oracle judges.
    People, which the organization has, too, do the kinds that people judge. The site file says what else a
    participant's own program does.
    """
    kinds = kinds_of(site)
    by_people = kinds.by_people(kind)
    if participant in [robot.name for robot in site.robots]:
        robots_do = [name for name, one in kinds.items() if one.behaviour]
        able, does = kind in robots_do, f"robots do {', '.join(robots_do) or 'nothing'} only"
    elif participant in oracle_names(site):
        able, does = False, "the oracle only judges work"
    elif participant == ORGANIZATION:
        energy = kinds.providing("energy")
        able = by_people or (energy is not None and kind == energy.name)
        does = f"the organization sells {energy.name} at its dock, and " if energy else ""
        does += "its people do the kinds that auditors judge"
    else:
        declared = next((one.kinds for one in site.participants if one.name == participant), None)
        able = by_people if declared is None else kind in declared
        does = (
            "people do the kinds that auditors judge; if it is a program, list its kinds in the site file, "
            "in the participant's `kinds`"
            if declared is None
            else f"by the site file it does {', '.join(declared) or 'nothing'}"
        )
    return "" if able else f"{participant} cannot do {kind}: {does}"


def most_offers(site: Site, participant: str, kind: str) -> int:
    """How many services of a kind a participant may offer at a time. Each does one task at a time: a robot
    and a person need one, the organization one for each dock of the site."""
    energy = kinds_of(site).providing("energy")
    sells = participant == ORGANIZATION and energy is not None and kind == energy.name
    return max(1, len(site.docks)) if sells else 1


def dock_offers(offers: list[Offer], site: Site) -> dict[str, Offer]:
    """Which of the organization's services belongs to which dock: in the order of the site file, without
    retired ones. A dock that is not offered yet is missing."""
    live = sorted((one for one in offers if one.state != "retired"), key=lambda one: one.id)
    return {dock.name: one for dock, one in zip(site.docks, live, strict=False)}


def numbered(request_id: str, number: int) -> str:
    """The ID of a request sent for the `number`th time: one whose transaction failed keeps that answer."""
    return request_id if number == 1 else f"{request_id}-{number}"


def acceptance(task: Task, number: int = 1) -> AcceptTask:
    """The command by which its executor agrees to do an assigned task."""
    request_id = numbered(f"accept-{task.id}-{task.attempt}-{task.nonce}", number)
    return AcceptTask(request_id=request_id, task_id=task.id, attempt=task.attempt)


def abandonment(task: Task, number: int = 1) -> AbandonTask:
    """The command by which its executor gives it back."""
    request_id = numbered(f"abandon-{task.id}-{task.attempt}-{task.nonce}", number)
    return AbandonTask(request_id=request_id, task_id=task.id, attempt=task.attempt)


def cancellation(task_id: int, request_id: str | None = None) -> CancelTask:
    """The command by which its creator takes back a task that nobody has."""
    return CancelTask(request_id=request_id, task_id=task_id)


class Assignment(BaseModel):
    """One attempt at a task, as no other chain, contracts or assignment has it.

    Task and attempt alone do not identify it: a new chain counts from 1 again, and an assignment that a
    reorganization reverted is made again, with another nonce.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    genesis_hash: str
    chain_id: int
    task_manager: str
    organization: str
    task_id: int
    attempt: int
    nonce: str


class Participant:
    """One wallet's commands and questions.

    With an `account` the wallet is this process's own: it signs, and the bridge only broadcasts. Without one
    the bridge signs. Every method raises NoResponder or QueryTimeout when the bridge is away and RemoteError
    with the bridge's own error.
    """

    def __init__(self, bus: Bus, org: str, name: str, account: LocalAccount | None = None) -> None:
        self._bus = bus
        self._account = account
        self._org = org
        self.name = name

    # -- queries ---------------------------------------------------------------------------------------

    def task(self, task_id: int) -> Task:
        return self.ask(queries.TASK, id=task_id)

    def tasks(self, **filters: Any) -> list[Task]:
        """The newest tasks that pass the filters (`state`, `kind`, ...), at most 100."""
        return self.ask(queries.TASKS, limit=100, **filters).tasks

    def wait(self, task: Task | int, timeout_s: float | None = None) -> Task:
        """Wait until a task (or the one with this ID) is settled, and return it as it is then.

        `timeout_s` is wall time, without limit by default. A bridge that is away for a while is waited for.
        Raises TaskNotDone for a task that failed or was cancelled, TaskUnfinished after `timeout_s`, and
        RemoteError, for an unknown ID for instance.
        """
        task_id = task if isinstance(task, int) else task.id
        ends_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        changed = threading.Event()
        events = self._bus.subscribe_json(
            topics.EVENT.pattern(org=self._org), lambda _key, _event: changed.set(), inline=True
        )
        state, problem = "unknown", ""
        try:
            while True:
                changed.clear()
                try:
                    found = self.task(task_id)
                except (NoResponder, QueryTimeout) as error:
                    problem = str(error)
                else:
                    state, problem = found.state, ""
                    if state == "settled":
                        return found
                    if state not in LIVE_STATES:
                        raise TaskNotDone(
                            f"task {task_id} is {state}",
                            task_id=task_id,
                            state=state,
                            reason=found.reason or "",
                        )
                left_s = ends_s - time.monotonic()
                if left_s <= 0:
                    raise TaskUnfinished(
                        f"task {task_id} was not over within {timeout_s} s",
                        task_id=task_id,
                        state=state,
                        **({"problem": problem} if problem else {}),
                    )
                # An event may have been lost, and the bridge may have been away.
                changed.wait(min(_LOOK_WALL_S, left_s))
        finally:
            events.undeclare()

    def assignments(self, kind: str) -> list[Task]:
        """Tasks that this participant has to do now, the oldest first."""
        mine = self.tasks(kind=kind, state="assigned", executor=self.name)
        return sorted(mine, key=lambda task: (task.assigned or 0.0, task.id))

    def own_service(self, kind: str) -> Offer | None:
        """The service of this kind that this participant offers, the oldest of several; no retired one."""
        return next(iter(self._own_services(kind)), None)

    def _own_services(self, kind: str) -> list[Offer]:
        services = self.ask(queries.SERVICES, provider=self.name, kind=kind).services
        return [service for service in services if service.state != "retired"]

    def binding(self, task: Task, device: str) -> Binding:
        """Ties a recording by `device` to this assignment."""
        chain = self.ask(queries.CHAIN)
        return Binding(
            chain_id=chain.chain_id,
            task_manager=chain.contracts.task_manager,
            organization=chain.contracts.organization,
            device=device,
            task_id=task.id,
            attempt=task.attempt,
            executor=task.executor or "",
            nonce=task.nonce or "",
        )

    def assignment(self, task: Task) -> Assignment:
        """Which attempt `task` is in now; what is remembered of an attempt is remembered under this."""
        chain = self.ask(queries.CHAIN)
        return Assignment(
            genesis_hash=chain.genesis_hash,
            chain_id=chain.chain_id,
            task_manager=chain.contracts.task_manager,
            organization=chain.contracts.organization,
            task_id=task.id,
            attempt=task.attempt,
            nonce=task.nonce or "",
        )

    def doubt(self, kind: Kind | None, params: Mapping[str, Any]) -> str:
        """Reason why a task to be posted can probably not be done; empty if none is known."""
        if kind is None or not kind.subject:
            return ""
        if isinstance(subject := params.get(kind.subject), str) and subject:
            return kind.doubt(params, self.ask(queries.TASKS, text=subject).tasks)
        live = self.ask(queries.TASKS, kind=kind.name, state=",".join(LIVE_STATES), limit=queries.MAX_PAGE)
        return kind.doubt(params, live.tasks)

    def ask(self, query: Query[A], **parameters: Any) -> A:
        """The index's answer. Raises MalformedAnswer, too."""
        return queries.ask(self._bus, self._org, query, **parameters)

    # -- commands --------------------------------------------------------------------------------------

    def offer_service(
        self,
        kind: str,
        price_iec: Decimal,
        description: str,
        number: int = 0,
        judge: str | None = None,
    ) -> Offer | None:
        """Register the service, or bring price and state of the one that there is in line. `number` counts
        from 0 where this participant offers several (`most_offers`): begin with 0. If the kind has got
        another contract as its judge, and that is still `judge` ("oracle" or "auditor"), the service agrees
        to it when it is idle; to nobody else.

        Returns the service as it was before, None when there was none. Doing it twice changes nothing.
        """
        service = next(iter(self._own_services(kind)[number:]), None)
        if service is not None and not service.agrees and service.task_id is None:
            rules = self.ask(queries.ORGANIZATION).kinds
            if judge in [one.judge for one in rules if one.kind == kind and one.allowed]:
                self.command("agree", Agree(service_id=service.id))
        if service is None:
            self.command(
                "register_service",
                RegisterService(
                    request_id=f"service-{self.name}-{kind}" + (f"-{number}" if number else ""),
                    kind=kind,
                    price_iec=price_iec,
                    description=description,
                ),
            )
        elif service.price_iec != price_iec or service.state not in ("active", "short"):
            self.command(
                "update_service",
                UpdateService(service_id=service.id, price_iec=price_iec, state="active"),
            )
        return service

    def accept_task(self, task: Task, number: int = 1) -> None:
        """Agree to do an assigned task; nothing where this participant has agreed before."""
        if not task.accepted:
            self.command("accept_task", acceptance(task, number))

    def abandon_task(self, task: Task, number: int = 1) -> None:
        """Give an assigned task back."""
        self.command("abandon_task", abandonment(task, number))

    def raise_reward(self, task_id: int, reward_iec: Decimal) -> int:
        """Post an open task of one's own again for more; returns its new ID. Done again it gives the same."""
        request = RaiseReward(request_id=f"raise-{task_id}", task_id=task_id, reward_iec=reward_iec)
        mined = self.command("raise_reward", request)
        if mined.task_id is None:
            raise MalformedAnswer("the answer has no ID of the new task", tx_hash=mined.tx_hash)
        return mined.task_id

    def set_payout(self, payout: str, provider: str | None = None) -> None:
        """Have payments for a provider's work, by default this participant's, go to another account."""
        self.command("set_payout", validate(SetPayout, {"payout": payout, "provider": provider}))

    def submit_proof(
        self, task_id: int, attempt: int, sha256: str, uri: str, nonce: str | None = None, number: int = 1
    ) -> None:
        """`nonce` is that of the assignment that was worked on: another one refuses the proof. Raises
        InvalidRequest, too."""
        request = {
            "request_id": numbered(f"proof-{task_id}-{attempt}-{sha256}", number),
            "task_id": task_id,
            "attempt": attempt,
            "proof_sha256": sha256,
            "proof_uri": uri,
            "nonce": nonce,
        }
        self.command("submit_proof", validate(SubmitProof, request))

    def conclude_rulings(self, now_s: float) -> float | None:
        """Conclude each task that this participant has done and that is due at `now_s` (site time), unless it
        was rejected. Returns when the next one is due, None if there is none.

        Raises only after it has tried to conclude all of them.
        """
        tasks = self.tasks(state=STATES, executor=self.name)
        due = {one.id: due_s(one.standing, one.verdict_deadline) for one in tasks}
        problem: BusError | RemoteError | None = None
        for task_id in [task_id for task_id, at_s in due.items() if at_s is not None and at_s < now_s]:
            try:
                self.command("conclude", Conclude(task_id=task_id))
            except (BusError, RemoteError) as error:
                if not (isinstance(error, RemoteError) and error.code in LOST_RACES):
                    problem = error
        if problem is not None:
            raise problem
        return min((at_s for at_s in due.values() if at_s is not None and at_s >= now_s), default=None)

    def command(self, name: str, request: Command) -> Mined:
        """Send a transaction through the bridge and wait for its receipt (at most 30 s of wall time)."""
        if self._account is None:
            return self._send(name, request, Mined)
        while True:
            prepare = Prepare(command=name, request=request.model_dump(mode="json", exclude_defaults=True))
            prepared = self._send("prepare", prepare, Prepared)
            mined = self._send("broadcast", self._signed(prepared, request), Mined)
            if not prepared.remaining:
                return mined

    def cost(self, name: str, request: Command) -> dict[str, Any]:
        """What the command would cost now. It is checked and simulated, and not sent."""
        key = topics.COMMAND.name(org=self._org, participant=self.name, command=name)
        return self._bus.query(key, request.model_copy(update={"dry_run": True}), timeout_s=30.0)

    def sign(self, name: Signable, request: Command, valid_s: int) -> SignedRequest:
        """Sign a command that somebody else sends with `relay`, valid for this many seconds of block time."""
        asked = Sign(
            command=name,
            request=request.model_dump(mode="json", exclude_defaults=True),
            valid_s=valid_s,
        )
        signed = self._send("sign", asked, SignedRequest)
        return signed if self._account is None else signed_requests.sign(signed, self._account)

    def _signed(self, prepared: Prepared, request: Command) -> Broadcast:
        """The data that `prepare` returned, signed here; or the signature made before, for a repeated
        request."""
        assert self._account is not None
        raw = prepared.raw
        if raw is None and prepared.transaction is not None:
            raw = self._account.sign_transaction(prepared.transaction).raw_transaction.to_0x_hex()
        # Calls before the command's own transaction do not answer its request.
        own = not prepared.remaining
        return Broadcast(
            raw=raw,
            request_id=request.request_id if own else None,
            content_sha256=prepared.content_sha256 or None if own else None,
        )

    def _send(self, command: str, request: Message, answer: type[A]) -> A:
        key = topics.COMMAND.name(org=self._org, participant=self.name, command=command)
        return queries.fitting(answer, self._bus.query(key, request, timeout_s=30.0), key)
