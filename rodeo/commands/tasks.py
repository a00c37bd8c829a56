"""Commands about tasks: post, cancel, take, hand in."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pydantic import Field

from rodeo.bus.messages import (
    NO_RULES,
    ORGANIZATION,
    Attempt,
    Hex32,
    Id,
    Iec,
    Kind,
    Party,
    TaskParams,
    Window,
)
from rodeo.chain import signed_requests
from rodeo.chain.contracts.abi import TaskRequest
from rodeo.chain.contracts.types import ZERO_ADDRESS, hex_bytes
from rodeo.commands.declare import Command, Line, Subject, command
from rodeo.commands.errors import (
    AssignmentChanged,
    CannotRaise,
    ProviderWithoutService,
    RewardBelowPrice,
    RulesNotCurrent,
    UnknownService,
)
from rodeo.commands.examples import DIGEST, PROOF_URI
from rodeo.commands.people import BY_OPERATOR, PEOPLE
from rodeo.errors import InvalidRequest
from rodeo.kinds import EXECUTION_WINDOW_S

if TYPE_CHECKING:
    from rodeo.chain.encoding import Call
    from rodeo.chain.signed_requests import Said
    from rodeo.commands.desk import Desk


def _matched_in_words(said: Mapping[str, Any]) -> str:
    task = said["task"]
    waits = (
        "no service fits, so it still waits" if task.state == "open" else f"service {task.service_id} has it"
    )
    return f"Task {task.id}: {waits}."


MAX_TEXT_BYTES = 16 * 1024
"""Most bytes of parameters and description together: everybody keeps and lists them indefinitely."""


@command("ros_dao", "robot_agent", *PEOPLE, signable=True)
class RegisterTask(Command):
    """Post a task. Its reward goes into escrow."""

    kind: Kind = Field(
        description="A kind of work that the organization accepts.", examples=["window_cleaning"]
    )
    reward_iec: Iec = Field(description="Reward in IEC, put into escrow.", examples=["100"])
    params: TaskParams = Field(
        {},
        description=(
            "The task's parameters: the fields of its kind. What follows from the others may be left out, as "
            "the place of a listed item."
        ),
        examples=[{"window": "north"}],
    )
    description: str = Field(default="", max_length=2000, description="Description for people.")
    execution_window_s: Window | None = Field(
        None,
        description=(
            "Time to do it, from its assignment to its proof, in seconds. By default what its kind says."
        ),
    )
    verdict_window_s: Window | None = Field(
        None, description=("Time to judge a proof, in seconds. By default what the site file says.")
    )
    max_attempts: Attempt | None = Field(None, description="Attempts before the reward is refunded.")
    rules_sha256: Hex32 | None = Field(
        None,
        description=(
            "Hash of the rules by which it is judged, among the kind's current ones (`rodeo kind "
            "show`). By default the newest that the bridge knows."
        ),
    )
    service_id: Id | None = Field(
        None,
        description=("The only service that may do it, at its own price. By default the policy chooses."),
    )
    provider: Party | None = Field(
        None,
        description=("The only provider that may do it, with any of its services: a name or an address."),
    )
    allow_wait: bool = Field(
        False, description=("Queue the task even if every offered service costs more than its reward.")
    )

    def calls(self, desk: Desk) -> list[Call]:
        request = self._task_request(desk)
        return [*desk.escrow_approval(request.reward), desk.calls.register_task(request)]

    def _task_request(self, desk: Desk) -> TaskRequest:
        """The task as it is registered. Raises RequestError where it would not be accepted."""
        desk.require_kind(self.kind)
        kind, params = desk.kinds.get(self.kind), desk.kinds.completed(self.kind, self.params)
        if kind is not None:
            kind.validate(params)
        text = json.dumps({"description": self.description, "params": params}, separators=(",", ":"))
        if len(text) > MAX_TEXT_BYTES:
            raise InvalidRequest(
                "parameters and description are too long", bytes=len(text), limit=MAX_TEXT_BYTES
            )
        reward = desk.currency.to_units(self.reward_iec)
        if not self.allow_wait:
            self._require_affordable_service(desk, reward)
        desk.require_funds(desk.address, reward)
        window_s = EXECUTION_WINDOW_S if kind is None else kind.execution_window_s
        return TaskRequest(
            kind=self.kind,
            reward=reward,
            execution_window=self.execution_window_s or window_s,
            verdict_window=self.verdict_window_s or desk.economy.verdict_window_s,
            max_attempts=self.max_attempts or desk.economy.max_attempts,
            rules=hex_bytes(self._rules_of(desk)),
            service_id=self._service_of(desk),
            provider=self._provider_of(desk),
            params=text,
        )

    def _service_of(self, desk: Desk) -> int:
        if self.service_id is None:
            return 0
        service = desk.index.services.get(self.service_id)
        if service is not None and service["state"] == "retired":
            raise InvalidRequest(
                "the task would wait indefinitely: this service was withdrawn for good",
                service_id=self.service_id,
            )
        return self.service_id

    def _provider_of(self, desk: Desk) -> str:
        if self.provider is None:
            return ZERO_ADDRESS
        if self.service_id is not None:
            raise InvalidRequest("name a service or a provider, not both")
        provider = desk.names.address(self.provider)
        if provider == desk.names.addresses[ORGANIZATION]:
            raise InvalidRequest("name one of the organization's services instead of the organization")
        if not desk.index.services.offers(provider, self.kind):
            raise ProviderWithoutService(
                f"{self.provider} offers no {self.kind}", provider=provider, kind=self.kind
            )
        return provider

    def _rules_of(self, desk: Desk) -> str:
        """Hash of the rules of a new task: named, so that none judge it that become current before it is
        mined."""
        current, wanted = desk.index.rules.of(self.kind), self.rules_sha256
        if wanted is None:
            return next(reversed(current), NO_RULES)
        if wanted not in current:  # as far as the index knows, which may be a block behind
            current = ["0x" + one.hex() for one in desk.client.rules.current_rules(self.kind)]
        if wanted not in current:
            raise RulesNotCurrent(
                "tasks of this kind are not posted under these rules",
                kind=self.kind,
                rules=wanted,
                current=current,
            )
        return wanted

    def _require_affordable_service(self, desk: Desk, reward: int) -> None:
        if self.provider is not None:
            offers = desk.index.services.offers(desk.names.address(self.provider), self.kind)
            prices = [offer["price"] for offer in offers if offer["state"] == "active"]
            which = f"every service of {self.provider}"
        elif self.service_id is None:
            # Who names nobody is compared in levels, who names somebody exactly.
            prices = [
                desk.currency.reward_for(price) for price in desk.index.services.active_prices(self.kind)
            ]
            which = "every service of this kind"
        else:
            service = desk.index.services.get(self.service_id)
            if service is None:
                raise UnknownService("no such service", service_id=self.service_id)
            prices, which = [service["price"]], f"service {self.service_id}"
        if prices and min(prices) > reward:
            raise RewardBelowPrice(
                f"{which} costs more than the reward",
                kind=self.kind,
                reward_iec=desk.currency.text(reward),
                lowest_price_iec=desk.currency.text(min(prices)),
            )

    def spends(self, desk: Desk) -> int:
        return desk.currency.to_units(self.reward_iec)

    def to_sign(self, desk: Desk, nonce: int, deadline: int) -> Said:
        request = signed_requests.TypedTask.of(self._task_request(desk))
        return signed_requests.RegisterTask(
            creator=desk.address, request=request, nonce=nonce, deadline=deadline
        )

    def takes(self, desk: Desk) -> tuple[str, int]:
        return desk.client.task_manager, self.spends(desk)


@command(
    "ros_dao",
    line=Line("task cancel {task_id}", "Task {task_id} is cancelled; {participant} got its reward back."),
    console=BY_OPERATOR,
    signable=True,
)
class CancelTask(Command):
    """Cancel a task that is not assigned. Its reward is refunded."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.calls.cancel_task(self.task_id)]

    def to_sign(self, desk: Desk, nonce: int, deadline: int) -> Said:
        return signed_requests.CancelTask(
            creator=desk.address, task_id=self.task_id, nonce=nonce, deadline=deadline
        )


