"""Events alone tell the whole state: after an eventful life the index of them is what the views answer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import groupby
from random import Random
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.chain import artifacts
from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import (
    Device,
    Fault,
    Finding,
    Hire,
    KindRules,
    Namers,
    Quorum,
    Revocation,
    Ruling,
    Service,
    ServiceState,
    Standing,
    Task,
    TaskState,
    Terms,
    Windows,
)
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import ZERO_ADDRESS, Policy, Role
from rodeo.chain.encoding import Call
from rodeo.chain.node.errors import ContractReverted
from rodeo.chain.reputation import Work
from rodeo.judging import votes
from rodeo.money.currency import IEC
from rodeo.signing import possession
from services.bridge.index import Index, Position, TimedLog, sqlite_url
from services.bridge.reading import Page
from tests.support.organization import GENESIS_S, KIND, PROOF, REPORT, Clock, Organization, founded
from tests.support.views import view

STEPS = 120
AUDITED = Windows(600, 7200, 60, 600, 7200, 3600)
DEVICE_KEY = Account.from_key("0x" + "11" * 32)
DEVICE = DEVICE_KEY.address
JUDGE_KEYS = [Account.from_key(f"0x{number:064}") for number in (11, 12, 13)]
JUDGES = [key.address for key in JUDGE_KEYS]
LIVE = (TaskState.ASSIGNED, TaskState.SUBMITTED, TaskState.RULED)
"""States in which a window runs."""


@dataclass
class Life:
    """Random things that the participants of an organization may do, one per step."""

    organization: Organization
    clock: Clock
    random: Random

    def prepare(self) -> None:
        organization, calls = self.organization, self.organization.client.organization_calls
        seats = self.organization.client.judge_calls.committee()
        oracles, auditors = self.judges
        for call in (
            calls.set_terms(Terms(IEC.to_units(Decimal(20)), IEC.to_units(Decimal(4)), 4)),
            *(
                calls.set_windows(one, Windows(600, 7200, 60, 600, 7200, 0), IEC.to_units(Decimal(60)))
                for one in ("battery_charging", "painting", KIND)
            ),
            calls.allow_kind("battery_charging", auditors, REPORT),
            calls.grant_role(Role.AUDITOR, organization.oracle.address),
            calls.grant_role(Role.MEMBER, organization.robot.address),
            calls.grant_role(Role.MEMBER, organization.operator.address),
            calls.set_members_only(True),
            calls.set_budget(Role.OPERATOR, IEC.to_units(Decimal(100_000)), 7200),
            calls.set_budget(Role.TREASURER, 7, 60),
            calls.grant_role(Role.GUARDIAN, organization.operator.address),
            calls.pause_tasks(600),
            calls.resume_tasks(),
            *(calls.suspend_provider(one) for one in (DEVICE, JUDGES[0])),
            calls.reinstate_provider(DEVICE),
            self.registered_device(organization.operator.address, 0),
            self.registered_device(organization.robot.address, 1),
            *(calls.allow_kind(KIND, oracles, rules) for rules in (PROOF, REPORT, PROOF)),
            calls.retire_rules(KIND, REPORT),
            calls.allow_kind("painting", auditors, PROOF),
            calls.disallow_kind("painting"),
            calls.set_windows(KIND, AUDITED, IEC.to_units(Decimal(60))),
            calls.vouch_for(organization.robot.address, False),
            organization.client.device_calls.post_root(DEVICE, 0, REPORT, "file:///day"),
            *(seats.seat(key.address, key.address, *self.agreed(key, key.address)) for key in JUDGE_KEYS[:2]),
            seats.set_quorum(KIND, 2, 2, 60, 0b11),
            seats.change_key(JUDGES[1], JUDGES[2], *self.agreed(JUDGE_KEYS[2], JUDGES[1])),
        ):
            organization.send(organization.operator, call)
        robot, operator, payouts = organization.robot, organization.operator, organization.client.calls
        organization.send(robot, payouts.set_payout(robot.address, operator.address))
        organization.send(operator, payouts.set_payout(robot.address, robot.address))
        organization.send(operator, payouts.set_payout(operator.address, robot.address))
        organization.send(organization.operator, calls.revoke_device(DEVICE, Revocation.COMPROMISED))
        organization.send(organization.operator, calls.revoke_role(Role.AUDITOR, organization.oracle.address))

    @property
    def judges(self) -> tuple[str, str]:
        """The oracle's judge, and the auditors'."""
        deployment = self.organization.client.deployment
        return deployment.address("OracleJudge"), deployment.address("AuditorJudge")

    def agreed(self, key: LocalAccount, owner: str) -> tuple[bytes, bytes]:
        """By which a judge's key agrees to its seat."""
        client = self.organization.client
        committee = client.deployment.address(artifacts.COMMITTEES[0])
        return votes.possession(key, owner, client.w3.eth.chain_id, committee)

    def registered_device(self, owner: str, nonce: int) -> Call:
        client = self.organization.client
        registry = client.deployment.address("DeviceRegistry")
        signature = possession.sign(DEVICE_KEY, owner, nonce, client.w3.eth.chain_id, registry)
        r, vs = bytes.fromhex(signature[2:66]), bytes.fromhex(signature[66:])
        return client.organization_calls.register_device(DEVICE, "mocap", owner, "mocap2", r, vs)

    def step(self) -> None:
        often = [self.post, self.offer, self.prove, self.judge, self.audit]
        seldom = [self.update, self.expire, self.cancel, self.govern, self.accept, self.abandon, self.agree]
        self.random.choice([*often, *often, *seldom])()

    def post(self) -> None:
        reward = self.random.choice([30, 60, 100])
        client, request = self.organization.client, self.organization.request(reward)
        services = range(1, client.services.count() + 1)
        if services and self.random.random() < 0.1:
            request = replace(request, service_id=self.random.choice(services))
        elif services and self.random.random() < 0.1:
            named = client.services.service(self.random.choice(services))
            if named.state is not ServiceState.RETIRED:
                request = replace(request, provider=named.provider)
        call = client.organization_calls.register_task(request)
        try:
            client.simulate(call, self.organization.operator.address)
        except ContractReverted as refused:
            # The service agreed to another judge than the kind has now.
            assert refused.name in ("ServiceOfOtherKind", "ProviderWithoutService"), refused
            return
        self.organization.send(self.organization.operator, call)

    def offer(self) -> None:
        price = IEC.to_units(Decimal(self.random.choice([20, 50, 80])))
        client = self.organization.client
        services = {one + 1: client.services.service(one + 1) for one in range(client.services.count())}
        idle = [one for one, known in services.items() if known.state is not ServiceState.RETIRED]
        idle = [one for one in idle if services[one].task_id == 0]
        if len(idle) > 3:  # a provider may not have many
            retired = client.calls.update_service(idle[0], services[idle[0]].price, ServiceState.RETIRED)
            self.organization.send(self.organization.robot, retired)
        if sum(one.task_id != 0 for one in services.values()) > 3 or not self._collect(services):
            return
        if not self._wake_up():
            return
        call = self.organization.client.calls.register_service(
            KIND, price, IEC.to_units(Decimal(20)), self.random.random() < 0.5, "cleans"
        )
        self.organization.send(self.organization.robot, call)

    def _collect(self, services: dict[int, Service]) -> bool:
        """Whether the robot may have another service: one that has retired counts while its bond is
        locked."""
        client, robot = self.organization.client, self.organization.robot
        over = {i for i, one in services.items() if one.state is ServiceState.RETIRED and not one.task_id}
        locked = [i for i in over if services[i].bond]
        if len(services) - len(over) + len(locked) < 8:
            return True
        if not locked or not self._pass_to(view(client, "Providers", "lockedUntil", robot.address)):
            return False
        price = services[locked[0]].price
        self.organization.send(robot, client.calls.update_service(locked[0], price, ServiceState.RETIRED))
        return True

    def _wake_up(self) -> bool:
        """Whether the robot is awake, or could wake up."""
        client = self.organization.client
        until_s = view(client, "Providers", "asleepUntil", self.organization.robot.address)
        if not self._pass_to(until_s):
            return False
        if until_s:
            self.organization.send(self.organization.robot, client.calls.wake_up())
        return True

    def update(self) -> None:
        client = self.organization.client
        for service_id in self._shuffled(client.services.count()):
            service = client.services.service(service_id)
            if service.state in (ServiceState.ACTIVE, ServiceState.PAUSED):
                state = self.random.choice([ServiceState.ACTIVE, ServiceState.PAUSED, ServiceState.RETIRED])
                if state is ServiceState.ACTIVE and not self._wake_up():
                    return
                call = client.calls.update_service(service_id, service.price, state)
                self.organization.send(self.organization.robot, call)
                return

    def accept(self) -> None:
        client = self.organization.client
        for task_id in self._tasks(TaskState.ASSIGNED):
            task = client.tasks.task(task_id)
            if not task.accepted:
                self.organization.send(
                    self.organization.robot, client.calls.accept_task(task_id, task.attempt)
                )
                return

    def abandon(self) -> None:
        """In the grace period or after it."""
        client = self.organization.client
        for task_id in self._tasks(TaskState.ASSIGNED):
            task = client.tasks.task(task_id)
            since_s = self.random.choice([0, 61])
            if self._pass_to(task.deadline - task.execution_window + since_s):
                call = client.calls.abandon_task(task_id, task.attempt)
                self.organization.send(self.organization.robot, call)
            return

    def _pass_to(self, time_s: int) -> bool:
        """Let time pass, unless a window would end meanwhile."""
        if any(self._end(task_id) < time_s for task_id in self._tasks(*LIVE)):
            return False
        self.clock.now_s = max(self.clock.now_s, time_s)
        return True

    def prove(self) -> None:
        client = self.organization.client
        for task_id in self._tasks(TaskState.ASSIGNED):
            attempt = client.tasks.task(task_id).attempt
            call = client.calls.submit_proof(task_id, attempt, PROOF, "file:///proof.mcap")
            self.organization.send(self.organization.robot, call)
            return

    def _end(self, task_id: int) -> int:
        """When the window of a running task ends."""
        client = self.organization.client
        standing = client.tasks.standing(task_id)
        return standing.until if standing.until else client.tasks.task(task_id).deadline

    def judge(self) -> None:
        """The oracle rules, or passes the case on; an auditor rules where it judges alone."""
        client, judges = self.organization.client, self.judges
        for task_id in self._tasks(TaskState.SUBMITTED):
            ruling = self.random.choice([*Ruling, Ruling.NONE])
            number = client.tasks.task(task_id).kind_id
            by_auditors = client.judges.numbered(number) == judges[1] or view(
                client, "TaskManager", "isRemoved", number
            )
            if by_auditors:
                found = self._found(task_id, ruling or Ruling.REJECTED)
                call = client.judge_calls.auditor.rule(found, "file:///report.json")
                self.organization.send(self.organization.operator, call)
            else:
                call = client.judge_calls.oracle.rule(self._found(task_id, ruling), "file:///report.json")
                self.organization.send(self.organization.oracle, call)
            return

    def audit(self) -> None:
        client = self.organization.client
        for task_id in self._tasks(TaskState.RULED):
            found = self._found(task_id, self.random.choice([Ruling.REJECTED, Ruling.ACCEPTED]))
            judge, uri = client.judges.numbered(client.tasks.task(task_id).kind_id), "file:///audit.json"
            if view(client, "TaskManager", "isRemoved", client.tasks.task(task_id).kind_id):
                call = client.judge_calls.auditor.rule(found, uri)
            elif client.tasks.task(task_id).deadline < self.clock.now_s:
                continue  # nobody has passed it on
            else:
                call = client.judge_calls.auditor.rule_for(judge, found, uri)
            self.organization.send(self.organization.operator, call)
            return

    def _found(self, task_id: int, ruling: Ruling) -> Finding:
        task = self.organization.client.tasks.task(task_id)
        amount = self.random.randint(1, task.price) if ruling is Ruling.ACCEPTED else 0
        fault = self.random.choice([*Fault]) if ruling is Ruling.VOID else Fault.NOBODY
        return Finding(task_id, task.attempt, PROOF, REPORT, bytes(32), ruling, fault, amount, "looked at it")

    def expire(self) -> None:
        """All that runs, now and then: the windows of the others end with that of the oldest."""
        client = self.organization.client
        running = self._tasks(*LIVE)
        if not running or self.random.random() < 0.5:
            return
        self.clock.now_s = max(self._end(task_id) for task_id in running) + 1
        for task_id in running:
            end = client.calls.expire_task if self._is(task_id, TaskState.ASSIGNED) else client.calls.conclude
            self.organization.send(self.organization.operator, end(task_id))

    def _is(self, task_id: int, state: TaskState) -> bool:
        return self.organization.client.tasks.task(task_id).state is state

    def agree(self) -> None:
        client = self.organization.client
        for service_id in self._shuffled(client.services.count()):
            service = client.services.service(service_id)
            if service.state is not ServiceState.RETIRED and not service.task_id:
                self.organization.send(self.organization.robot, client.calls.agree(service_id))
                return

    def cancel(self) -> None:
        client = self.organization.client
        for task_id in self._tasks(TaskState.OPEN):
            if client.tasks.task(task_id).creator == client.organization:
                call = client.organization_calls.cancel_task(task_id)
                self.organization.send(self.organization.operator, call)
                return

    def govern(self) -> None:
        client = self.organization.client
        calls = client.organization_calls
        oracles, auditors = self.judges
        audited = calls.set_windows(KIND, AUDITED, IEC.to_units(Decimal(60)))
        rules = [audited, calls.allow_kind(KIND, auditors, PROOF)]
        rules += [calls.allow_kind(KIND, oracles, PROOF) for _ in range(3)]
        chosen = self.random.choice([*rules, *(calls.set_policy(policy) for policy in Policy)])
        self.organization.send(self.organization.operator, chosen)
        if self.random.random() < 0.3:
            robot = self.organization.robot.address
            vouched = calls.vouch_for(robot, not client.services.is_proven(robot))
            self.organization.send(self.organization.operator, vouched)
        if self.random.random() < 0.2:
            number = client.rules.kind(KIND).number
            self.organization.send(self.organization.operator, calls.remove_judge(number))
            self.organization.send(self.organization.operator, calls.allow_kind(KIND, oracles, PROOF))
            for task_id in self._tasks(TaskState.RULED):
                if client.tasks.task(task_id).kind_id == number:
                    self.organization.send(self.organization.operator, client.calls.conclude(task_id))
        for service_id in self._shuffled(client.services.count()):
            service = client.services.service(service_id)
            if service.state is ServiceState.SUSPENDED and service.bond >= service.penalty:
                self.organization.send(self.organization.operator, calls.reinstate_service(service_id))
                return
            if service.state is ServiceState.ACTIVE and self.random.random() < 0.1:
                self.organization.send(self.organization.operator, calls.suspend_service(service_id))
                return

    def _tasks(self, *states: TaskState) -> list[int]:
        client = self.organization.client
        return [i for i in self._shuffled(client.tasks.count()) if client.tasks.task(i).state in states]

    def _shuffled(self, count: int) -> list[int]:
        return self.random.sample(range(1, count + 1), count)


