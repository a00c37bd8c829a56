"""What each contract event changes in the index."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from eth_utils import keccak

from rodeo.bus import decode_json
from rodeo.chain import artifacts, events
from rodeo.chain.abi import Cause, Ruling
from rodeo.chain.governance import SUPPORT, shown_text, text_of
from rodeo.chain.logs import Log, woken
from rodeo.chain.reputation import Work, is_own
from rodeo.chain.types import ZERO_ADDRESS, TimelockRole
from rodeo.currency import Currency
from rodeo.errors import MalformedJson
from rodeo.strict_json import whole_characters
from services.bridge import schema
from services.bridge.rows import Rows

ORACLES = artifacts.COMMITTEES[0]

_OfStake = events.StakeDeposited | events.WithdrawalAnnounced | events.StakeWithdrawn | events.StakeLost


def proposal_key(proposal_id: int) -> str:
    """How the index writes the governor's number of a proposal."""
    return f"0x{proposal_id:064x}"


def operation_key(operation_id: bytes) -> str:
    """How the index writes the timelock's id of an operation, or any other 32 bytes of it."""
    return "0x" + operation_id.hex()


@dataclass
class Projection:
    """Applies events to `rows`. `contracts`: name -> address."""

    rows: Rows
    contracts: Mapping[str, str]
    currency: Currency
    _reasons: dict[str, list[_Reason]] = field(default_factory=dict)
    _ends: set[tuple[int, int]] = field(default_factory=set)
    """(block, log index) of the last event of each thing that the contracts did."""
    _free: list[int] = field(default_factory=list)
    """Services that become free by what they do now; at its end each has a task or a place in the line, or
    stands back."""
    _woken: set[tuple[int, int]] = field(default_factory=set)
    """(block, log index) of each event of a provider that has called `wakeUp`."""
    _reported: tuple[str, events.Reported] | None = None
    """The transaction of the last report, and what it says of the ruling that follows."""

    def prepare(self, logs: Iterable[Log]) -> None:
        """See all events that will be applied: a transfer is explained by its neighbours, before or after."""
        logs = list(logs)
        self._reasons = defaultdict(list)
        self._woken = woken(logs)
        last: Log | None = None
        final: tuple[str, int | None] | None = None
        """Transaction and task of the last ruling, if it is final: how the attempt ends is part of it."""
        for log in logs:
            self._reasons[log.tx_hash] += self._explanations(log)
            begins = isinstance(log.event, _BEGINNINGS) and final != _place(log)
            begins |= (log.block, log.log_index) in self._woken
            if last is not None and (last.tx_hash != log.tx_hash or begins):
                self._ends.add((last.block, last.log_index))
            if isinstance(log.event, events.Ruled):
                final = None if log.event.until else _place(log)
            last = log
        if last is not None:
            self._ends.add((last.block, last.log_index))

    def apply(self, seq: int, log: Log, time_s: int) -> None:
        """Take in the next of the events that `prepare` saw."""
        self._apply(seq, log, time_s)
        if (log.block, log.log_index) in self._ends:
            self._place_free(time_s)

    def _apply(self, seq: int, log: Log, time_s: int) -> None:
        """Events without a case change nothing that can be queried; they are kept and published."""
        rows, event = self.rows, log.event
        match event:
            case events.TaskRegistered():
                params, description = parse_task_text(event.params)
                kind = self._kind(event.kind)
                rows.add(
                    schema.tasks,
                    id=event.task_id,
                    kind=event.kind,
                    state="open",
                    attempt=0,
                    max_attempts=event.max_attempts,
                    creator=event.creator,
                    reward=event.reward,
                    paid=0,
                    refunded=0,
                    execution_window_s=event.execution_window,
                    verdict_window_s=event.verdict_window,
                    grace_s=kind["grace_s"],
                    passed=[],
                    audit_window_s=kind["audit_window_s"],
                    number=kind["number"],
                    after_removal=False,
                    passed_on=False,
                    set_aside=0,
                    rules_sha256="0x" + event.rules.hex() if any(event.rules) else None,
                    params=params,
                    description=description,
                    text=event.params.lower(),
                    registered=time_s,
                )
            case events.ServiceRequested():
                self._change_task(event.task_id, requested_service_id=event.service_id)
            case events.ProviderRequested():
                self._change_task(event.task_id, requested_provider=event.provider)
            case events.TaskAssigned():
                self._change_task(
                    event.task_id,
                    **dict.fromkeys(_OF_ATTEMPT),
                    after_removal=False,
                    passed_on=False,
                    state="assigned",
                    accepted=rows.get(schema.services, event.service_id)["auto_accept"],
                    attempt=event.attempt,
                    executor=event.executor,
                    service_id=event.service_id,
                    price=event.price,
                    assigned=time_s,
                    execution_deadline=event.deadline,
                    nonce="0x" + event.nonce.hex(),
                )
                rows.change(schema.services, event.service_id, task_id=event.task_id, place=0)
                self._take(event.service_id)  # its next task, before it waited
            case events.TaskAccepted():
                self._change_task(event.task_id, accepted=True)
            case events.ProofSubmitted():
                task = rows.get(schema.tasks, event.task_id)
                deadline = time_s + task["verdict_window_s"]
                self._change_task(
                    event.task_id,
                    state="submitted",
                    proof_submitted=time_s,
                    proof_sha256="0x" + event.proof_hash.hex(),
                    proof_uri=event.uri,
                    verdict_deadline=deadline,
                    case_end=deadline + task["audit_window_s"],
                )
            case events.Reported():
                self._reported = log.tx_hash, event
            case events.PassedOn():
                self._change_task(event.task_id, passed_on=True)
            case events.Ruled():
                self._rule(event, log.tx_hash)
            case events.TaskSettled():
                standing = rows.get(schema.tasks, event.task_id)["standing"]
                # A task that nobody could do is none that its executor has done.
                counter = "completed" if standing["ruling"] == "accepted" else None
                self._end_attempt(event.task_id, counter, event.paid, time_s)
                self._change_task(
                    event.task_id,
                    **_WITHOUT_RULING,
                    verdict=standing["ruling"],
                    state="settled",
                    settled=time_s,
                    ended=time_s,
                    paid=event.paid,
                    refunded=event.refund,
                )
            case events.TaskPassed():
                provider = rows.get(schema.services, event.provider)["provider"]
                passed = rows.get(schema.tasks, event.task_id)["passed"]
                entry = {"provider": provider, "gave_up": event.gave_up}
                self._change_task(event.task_id, passed=[*passed, entry])
            case events.TaskRequeued():
                verdict = self._fail_attempt(event.task_id, event.cause, time_s)
                self._change_task(
                    event.task_id,
                    **_WITHOUT_RULING,
                    **dict.fromkeys(_OF_ASSIGNMENT),
                    **verdict,
                    state="open",
                )
            case events.TaskFailed():
                verdict = self._fail_attempt(event.task_id, event.cause, time_s)
                self._change_task(
                    event.task_id,
                    **_WITHOUT_RULING,
                    **verdict,
                    state="failed",
                    ended=time_s,
                    refunded=event.refund,
                )
            case events.TaskCancelled():
                self._change_task(event.task_id, state="cancelled", ended=time_s, refunded=event.refund)
            case events.ServiceRegistered():
                rows.add(
                    schema.services,
                    id=event.service_id,
                    kind=event.kind,
                    number=self._kind(event.kind)["number"],
                    provider=event.provider,
                    price=event.price,
                    state="active",
                    description=event.description,
                    auto_accept=event.auto_accept,
                    completed=0,
                    rejected=0,
                    expired=0,
                    bond=0,
                    set_aside=0,
                    penalty=0,
                    max_failures=0,
                    namers="proven",
                    max_void_percent=0,
                    place=0,
                    waits_as_proven=False,
                )
                self._free.append(event.service_id)
                self._change_provider(event.provider)
                if event.provider != self.contracts.get("Organization"):  # it has any number
                    live = self._provider(event.provider)["services"]
                    self._change_provider(event.provider, services=[*live, event.service_id])
            case events.TermsAgreed():
                rows.change(
                    schema.services,
                    event.service_id,
                    bond=event.bond,
                    penalty=event.penalty,
                    max_failures=event.max_failures,
                )
            case events.PenaltySetAside():
                self._change_task(event.task_id, set_aside=event.amount)
                self._change_bond(event.service_id, bond=-event.amount, set_aside=event.amount)
            case events.PenaltyReturned():
                self._change_bond(event.service_id, bond=event.amount, set_aside=-event.amount)
                self._resume_short(event.service_id)
            case events.BondPenalized():
                was_set_aside = bool(rows.get(schema.tasks, event.task_id)["set_aside"])
                lost = "set_aside" if was_set_aside else "bond"
                self._change_bond(event.service_id, **{lost: -event.amount})
            case events.BondReturned():
                # One that retires has it back when it is idle, and what was set aside when the case ends.
                service = rows.get(schema.services, event.service_id)
                retires = bool(service["bond"]) and service["task_id"] is None
                self._change_bond(event.service_id, **{"bond" if retires else "set_aside": -event.amount})
                self._free.append(event.service_id)
            case events.ServiceSuspended():
                rows.change(schema.services, event.service_id, state="suspended", place=0)
            case events.BondRanShort():
                rows.change(schema.services, event.service_id, state="short", place=0)
            case events.ServiceFellAsleep():
                rows.change(schema.services, event.service_id, state="paused", place=0)
            case events.ServiceStoodBack():
                rows.change(schema.services, event.service_id, place=0)
                self._take(event.service_id)
            case events.NamersChanged():
                rows.change(
                    schema.services,
                    event.service_id,
                    namers=event.namers.name.lower(),
                    max_void_percent=event.max_voids,
                )
            case events.ServiceReinstated():
                rows.change(schema.services, event.service_id, state="paused")
                self._change_provider(rows.get(schema.services, event.service_id)["provider"], failures=0)
            case events.ProviderSuspended():
                self._change_provider(event.provider, suspended=True)
            case events.ProviderReinstated():
                self._change_provider(event.provider, suspended=False)
            case events.ProviderFellAsleep():
                self._change_provider(event.provider, asleep_until=event.until)
            case events.ProviderWokeUp():
                self._change_provider(event.provider, asleep_until=None)
                if (log.block, log.log_index) in self._woken:
                    self._offer_all(event.provider)
            case events.ProviderRests():
                locked = {"bond_locked_until": time_s + _BOND_DELAY_S}
                self._change_provider(event.provider, rests_until=event.until, **locked)
            case events.ProviderProven():
                self._change_provider(event.provider, earned=True, bond_locked_until=None)
            case events.ProviderVouched():
                self._vouch(event.provider, event.vouched)
            case events.PayoutChanged():
                payout = None if event.payout == event.provider else event.payout
                self._change_provider(event.provider, payout=payout)
            case events.ServiceUpdated():
                # It queues again at the back.
                state = event.state.name.lower()
                rows.change(schema.services, event.service_id, price=event.price, state=state, place=0)
                self._free.append(event.service_id)
            case events.ServiceAgreed():
                rows.change(schema.services, event.service_id, number=event.kind_id, place=0)
                self._free.append(event.service_id)
            case events.DeviceRegistered():
                rows.add(
                    schema.devices,
                    address=event.device,
                    role=event.role,
                    name=event.device_name,
                    owner=event.owner,
                    registrar=event.registrar,
                    registered=time_s,
                )
            case events.DeviceOwnerChanged():
                rows.change(schema.devices, event.device, owner=event.owner)
            case events.DeviceRevoked():
                because = event.reason.name.lower()
                rows.change(schema.devices, event.device, revoked=time_s, revoked_because=because)
            case events.WitnessRoot():
                rows.add(
                    schema.roots,
                    device=event.device,
                    day=event.day,
                    root="0x" + event.root.hex(),
                    uri=event.uri,
                    block=log.block,
                    time_s=time_s,
                    tx_hash=log.tx_hash,
                )
            case events.KindAllowed():
                rows.put(
                    schema.numbers, number=event.number, kind=event.kind, judge=event.judge, removed=False
                )
                asked = {"judges_window_s": event.judges_window, "max_case_s": event.max_case}
                self._change_kind(event.kind, allowed=True, number=event.number, **asked)
                self._change_rules(event.kind, event.rules, current=any(event.rules))
            case events.RulesRetired():
                self._change_rules(event.kind, event.rules, current=False)
            case events.KindDisallowed():
                self._change_kind(event.kind, allowed=False)
            case events.JudgeRemoved():
                rows.change(schema.numbers, event.number, removed=True)
            case events.WindowsChanged():
                windows = {f"{name}_s": value for name, value in vars(event.windows).items()}
                self._change_kind(event.kind, **windows, reference_price=event.reference_price)
            case events.JudgeSeated():
                rows.add(
                    schema.judges,
                    committee=self._committee(log.contract),
                    seat=event.seat,
                    key=event.key,
                    first_key=event.key,
                    owner=event.owner,
                    stake=0,
                    leaving=0,
                    leaving_until_s=0,
                )
            case events.JudgeKeyChanged():
                rows.change(schema.judges, self._committee(log.contract), event.seat, key=event.key)
            case events.QuorumChanged():
                seats = [seat for seat in range(64) if event.seats >> seat & 1]
                committee = self._committee(log.contract)
                if committee == ORACLES:
                    self._change_kind(
                        event.kind,
                        votes=event.votes,
                        panel=event.panel,
                        rotation_s=event.rotation,
                        seats=seats,
                    )
                else:
                    self._change_challenges(committee, event.kind, votes=event.votes, seats=seats)
            case events.InstancesChanged():
                # Of one that is named twice, the first counts.
                needed = {
                    self._staked_in(one.committee): one.judge_stake for one in reversed(event.instances)
                }
                self._change_kind(event.kind, judge_stake=needed.get(ORACLES, 0))
                for committee in self._later_committees:
                    self._change_challenges(committee, event.kind, judge_stake=needed.get(committee, 0))
            case events.StakeDeposited():
                self._change_stake(event, stake=event.amount)
            case events.WithdrawalAnnounced():
                self._change_stake(event, event.until, stake=-event.amount, leaving=event.amount)
            case events.StakeWithdrawn():
                self._change_stake(event, 0, leaving=-event.amount)
            case events.StakeLost():
                self._lose_stake(event)
            case events.InstanceRuled() if event.ruling is not Ruling.NONE:
                self._rule_as_instance(event, time_s)
            case events.Challenged():
                task = rows.get(schema.tasks, event.task_id)
                dispute = task["dispute"] | {
                    "until": event.until,
                    "challenger": event.challenger,
                    "stake_iec": self.currency.text(event.stake),
                    "because": event.reason,
                }
                self._change_task(event.task_id, dispute=dispute)
                case = event.task_id, task["attempt"]
                rows.change(schema.cases, *case, until=event.until, staked=True)
            case events.CaseSettled():
                rows.change(schema.cases, event.task_id, event.attempt, settled=True)
                task = rows.get(schema.tasks, event.task_id)
                if task["dispute"] is not None and task["attempt"] == event.attempt:
                    self._change_task(event.task_id, dispute=task["dispute"] | {"settled": True})
            case events.TermsChanged():
                terms = {
                    "bond_iec": self.currency.text(event.bond),
                    "penalty_iec": self.currency.text(event.penalty),
                    "max_failures": event.max_failures,
                }
                rows.put(schema.settings, name="terms", value=terms)
            case events.MembersOnlyChanged():
                rows.put(schema.settings, name="members_only", value=event.members_only)
            case events.BudgetChanged():
                budget = {
                    "amount_iec": self.currency.text(event.amount),
                    "period_s": event.period,
                    "since_s": time_s,
                }
                rows.put(schema.settings, name=f"budget {event.role}", value=budget)
            case events.TasksPaused():
                rows.put(schema.settings, name="paused_until_s", value=event.until)
            case events.TasksResumed():
                rows.put(schema.settings, name="paused_until_s", value=0)
            case events.AuditorsChanged():
                rows.put(schema.settings, name="auditors", value=event.auditors)
            case events.PolicyChanged():
                rows.put(schema.settings, name="policy", value=event.policy)
            case events.RoleGranted() if self._counts(log.contract, event.role):
                rows.put(schema.roles, role=event.role, address=event.account, held=True)
            case events.RoleRevoked() if self._counts(log.contract, event.role):
                rows.put(schema.roles, role=event.role, address=event.account, held=False)
            case events.ProposalCreated():
                rows.add(
                    schema.proposals,
                    id=proposal_key(event.proposal_id),
                    number=self._next_proposal(),
                    proposer=event.proposer,
                    description=shown_text(event.description, event.proposer),
                    description_hash="0x" + keccak(text=event.description).hex(),
                    targets=event.targets,
                    values=[str(one) for one in event.values],
                    calldatas=["0x" + one.hex() for one in event.calldatas],
                    created=time_s,
                    vote_end=event.vote_end,
                    **dict.fromkeys(SUPPORT, 0),
                )
            # Whoever votes says how, by calling one function or another: both count.
            case events.VoteCast() | events.VoteCastWithParams():
                support, key = SUPPORT[event.support], proposal_key(event.proposal_id)
                rows.change(
                    schema.proposals,
                    key,
                    **{support: rows.get(schema.proposals, key)[support] + event.weight},
                )
                rows.add(
                    schema.ballots, proposal=key, voter=event.voter, support=support, weight=event.weight
                )
            case events.ProposalQueued():
                rows.change(schema.proposals, proposal_key(event.proposal_id), ready=event.eta_seconds)
            case events.ProposalExecuted():
                rows.change(schema.proposals, proposal_key(event.proposal_id), ended="executed")
            case events.ProposalCanceled():
                rows.change(schema.proposals, proposal_key(event.proposal_id), ended="canceled")
            case events.CallScheduled():
                self._schedule(event, time_s)
            case events.CallSalt():
                self._change_operation(event.id, salt="0x" + event.salt.hex())
            case events.Cancelled():
                self._change_operation(event.id, ended="canceled")
            case events.CallExecuted():
                self._change_operation(event.id, ended="executed")
                self._hide_founding(event.id, log.tx_hash)
            case events.MinDelayChange():
                if event.new_duration and rows.find(schema.settings, "founded") is None:
                    rows.put(schema.settings, name="founded", value=log.tx_hash)
            case events.RoundOpened():
                rows.add(
                    schema.budget_votes,
                    number=event.round_id,
                    amount=event.amount,
                    opened=time_s,
                    end=event.end,
                    recipients=event.recipients,
                    votes=[0] * len(event.recipients),
                    paid=[None] * len(event.recipients),
                )
            case events.BudgetVoteCast():
                self._cast_budget_vote(event)
            case events.BudgetPaid():
                before = rows.get(schema.budget_votes, event.round_id)
                paid = [
                    str(event.amount) if one == event.recipient else amount
                    for one, amount in zip(before["recipients"], before["paid"], strict=True)
                ]
                rows.change(schema.budget_votes, event.round_id, paid=paid)
            case events.PaymentDeferred():
                self._change_balance(event.account, owed=event.amount)
            case events.PaymentCollected():
                self._change_balance(event.account, owed=-event.amount)
            case events.Transfer():
                self._transfer(seq, log, event, time_s)

    def _counts(self, contract: str, role: str) -> bool:
        """Whether this contract knows this role: the timelock has those who propose, the organization all
        others. Each may hand out any 32 bytes as a role."""
        is_timelock = contract == self.contracts.get("OrganizationTimelock")
        return is_timelock == (role in list(TimelockRole))

    def _schedule(self, event: events.CallScheduled, time_s: int) -> None:
        """The next call of an operation of the timelock."""
        key = operation_key(event.id)
        if not event.index:
            # After it was cancelled it may be scheduled again, and begins anew.
            self.rows.put(
                schema.proposals,
                id=key,
                number=self._next_proposal(),
                description="",
                targets=[],
                values=[],
                calldatas=[],
                predecessor=operation_key(event.predecessor),
                salt=operation_key(bytes(32)),
                created=time_s,
                ready=time_s + event.delay,
                **dict.fromkeys(SUPPORT, 0),
            )
        before = self.rows.get(schema.proposals, key)
        targets, calldatas = (
            [*before["targets"], event.target],
            [*before["calldatas"], "0x" + event.data.hex()],
        )
        self.rows.change(
            schema.proposals,
            key,
            targets=targets,
            values=[*before["values"], str(event.value)],
            calldatas=calldatas,
            description=text_of(targets, [bytes.fromhex(one[2:]) for one in calldatas]),
        )

    def _change_operation(self, operation_id: bytes, **values: Any) -> None:
        key = operation_key(operation_id)
        # One without calls logs no call, and does nothing.
        if self.rows.find(schema.proposals, key) is not None:
            self.rows.change(schema.proposals, key, **values)

    def _hide_founding(self, operation_id: bytes, tx_hash: str) -> None:
        """What the founder has the organization told at once is no proposal. What it schedules and does not
        execute before the delay is set stays one: that can be executed at any time."""
        key, founded = operation_key(operation_id), self.rows.find(schema.settings, "founded")
        number = (self.rows.find(schema.proposals, key) or {}).get("number")
        is_last = number is not None and number == self._proposal_count()
        if is_last and (founded is None or founded["value"] == tx_hash):
            self.rows.change(schema.proposals, key, number=None)
            self.rows.put(schema.settings, name="proposals", value=self._proposal_count() - 1)

    def _cast_budget_vote(self, event: events.BudgetVoteCast) -> None:
        """The member's votes, in place of those that it gave before."""
        ballot = self.rows.find(schema.budget_ballots, event.round_id, event.account)
        before = [0] * len(event.votes) if ballot is None else ballot["votes"]
        votes = self.rows.get(schema.budget_votes, event.round_id)["votes"]
        added = [total + new - old for total, new, old in zip(votes, event.votes, before, strict=True)]
        self.rows.change(schema.budget_votes, event.round_id, votes=added)
        self.rows.put(
            schema.budget_ballots, budget_vote=event.round_id, voter=event.account, votes=event.votes
        )

    def _next_proposal(self) -> int:
        """The number of a new one."""
        number = self._proposal_count() + 1
        self.rows.put(schema.settings, name="proposals", value=number)
        return number

    def _proposal_count(self) -> int:
        row = self.rows.find(schema.settings, "proposals")
        return 0 if row is None else int(row["value"])

    def _change_task(self, task_id: int, **values: Any) -> None:
        self.rows.change(schema.tasks, task_id, **values)

    def _rule(self, event: events.Ruled, tx_hash: str) -> None:
        """What a judge said of a proof; or that nobody has, or that who did rules no more."""
        task = self.rows.get(schema.tasks, event.task_id)
        removed = bool(self._number(task["number"])["removed"])
        standing = {
            "ruling": event.ruling.name.lower(),
            "fault": event.fault.name.lower(),
            "amount_iec": self.currency.text(event.amount),
            "until": event.until,
        }
        if task["state"] == "submitted":
            self._free_service(task)
        # One that is final is done at once, by the events that follow.
        self._change_task(
            event.task_id,
            **self._report_of(event, tx_hash, task),
            state="ruled",
            standing=standing,
            standing_until=event.until or None,
            after_removal=removed,
        )

    def _report_of(self, event: events.Ruled, tx_hash: str, task: Mapping[str, Any]) -> dict[str, Any]:
        """What the judge says in words, if it does: in the same transaction, or before where the same ruling
        stands longer now."""
        sha256 = "0x" + event.report.hex() if any(event.report) else None
        where, said = self._reported or ("", None)
        self._reported = None  # it comes right before its ruling
        if said is not None and (where, said.task_id) == (tx_hash, event.task_id):
            return {"reason": said.reason, "report_sha256": sha256, "report_uri": said.report_uri}
        if sha256 is not None and sha256 == task["report_sha256"]:
            return {}
        return {"reason": None, "report_sha256": sha256, "report_uri": None}

    def _rule_as_instance(self, event: events.InstanceRuled, time_s: int) -> None:
        task = self.rows.get(schema.tasks, event.task_id)
        dispute = {"instance": event.instance, "until": event.until or time_s}
        self._change_task(event.task_id, dispute=dispute)
        before = self.rows.find(schema.cases, event.task_id, event.attempt)
        committee = artifacts.COMMITTEES[event.instance]
        # Judges stake for what they accept, and nothing overturns the last ruling.
        stakes = (
            event.ruling is Ruling.ACCEPTED and event.until and self._judge_stake(committee, task["kind"])
        )
        self.rows.put(
            schema.cases,
            task_id=event.task_id,
            attempt=event.attempt,
            number=task["number"],
            until=event.until,
            staked=bool(stakes) or (before is not None and before["staked"]),
            settled=False,
        )

    def _judge_stake(self, committee: str, kind: str) -> int:
        """What each of its judges must have deposited for its vote on this kind."""
        if committee == ORACLES:
            return int(self._kind(kind)["judge_stake"])
        row = self.rows.find(schema.challenge_kinds, committee, kind)
        return 0 if row is None else int(row["judge_stake"])

    def _change_bond(self, service_id: int, **by: int) -> None:
        row = self.rows.get(schema.services, service_id)
        self.rows.change(
            schema.services, service_id, **{name: row[name] + change for name, change in by.items()}
        )

    def _resume_short(self, service_id: int) -> None:
        """Its bond covers a penalty again: as ServiceManager.conclude."""
        service = self.rows.get(schema.services, service_id)
        if service["state"] == "short" and service["bond"] >= service["penalty"]:
            awake = self._provider(service["provider"])["asleep_until"] is None
            self.rows.change(schema.services, service_id, state="active" if awake else "paused")
            if awake and (self._is_proven(service["provider"]) or not self._is_engaged(service["provider"])):
                self._free.append(service_id)

    def _change_provider(self, address: str, **values: Any) -> None:
        self.rows.put(schema.providers, **{**self._provider(address), **values})

    def _provider(self, address: str) -> Mapping[str, Any]:
        unknown = {
            "address": address,
            "failures": 0,
            "done": 0,
            "failed": 0,
            "day": 0,
            "creator": 0,
            "asleep_until": None,
            "rests_until": None,
            "bond_locked_until": None,
            "earned": False,
            "vouched": False,
            "services": [],
            "suspended": False,
            "payout": None,
        }
        return self.rows.find(schema.providers, address) or unknown

    def _is_proven(self, address: str) -> bool:
        provider = self._provider(address)
        return address == self.contracts.get("Organization") or provider["earned"] or provider["vouched"]

    def _vouch(self, address: str, vouched: bool) -> None:
        """It begins anew if that proves it, or the other way round."""
        before = self._is_proven(address)
        self._change_provider(address, vouched=vouched)
        if self._is_proven(address) != before:
            self._change_provider(address, bond_locked_until=None, **_AWAKE)
            self._offer_all(address)

    def _live(self, address: str) -> list[Mapping[str, Any]]:
        """The provider's services that are not over, in the contract's order."""
        return [self.rows.get(schema.services, one) for one in self._provider(address)["services"]]

    def _is_engaged(self, address: str) -> bool:
        """Whether one of its services works or waits."""
        return any(one["place"] or one["task_id"] is not None for one in self._live(address))

    def _offer_all(self, address: str) -> None:
        """As ServiceManager: all its services that could work and are in no line, or in the wrong one."""
        proven = self._is_proven(address)
        for one in self._live(address):
            is_placed = one["place"] and one["waits_as_proven"] == proven
            if not is_placed and one["state"] == "active" and one["task_id"] is None:
                self.rows.change(schema.services, one["id"], place=0)
                self._free.append(one["id"])

    def _payout_of(self, address: str) -> str:
        return str(self._provider(address)["payout"] or address)

    def _change_kind(self, kind: str, **values: Any) -> None:
        self.rows.put(schema.kinds, **{**self._kind(kind), **values})

    @property
    def _later_committees(self) -> list[str]:
        """Names of those that decide about challenges."""
        return [name for name in artifacts.COMMITTEES[1:] if name in self.contracts]

    def _committee(self, contract: str) -> str:
        """The name of the committee that logs at this address."""
        found = (name for name in self._later_committees if self.contracts[name] == contract)
        return next(found, ORACLES)

    def _staked_in(self, committee: str) -> str | None:
        """The name of the organization's committee at this address. Anybody may deposit for the seats of
        another contract."""
        names = (ORACLES, *self._later_committees)
        return next((name for name in names if self.contracts.get(name) == committee), None)

    def _change_stake(self, event: _OfStake, until_s: int | None = None, **by: int) -> None:
        committee = self._staked_in(event.committee)
        if committee is None:
            return
        row = self.rows.get(schema.judges, committee, event.seat)
        values = {name: row[name] + change for name, change in by.items()}
        if until_s is not None:
            values["leaving_until_s"] = until_s
        self.rows.change(schema.judges, committee, event.seat, **values)

    def _lose_stake(self, event: events.StakeLost) -> None:
        """First what counts for votes, as the contract takes it."""
        committee = self._staked_in(event.committee)
        if committee is not None:
            counted = min(event.amount, self.rows.get(schema.judges, committee, event.seat)["stake"])
            self._change_stake(event, stake=-counted, leaving=counted - event.amount)

    def _change_challenges(self, committee: str, kind: str, **values: Any) -> None:
        key = {"committee": committee, "kind": kind}
        before = self.rows.find(schema.challenge_kinds, committee, kind)
        unknown = {**key, "votes": 0, "seats": [], "judge_stake": 0}
        self.rows.put(schema.challenge_kinds, **{**(before or unknown), **values})

    def _change_rules(self, kind: str, rules: bytes, *, current: bool) -> None:
        """They are the newest now, or current no longer."""
        named = "0x" + rules.hex()
        others = [one for one in self._kind(kind)["rules_sha256"] if one != named]
        self._change_kind(kind, rules_sha256=[*others, named] if current else others)

    def _kind(self, kind: str) -> Mapping[str, Any]:
        unknown = {
            "kind": kind,
            "allowed": False,
            "number": 0,
            "min_window_s": 0,
            "max_window_s": 0,
            "grace_s": 0,
            "reference_price": 0,
            "min_verdict_window_s": 0,
            "max_verdict_window_s": 0,
            "audit_window_s": 0,
            "judges_window_s": 0,
            "max_case_s": 0,
            "rules_sha256": [],
            "votes": 0,
            "panel": 0,
            "rotation_s": 0,
            "seats": [],
            "judge_stake": 0,
        }
        return self.rows.find(schema.kinds, kind) or unknown

    def _number(self, number: int) -> Mapping[str, Any]:
        """The judge, and whether it still judges."""
        return self.rows.find(schema.numbers, number) or {"judge": ZERO_ADDRESS, "removed": False}

    def _free_service(self, task: Mapping[str, Any]) -> None:
        """The attempt is over for the service that made it, if not yet for its record."""
        self.rows.change(schema.services, task["service_id"], task_id=None)
        self._free.append(task["service_id"])

    def _fail_attempt(self, task_id: int, cause: Cause, time_s: int) -> dict[str, Any]:
        """Returns how the attempt ended."""
        task = self.rows.get(schema.tasks, task_id)
        self._end_attempt(task_id, _COUNTER.get(cause), task["price"], time_s)
        if cause not in _OF_RULING:
            return dict(_VERDICT_OF_EXPIRY[cause])
        is_void = cause is Cause.VOID
        return {"verdict": cause.name.lower(), "fault": task["standing"]["fault"] if is_void else None}

    def _end_attempt(self, task_id: int, counter: str | None, value: int, time_s: float) -> None:
        """The attempt was paid, or would have been, `value` wei; its service's `counter` goes up by one."""
        task = self.rows.get(schema.tasks, task_id)
        if task["state"] != "ruled":  # else it was free since the first ruling
            self._free_service(task)
        if counter is None:
            return
        service = self.rows.get(schema.services, task["service_id"])
        # As ServiceManager counts: failures in a row of all the provider's services.
        provider = self._provider(service["provider"])
        completed, failures = counter == "completed", min(provider["failures"] + 1, 255)
        work = Work(provider["done"], provider["failed"], provider["day"], provider["creator"])
        own = self._is_own(task["creator"], service["provider"])
        if not own:
            counted = min(value, self._kind(task["kind"])["reference_price"])
            creator = "" if task["creator"] == self.contracts.get("Organization") else task["creator"]
            work = work.plus(counted, completed, time_s, creator, self.currency)
        if completed:
            failures = provider["failures"] if own else 0
        forgiven = _AWAKE if completed and not own else {}
        self._change_provider(service["provider"], failures=failures, **forgiven, **asdict(work))
        self.rows.change(schema.services, service["id"], **{counter: service[counter] + 1})

    def _is_own(self, creator: str, provider: str) -> bool:
        devices = {address: self.rows.find(schema.devices, address) for address in (creator, provider)}
        owners = {key: row["owner"] for key, row in devices.items() if row}
        return is_own(creator, provider, owners, self._payout_of(provider))

    def _take(self, service_id: int) -> None:
        """The service needs no place now."""
        self._free = [one for one in self._free if one != service_id]

    def _place_free(self, time_s: int) -> None:
        """As ServiceManager.enqueue: behind the others, where it takes tasks and there was none, unless its
        provider rests.

        The places of all kinds are numbered together.
        """
        free, self._free = self._free, []
        for service_id in free:
            service = self.rows.get(schema.services, service_id)
            owner, is_idle = service["provider"], service["task_id"] is None
            if service["state"] == "retired" and is_idle and not service["bond"]:
                live = [one for one in self._provider(owner)["services"] if one != service_id]
                self._change_provider(owner, services=live)
            proven = self._is_proven(owner)
            rests = not proven and (self._provider(owner)["rests_until"] or 0) > time_s
            if service["state"] == "active" and is_idle and not service["place"] and not rests:
                row = self.rows.find(schema.settings, "places")
                place = 1 if row is None else row["value"] + 1
                self.rows.put(schema.settings, name="places", value=place)
                self.rows.change(schema.services, service_id, place=place, waits_as_proven=proven)

    # -- tokens --------------------------------------------------------------------------------------------

    def _transfer(self, seq: int, log: Log, event: events.Transfer, time_s: int) -> None:
        sender_balance = self._add_balance(event.sender, -event.value)
        to_balance = self._add_balance(event.to, event.value)
        reason = self._reason(log.tx_hash, event)
        self.rows.add(
            schema.transfers,
            seq=seq,
            block=log.block,
            time_s=time_s,
            tx_hash=log.tx_hash,
            sender=event.sender,
            to=event.to,
            amount=event.value,
            sender_balance=sender_balance,
            to_balance=to_balance,
            task_id=reason.task_id,
            reason=reason.text,
        )

    def _add_balance(self, address: str, change: int) -> int | None:
        # Tokens are minted from and burnt to the zero address.
        if address == ZERO_ADDRESS:
            return None
        return int(self._change_balance(address, balance=change)["balance"])

    def _change_balance(self, address: str, **changes: int) -> Mapping[str, Any]:
        row = self.rows.find(schema.balances, address) or {"address": address, "balance": 0, "owed": 0}
        after = {**row, **{name: row[name] + change for name, change in changes.items()}}
        self.rows.put(schema.balances, **after)
        return after

    def _explanations(self, log: Log) -> list[_Reason]:
        """Why tokens move in the transaction of `log`, as its event tells."""
        tasks, organization = self.contracts.get("TaskManager"), self.contracts.get("Organization")
        disputes = self.contracts.get("DisputeJudge")
        match event := log.event:
            case events.TaskRegistered():
                return [_Reason("escrow", event.task_id, event.creator, tasks, event.reward)]
            case events.TaskSettled():
                # A service that retired has its bond back, or what was set aside of it, in the same transfer.
                bonds = [one.amount for one in self._reasons[log.tx_hash] if one.text == "bond_returned"]
                return [
                    *(
                        _Reason("payment", event.task_id, tasks, event.payout, event.paid + bond)
                        for bond in (0, *bonds)
                    ),
                    _Reason("surplus", event.task_id, tasks, None, event.refund),
                ]
            case events.TaskFailed() | events.TaskCancelled():
                return [_Reason("refund", event.task_id, tasks, None, event.refund)]
            case events.TermsAgreed():
                return [_Reason("bond", None, None, tasks, event.bond)]
            case events.BondPenalized():
                return [_Reason("penalty", event.task_id, tasks, organization, event.amount)]
            case events.BondReturned():
                return [_Reason("bond_returned", None, tasks, self._payout_of(event.provider), event.amount)]
            case events.PaymentCollected():
                return [_Reason("collected", None, tasks, self._payout_of(event.account), event.amount)]
            case events.Challenged():
                return [_Reason("stake", event.task_id, event.challenger, disputes, event.stake)]
            case events.StakePaid():
                return [_Reason("stake_paid", event.task_id, disputes, event.account, event.amount)]
            case events.StakeDeposited():
                return [_Reason("judge_stake", None, event.payer, disputes, event.amount)]
            case events.StakeWithdrawn():
                return [_Reason("judge_stake_paid", None, disputes, event.account, event.amount)]
            case events.Deposited():
                return [_Reason("deposit", None, event.sender, organization, event.amount)]
            case events.Withdrawn():
                return [_Reason("withdrawal", None, organization, event.to, event.amount)]
        return []

    def _reason(self, tx_hash: str, transfer: events.Transfer) -> _Reason:
        reasons = self._reasons.get(tx_hash, [])
        for position, reason in enumerate(reasons):
            if reason.explains(transfer):
                return reasons.pop(position)
        if transfer.sender == ZERO_ADDRESS:
            return _Reason("mint")
        return _Reason("burn" if transfer.to == ZERO_ADDRESS else "transfer")