@command("ros_dao", "robot_agent", *PEOPLE, signable=True)
class AcceptTask(Command):
    """The executor agrees to do an assigned task: from then on a failure costs it the penalty of its terms. A
    proof accepts, too."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    attempt: Attempt = Field(description="The attempt, counted from 1.", examples=[1])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.calls.accept_task(self.task_id, self.attempt)]

    def to_sign(self, desk: Desk, nonce: int, deadline: int) -> Said:
        return signed_requests.AcceptTask(
            executor=desk.address, task_id=self.task_id, attempt=self.attempt, nonce=nonce, deadline=deadline
        )


@command("ros_dao", "robot_agent", "charger", "operator", signable=True)
class AbandonTask(Command):
    """The executor gives an assigned task back, so that another attempt begins. In the kind's grace period
    the attempt does not count, and it costs a proven provider nothing; a provider that is not proven rests.
    Later it costs the penalty if the executor had accepted the task."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    attempt: Attempt = Field(description="The attempt, counted from 1.", examples=[1])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.calls.abandon_task(self.task_id, self.attempt)]

    def to_sign(self, desk: Desk, nonce: int, deadline: int) -> Said:
        return signed_requests.AbandonTask(
            executor=desk.address, task_id=self.task_id, attempt=self.attempt, nonce=nonce, deadline=deadline
        )


