"""What each command checks before it costs anything, what it calls on chain, and who may be named in it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from decimal import Decimal
from hashlib import sha256
from typing import Any, get_args

from eth_account import Account
from eth_typing import ChecksumAddress
from eth_utils import is_address, to_checksum_address

from rodeo import signed_requests, votes
from rodeo.addresses import typed_address
from rodeo.bus import validate
from rodeo.chain.abi import Namers, Quorum, Revocation, ServiceState, TaskRequest, Terms, Windows
from rodeo.chain.calls import ParticipantCalls
from rodeo.chain.client import ChainClient
from rodeo.chain.encoding import Call
from rodeo.chain.governance import BUDGET_CREDITS, Operation, Proposed, protected_text, shares
from rodeo.chain.types import ZERO_ADDRESS, Policy, Role, TimelockRole, hex_bytes
from rodeo.config import EconomyConfig
from rodeo.currency import Currency
from rodeo.errors import InvalidRequest
from rodeo.evidence.store import Store
from rodeo.kinds import (
    DEFAULT_PRICE_IEC,
    EXECUTION_WINDOW_S,
    GRACE_S,
    GRACE_STEP_S,
    MAX_WINDOW_S,
    PEOPLES_MIN_WINDOW_S,
    VERDICT_WINDOWS_S,
    Kinds,
)
from rodeo.messages import (
    JUDGES,
    AbandonTask,
    AcceptTask,
    Admit,
    Agree,
    AllowKind,
    AllowPayments,
    AnnounceWithdrawal,
    Broadcast,
    CancelProposal,
    CancelTask,
    CastBudgetVote,
    CastVote,
    Challenge,
    ChangeJudgeKey,
    Collect,
    Command,
    Conclude,
    Deposit,
    DepositStake,
    Dismiss,
    ExecuteProposal,
    ExpireTask,
    GrantRole,
    HandOver,
    MatchTask,
    OpenBudgetVote,
    PauseTasks,
    PayBudgetShare,
    PostRoot,
    PostVotes,
    Prepare,
    Proposable,
    Propose,
    QueueProposal,
    RaiseReward,
    RegisterDevice,
    RegisterService,
    RegisterTask,
    ReinstateProvider,
    ReinstateService,
    Relay,
    RemoveJudge,
    RescueTokens,
    ResumeTasks,
    RetireRules,
    RevokeDevice,
    RevokeRequest,
    RevokeRole,
    Rule,
    SeatJudge,
    SetBudget,
    SetDelay,
    SetMembersOnly,
    SetNamers,
    SetPayout,
    SetPolicy,
    SetQuorum,
    SetTerms,
    SettleStakes,
    Sign,
    SignedRequest,
    SignedVote,
    SignVote,
    SubmitProof,
    SuspendProvider,
    SuspendService,
    Transfer,
    TypedSignature,
    UnseatJudge,
    UpdateService,
    Vote,
    Vouch,
    Withdraw,
    WithdrawStake,
)
from rodeo.signed_requests import UNLIMITED
from services.bridge.errors import (
    ActsAtOnce,
    AlreadyOffered,
    AlreadyProposed,
    AssignmentChanged,
    CannotDo,
    CannotRaise,
    CannotSign,
    DailyLimitReached,
    HasToBeProposed,
    InsufficientFunds,
    InvalidQuorum,
    KindWithoutChecks,
    KindWithoutQuorum,
    KindWithoutRules,
    MembersDecide,
    NoCredits,
    NoDispute,
    NotAJudge,
    NotARecipient,
    NothingToPay,
    NotThisWallets,
    NoVotes,
    ProviderWithoutService,
    RewardBelowPrice,
    RulesNotCurrent,
    StakeTooLow,
    TooFewCredits,
    UnexpectedBudgetVoteState,
    UnexpectedProposalState,
    UnknownBudgetVote,
    UnknownCommand,
    UnknownKind,
    UnknownParticipant,
    UnknownProposal,
    UnknownService,
    UnknownTask,
)
from services.bridge.index import Index, Row
from services.bridge.journal import decoded
from services.bridge.names import ORGANIZATION, Names
from services.bridge.orders import Order
from services.bridge.projection import ORACLES, proposal_key
from services.bridge.relaying import Requests, Said, nonce_of
from services.bridge.transactions import Transactions

NO_RULES = "0x" + "00" * 32
"""Rules of a task that names none: the newest that are current, if there are any."""


MAX_TEXT_BYTES = 16 * 1024
"""Most bytes of parameters and description together: everybody keeps and lists them indefinitely."""


Reply = dict[str, Any]


@dataclass
class Wallet:
    """A participant's commands. `execute` is used by one thread, the participant's own."""

    participant: str
    client: ChainClient
    transactions: Transactions
    index: Index
    names: Names
    store: Store
    economy: EconomyConfig
    kinds: Kinds
    _approved: set[str] = field(default_factory=set)
    _offering: dict[str, tuple[str | None, Future[Reply]]] = field(default_factory=dict)
    """Kind -> `request_id` and reply of the last offer of it that this process has sent."""

    @property
    def address(self) -> str:
        """The account that creates, executes and pays on chain."""
        return self.names.addresses[self.participant]

    @property
    def key_address(self) -> str:
        """The account that signs."""
        return self.names.keys[self.participant]

    @property
    def _currency(self) -> Currency:
        return self.client.currency

    @property
    def calls(self) -> ParticipantCalls:
        """Direct, or through the Organization contract."""
        return self.client.organization_calls if self.participant == ORGANIZATION else self.client.calls

    def execute(self, name: str, data: dict[str, Any]) -> Reply | Future[Reply]:
        """Carry out the command `name`; its reply, now or once mined.

        The same `request_id` again gives the same reply. Raises RequestError before anything was sent, and
        what `Orders` and `Signer` raise.
        """
        if name == "prepare":
            return self._prepare(validate(Prepare, data))
        if name == "broadcast":
            return self._broadcast(validate(Broadcast, data))
        if name == "sign":
            return self._sign(validate(Sign, data))
        if name == "sign_vote":
            return self._sign_vote(validate(SignVote, data))
        command, build = self._parse(name, data)
        if command.dry_run:
            orders = self._orders(name, command, build)
            calls = [order.call.name for order in orders]
            # What comes after the first depends on it.
            return {"dry_run": True, "calls": calls, **self.transactions.signer.cost(orders[0])}
        if (known := self._before(name, command)) is not None:
            return self.transactions.orders.submit(known)
        *before, order = self._orders(name, command, build)
        if before:  # a task that was cancelled to be posted for more would be gone
            self.transactions.signer.check_spending(order)
        for first in before:
            self.transactions.orders.submit(first).result()
        sent = self.transactions.orders.submit(order)
        if isinstance(command, RegisterService):
            self._offering[command.kind] = command.request_id, sent
        return sent

    def _parse(self, name: str, data: dict[str, Any]) -> tuple[Command, Build]:
        if name not in _COMMANDS:
            raise UnknownCommand("no such command", command=name, known=sorted(KNOWN))
        model, build = _COMMANDS[name]
        return validate(model, data), build

    def _orders(self, name: str, command: Command, build: Build) -> list[Order]:
        """What is to be sent one after the other; the last is the command's own."""
        if name in _OF_ADMINISTRATOR:
            self._require_no_timelock(name)
        *before, call = build(self, command)
        return [
            *(Order(self.participant, one.name, one) for one in before),
            Order(
                self.participant,
                name,
                call,
                command.request_id,
                _content_sha256(name, command),
                self._task_of(command),
                self._spends(command),
                *self._assignment(command),
            ),
        ]

    def _task_of(self, command: Command) -> int | None:
        """The task that it is about, if there is one already."""
        about = self._requests.read(command.signed) if isinstance(command, Relay) else command
        return getattr(about, "task_id", None)

    def _assignment(self, command: Command) -> tuple[int | None, str | None]:
        """Attempt and nonce of the assignment that a proof is for."""
        if isinstance(command, Relay):
            said = self._requests.read(command.signed)
            if not isinstance(said, signed_requests.SubmitProof):
                return None, None
            task_id, attempt, nonce = said.task_id, said.attempt, None
        elif isinstance(command, SubmitProof):
            task_id, attempt, nonce = command.task_id, command.attempt, command.nonce
        else:
            return None, None
        task = self.index.task(task_id)
        return attempt, nonce or (None if task is None else task["nonce"])

    def _before(self, name: str, command: Command) -> Order | None:
        """The order of the same request when it was made before: its checks do not hold any more."""
        if command.request_id is None:
            return None
        content = _content_sha256(name, command)
        entry = self.transactions.orders.find(self.participant, command.request_id, content)
        if entry is None:
            return None
        return Order(self.participant, name, Call(entry.to, "0x", name), command.request_id, content)  # type: ignore[arg-type]

    def _spends(self, command: Command) -> int:
        """Wei of the payment token that leave the wallet, or the treasury, by it: at most, and once. What
        comes back later, such as a cancelled task's reward, is not subtracted. Raises DailyLimitReached where
        there is no upper bound and the wallet has a limit."""
        match command:
            case RegisterTask():
                return self._currency.to_units(command.reward_iec)
            case RaiseReward():
                task = self.index.task(command.task_id)
                # An open task's reward comes back first. A cancelled one's came back before.
                back = task["reward"] if task is not None and task["state"] == "open" else 0
                return self._currency.to_units(command.reward_iec) - back
            case Transfer() | Deposit() | DepositStake() | Withdraw() | OpenBudgetVote():
                return self._currency.to_units(command.amount_iec)
            case RegisterService():
                return self._max_bond(command)
            case Challenge():
                return self._stake(self._disputed(command.task_id))
            case RescueTokens() if to_checksum_address(command.token) == self.client.deployment.address(
                "IECoin"
            ):
                return self.client.unaccounted()
            case SetPayout():
                self._require_bounded(command)
            case Propose() if not self.client.deployment.decides_by_vote:
                # The wallet decides it now, whoever executes it later.
                return self._spends(self._parse(command.command, command.request)[0])
        return 0

    def _require_bounded(self, command: SetPayout) -> None:
        """Whoever is named is paid all that the provider earns from then on. Raises DailyLimitReached."""
        limits = self.transactions.orders.wallets[self.participant].limits
        known = (self.address, self.names.payout(self.participant))
        if limits.has_daily_iec and self._payee("payout", command.payout) not in known:
            raise DailyLimitReached(
                "a wallet with a daily limit names no payout address but its own and the site file's: set "
                "the robot's payout there, or remove the limit",
                participant=self.participant,
                payout=command.payout,
            )

    # -- a wallet that lives elsewhere ---------------------------------------------------------------------

    def _prepare(self, request: Prepare) -> Reply:
        """The transaction to sign, or the signed one where this request was broadcast before."""
        command, build = self._parse(request.command, request.request)
        content = _content_sha256(request.command, command)
        if command.request_id is not None:
            entry = self.transactions.orders.find(self.participant, command.request_id, content)
            if entry is not None:
                return {"raw": "0x" + entry.raw.hex(), "content_sha256": content, "remaining": 0}
        first, *others = orders = self._orders(request.command, command, build)
        self.transactions.signer.check_spending(orders[-1])
        return {
            "transaction": self.transactions.signer.unsigned(first),
            "content_sha256": first.content_sha256,
            "remaining": len(others),
        }

    def _broadcast(self, request: Broadcast) -> Future[Reply]:
        raw = bytes.fromhex(request.raw[2:])
        try:
            fields = decoded(raw)
            signer = Account.recover_transaction(raw)
        except Exception as error:
            # rlp, eth_keys and eth_account each raise their own types on hostile bytes; all mean the same.
            raise NotThisWallets(
                "this is not a signed transaction of type 2", problem=repr(error)[:200]
            ) from error
        chain_id, to = self.client.deployment.chain_id, to_checksum_address(fields["to"] or ZERO_ADDRESS)
        found = (signer, fields.get("chainId"), to in self.client.deployment.contracts.values())
        if found != (self.key_address, chain_id, True) or "maxFeePerGas" not in fields:
            raise NotThisWallets(
                "not signed by this participant for this chain and these contracts",
                signer=signer,
                expected_signer=self.key_address,
                chain_id=fields.get("chainId"),
                expected_chain_id=chain_id,
                to=to,
            )
        call = Call(to, "0x" + bytes(fields["data"]).hex(), "broadcast")  # type: ignore[arg-type]
        content = request.content_sha256 or sha256(raw).hexdigest()
        return self.transactions.orders.broadcast(
            Order(
                self.participant, "broadcast", call, request.request_id or sha256(raw).hexdigest(), content
            ),
            raw,
        )

    # -- what somebody else sends ---------------------------------------------------------------------------

    @property
    def _requests(self) -> Requests:
        return Requests(self.client)

    def _sign(self, request: Sign) -> Reply:
        """What `relay` sends; without signatures for a wallet that signs for itself."""
        wallet = self.transactions.orders.wallets[self.participant]
        if self.participant == ORGANIZATION:
            raise CannotSign("the organization is a contract that signs nothing: its operators send")
        if wallet.limits.has_daily:
            raise CannotSign("what others send cannot be counted against the wallet's daily limit")
        command, _ = self._parse(request.command, request.request)
        deadline = int(self.index.position.block_time_s) + request.valid_s
        said, permit = self._said(command, deadline), None
        taker, amount = self._taken(said)
        if amount and self._approval(taker, amount):
            permit = self._requests.permit(self.address, taker, amount, deadline)
        signed = SignedRequest(
            request=TypedSignature(typed_data=self._requests.typed(said)),
            permit=None if permit is None else TypedSignature(typed_data=permit),
        )
        if wallet.account is not None:
            signed = signed_requests.sign(signed, wallet.account)
        return signed.model_dump(mode="json")

    def _said(self, command: Command, deadline: int) -> Said:
        """The request of a command, whose checks are those of sending it. Raises RequestError."""
        nonce = nonce_of(command.request_id)
        match command:
            case RegisterTask():
                return signed_requests.RegisterTask(
                    creator=self.address,
                    request=signed_requests.TypedTask.of(self._task_request(command)),
                    nonce=nonce,
                    deadline=deadline,
                )
            case SubmitProof():
                return signed_requests.SubmitProof(
                    executor=self.address,
                    task_id=command.task_id,
                    attempt=command.attempt,
                    proof_hash=command.proof_sha256,
                    uri=self._proof_uri(command),
                    nonce=nonce,
                    deadline=deadline,
                )
            case CancelTask():
                return signed_requests.CancelTask(
                    creator=self.address, task_id=command.task_id, nonce=nonce, deadline=deadline
                )
            case AcceptTask() | AbandonTask():
                back = isinstance(command, AbandonTask)
                said = signed_requests.AbandonTask if back else signed_requests.AcceptTask
                return said(
                    executor=self.address,
                    task_id=command.task_id,
                    attempt=command.attempt,
                    nonce=nonce,
                    deadline=deadline,
                )
            case Challenge():
                task = self._disputed(command.task_id)
                self._require_funds(self.address, self._stake(task))
                return signed_requests.Challenge(
                    challenger=self.address,
                    judge=self._disputes(),
                    task_id=command.task_id,
                    attempt=task["attempt"],
                    instance=task["dispute"]["instance"],
                    reason=command.reason,
                    nonce=nonce,
                    deadline=deadline,
                )
        raise UnknownCommand("nobody sends this for another", command=type(command).__name__)

    def _taken(self, said: Said) -> tuple[str, int]:
        """The contract that takes tokens from whoever signed, and how many."""
        match said:
            case signed_requests.RegisterTask():
                return self.client.task_manager, said.request.reward
            case signed_requests.Challenge():
                return said.judge, self._stake(self._disputed(said.task_id))
        return self.client.task_manager, 0

    def _relay(self, command: Relay) -> list[Call]:
        return self._requests.calls(command.signed)

    def _allow_payments(self, _command: AllowPayments) -> list[Call]:
        calls = self._escrow_approval(UNLIMITED // 2 + 1)
        if not calls:
            raise InvalidRequest("the contracts may take payments of any amount already")
        return calls

    def _revoke_request(self, command: RevokeRequest) -> list[Call]:
        return [self.client.calls.revoke_request(command.nonce)]

    # -- what each command becomes: transactions one after the other, the last is the command's own --

    def _register_task(self, command: RegisterTask) -> list[Call]:
        request = self._task_request(command)
        return [*self._escrow_approval(request.reward), self.calls.register_task(request)]

    def _task_request(self, command: RegisterTask) -> TaskRequest:
        """The task as it is registered. Raises RequestError where it would not be accepted."""
        self._require_kind(command.kind)
        kind = self.kinds.get(command.kind)
        if kind is not None:
            kind.validate(command.params)
        text = json.dumps(
            {"description": command.description, "params": command.params}, separators=(",", ":")
        )
        if len(text) > MAX_TEXT_BYTES:
            raise InvalidRequest(
                "parameters and description are too long", bytes=len(text), limit=MAX_TEXT_BYTES
            )
        reward = self._currency.to_units(command.reward_iec)
        if not command.allow_wait:
            self._require_affordable_service(command, reward)
        self._require_funds(self.address, reward)
        window_s = EXECUTION_WINDOW_S if kind is None else kind.execution_window_s
        return TaskRequest(
            kind=command.kind,
            reward=reward,
            execution_window=command.execution_window_s or window_s,
            verdict_window=command.verdict_window_s or self.economy.verdict_window_s,
            max_attempts=command.max_attempts or self.economy.max_attempts,
            rules=hex_bytes(self._rules_of(command)),
            service_id=self._service_of(command),
            provider=self._provider_of(command),
            params=text,
        )

    def _service_of(self, command: RegisterTask) -> int:
        if command.service_id is None:
            return 0
        service = self.index.service(command.service_id)
        if service is not None and service["state"] == "retired":
            raise InvalidRequest(
                "the task would wait indefinitely: this service was withdrawn for good",
                service_id=command.service_id,
            )
        return command.service_id

    def _provider_of(self, command: RegisterTask) -> str:
        if command.provider is None:
            return ZERO_ADDRESS
        if command.service_id is not None:
            raise InvalidRequest("name a service or a provider, not both")
        provider = self.names.address(command.provider)
        if provider == self.names.addresses[ORGANIZATION]:
            raise InvalidRequest("name one of the organization's services instead of the organization")
        if not self.index.offers(provider, command.kind):
            raise ProviderWithoutService(
                f"{command.provider} offers no {command.kind}", provider=provider, kind=command.kind
            )
        return provider

    def _cancel_task(self, command: CancelTask) -> list[Call]:
        return [self.calls.cancel_task(command.task_id)]

    def _accept_task(self, command: AcceptTask) -> list[Call]:
        return [self.calls.accept_task(command.task_id, command.attempt)]

    def _abandon_task(self, command: AbandonTask) -> list[Call]:
        return [self.calls.abandon_task(command.task_id, command.attempt)]

    def _raise_reward(self, command: RaiseReward) -> list[Call]:
        task = self._task(command.task_id)
        reward = self._currency.to_units(command.reward_iec)
        if task["creator"] != self.address or task["state"] not in ("open", "cancelled"):
            raise CannotRaise(
                "only the creator raises the reward of a task, and only while nobody has taken it",
                task_id=command.task_id,
                creator=task["creator"],
                state=task["state"],
            )
        if reward <= task["reward"]:
            raise CannotRaise(
                "a reward can only be raised",
                task_id=command.task_id,
                reward_iec=self._currency.text(reward),
                reward_now_iec=self._currency.text(task["reward"]),
            )
        is_open = task["state"] == "open"
        # What is in escrow comes back first.
        self._require_funds(self.address, reward - (task["reward"] if is_open else 0))
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
        approval, post = self._escrow_approval(reward), self.calls.register_task(request)
        if not is_open:
            return [*approval, post]
        # A task that is cancelled, and refused after that, would be gone. What is in escrow cannot pay yet.
        payable = not approval and self.client.balance(self.address) >= reward
        tried = post if payable else self.calls.register_task(replace(request, reward=0))
        self.client.simulate(tried, self.key_address)
        return [self.calls.cancel_task(command.task_id), *approval, post]

    def _match_task(self, command: MatchTask) -> list[Call]:
        return [self.client.calls.match_task(command.task_id, command.service_id or 0)]

    def _submit_proof(self, command: SubmitProof) -> list[Call]:
        uri = self._proof_uri(command)
        return [
            self.calls.submit_proof(command.task_id, command.attempt, hex_bytes(command.proof_sha256), uri)
        ]

    def _proof_uri(self, command: SubmitProof) -> str:
        """Where the proof is, if it is for the assignment that the task has. Raises AssignmentChanged."""
        uri = self.store.check(command.proof_uri)
        task = self.index.task(command.task_id)
        if command.nonce is not None and task is not None and task["nonce"] != command.nonce:
            raise AssignmentChanged(
                "the proof belongs to an earlier assignment of this task",
                task_id=command.task_id,
                nonce=command.nonce,
                nonce_now=task["nonce"],
            )
        return uri

    def _rule(self, command: Rule) -> list[Call]:
        task = self._task(command.task_id)
        judge, removed = self._judge_of(task)
        said = votes.finding(command, self._currency, task["rules_sha256"])
        auditors = self.client.auditor_calls
        if removed:
            return [auditors.rule(said, command.report_uri)]
        if task["passed_on"] and task["attempt"] == command.attempt:
            return [auditors.rule_for(judge, said, command.report_uri)]
        for calls, contract in ((self.client.oracle_calls, "OracleJudge"), (auditors, "AuditorJudge")):
            if judge == self.client.deployment.address(contract):
                return [calls.rule(said, command.report_uri)]
        raise NotAJudge("no single account rules on this task: its judges post votes", judge=judge)

    def _post_votes(self, command: PostVotes) -> list[Call]:
        judge, _ = self._judge_of(self._task(command.vote.task_id))
        said = votes.finding(command.vote, self._currency)
        signatures = b"".join(hex_bytes(one) for one in command.signatures)
        for calls, contract in (
            (self.client.committee_calls(), "OracleCommittee"),
            (self.client.dispute_calls, "DisputeJudge"),
        ):
            if judge == self.client.deployment.contracts.get(contract):
                return [calls.post_votes(said, command.report_uri, signatures)]
        raise NotAJudge("nobody votes on this task: another contract judges it", judge=judge)

    def _judge_of(self, task: Row) -> tuple[str, bool]:
        """The contract that judged the kind when the task was posted, and whether it was removed."""
        number = self.index.numbers()[task["number"]]
        return number["judge"], number["removed"]

    def _challenge(self, command: Challenge) -> list[Call]:
        task = self._disputed(command.task_id)
        stake, against = self._stake(task), (task["attempt"], task["dispute"]["instance"])
        self._require_funds(self.key_address, stake)
        return [
            *self._approval(self._disputes(), stake),
            self.client.dispute_calls.challenge(command.task_id, *against, command.reason),
        ]

    def _conclude(self, command: Conclude) -> list[Call]:
        return [self.client.calls.conclude(command.task_id)]

    def _settle_stakes(self, command: SettleStakes) -> list[Call]:
        self._disputes()
        return [self.client.dispute_calls.settle(command.task_id, command.attempt)]

    def _sign_vote(self, request: SignVote) -> Reply:
        """A vote of a judge who decides about a challenge, and relies on the report of the ruling that
        stands."""
        account = self.transactions.orders.wallets[self.participant].account
        if account is None:
            raise CannotSign("this participant signs for itself: its vote is EIP-712 typed data")
        task = self._disputed(request.task_id)
        instance = task["dispute"]["instance"] + 1
        committees = self.client.deployment.committees
        if instance >= len(committees):
            raise NoDispute("nobody decides about a challenge of this ruling", task_id=task["id"])
        judge = self.client.seat(account.address, committees[instance])
        if judge is None:
            raise NotAJudge(
                "this participant does not judge what is challenged", participant=self.participant
            )
        accepted, amount = request.ruling == "accepted", request.amount_iec
        if not accepted and amount is not None:
            raise InvalidRequest("only an accepted proof is paid an amount", ruling=request.ruling)
        if accepted and amount is None:
            amount = self._currency.from_units(task["price"])
        paid = self._currency.to_units(amount or Decimal(0))
        if request.ruling == "impossible":
            paid = task["price"] // 10  # IMPOSSIBLE_SHARE of the contract
        self._require_stake(judge.number, committees[instance], task["kind"], instance, paid)
        vote = Vote(
            task_id=task["id"],
            attempt=task["attempt"],
            proof_sha256=task["proof_sha256"],
            report_sha256=task["report_sha256"] or NO_RULES,
            rules_sha256=task["rules_sha256"] or NO_RULES,
            ruling=request.ruling,
            fault=request.fault,
            amount_iec=amount or Decimal(0),
            reason=request.reason or f"decided by {JUDGES[instance]}",
        )
        deployment = self.client.deployment
        signature = votes.sign(
            vote, account, deployment.chain_id, deployment.address(committees[instance]), self._currency
        )
        signed = SignedVote(vote=vote, report_uri=task["report_uri"] or "", signature=signature)
        return signed.model_dump(mode="json")

    def _task(self, task_id: int) -> Row:
        """Raises UnknownTask."""
        task = self.index.task(task_id)
        if task is None:
            raise UnknownTask("no such task", task_id=task_id)
        return task

    def _disputed(self, task_id: int) -> Row:
        """A task on which a ruling stands that can be challenged, or was. Raises NoDispute."""
        task = self._task(task_id)
        if task["dispute"] is None or task["state"] != "ruled":
            raise NoDispute(
                "no ruling stands here that can be challenged", task_id=task_id, state=task["state"]
            )
        return task

    def _require_stake(self, seat: int, committee: str, kind: str, instance: int, paid: int) -> None:
        """A vote without it would keep those of the others from counting. Raises StakeTooLow."""
        instances = self.client.instances(kind)
        needed = instances[instance].judge_stake if instance < len(instances) else 0
        if needed:  # nothing overturns the last instance, whose judges stake nothing
            needed = max(needed, self.client.stake_needed(seat, committee, paid))
        if (stake := self.client.stake(seat, committee)) < needed:
            raise StakeTooLow(
                "the stake of this judge is too low for its vote to count: somebody has to deposit",
                participant=self.participant,
                stake_iec=self._currency.text(stake),
                needed_iec=self._currency.text(needed),
            )

    def _stake(self, task: Row) -> int:
        """What a challenge of the ruling costs whoever is wrong, wei. Raises NoDispute."""
        instances, instance = self.client.instances(task["kind"]), task["dispute"]["instance"]
        if instance + 1 >= len(instances):
            raise NoDispute("nobody decides about a challenge of this ruling", task_id=task["id"])
        return instances[instance].stake

    def _expire_task(self, command: ExpireTask) -> list[Call]:
        return [self.client.calls.expire_task(command.task_id)]

    def _register_service(self, command: RegisterService) -> list[Call]:
        self._require_kind(command.kind)
        self._require_able(command.kind)
        self._require_room_for(command)
        price = self._currency.to_units(command.price_iec)
        bond, max_bond = self._bond(), self._max_bond(command)
        self._require_funds(self.address, bond)
        auto_accept = command.auto_accept
        if auto_accept is None:  # what nobody can check before it is assigned is free text
            auto_accept = not self.kinds.by_people(command.kind)
        offer = self.calls.register_service(command.kind, price, max_bond, auto_accept, command.description)
        return [*self._wake_up(), *self._escrow_approval(bond), offer]

    def _update_service(self, command: UpdateService) -> list[Call]:
        service = self.index.service(command.service_id)
        if service is None:
            raise UnknownService("no such service", service_id=command.service_id)
        if command.state == "active":
            self._require_able(service["kind"])
        price = service["price"] if command.price_iec is None else self._currency.to_units(command.price_iec)
        state = ServiceState[(command.state or service["state"]).upper()]
        woken = self._wake_up() if state is ServiceState.ACTIVE else []
        return [*woken, self.calls.update_service(command.service_id, price, state)]

    def _set_namers(self, command: SetNamers) -> list[Call]:
        namers = Namers[command.namers.upper()]
        return [self.client.calls.set_namers(command.service_id, namers, command.max_void_percent)]

    def _agree(self, command: Agree) -> list[Call]:
        return [self.calls.agree(command.service_id)]

    def _wake_up(self) -> list[Call]:
        """What comes before an offer of a provider that let too many attempts pass without a proof."""
        return [self.client.calls.wake_up()] if self.index.is_asleep(self.address) else []

    def _set_payout(self, command: SetPayout) -> list[Call]:
        provider = self.address if command.provider is None else self.names.address(command.provider)
        return [self.client.calls.set_payout(provider, self._payee("payout", command.payout))]

    def _payee(self, field: str, who: str) -> str:
        """The address of whoever is to be paid: nobody could correct a mistyped one.

        Raises InvalidRequest.
        """
        try:
            return self.names.addresses.get(who) or typed_address(who)
        except ValueError as error:
            raise InvalidRequest(f"{field}: neither a participant nor {error}") from error

    def _transfer(self, command: Transfer) -> list[Call]:
        amount = self._currency.to_units(command.amount_iec)
        to = self.names.address(command.to)
        self._require_funds(self.address, amount)
        return [self.calls.transfer(to, amount)]

    def _deposit(self, command: Deposit) -> list[Call]:
        amount = self._currency.to_units(command.amount_iec)
        # From the key's own account also for the organization, whose contract is where it goes.
        self._require_funds(self.key_address, amount)
        approval = self._approval(self.client.organization, amount)
        return [*approval, self.client.organization_calls.deposit(amount)]

    def _withdraw(self, command: Withdraw) -> list[Call]:
        amount = self._currency.to_units(command.amount_iec)
        to = self.names.address(command.to)
        self._require_funds(self.client.organization, amount)
        return [self.client.organization_calls.transfer(to, amount)]

    def _register_device(self, command: RegisterDevice) -> list[Call]:
        owner = self.names.address(command.owner)
        device = self.names.address(command.device)
        calls = self.client.organization_calls
        signed = _halves(command.signature)
        return [calls.register_device(device, command.role, owner, command.name, *signed)]

    def _revoke_device(self, command: RevokeDevice) -> list[Call]:
        reason = Revocation[command.reason.upper()]
        return [self.client.organization_calls.revoke_device(self.names.address(command.device), reason)]

    def _post_root(self, command: PostRoot) -> list[Call]:
        device, root = self.names.address(command.device), hex_bytes(command.root)
        return [self.client.device_calls.post_root(device, command.day, root, command.uri)]

    def _allow_kind(self, command: AllowKind) -> list[Call]:
        calls = self.client.organization_calls
        if command.judge == "oracle" and self.kinds.by_people(command.kind):
            raise KindWithoutChecks(
                "the oracle has no checks for this kind: let auditors judge it",
                kind=command.kind,
                kinds_with_checks=sorted(name for name, kind in self.kinds.items() if not kind.by_people),
            )
        found = self._windows(command)
        if command.judge is None:
            return [*found, calls.disallow_kind(command.kind)]
        # Last, so that nobody posts such a task before its rules hold.
        judge = self._judge_for(command.kind, command.judge)
        kept = self.index.rules(command.kind, judge)
        rules = command.rules_sha256 or next(reversed(kept), NO_RULES)
        if command.judge == "oracle" and rules == NO_RULES:
            raise KindWithoutRules(
                "say by which rules the oracle judges this kind: `rodeo kind show` names those of a kind",
                kind=command.kind,
            )
        return [*found, calls.allow_kind(command.kind, judge, hex_bytes(rules))]

    def _windows(self, command: AllowKind) -> list[Call]:
        """What sets the kind's windows and reference price, where the command names any, or the kind has none
        and is allowed. What the command leaves out stays as it is."""
        row, kind = self.index.kind(command.kind), self.kinds.get(command.kind)
        has_windows = row is not None and row["max_window_s"] > 0
        named = (
            *(command.min_window_s, command.max_window_s, command.grace_s),
            *(command.min_verdict_window_s, command.max_verdict_window_s, command.audit_window_s),
        )
        price_iec = command.reference_price_iec
        if price_iec is None and all(one is None for one in named) and (has_windows or not command.allowed):
            return []
        if row is not None and has_windows:
            known = (
                *(row["min_window_s"], row["max_window_s"], row["grace_s"]),
                *(row["min_verdict_window_s"], row["max_verdict_window_s"], row["audit_window_s"]),
            )
            price = row["reference_price"]
        else:
            declared = _UNDECLARED if kind is None else (*kind.windows_s, kind.grace_period_s)
            known = (*declared, *VERDICT_WINDOWS_S, 0)
            price_iec = price_iec or (DEFAULT_PRICE_IEC if kind is None else kind.reference_price_iec)
        if price_iec is not None:
            price = self._currency.to_units(price_iec)
        shortest, longest, grace, *judged = (
            now if one is None else one for one, now in zip(named, known, strict=True)
        )
        if command.grace_s is None and grace > shortest // 2:
            grace = min(GRACE_S, shortest // 2 // GRACE_STEP_S * GRACE_STEP_S)
        if shortest > longest:
            raise InvalidRequest(
                "the shortest execution window is longer than the longest",
                min_window_s=shortest,
                max_window_s=longest,
            )
        if grace > shortest // 2:
            raise InvalidRequest(
                "the grace period is at most half of the shortest execution window",
                grace_s=grace,
                min_window_s=shortest,
            )
        calls = self.client.organization_calls
        return [calls.set_windows(command.kind, Windows(shortest, longest, grace, *judged), price)]

    def _judge_for(self, kind: str, judge: str) -> str:
        """The address of the contract that judges `kind` from now on. Where oracles judge it already, theirs
        stays, however many they are by now. Raises KindWithoutQuorum."""
        deployment, present = self.client.deployment, self.index.numbers().get(self.index.number_of(kind))
        if present is not None and self.names.judge(present["judge"]) == judge:
            return str(present["judge"])
        if judge == "auditor":
            return deployment.address("AuditorJudge")
        if judge != "oracle":
            return to_checksum_address(judge)
        if not self.index.judges():
            return deployment.address("OracleJudge")
        if not self.client.quorum(kind).votes:
            raise KindWithoutQuorum(
                "several oracles judge here: say first how many have to agree about this kind, with "
                "`rodeo organization quorum`",
                kind=kind,
            )
        can_be_challenged = deployment.has_disputes and bool(self.client.instances(kind))
        return deployment.address("DisputeJudge" if can_be_challenged else "OracleCommittee")

    def _remove_judge(self, command: RemoveJudge) -> list[Call]:
        present, numbers = self.index.number_of(command.kind), self.index.numbers()
        if not present:
            raise UnknownKind("this kind never had a judge", kind=command.kind, known=self.index.kinds())
        # The kind may have had another judge between two numbers of this one, under which tasks still run.
        judge = numbers[present]["judge"]
        others = [
            number
            for number, row in numbers.items()
            if row["kind"] == command.kind and row["judge"] == judge and not row["removed"]
        ]
        wanted = [present, *(number for number in others if number != present)]
        return [self.client.organization_calls.remove_judge(number) for number in wanted]

    def _retire_rules(self, command: RetireRules) -> list[Call]:
        calls = self.client.organization_calls
        return [calls.retire_rules(command.kind, hex_bytes(command.rules_sha256))]

    def _set_policy(self, command: SetPolicy) -> list[Call]:
        return [self.client.organization_calls.set_policy(Policy[command.policy.upper()])]

    def _set_terms(self, command: SetTerms) -> list[Call]:
        terms = Terms(
            self._currency.to_units(command.bond_iec),
            self._currency.to_units(command.penalty_iec),
            command.max_failures,
        )
        return [self.client.organization_calls.set_terms(terms)]

    def _set_members_only(self, command: SetMembersOnly) -> list[Call]:
        return [self.client.organization_calls.set_members_only(command.enabled)]

    def _set_budget(self, command: SetBudget) -> list[Call]:
        role = Role[command.role.upper()]
        amount = self._currency.to_units(command.amount_iec)
        return [self.client.organization_calls.set_budget(role, amount, command.period_s)]

    def _pause_tasks(self, command: PauseTasks) -> list[Call]:
        return [self.client.organization_calls.pause_tasks(command.duration_s)]

    def _resume_tasks(self, _command: ResumeTasks) -> list[Call]:
        return [self.client.organization_calls.resume_tasks()]

    def _admit(self, command: Admit) -> list[Call]:
        account = self.names.address(command.account)
        return [self.client.organization_calls.grant_role(Role.MEMBER, account), *self._counted(account)]

    def _dismiss(self, command: Dismiss) -> list[Call]:
        account = self.names.address(command.account)
        return [self.client.organization_calls.revoke_role(Role.MEMBER, account), *self._counted(account)]

    def _counted(self, account: str) -> list[Call]:
        """What tells the votes whether `account` is a member. Nobody proposes while they know fewer members
        than there are, and a dismissed one counts for the quorum until they know."""
        if not self.client.deployment.decides_by_vote:
            return []
        return [self.client.governance_calls.votes.sync(account)]

    def _vouch(self, command: Vouch) -> list[Call]:
        account = self.names.address(command.account)
        return [self.client.organization_calls.vouch_for(account, command.vouched)]

    def _suspend_provider(self, command: SuspendProvider) -> list[Call]:
        return [self.client.organization_calls.suspend_provider(self.names.address(command.account))]

    def _reinstate_provider(self, command: ReinstateProvider) -> list[Call]:
        return [self.client.organization_calls.reinstate_provider(self.names.address(command.account))]

    def _suspend_service(self, command: SuspendService) -> list[Call]:
        return [self.client.organization_calls.suspend_service(command.service_id)]

    def _reinstate_service(self, command: ReinstateService) -> list[Call]:
        return [self.client.organization_calls.reinstate_service(command.service_id)]

    def _rescue_tokens(self, command: RescueTokens) -> list[Call]:
        to = self.names.address(command.to)
        return [self.client.organization_calls.rescue_tokens(to_checksum_address(command.token), to)]

    def _grant_role(self, command: GrantRole) -> list[Call]:
        role, account = Role[command.role.upper()], self.names.key_address(command.account)
        counted = self._counted(account) if role is Role.MEMBER else []
        return [self.client.organization_calls.grant_role(role, account), *counted]

    def _revoke_role(self, command: RevokeRole) -> list[Call]:
        role, account = Role[command.role.upper()], self.names.key_address(command.account)
        counted = self._counted(account) if role is Role.MEMBER else []
        return [self.client.organization_calls.revoke_role(role, account), *counted]

    def _change_judge_key(self, command: ChangeJudgeKey) -> list[Call]:
        old, key = self._judges_key(command.judge), to_checksum_address(command.key)
        return [self.client.committee_calls().change_key(old, key, *_halves(command.signature))]

    def _seat_judge(self, command: SeatJudge) -> list[Call]:
        key = to_checksum_address(command.key)
        owner = key if command.owner is None else self.names.address(command.owner)
        return [self.client.committee_calls().seat(key, owner, *_halves(command.signature))]

    def _unseat_judge(self, command: UnseatJudge) -> list[Call]:
        bit = self._judges_bit(command.judge)
        quorums = {row["kind"]: self.client.quorum(row["kind"]) for row in self.index.all_kinds()}
        calls = [
            self._quorum_call(kind, now.votes, now.seats & ~bit, now)
            for kind, now in quorums.items()
            if now.seats & bit
        ]
        if not calls:
            raise NotAJudge("this judge judges no kind of work", judge=command.judge)
        return calls

    def _set_quorum(self, command: SetQuorum) -> list[Call]:
        if command.kind not in self.kinds:  # else it may be allowed afterwards
            self._require_kind(command.kind)
        now = self.client.quorum(command.kind)
        seats = now.seats
        if command.judges is not None:
            seats = 0
            for one in command.judges:
                seats |= self._judges_bit(one)
        if command.rotation_s is not None:
            now = replace(now, rotation=command.rotation_s)
        return [self._quorum_call(command.kind, command.votes, seats, now, command.panel)]

    def _quorum_call(self, kind: str, votes: int, seats: int, now: Quorum, panel: int | None = None) -> Call:
        """What has `votes` of the seats with these bits judge `kind`. A decision by vote is executed days
        later, so the contract's refusal would come late. Raises InvalidQuorum."""
        count = seats.bit_count()
        if panel is None:
            panel = count if now.panel == now.count else min(now.panel, count)
        if not panel < 2 * votes <= 2 * panel or panel > count:
            raise InvalidQuorum(
                "the votes must be more than half of the panel, and the panel at most all judges of the kind",
                kind=kind,
                votes=votes,
                panel=panel,
                judges=count,
            )
        return self.client.committee_calls().set_quorum(kind, votes, panel, now.rotation, seats)

    def _judges_key(self, who: str) -> str:
        """Address with which a judge votes, who is named, or `who` itself. Raises UnknownParticipant."""
        keys = {row["name"]: row["key"] for row in self.index.judges()}
        known = keys.get(who)
        if known is None and not is_address(who):
            raise UnknownParticipant("no such judge", who=who, known=sorted(filter(None, keys)))
        return to_checksum_address(known or who)

    def _judges_bit(self, who: str) -> int:
        """The bit that stands for a judge's seat. Raises UnknownParticipant."""
        return 1 << self._judges_seat(who)

    def _judges_seat(self, who: str) -> int:
        """Raises UnknownParticipant."""
        sitting = self.client.seat(self._judges_key(who))
        if sitting is None:
            raise UnknownParticipant("no judge votes with this key", who=who)
        return sitting.number

    def _deposit_stake(self, command: DepositStake) -> list[Call]:
        disputes, amount = self._disputes(), self._currency.to_units(command.amount_iec)
        committee, seat = self._staked(command.judge)
        self._require_funds(self.key_address, amount)
        return [
            *self._approval(disputes, amount),
            self.client.dispute_calls.deposit_stake(committee, seat, amount),
        ]

    def _announce_withdrawal(self, command: AnnounceWithdrawal) -> list[Call]:
        self._disputes()
        amount = self._currency.to_units(command.amount_iec)
        committee, seat = self._staked(command.judge)
        return [self.client.dispute_calls.announce_withdrawal(committee, seat, amount)]

    def _withdraw_stake(self, command: WithdrawStake) -> list[Call]:
        self._disputes()
        return [self.client.dispute_calls.withdraw_stake(*self._staked(command.judge))]

    def _staked(self, who: str) -> tuple[ChecksumAddress, int]:
        """Committee and seat of a judge: of an oracle, or of a participant who decides about challenges.
        Raises UnknownParticipant."""
        key = self.names.keys.get(who, who)
        if who not in {row["name"] for row in self.index.judges()} and is_address(key):
            for committee in self.client.deployment.committees[1:]:
                if (judge := self.client.seat(key, committee)) is not None:
                    return self.client.deployment.address(committee), judge.number
        return self.client.deployment.address(ORACLES), self._judges_seat(who)

    def _disputes(self) -> ChecksumAddress:
        """Where judges have stakes. Raises NoDispute."""
        if not self.client.deployment.has_disputes:
            raise NoDispute("rulings cannot be challenged here, so nobody has a stake")
        return self.client.deployment.address("DisputeJudge")

    # -- decisions after a delay ---------------------------------------------------------------------------

    def _propose(self, command: Propose) -> list[Call]:
        self._require_timelock()
        proposed, build = self._parse(command.command, command.request)
        if isinstance(proposed, UpdateService) and proposed.state is None:
            # As it is now is not as it is when this is executed, days later.
            raise InvalidRequest("a proposal names the state that the service has afterwards, too")
        if isinstance(proposed, UpdateService):
            self._require_own_service(proposed.service_id)
        calls = build(replace(self, participant=ORGANIZATION), proposed)
        if not self.client.deployment.decides_by_vote:
            salt, delay_s = os.urandom(32), self.client.decision_delay_s()
            return [self.client.governance_calls.schedule(calls, command.description, salt, delay_s)]
        text = protected_text(command.description, self.key_address)
        made = self.client.governance_calls.proposal_id(calls, text)
        if (number := self.index.proposal_number(proposal_key(made))) is not None:
            # The governor identifies a proposal by its calls and its text, even after it has ended.
            raise AlreadyProposed(
                "this account proposed the same before with the same words: change the words",
                proposal=number,
                description=command.description,
            )
        return [self.client.governance_calls.propose(calls, text)]

    def _require_own_service(self, service_id: int) -> None:
        """Raises InvalidRequest where it is no service of the organization: only its provider changes it."""
        service = self.index.service(service_id)
        if service is not None and service["provider"] != self.client.organization:
            raise InvalidRequest(
                "the organization does not offer this service, so it cannot change it",
                service_id=service_id,
                provider=service["provider"],
            )

    def _cast_vote(self, command: CastVote) -> list[Call]:
        self._require_votes()
        key = self._proposal(command.proposal)["id"]
        return [self.client.governance_calls.cast_vote(int(key, 16), command.support)]

    def _queue_proposal(self, command: QueueProposal) -> list[Call]:
        self._require_votes()
        return [self.client.governance_calls.queue(_proposed(self._proposal(command.proposal)))]

    def _execute_proposal(self, command: ExecuteProposal) -> list[Call]:
        row = self._proposal(command.proposal)
        if self.client.deployment.decides_by_vote:
            return [self.client.governance_calls.execute(_proposed(row))]
        self._require_state(row, "ready")
        return [self.client.governance_calls.perform(_operation(row), hex_bytes(row["id"]))]

    def _cancel_proposal(self, command: CancelProposal) -> list[Call]:
        row = self._proposal(command.proposal)
        self._require_no_votes("a proposal is decided by votes, and nobody withdraws it")
        self._require_state(row, "waiting", "ready")
        return [self.client.governance_calls.cancel(hex_bytes(row["id"]))]

    def _hand_over(self, command: HandOver) -> list[Call]:
        self._require_timelock()
        self._require_no_votes("the members decide, and no key proposes in their place")
        holders = self.index.roles()
        former = sorted({one for role in TimelockRole for one in holders.get(role, ())})
        to = self.names.key_address(command.account)
        return self.client.governance_calls.hand_over(former, to)

    def _set_delay(self, command: SetDelay) -> list[Call]:
        self._require_timelock()
        return [self.client.governance_calls.set_delay(command.delay_s)]

    def _require_no_timelock(self, command: str) -> None:
        """Raises HasToBeProposed where the administrator is one: it does `command` after a proposal alone."""
        if not self.client.deployment.has_timelock:
            return
        if self.client.administrator() == self.client.deployment.address("OrganizationTimelock"):
            raise HasToBeProposed(
                "no key does this at once in this organization: propose it with `rodeo organization propose "
                "--why TEXT`, followed by the command",
                command=command,
                delay_s=self.client.decision_delay_s(),
            )

    def _require_timelock(self) -> None:
        if not self.client.deployment.has_timelock:
            raise ActsAtOnce(
                "the administrator's key acts at once in this organization, and nothing is proposed"
            )

    def _require_state(self, row: Row, *wanted: str) -> None:
        """Raises UnexpectedProposalState, of a proposal where nobody votes."""
        state = self.client.operation_state(hex_bytes(row["id"]))
        if state not in wanted:
            raise UnexpectedProposalState(
                "this cannot be done to the proposal in its state; `rodeo organization proposals` shows it",
                proposal=row["number"],
                state=state,
                wanted=" or ".join(wanted),
            )

    def _require_no_votes(self, problem: str) -> None:
        if self.client.deployment.decides_by_vote:
            raise MembersDecide(problem)

    def _require_votes(self) -> None:
        if not self.client.deployment.decides_by_vote:
            raise NoVotes("this organization has an administrator, and its members do not vote")

    def _proposal(self, number: int) -> Row:
        self._require_timelock()
        found = self.index.proposal(number)
        if found is None:
            raise UnknownProposal("no such proposal", proposal=number)
        return found

    def _collect(self, _command: Collect) -> list[Call]:
        return [self.client.calls.withdraw_payments(self.address)]

    # -- money that members split --------------------------------------------------------------------------

    def _open_budget_vote(self, command: OpenBudgetVote) -> list[Call]:
        self._require_votes()
        amount = self._currency.to_units(command.amount_iec)
        recipients = [self._payee("recipients", one) for one in command.recipients]
        for number, (one, who) in enumerate(zip(recipients, command.recipients, strict=True)):
            if one in (ZERO_ADDRESS, *self.client.deployment.contracts.values()):
                raise NotARecipient(
                    "the zero address and the organization's own contracts cannot be paid a share",
                    recipient=who,
                )
            if one in recipients[:number]:
                raise NotARecipient("each recipient is named once", recipient=who)
        # The members would split what is not there.
        self._require_funds(self.client.organization, amount)
        return [self.client.governance_calls.budgets.open(recipients, amount, command.duration_s)]

    def _cast_budget_vote(self, command: CastBudgetVote) -> list[Call]:
        row = self._budget_vote(command.budget_vote, "open")
        places = {self._place(row, who): votes for who, votes in command.votes.items()}
        if len(places) < len(command.votes):
            raise InvalidRequest("a recipient is named twice", votes=command.votes)
        votes = [places.get(place, 0) for place in range(len(row["recipients"]))]
        if (needed := sum(one * one for one in votes)) > BUDGET_CREDITS:
            raise TooFewCredits(
                "these votes cost more credits than a member has: n votes cost n * n",
                votes=command.votes,
                needed=needed,
                credits=BUDGET_CREDITS,
            )
        if not self.client.has_credits(self.key_address, int(row["opened"])):
            raise NoCredits(
                "only members from before the budget vote was opened have credits in it",
                participant=self.participant,
                budget_vote=row["number"],
            )
        return [self.client.governance_calls.budgets.vote(row["number"], votes)]

    def _pay_budget_share(self, command: PayBudgetShare) -> list[Call]:
        row = self._budget_vote(command.budget_vote, "ended")
        place = self._place(row, command.recipient)
        share, paid = shares(row["amount"], row["votes"])[place], row["paid"][place]
        if paid is not None or not share:
            raise NothingToPay(
                "this recipient got no votes" if paid is None else "this recipient was paid its share",
                budget_vote=row["number"],
                recipient=command.recipient,
                paid_iec=self._currency.text(int(paid or 0)),
            )
        self._require_funds(self.client.organization, share)
        return [self.client.governance_calls.budgets.pay(row["number"], place)]

    def _budget_vote(self, number: int, state: str) -> Row:
        """A budget vote in which members vote still (`open`), or no more (`ended`)."""
        self._require_votes()
        row = self.index.budget_vote(number)
        if row is None:
            raise UnknownBudgetVote(
                "no such budget vote; `rodeo organization budget-votes` lists them", budget_vote=number
            )
        found = "open" if self.client.voting_time_s() < row["end"] else "ended"
        if found != state:
            raise UnexpectedBudgetVoteState(
                "voting has ended"
                if state == "open"
                else "voting is still open: shares are paid after it ends",
                budget_vote=number,
                end_s=row["end"],
            )
        return row

    def _place(self, row: Row, who: str) -> int:
        """Where a recipient stands in the list of a budget vote. Raises NotARecipient."""
        recipients, address = row["recipients"], self._payee("recipient", who)
        if address not in recipients:
            raise NotARecipient(
                "this budget vote has no such recipient",
                recipient=who,
                known=[self.names.name(one) or one for one in recipients],
            )
        return int(recipients.index(address))

    # -- checks --------------------------------------------------------------------------------------------

    def _bond(self) -> int:
        """What a new service has to lock, wei."""
        return self._currency.to_units(Decimal((self.index.setting("terms") or {}).get("bond_iec", 0)))

    def _max_bond(self, command: RegisterService) -> int:
        """The highest bond that the new service agrees to lock, wei."""
        most_iec = command.max_bond_iec
        return self._bond() if most_iec is None else self._currency.to_units(most_iec)

    def _require_kind(self, kind: str) -> None:
        if kind not in self.index.kinds() and not self.client.is_kind_allowed(kind):
            raise UnknownKind(
                "the organization does not accept this kind", kind=kind, known=self.index.kinds()
            )

    def _rules_of(self, command: RegisterTask) -> str:
        """Hash of the rules of a new task: named, so that none judge it that become current before it is
        mined."""
        current, wanted = self.index.rules(command.kind), command.rules_sha256
        if wanted is None:
            return next(reversed(current), NO_RULES)
        if wanted not in current:  # as far as the index knows, which may be a block behind
            current = ["0x" + one.hex() for one in self.client.current_rules(command.kind)]
        if wanted not in current:
            raise RulesNotCurrent(
                "tasks of this kind are not posted under these rules",
                kind=command.kind,
                rules=wanted,
                current=current,
            )
        return wanted

    def _require_able(self, kind: str) -> None:
        if reason := self.names.cannot_do(self.participant, kind):
            raise CannotDo(reason, participant=self.participant, kind=kind)

    def _require_room_for(self, command: RegisterService) -> None:
        kind = command.kind
        request_id, sent = self._offering.get(kind, (None, None))
        if sent is not None and not sent.done():
            if request_id is not None and request_id == command.request_id:
                return  # the same one again, which is known
            raise AlreadyOffered(
                f"{self.participant} is offering {kind} already; its transaction is not mined yet", kind=kind
            )
        offers, most = self.index.offers(self.address, kind), self.names.most_offers(self.participant, kind)
        if len(offers) >= most:
            service = offers[-1]
            raise AlreadyOffered(
                f"{self.participant} offers {kind} already, as service {service['id']}, which is "
                f"{service['state']}: change that one's price or state, or withdraw it first",
                most_offers=most,
                kind=kind,
                service_id=service["id"],
                state=service["state"],
                price_iec=self._currency.text(service["price"]),
            )

    def _require_affordable_service(self, command: RegisterTask, reward: int) -> None:
        if command.provider is not None:
            offers = self.index.offers(self.names.address(command.provider), command.kind)
            prices = [offer["price"] for offer in offers if offer["state"] == "active"]
            which = f"every service of {command.provider}"
        elif command.service_id is None:
            # Who names nobody is compared in levels, who names somebody exactly.
            prices = [self._currency.reward_for(price) for price in self.index.active_prices(command.kind)]
            which = "every service of this kind"
        else:
            service = self.index.service(command.service_id)
            if service is None:
                raise UnknownService("no such service", service_id=command.service_id)
            prices, which = [service["price"]], f"service {command.service_id}"
        if prices and min(prices) > reward:
            raise RewardBelowPrice(
                f"{which} costs more than the reward",
                kind=command.kind,
                reward_iec=self._currency.text(reward),
                lowest_price_iec=self._currency.text(min(prices)),
            )

    def _require_funds(self, account: str, needed: int) -> None:
        # The index may be a block behind, so that only the node can say no.
        if self.index.balance(account) >= needed:
            return
        balance = self.client.balance(account)
        if balance < needed:
            raise InsufficientFunds(
                "the account's balance is too low for this",
                account=account,
                name=self.names.key_name(account),
                balance_iec=self._currency.text(balance),
                needed_iec=self._currency.text(needed),
            )

    def _escrow_approval(self, needed: int) -> list[Call]:
        """For what the TaskManager takes. The Organization approved it in its constructor."""
        return [] if self.participant == ORGANIZATION else self._approval(self.client.task_manager, needed)

    def _approval(self, spender: str, needed: int) -> list[Call]:
        """What lets `spender` take tokens from this wallet for good; nothing where it may already."""
        if spender in self._approved:
            return []
        allowance = self.client.allowance(self.key_address, spender)
        if allowance < needed:
            # Some tokens refuse to change an allowance that is not used up.
            reset = [self.client.calls.approve(spender, 0)] if allowance else []
            return [*reset, self.client.calls.approve(spender, UNLIMITED)]
        if allowance > UNLIMITED // 2:  # never used up
            self._approved.add(spender)
        return []


Build = Callable[[Wallet, Any], list[Call]]

_COMMANDS: dict[str, tuple[type[Command], Build]] = {
    "register_task": (RegisterTask, Wallet._register_task),
    "cancel_task": (CancelTask, Wallet._cancel_task),
    "accept_task": (AcceptTask, Wallet._accept_task),
    "abandon_task": (AbandonTask, Wallet._abandon_task),
    "raise_reward": (RaiseReward, Wallet._raise_reward),
    "submit_proof": (SubmitProof, Wallet._submit_proof),
    "rule": (Rule, Wallet._rule),
    "post_votes": (PostVotes, Wallet._post_votes),
    "challenge": (Challenge, Wallet._challenge),
    "conclude": (Conclude, Wallet._conclude),
    "settle_stakes": (SettleStakes, Wallet._settle_stakes),
    "expire_task": (ExpireTask, Wallet._expire_task),
    "register_service": (RegisterService, Wallet._register_service),
    "update_service": (UpdateService, Wallet._update_service),
    "agree": (Agree, Wallet._agree),
    "set_payout": (SetPayout, Wallet._set_payout),
    "set_namers": (SetNamers, Wallet._set_namers),
    "transfer": (Transfer, Wallet._transfer),
    "match_task": (MatchTask, Wallet._match_task),
    "deposit": (Deposit, Wallet._deposit),
    "withdraw": (Withdraw, Wallet._withdraw),
    "register_device": (RegisterDevice, Wallet._register_device),
    "revoke_device": (RevokeDevice, Wallet._revoke_device),
    "post_root": (PostRoot, Wallet._post_root),
    "allow_kind": (AllowKind, Wallet._allow_kind),
    "remove_judge": (RemoveJudge, Wallet._remove_judge),
    "retire_rules": (RetireRules, Wallet._retire_rules),
    "set_policy": (SetPolicy, Wallet._set_policy),
    "set_terms": (SetTerms, Wallet._set_terms),
    "set_members_only": (SetMembersOnly, Wallet._set_members_only),
    "set_budget": (SetBudget, Wallet._set_budget),
    "pause_tasks": (PauseTasks, Wallet._pause_tasks),
    "resume_tasks": (ResumeTasks, Wallet._resume_tasks),
    "admit": (Admit, Wallet._admit),
    "dismiss": (Dismiss, Wallet._dismiss),
    "vouch": (Vouch, Wallet._vouch),
    "suspend_provider": (SuspendProvider, Wallet._suspend_provider),
    "reinstate_provider": (ReinstateProvider, Wallet._reinstate_provider),
    "suspend_service": (SuspendService, Wallet._suspend_service),
    "reinstate_service": (ReinstateService, Wallet._reinstate_service),
    "rescue_tokens": (RescueTokens, Wallet._rescue_tokens),
    "grant_role": (GrantRole, Wallet._grant_role),
    "revoke_role": (RevokeRole, Wallet._revoke_role),
    "change_judge_key": (ChangeJudgeKey, Wallet._change_judge_key),
    "seat_judge": (SeatJudge, Wallet._seat_judge),
    "unseat_judge": (UnseatJudge, Wallet._unseat_judge),
    "set_quorum": (SetQuorum, Wallet._set_quorum),
    "deposit_stake": (DepositStake, Wallet._deposit_stake),
    "announce_withdrawal": (AnnounceWithdrawal, Wallet._announce_withdrawal),
    "withdraw_stake": (WithdrawStake, Wallet._withdraw_stake),
    "propose": (Propose, Wallet._propose),
    "cast_vote": (CastVote, Wallet._cast_vote),
    "queue_proposal": (QueueProposal, Wallet._queue_proposal),
    "execute_proposal": (ExecuteProposal, Wallet._execute_proposal),
    "cancel_proposal": (CancelProposal, Wallet._cancel_proposal),
    "hand_over": (HandOver, Wallet._hand_over),
    "set_delay": (SetDelay, Wallet._set_delay),
    "open_budget_vote": (OpenBudgetVote, Wallet._open_budget_vote),
    "cast_budget_vote": (CastBudgetVote, Wallet._cast_budget_vote),
    "pay_budget_share": (PayBudgetShare, Wallet._pay_budget_share),
    "collect": (Collect, Wallet._collect),
    "relay": (Relay, Wallet._relay),
    "allow_payments": (AllowPayments, Wallet._allow_payments),
    "revoke_request": (RevokeRequest, Wallet._revoke_request),
}


_UNDECLARED = PEOPLES_MIN_WINDOW_S, MAX_WINDOW_S, PEOPLES_MIN_WINDOW_S // 2
"""Execution windows and grace period of a kind that the site file does not list: people do it, and have to
accept in the grace period."""

_OF_ADMINISTRATOR = frozenset(get_args(Proposable)) - {
    *("change_judge_key", "remove_judge", "resume_tasks", "update_service")
}
"""Commands of the administrator alone; the others may be those of judges, guardians and operators, too."""

KNOWN = frozenset({*_COMMANDS, "prepare", "broadcast", "sign", "sign_vote"})
"""Names of all commands."""


def _halves(signature: str) -> tuple[bytes, bytes]:
    """r, and s with its parity (EIP-2098)."""
    raw = hex_bytes(signature)
    return raw[:32], raw[32:]


def _proposed(row: Row) -> Proposed:
    return Proposed(
        targets=row["targets"],
        values=[int(one) for one in row["values"]],
        calldatas=[bytes.fromhex(one[2:]) for one in row["calldatas"]],
        description_hash=hex_bytes(row["description_hash"]),
    )


def _operation(row: Row) -> Operation:
    return Operation(
        targets=row["targets"],
        values=[int(one) for one in row["values"]],
        calldatas=[bytes.fromhex(one[2:]) for one in row["calldatas"]],
        predecessor=hex_bytes(row["predecessor"]),
        salt=hex_bytes(row["salt"]),
    )


def _content_sha256(name: str, command: Command) -> str:
    # The nonce of a proof's assignment is in the proof.
    content = command.model_dump_json(exclude={"request_id", "dry_run", "nonce"})
    return sha256(f"{name} {content}".encode()).hexdigest()