@dataclass
class Indexed:
    """The index of a life, its rows as what the contracts' views answer."""

    index: Index
    now_s: int

    def _row(self, found: Mapping[str, Any] | None) -> Mapping[str, Any]:
        assert found is not None
        return found

    def task(self, task_id: int) -> Task:
        row = self._row(self.index.tasks.get(task_id))
        state, asked = TaskState[row["state"].upper()], row["requested_service_id"]
        ends = {TaskState.ASSIGNED: row["execution_deadline"], TaskState.CANCELLED: 0, TaskState.OPEN: 0}
        proven = state in LIVE[1:]
        hired = Hire.SERVICE if asked else Hire.PROVIDER if row["requested_provider"] else Hire.NONE
        return Task(
            creator=row["creator"],
            reward=row["reward"],
            kind_id=row["number"],
            price=row["price"] or 0,
            service_id=row["service_id"] or asked or 0,
            provider=row["requested_provider"] or ZERO_ADDRESS,
            execution_window=row["execution_window_s"],
            verdict_window=row["verdict_window_s"],
            deadline=row["verdict_deadline"] if proven else ends.get(state, 0),
            case_end=row["case_end"] if proven else 0,
            attempt=row["attempt"],
            max_attempts=row["max_attempts"],
            state=state,
            accepted=row["accepted"],
            hired=hired,
            proof_hash=bytes.fromhex(row["proof_sha256"][2:]) if proven else bytes(32),
        )

    def standing(self, task_id: int) -> Standing | None:
        """The ruling on a task that waits for the end of its case."""
        row = self._row(self.index.tasks.get(task_id))
        if (found := row["standing"]) is None:
            return None
        return Standing(
            proof_hash=bytes.fromhex(row["proof_sha256"][2:]),
            ruling=Ruling[found["ruling"].upper()],
            amount=IEC.to_units(Decimal(found["amount_iec"])),
            until=found["until"],
            penalty=row["set_aside"],
            after_removal=row["after_removal"],
        )

    def service(self, service_id: int) -> Service:
        row = self._row(self.index.services.get(service_id))
        provider = self.index.services.providers()[row["provider"]]
        work = Work(provider["done"], provider["failed"], provider["day"])
        return Service(
            **{name: row[name] for name in ("provider", "price", "kind", "place", "completed", "rejected")},
            **{name: row[name] for name in ("expired", "bond", "penalty", "max_failures", "auto_accept")},
            task_id=row["task_id"] or 0,
            state=ServiceState[row["state"].upper()],
            reputation=work.reputation(self.now_s),
            failures=provider["failures"],
            proven=provider["earned"] or provider["vouched"],
            namers=Namers[row["namers"].upper()],
            max_voids=row["max_void_percent"],
        )

    def device(self, address: str) -> Device:
        (row,) = [one for one in self.index.rules.devices() if one["address"] == address]
        because = Revocation[row["revoked_because"].upper()] if row["revoked_because"] else Revocation.NONE
        names = ("role", "name", "owner", "registrar")
        times = {"registered_at": row["registered"], "revoked_at": row["revoked"] or 0}
        return Device(**{name: row[name] for name in names}, **times, revocation=because)

    def kind(self, kind: str) -> KindRules:
        row = self._row(self.index.rules.kind(kind))
        return KindRules(**{name: row.get(f"{name}_s", row.get(name)) for name in vars(KindRules(*[0] * 10))})

    def quorum(self, kind: str) -> Quorum:
        row = self._row(self.index.rules.kind(kind))
        seats = row["seats"]
        mask = sum(1 << seat for seat in seats)
        return Quorum(row["votes"], row["panel"], row["rotation_s"], len(seats), mask)

    def terms(self) -> Terms:
        found = self.index.rules.setting("terms")
        bond, penalty = (IEC.to_units(Decimal(found[name])) for name in ("bond_iec", "penalty_iec"))
        return Terms(bond, penalty, found["max_failures"])


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Life, list[Log], Indexed]]:
    """An eventful life, the logs of it, and what the bridge's index makes of them, block after block."""
    # Not on anvil as well: it follows the clock block by block, and refuses what the new time would allow.
    clock = Clock()
    with founded(tmp_path_factory.mktemp("lived"), clock) as organization:
        life = Life(organization, clock, Random(1))
        life.prepare()
        for _ in range(STEPS):
            life.step()
        client, w3 = organization.client, organization.client.w3
        logs, deployment = client.logs(client.deployment.block, w3.eth.block_number), client.deployment
        url = sqlite_url(organization.site.data_dir / "index.sqlite")
        index = Index(url, deployment.chain_id, deployment.genesis_hash, deployment.contracts)
        for block, found in groupby(logs, lambda log: log.block):
            time_s = w3.eth.get_block(block)["timestamp"]
            timed = [TimedLog(log, time_s) for log in found]
            index.apply(timed, Position(block, timed[0].log.block_hash, time_s))
        yield life, logs, Indexed(index, index.position.block_time_s)
        index.close()