def _place(log: Log) -> tuple[str, int | None]:
    """Transaction and task of what happened."""
    return log.tx_hash, getattr(log.event, "task_id", None)


@dataclass(frozen=True)
class _Reason:
    """Why tokens moved. None is anybody."""

    text: str
    task_id: int | None = None
    sender: str | None = None
    to: str | None = None
    amount: int = 0

    def explains(self, transfer: events.Transfer) -> bool:
        return (
            self.sender in (None, transfer.sender)
            and self.to in (None, transfer.to)
            and self.amount == transfer.value
        )


_OF_ATTEMPT = (
    "proof_submitted",
    "verdict_deadline",
    "case_end",
    "proof_sha256",
    "proof_uri",
    "verdict",
    "fault",
    "reason",
    "report_sha256",
    "report_uri",
    "dispute",
)
"""Columns that a new attempt starts without. Until then they tell how the last attempt ended."""

_OF_ASSIGNMENT = (
    "executor",
    "service_id",
    "price",
    "accepted",
    "assigned",
    "execution_deadline",
    "verdict_deadline",
    "case_end",
    "nonce",
)
"""Columns that only an assigned task has."""

_WITHOUT_RULING: dict[str, Any] = {"standing": None, "standing_until": None, "set_aside": 0}
"""Columns of a task on which no ruling stands."""

