"""A participant's view of the organization: its commands to the bridge, and what it asks the index."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

from eth_account.signers.local import LocalAccount
from pydantic import BaseModel, ConfigDict

from rodeo import topics
from rodeo.bus import Bus, validate
from rodeo.charging import ChargingParams
from rodeo.cleaning import CleaningParams
from rodeo.config import Site
from rodeo.evidence import Binding
from rodeo.messages import (
    Broadcast,
    Command,
    Message,
    Prepare,
    RegisterService,
    SubmitProof,
    Task,
    UpdateService,
)

CLEANING = "waste_disposal"
CHARGING = "battery_charging"

ORGANIZATION = "organization"
"""The participant that speaks for the organization: its operator's wallet."""

MACHINE_JUDGED = frozenset({CLEANING, CHARGING})
"""Kinds with checks of their own. People judge every other kind: no oracle sees whether it was done."""


KIND_PARAMS: dict[str, type[BaseModel]] = {CLEANING: CleaningParams, CHARGING: ChargingParams}
"""Kinds whose parameters have a schema; those of other kinds are the participants' own affair."""


def is_peoples(kind: str) -> bool:
    """Whether a proof of this kind of work is people's word, which an auditor judges: the oracle has checks
    of its own for the other kinds only."""
    return kind not in MACHINE_JUDGED


def cannot_do(site: Site, participant: str, kind: str) -> str:
    """Why `participant` of the site cannot do work of this kind, as a sentence; empty where it can.

    A robot's mind does cleaning, the organization's dock sells charging, and the oracle judges. People, which
    the organization has, too, do the kinds that people judge. The site file says what else a participant's
    own program does.
    """
    if participant in [robot.name for robot in site.robots]:
        able, does = kind == CLEANING, f"robots do {CLEANING} only"
    elif participant == "oracle":
        able, does = False, "the oracle judges work and does none"
    elif participant == ORGANIZATION:
        able = kind == CHARGING or is_peoples(kind)
        does = f"the organization sells {CHARGING} at its dock, and its people do what auditors judge"
    else:
        declared = next((one.kinds for one in site.participants if one.name == participant), None)
        able = is_peoples(kind) if declared is None else kind in declared
        does = (
            "people do the kinds that auditors judge; what a participant's own program does is named in "
            "the site file, in the participant's `kinds`"
            if declared is None
            else f"by the site file it does {', '.join(declared) or 'nothing'}"
        )
    return "" if able else f"{participant} cannot do {kind}: {does}"


class Assignment(BaseModel):
    """One attempt at a task, as no other chain, contracts or assignment has it.

    Task and attempt alone do not tell: a new chain counts from 1 again, and what a reorganization took back
    is assigned again, with another nonce.
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
        return validate(Task, self.state(f"task/{task_id}"))

    def tasks(self, **filters: Any) -> list[Task]:
        """The newest tasks that pass the filters (`state`, `kind`, ...), at most 100."""
        answer = self.state("tasks", limit=100, **filters)
        return [validate(Task, task) for task in answer["tasks"]]

    def assignments(self, kind: str) -> list[Task]:
        """Tasks that this participant has to do now, the oldest first."""
        mine = [task for task in self.tasks(kind=kind, state="assigned") if task.executor_name == self.name]
        return sorted(mine, key=lambda task: (task.assigned or 0.0, task.id))

    def own_service(self, kind: str) -> dict[str, Any] | None:
        """The service of this kind that this participant offers, unless it is retired."""
        for service in self.state("services")["services"]:
            mine = service["provider_name"] == self.name and service["kind"] == kind
            if mine and service["state"] != "retired":
                return dict(service)
        return None

    def binding(self, task: Task, device: str) -> Binding:
        """What ties a recording by `device` to this assignment."""
        chain = self.state("chain")
        return Binding(
            chain_id=int(chain["chain_id"]),
            task_manager=chain["contracts"]["TaskManager"],
            organization=chain["contracts"]["Organization"],
            device=device,
            task_id=task.id,
            attempt=task.attempt,
            executor=task.executor or "",
            nonce=task.nonce or "",
        )

    def assignment(self, task: Task) -> Assignment:
        """Which attempt `task` is in now; what is remembered of an attempt is remembered under this."""
        chain = self.state("chain")
        return Assignment(
            genesis_hash=chain["genesis_hash"],
            chain_id=int(chain["chain_id"]),
            task_manager=chain["contracts"]["TaskManager"],
            organization=chain["contracts"]["Organization"],
            task_id=task.id,
            attempt=task.attempt,
            nonce=task.nonce or "",
        )

    def state(self, what: str, **parameters: Any) -> dict[str, Any]:
        """The index's answer to `state/<what>`."""
        return self._bus.query(topics.STATE.name(org=self._org, what=what), parameters=parameters)

    # -- commands --------------------------------------------------------------------------------------

    def offer_service(self, kind: str, price_iec: Decimal, description: str) -> dict[str, Any] | None:
        """Register the service, or bring price and state of the one that there is in line.

        Returns the service as it was before, None when there was none. Doing it twice changes nothing.
        """
        service = self.own_service(kind)
        if service is None:
            self.command(
                "register_service",
                RegisterService(
                    request_id=f"service-{self.name}-{kind}",
                    kind=kind,
                    price_iec=price_iec,
                    description=description,
                ),
            )
        elif Decimal(service["price_iec"]) != price_iec or service["state"] != "active":
            self.command(
                "update_service",
                UpdateService(service_id=int(service["id"]), price_iec=price_iec, state="active"),
            )
        return service

    def submit_proof(
        self, task_id: int, attempt: int, sha256: str, uri: str, nonce: str | None = None
    ) -> None:
        """`nonce` is that of the assignment that was worked on: another one refuses the proof."""
        self.command(
            "submit_proof",
            SubmitProof(
                request_id=f"proof-{task_id}-{attempt}-{sha256}",
                task_id=task_id,
                attempt=attempt,
                proof_sha256=sha256,
                proof_uri=uri,
                nonce=nonce,
            ),
        )

    def command(self, name: str, request: Command) -> dict[str, Any]:
        """Send a transaction through the bridge and wait for its receipt (at most 30 s of wall time)."""
        if self._account is None or request.dry_run:
            return self._ask(name, request)
        while True:
            prepared = self._ask(
                "prepare",
                Prepare(command=name, request=request.model_dump(mode="json", exclude_defaults=True)),
            )
            reply = self._ask("broadcast", self._signed(prepared, request))
            if not prepared["remaining"]:
                return reply

    def _signed(self, prepared: dict[str, Any], request: Command) -> Broadcast:
        """What `prepare` said, signed here; or signed before, where the request was made before."""
        assert self._account is not None
        raw = prepared.get("raw")
        if raw is None:
            raw = self._account.sign_transaction(prepared["transaction"]).raw_transaction.to_0x_hex()
        # What comes before the command's own transaction is no answer to its request.
        own = not prepared["remaining"]
        return Broadcast(
            raw=raw,
            request_id=request.request_id if own else None,
            content_sha256=prepared["content_sha256"] or None if own else None,
        )

    def _ask(self, command: str, request: Message) -> dict[str, Any]:
        key = topics.COMMAND.name(org=self._org, participant=self.name, command=command)
        return self._bus.query(key, request, timeout_s=30.0)
