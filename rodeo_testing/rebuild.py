"""The state of an organization, made of its contracts' events and nothing else.

It knows the rules of docs/reference/contracts.md, never asks a contract, and says the same as their views.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from rodeo.chain import events
from rodeo.chain.abi import (
    Cause,
    Device,
    Hire,
    KindRules,
    Namers,
    Quorum,
    Revocation,
    Ruling,
    Seat,
    Service,
    ServiceState,
    Standing,
    Task,
    TaskState,
    Terms,
)
from rodeo.chain.logs import Log, woken
from rodeo.chain.reputation import Work, is_own
from rodeo.chain.types import ZERO_ADDRESS

NO_PROOF = bytes(32)
BOND_DELAY_S = 24 * 3600

_COUNTERS = {
    Cause.REJECTED: "rejected",
    Cause.EXECUTION_EXPIRED: "expired",
    Cause.ABANDONED_LATE: "expired",
}
"""What of its service's record an attempt counts in that failed; others count in none."""


@dataclass
class Rebuilt:
    """What the views of the contracts answer, by what they are asked for."""

    tasks: dict[int, Task] = field(default_factory=dict)
    services: dict[int, Service] = field(default_factory=dict)
    """`place` is 0: `waiting` has the order."""
    failures: dict[str, int] = field(default_factory=dict)
    """Provider -> failures in a row of all its services."""
    work: dict[str, Work] = field(default_factory=dict)
    """Provider -> what it is known for."""
    reference_prices: dict[str, int] = field(default_factory=dict)
    """Kind -> the most that an attempt counts in a record."""
    suspended_providers: set[str] = field(default_factory=set)
    asleep: dict[str, int] = field(default_factory=dict)
    """Provider -> when it may wake up, of those that are asleep."""
    rests: dict[str, int] = field(default_factory=dict)
    """Provider -> until when it rests or rested, of those that are not proven."""
    locked: dict[str, int] = field(default_factory=dict)
    """Provider -> until when its bonds are locked."""
    earned: set[str] = field(default_factory=set)
    """Providers that their accepted work has proven."""
    vouched: set[str] = field(default_factory=set)
    """Those that the organization vouches for."""
    passed: dict[int, list[tuple[int, bool]]] = field(default_factory=dict)
    """Task -> numbers of the providers that it has passed, and whether each gave it up, the last first."""
    lines: dict[int, bool] = field(default_factory=dict)
    """Service that waits -> whether in a line of proven providers."""
    organization: str = ""
    """Its address: it is proven, and all work for it counts."""
    payouts: dict[str, str] = field(default_factory=dict)
    """Provider -> who is paid for its work, of those that have named somebody."""
    waiting: list[int] = field(default_factory=list)
    """Services that wait for a task, those that have waited longest first."""
    devices: dict[str, Device] = field(default_factory=dict)
    roots: dict[tuple[str, int], bytes] = field(default_factory=dict)
    kinds: dict[str, KindRules] = field(default_factory=dict)
    judges_of: dict[int, str] = field(default_factory=dict)
    """Number of a kind -> the contract that judges it."""
    removed: set[int] = field(default_factory=set)
    """Numbers whose judge rules no more."""
    rules: dict[str, list[bytes]] = field(default_factory=dict)
    """Kind -> the hashes that are current, the newest last."""
    rules_of_tasks: dict[int, bytes] = field(default_factory=dict)
    """What only the event tells."""
    kinds_of_tasks: dict[int, str] = field(default_factory=dict)
    audits_of_tasks: dict[int, int] = field(default_factory=dict)
    """Task -> the audit window that its kind had when it was posted, s."""
    standing: dict[int, Standing] = field(default_factory=dict)
    """Task -> the ruling that stands; while a final one is done, that one."""
    set_aside: dict[tuple[int, int], int] = field(default_factory=dict)
    """(service, task) -> what of the bond waits for the end of the case."""
    seats: dict[str, Seat] = field(default_factory=dict)
    """Key -> the seat of the judge in the committee of oracles."""
    quorums: dict[str, Quorum] = field(default_factory=dict)
    roles: set[tuple[str, str]] = field(default_factory=set)
    """(role, account)"""
    terms: Terms = field(default_factory=lambda: Terms(0, 0, 0))
    auditors: str = ZERO_ADDRESS
    members_only: bool = False
    policy: str = ZERO_ADDRESS
    budgets: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Role -> (amount, period)."""
    paused_until: int = 0
    balances: dict[str, int] = field(default_factory=dict)
    owed: dict[str, int] = field(default_factory=dict)
    _time_s: int = 0
    _freed: int = 0
    """The service whose attempt was over last."""

    def apply(self, log: Log, time_s: int, *, woke: bool = False) -> None:
        """Take in the next event, of a block at `time_s`; `woke`: its provider called `wakeUp`."""
        event, self._time_s = log.event, time_s
        match event:
            case events.TaskRegistered():
                self.rules_of_tasks[event.task_id] = event.rules
                self.kinds_of_tasks[event.task_id] = event.kind
                self.audits_of_tasks[event.task_id] = self.kinds[event.kind].audit_window
                self.tasks[event.task_id] = Task(
                    creator=event.creator,
                    reward=event.reward,
                    kind_id=self.kinds[event.kind].number,
                    price=0,
                    service_id=0,
                    deadline=0,
                    case_end=0,
                    execution_window=event.execution_window,
                    verdict_window=event.verdict_window,
                    attempt=0,
                    max_attempts=event.max_attempts,
                    state=TaskState.OPEN,
                    accepted=False,
                    provider=ZERO_ADDRESS,
                    hired=Hire.NONE,
                    proof_hash=NO_PROOF,
                )
            case events.ServiceRequested():
                self._task(event.task_id, service_id=event.service_id, hired=Hire.SERVICE)
            case events.ProviderRequested():
                self._task(event.task_id, provider=event.provider, hired=Hire.PROVIDER)
            case events.TaskAssigned():
                self._task(
                    event.task_id,
                    state=TaskState.ASSIGNED,
                    attempt=event.attempt,
                    service_id=event.service_id,
                    price=event.price,
                    deadline=event.deadline,
                    accepted=self.services[event.service_id].auto_accept,
                )
                self._service(event.service_id, task_id=event.task_id)
            case events.TaskAccepted():
                self._task(event.task_id, accepted=True)
            case events.ProofSubmitted():
                deadline = time_s + self.tasks[event.task_id].verdict_window
                self._task(
                    event.task_id,
                    state=TaskState.SUBMITTED,
                    proof_hash=event.proof_hash,
                    deadline=deadline,
                    case_end=deadline + self.audits_of_tasks[event.task_id],
                )
            case events.TaskPassed():
                self.passed.setdefault(event.task_id, []).insert(0, (event.provider, event.gave_up))
            case events.Ruled():
                self._free(event.task_id)
                removed = self.tasks[event.task_id].kind_id in self.removed
                self.standing[event.task_id] = Standing(
                    event.proof_hash, event.ruling, event.amount, event.until, 0, removed
                )
                self._task(event.task_id, state=TaskState.RULED)
            case events.TaskSettled():
                accepted = self.standing[event.task_id].ruling is Ruling.ACCEPTED
                self._release(event.task_id, "completed" if accepted else None, event.paid, time_s)
                self._task(
                    event.task_id, state=TaskState.SETTLED, deadline=0, case_end=0, proof_hash=NO_PROOF
                )
            case events.TaskRequeued():
                self._release(
                    event.task_id, _COUNTERS.get(event.cause), self.tasks[event.task_id].price, time_s
                )
                task = self.tasks[event.task_id]
                self._task(
                    event.task_id,
                    state=TaskState.OPEN,
                    service_id=task.service_id if task.hired is Hire.SERVICE else 0,
                    price=0,
                    deadline=0,
                    case_end=0,
                    proof_hash=NO_PROOF,
                )
            case events.TaskFailed():
                self._release(
                    event.task_id, _COUNTERS.get(event.cause), self.tasks[event.task_id].price, time_s
                )
                self._task(event.task_id, state=TaskState.FAILED, deadline=0, case_end=0, proof_hash=NO_PROOF)
            case events.TaskCancelled():
                self._task(event.task_id, state=TaskState.CANCELLED)
            case events.ServiceRegistered():
                self.services[event.service_id] = Service(
                    provider=event.provider,
                    price=event.price,
                    kind=event.kind,
                    task_id=0,
                    place=0,
                    state=ServiceState.ACTIVE,
                    completed=0,
                    rejected=0,
                    expired=0,
                    reputation=32,
                    bond=0,
                    penalty=0,
                    max_failures=0,
                    failures=self.failures.get(event.provider, 0),
                    auto_accept=event.auto_accept,
                    proven=self._is_proven(event.provider),
                    namers=Namers.PROVEN,
                    max_voids=0,
                )
                self._wait(event.service_id)
            case events.TermsAgreed():
                self._service(
                    event.service_id, bond=event.bond, penalty=event.penalty, max_failures=event.max_failures
                )
            case events.ServiceUpdated():
                # Queues again at the back.
                self._leave_line(event.service_id)
                self._service(event.service_id, price=event.price, state=event.state)
                self._wait(event.service_id)
            case events.ServiceSuspended():
                self._service(event.service_id, state=ServiceState.SUSPENDED)
            case events.ServiceAgreed():
                self._leave_line(event.service_id)
                self._wait(event.service_id)
            case events.BondRanShort():
                self._service(event.service_id, state=ServiceState.SHORT)
            case events.ServiceStoodBack():
                self._leave_line(event.service_id)
            case events.NamersChanged():
                self._service(event.service_id, namers=event.namers, max_voids=event.max_voids)
            case events.ServiceFellAsleep():
                self._service(event.service_id, state=ServiceState.PAUSED)
            case events.ProviderSuspended():
                self.suspended_providers.add(event.provider)
            case events.ProviderReinstated():
                self.suspended_providers.remove(event.provider)
            case events.ProviderFellAsleep():
                self.asleep[event.provider] = event.until
            case events.ProviderWokeUp():
                self.asleep.pop(event.provider, None)
                if woke:
                    self._offer_all(event.provider)
            case events.ProviderRests():
                self.rests[event.provider] = event.until
                self.locked[event.provider] = time_s + BOND_DELAY_S
                if self.services[self._freed].provider == event.provider:
                    self._leave_line(self._freed)
            case events.ProviderProven():
                self.earned.add(event.provider)
                self.locked.pop(event.provider, None)
                self._set_proven(event.provider)
            case events.ProviderVouched():
                before = self._is_proven(event.provider)
                (self.vouched.add if event.vouched else self.vouched.discard)(event.provider)
                if self._is_proven(event.provider) != before:
                    self._begin_anew(event.provider)
                    self.locked.pop(event.provider, None)
                    self._set_proven(event.provider)
                    self._offer_all(event.provider)
            case events.PayoutChanged():
                self.payouts[event.provider] = event.payout
            case events.ServiceReinstated():
                self._service(event.service_id, state=ServiceState.PAUSED)
                self._set_failures(self.services[event.service_id].provider, 0)
            case events.PenaltySetAside():
                self.set_aside[event.service_id, event.task_id] = event.amount
                bond = self.services[event.service_id].bond
                self._service(event.service_id, bond=bond - event.amount)
                standing = self.standing[event.task_id]
                self.standing[event.task_id] = replace(standing, penalty=event.amount)
            case events.PenaltyReturned():
                del self.set_aside[event.service_id, event.task_id]
                service = self.services[event.service_id]
                self._service(event.service_id, bond=service.bond + event.amount)
                if service.state is ServiceState.SHORT and service.bond + event.amount >= service.penalty:
                    awake = service.provider not in self.asleep
                    is_free = self._is_proven(service.provider) or not (
                        self._is_engaged(service.provider) or self._rests(service.provider)
                    )
                    self._service(
                        event.service_id, state=ServiceState.ACTIVE if awake else ServiceState.PAUSED
                    )
                    if is_free:
                        self._wait(event.service_id)
            case events.BondPenalized():
                if self.set_aside.pop((event.service_id, event.task_id), None) is None:
                    bond = self.services[event.service_id].bond
                    self._service(event.service_id, bond=bond - event.amount)
            case events.BondReturned():
                service = self.services[event.service_id]
                if service.bond and not service.task_id:
                    self._service(event.service_id, bond=0)
                else:  # after it retired: the case of a task that it did before has ended
                    waiting = [key for key in self.set_aside if key[0] == event.service_id]
                    del self.set_aside[next(key for key in waiting if self.set_aside[key] == event.amount)]
            case events.PaymentDeferred():
                self.owed[event.account] = self.owed.get(event.account, 0) + event.amount
            case events.PaymentCollected():
                self.owed[event.account] -= event.amount
            case events.DeviceRegistered():
                self.devices[event.device] = Device(
                    role=event.role,
                    name=event.device_name,
                    owner=event.owner,
                    registered_at=time_s,
                    revoked_at=0,
                    registrar=event.registrar,
                    revocation=Revocation.NONE,
                )
            case events.DeviceOwnerChanged():
                self.devices[event.device] = replace(self.devices[event.device], owner=event.owner)
            case events.DeviceRevoked():
                revoked = replace(self.devices[event.device], revoked_at=time_s, revocation=event.reason)
                self.devices[event.device] = revoked
            case events.JudgeSeated():
                self.seats[event.key] = Seat(event.owner, event.seat, time_s)
            case events.JudgeKeyChanged():
                self.seats[event.key] = replace(self.seats.pop(event.old_key), since=time_s)
            case events.QuorumChanged():
                self.quorums[event.kind] = Quorum(
                    event.votes, event.panel, event.rotation, event.seats.bit_count(), event.seats
                )
            case events.KindAllowed():
                self.judges_of[event.number] = event.judge
                asked = {"judges_window": event.judges_window, "max_case": event.max_case}
                self._kind(event.kind, allowed=True, number=event.number, **asked)
                if any(event.rules):
                    self._forget_rules(event.kind, event.rules)
                    self.rules[event.kind].append(event.rules)
            case events.RulesRetired():
                self._forget_rules(event.kind, event.rules)
            case events.KindDisallowed() if event.kind in self.kinds:
                self._kind(event.kind, allowed=False)
            case events.JudgeRemoved():
                self.removed.add(event.number)
            case events.WitnessRoot():
                self.roots[event.device, event.day] = event.root
            case events.WindowsChanged():
                self._kind(event.kind, **vars(event.windows))
                self.reference_prices[event.kind] = event.reference_price
            case events.RoleGranted():
                self.roles.add((event.role, event.account))
            case events.RoleRevoked():
                self.roles.remove((event.role, event.account))
            case events.TermsChanged():
                self.terms = Terms(event.bond, event.penalty, event.max_failures)
            case events.MembersOnlyChanged():
                self.members_only = event.members_only
            case events.BudgetChanged():
                self.budgets[event.role] = event.amount, event.period
            case events.TasksPaused():
                self.paused_until = event.until
            case events.TasksResumed():
                self.paused_until = min(self.paused_until, time_s)
            case events.AuditorsChanged():
                self.auditors = event.auditors
            case events.PolicyChanged():
                self.policy = event.policy
            case events.Transfer():
                self._balance(event.sender, -event.value)
                self._balance(event.to, event.value)

    def _task(self, task_id: int, **changes: object) -> None:
        self.tasks[task_id] = replace(self.tasks[task_id], **changes)  # type: ignore[arg-type]

    def _service(self, service_id: int, **changes: object) -> None:
        """Change a service, which waits no longer if it cannot take a task."""
        service = replace(self.services[service_id], **changes)  # type: ignore[arg-type]
        self.services[service_id] = service
        if not self._is_available(service_id):
            self._leave_line(service_id)

    def _is_available(self, service_id: int) -> bool:
        service = self.services[service_id]
        return service.state is ServiceState.ACTIVE and service.task_id == 0

    def _wait(self, service_id: int) -> None:
        """Behind the others, if it can take a task."""
        if self._is_available(service_id) and service_id not in self.waiting:
            self.waiting.append(service_id)
            self.lines[service_id] = self._is_proven(self.services[service_id].provider)

    def _leave_line(self, service_id: int) -> None:
        if service_id in self.waiting:
            self.waiting.remove(service_id)

    def _is_proven(self, provider: str) -> bool:
        return provider == self.organization or provider in self.earned | self.vouched

    def _rests(self, provider: str) -> bool:
        return not self._is_proven(provider) and self.rests.get(provider, 0) > self._time_s

    def _is_engaged(self, provider: str) -> bool:
        """Whether one of its services works or waits."""
        mine = self._services_of(provider)
        return any(one in self.waiting or self.services[one].task_id for one in mine)

    def _services_of(self, provider: str) -> list[int]:
        """Those that are not over."""
        return [
            key
            for key, one in self.services.items()
            if one.provider == provider and (one.state is not ServiceState.RETIRED or one.task_id or one.bond)
        ]

    def _begin_anew(self, provider: str) -> None:
        for known in (self.asleep, self.rests):
            known.pop(provider, None)

    def _set_proven(self, provider: str) -> None:
        for service_id in self._services_of(provider):
            self._service(service_id, proven=self._is_proven(provider))

    def _offer_all(self, provider: str) -> None:
        for service_id in self._services_of(provider):
            is_placed = service_id in self.waiting and self.lines[service_id] == self._is_proven(provider)
            if not is_placed:
                self._leave_line(service_id)
                self._wait(service_id)

    def _free(self, task_id: int) -> None:
        """The attempt is over for the service that made it, if it was not before, by an earlier ruling."""
        if self.tasks[task_id].state is not TaskState.RULED:
            self._freed = self.tasks[task_id].service_id
            self._service(self._freed, task_id=0)
            if not self._rests(self.services[self._freed].provider):
                self._wait(self._freed)

    def _release(self, task_id: int, counter: str | None, value: int, time_s: int) -> None:
        """The attempt is over, and counts in the record of its service."""
        self._free(task_id)
        standing = self.standing.pop(task_id, None)
        if counter is None:
            return
        service_id, accepted = self.tasks[task_id].service_id, counter == "completed"
        service = self.services[service_id]
        owners = {address: device.owner for address, device in self.devices.items()}
        payout = self.payouts.get(service.provider, service.provider)
        own = is_own(self.tasks[task_id].creator, service.provider, owners, payout)
        if not own:
            work = self.work.get(service.provider, Work())
            task = self.tasks[task_id]
            creator = "" if task.creator == self.organization else task.creator
            counted = min(value, self.reference_prices[self.kinds_of_tasks[task_id]])
            self.work[service.provider] = work.plus(counted, accepted, time_s, creator)
        if not accepted:
            self._set_failures(service.provider, service.failures + 1)
        elif not own:
            self._set_failures(service.provider, 0)
            self._begin_anew(service.provider)
            if standing is not None and not standing.until:  # it is free since now
                self._wait(service_id)
        self._service(service_id, **{counter: getattr(service, counter) + 1})

    def _set_failures(self, provider: str, failures: int) -> None:
        self.failures[provider] = failures
        for service_id, service in self.services.items():
            if service.provider == provider:
                self.services[service_id] = replace(service, failures=failures)

    def _kind(self, kind: str, **changes: object) -> None:
        rules = self.kinds.get(kind, KindRules(False, 0, 0, 0, 0, 0, 0, 0, 0, 0))
        self.kinds[kind] = replace(rules, **changes)  # type: ignore[arg-type]

    def _forget_rules(self, kind: str, rules: bytes) -> None:
        self.rules[kind] = [one for one in self.rules.get(kind, []) if one != rules]

    def _balance(self, account: str, change: int) -> None:
        self.balances[account] = self.balances.get(account, 0) + change


def rebuild(logs: Sequence[Log], time_of: Callable[[int], int], organization: str) -> Rebuilt:
    """The state after `logs`, which are all of them, in chain order; `time_of(block)` is its time, s."""
    state = Rebuilt(organization=organization)
    time_s, calls = 0, woken(logs)
    for log in logs:
        time_s = time_of(log.block)
        state.apply(log, time_s, woke=(log.block, log.log_index) in calls)
    for service_id, service in state.services.items():
        reputation = state.work.get(service.provider, Work()).reputation(time_s)
        state.services[service_id] = replace(service, reputation=reputation)
    return state