Lived = tuple[Life, list[Log], Indexed]


@pytest.mark.long
def test_tasks_and_rulings_are_what_the_contracts_answer(lived: Lived) -> None:
    life, logs, indexed = lived
    client, index = life.organization.client, indexed.index
    rules = {
        log.event.task_id: log.event.rules for log in logs if isinstance(log.event, events.TaskRegistered)
    }
    assert list(rules) == list(range(1, client.tasks.count() + 1))
    for task_id in rules:
        kept, row, found = client.tasks.task(task_id), index.tasks.get(task_id), indexed.task(task_id)
        assert row is not None
        if row["accepted"] is None:  # nobody has the task
            found = replace(found, accepted=kept.accepted)
        assert found == kept, task_id
        standing = client.tasks.standing(task_id)
        assert (indexed.standing(task_id) or replace(standing, until=0)) == standing, task_id
        passed = [(one["provider"], one["gave_up"]) for one in row["passed"]]
        providers = [
            (client.services.service(one).provider, gave_up) for one, gave_up in client.tasks.passed(task_id)
        ]
        assert passed == providers[::-1], task_id
        assert row["rules_sha256"] == "0x" + rules[task_id].hex(), task_id
        ended = row["ended"] is not None
        assert row["paid"] + row["refunded"] == (kept.reward if ended else 0), task_id
    # A life in which nothing happened would prove nothing.
    happened = {type(log.event) for log in logs}
    assert happened >= {events.PassedOn, events.PenaltyReturned, events.ServiceAgreed, events.JudgeRemoved}
    assert happened >= {events.TaskPassed, events.ProviderRests}
    assert happened >= {events.ServiceStoodBack, events.ProviderVouched}