_BOND_DELAY_S = 24 * 3600
"""`BOND_DELAY` of Providers: how long its bonds are locked after a rest began."""

_AWAKE: dict[str, Any] = {"asleep_until": None, "rests_until": None}
"""Columns of a provider whose proof was accepted, or that the organization vouches for now, or no longer."""

_BEGINNINGS = (
    events.TaskRegistered,
    events.Ruled,
    events.TaskRequeued,
    events.TaskFailed,
    events.ServiceRegistered,
    events.ServiceUpdated,
    events.ServiceAgreed,
    events.ProviderVouched,
)
"""With these the contracts begin something that may free a service or give it a task; a transaction of
another contract may make them do several things."""

_OF_RULING = (Cause.REJECTED, Cause.GIVEN_UP, Cause.VOID)
"""Causes that a judge decides; the others are the executor's own."""

_COUNTER = {
    Cause.REJECTED: "rejected",
    Cause.EXECUTION_EXPIRED: "expired",
    Cause.ABANDONED_LATE: "expired",
}
"""What a failed attempt adds to its service's record. What is void, given up, or was not agreed to adds
nothing."""

_VERDICT_OF_EXPIRY = {
    Cause.EXECUTION_EXPIRED: {"verdict": "expired", "reason": "no proof within the execution window"},
    Cause.NOT_ACCEPTED: {"verdict": "expired", "reason": "the executor did not accept the task in time"},
    Cause.ABANDONED: {
        "verdict": "abandoned",
        "reason": "the executor gave the task back in the grace period, or had not accepted it",
    },
    Cause.ABANDONED_LATE: {
        "verdict": "abandoned",
        "reason": "the executor gave the task back after the grace period",
    },
}


def parse_task_text(text: str) -> tuple[dict[str, Any], str]:
    """Parameters and description from a task's `params`, which anybody may have filled with anything."""
    try:
        value = decode_json(whole_characters(text).encode(errors="replace"))
    except MalformedJson:
        return {}, text
    params, description = value.get("params"), value.get("description", "")
    if not isinstance(params, dict) or not isinstance(description, str):
        return {}, text
    return params, description