@command("ros_dao", "robot_agent", "operator")
class RaiseReward(Command):
    """Post an open task of one's own again for a higher reward. The contracts cannot raise a reward, so the
    task is cancelled, and the new one has another ID. A task that is already cancelled is only posted
    again."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    reward_iec: Iec = Field(description="The new reward, in IEC.", examples=["100"])

    def calls(self, desk: Desk) -> list[Call]:
        task = desk.task(self.task_id)
        reward = desk.currency.to_units(self.reward_iec)
        if task["creator"] != desk.address or task["state"] not in ("open", "cancelled"):
            raise CannotRaise(
                "only the creator raises the reward of a task, and only while nobody has taken it",
                task_id=self.task_id,
                creator=task["creator"],
                state=task["state"],
            )
        if reward <= task["reward"]:
            raise CannotRaise(
                "a reward can only be raised",
                task_id=self.task_id,
                reward_iec=desk.currency.text(reward),
                reward_now_iec=desk.currency.text(task["reward"]),
            )
        is_open = task["state"] == "open"
        # What is in escrow comes back first.
        desk.require_funds(desk.address, reward - (task["reward"] if is_open else 0))
        params = {"description": task["description"], "params": task["params"]}
        request = TaskRequest(
            kind=task["kind"],
            reward=reward,
            execution_window=task["execution_window_s"],
            verdict_window=task["verdict_window_s"],
            max_attempts=max(1, task["max_attempts"] - (task["attempt"] - len(task["passed"]))),
            rules=hex_bytes(task["rules_sha256"] or NO_RULES),
            service_id=task["requested_service_id"] or 0,
            provider=task["requested_provider"] or ZERO_ADDRESS,
            params=json.dumps(params, separators=(",", ":")),
        )
        approval, post = desk.escrow_approval(reward), desk.calls.register_task(request)
        if not is_open:
            return [*approval, post]
        # A task that is cancelled, and refused after that, would be gone. What is in escrow cannot pay yet.
        payable = not approval and desk.client.token.balance(desk.address) >= reward
        tried = post if payable else desk.calls.register_task(replace(request, reward=0))
        desk.client.simulate(tried, desk.key_address)
        return [desk.calls.cancel_task(self.task_id), *approval, post]

    def spends(self, desk: Desk) -> int:
        task = desk.index.tasks.get(self.task_id)
        # An open task's reward comes back first. A cancelled one's came back before.
        back = task["reward"] if task is not None and task["state"] == "open" else 0
        return desk.currency.to_units(self.reward_iec) - int(back)


@command("ros_dao", "robot_agent", "charger", *PEOPLE, signable=True)
class SubmitProof(Command):
    """Submit the proof of an attempt: its hash, and where it is."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    attempt: Attempt = Field(description="The attempt, counted from 1.", examples=[1])
    proof_sha256: Hex32 = Field(examples=[DIGEST])
    proof_uri: str = Field(min_length=1, max_length=2048, examples=[PROOF_URI])
    nonce: Hex32 | None = Field(
        None,
        description=(
            "Nonce of the assignment that the proof is for. If the task has another nonce by now, for"
            " example after a reorganization, the bridge sends nothing."
        ),
    )

    def calls(self, desk: Desk) -> list[Call]:
        uri = self._proof_uri(desk)
        return [desk.calls.submit_proof(self.task_id, self.attempt, hex_bytes(self.proof_sha256), uri)]

    def _proof_uri(self, desk: Desk) -> str:
        """Where the proof is, if it is for the assignment that the task has. Raises AssignmentChanged."""
        uri = desk.store.check(self.proof_uri)
        task = desk.index.tasks.get(self.task_id)
        if self.nonce is not None and task is not None and task["nonce"] != self.nonce:
            raise AssignmentChanged(
                "the proof belongs to an earlier assignment of this task",
                task_id=self.task_id,
                nonce=self.nonce,
                nonce_now=task["nonce"],
            )
        return uri

    def subject(self, desk: Desk) -> Subject:
        task = desk.index.tasks.get(self.task_id)
        return Subject(self.task_id, self.attempt, self.nonce or (None if task is None else task["nonce"]))

    def to_sign(self, desk: Desk, nonce: int, deadline: int) -> Said:
        return signed_requests.SubmitProof(
            executor=desk.address,
            task_id=self.task_id,
            attempt=self.attempt,
            proof_hash=self.proof_sha256,
            uri=self._proof_uri(desk),
            nonce=nonce,
            deadline=deadline,
        )


@command()
class ExpireTask(Command):
    """End an attempt whose time is over without a proof. Anybody may."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.calls.expire_task(self.task_id)]


@command(
    line=Line(
        "task match {task_id}", _matched_in_words, spelled={"service_id": "--service"}, shows_task=True
    ),
    console=BY_OPERATOR,
)
class MatchTask(Command):
    """Give an open task to a service that is free, fits, and has not had it before. Anybody may.

    The contracts look at a few services and tasks only, and may overlook some that fit.
    """

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    service_id: Id | None = Field(
        None, description="The service that gets it. By default the policy chooses again."
    )

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.calls.match_task(self.task_id, self.service_id or 0)]