@pytest.mark.long
def test_services_providers_and_bonds_are_what_the_contracts_answer(lived: Lived) -> None:
    life, _, indexed = lived
    client, index = life.organization.client, indexed.index
    services = {i: client.services.service(i) for i in range(1, client.services.count() + 1)}
    for i, service in services.items():
        found = indexed.service(i)
        if not (service.state is not ServiceState.RETIRED or service.task_id or service.bond):
            found = replace(found, proven=service.proven)  # as it was when the service ended
        assert found == service, i
    assert any(service.completed + service.rejected + service.expired for service in services.values())
    assert all(service.reputation != 32 for service in services.values())

    tasks = [client.tasks.task(i) for i in range(1, client.tasks.count() + 1)]
    ruled = [(i, task) for i, task in enumerate(tasks, 1) if task.state is TaskState.RULED]
    for i in services:
        row = index.services.get(i)
        assert row is not None
        waits = sum(client.tasks.standing(one).penalty for one, task in ruled if task.service_id == i)
        assert row["set_aside"] == waits, i

    robot, operator = life.organization.robot.address, life.organization.operator.address
    provider, proven = index.services.providers()[robot], client.services.is_proven(robot)
    assert (provider["earned"] or provider["vouched"]) == proven
    rests_until = provider["rests_until"] or 0
    until = (provider["asleep_until"] or 0) if proven else rests_until * (rests_until > indexed.now_s)
    assert view(client, "Providers", "asleepUntil", robot) == until
    assert view(client, "Providers", "lockedUntil", robot) == (provider["bond_locked_until"] or 0)
    assert index.services.payouts() == {operator: robot}
    assert {one: view(client, "Providers", "payoutOf", one) for one in (robot, operator)} == (
        {robot: robot, operator: robot}
    )
    suspended = {one for one, row in index.services.providers().items() if row["suspended"]}
    assert suspended == {JUDGES[0]}
    for one in (DEVICE, JUDGES[0], robot):
        assert view(client, "Organization", "isSuspended", one) == (one in suspended)

    rewards = sum(task.reward for task in tasks if task.state in (TaskState.OPEN, *LIVE))
    bonds = sum(service.bond for service in services.values())
    bonds += sum(client.tasks.standing(one).penalty for one, _ in ruled)
    assert index.money.balances()[client.task_manager] == rewards + bonds + sum(index.money.owed().values())


@pytest.mark.long
def test_the_organization_is_what_the_contracts_answer(lived: Lived) -> None:
    life, _, indexed = lived
    client, index = life.organization.client, indexed.index
    seated = {row["key"]: (row["owner"], row["seat"]) for row in index.rules.judges()}
    seats = {key: client.judges.seat(key) for key in JUDGES}
    assert seated == {key: (seat.owner, seat.number) for key, seat in seats.items() if seat}
    assert seated.keys() == {JUDGES[0], JUDGES[2]} and client.judges.quorum(KIND) == indexed.quorum(KIND)
    assert client.devices.device(DEVICE) == indexed.device(DEVICE)
    (root,), _ = index.rules.roots(None, Page(10))
    assert (root["device"], root["day"], root["root"]) == (
        DEVICE,
        0,
        "0x" + view(client, "DeviceRegistry", "rootOf", DEVICE, 0).hex(),
    )
    for row in index.rules.all_kinds():
        kind = row["kind"]
        assert client.rules.kind(kind) == indexed.kind(kind)
        assert client.judges.numbered(row["number"]) == index.rules.numbers()[row["number"]]["judge"]
        assert ["0x" + one.hex() for one in client.rules.current_rules(kind)] == index.rules.of(kind)
    assert client.rules.terms() == indexed.terms()
    assert view(client, "Organization", "membersOnly") == index.rules.setting("members_only")
    assert (client.rules.policy(), client.judges.auditors()) == (
        index.rules.setting("policy"),
        index.rules.setting("auditors"),
    )
    for role in (Role.OPERATOR, Role.TREASURER):
        kept, budget = client.rules.budget(role), index.rules.setting(f"budget {role}")
        assert (IEC.text(kept.amount), kept.period) == (budget["amount_iec"], budget["period_s"])
    assert (
        index.rules.setting("paused_until_s") == 0
        and GENESIS_S <= view(client, "Organization", "pausedUntil") <= indexed.now_s
    )
    roles = {(role, account) for role, accounts in index.rules.roles().items() for account in accounts}
    accounts = {account for _, account in roles} | set(index.money.balances())
    held = {
        (role.value, account) for role in Role for account in accounts if client.rules.has_role(role, account)
    }
    assert held == {(role, account) for role, account in roles if role in list(Role)}
    for account in accounts:
        assert client.token.balance(account) == index.money.balance(account), account
