"""An organization moves to new contracts, and nobody loses anything by it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount
from eth_utils import keccak
from web3.types import RPCEndpoint

from deploy import contracts, migration
from deploy.founding import OtherToken
from deploy.migration import (
    Founded,
    JudgeUnseated,
    JustMoved,
    KeyRevoked,
    MembersDecide,
    NotAdministrator,
    SiteIsUp,
    TasksRunOn,
    cancel,
    migrate,
)
from deploy.waiting import DelayRuns
from deploy.waiting import proposed as waiting_for
from rodeo import keystores, wallets
from rodeo.chain import transactions
from rodeo.chain.abi import KindRules, Review, Revocation, ServiceState, Silence, TaskState, Terms, Verdict
from rodeo.chain.client import ChainClient, connect
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.chain.errors import ChainUnavailable, ContractReverted, NotDeployed
from rodeo.chain.registry import PROXY
from rodeo.chain.types import Policy, Role
from rodeo.config import BRIDGE, BudgetConfig, GovernanceConfig, JudgeConfig, Site, TermsConfig, TokenConfig
from rodeo.currency import IEC
from rodeo.instance import lock_instance
from rodeo.kinds import kinds_of
from tests.support.organization import (
    CHAIN_ID,
    GENESIS_S,
    KIND,
    PROOF,
    REPORT,
    Organization,
    founded,
    resumed,
    running_chain,
)

BANNED = "0x" + "Ba" * 20


class Lab(Organization):
    """A laboratory that has worked: it has members, a robot at work, and rules that were changed on chain."""

    stranger: LocalAccount = Account.from_key(keccak(text="a stranger"))

    def __init__(self, site: Site) -> None:
        super().__init__(site)
        self.said: list[str] = []

    def worked(self) -> None:
        calls = self.client.organization_calls
        self.client.w3.eth.send_transaction(
            {
                "from": self.client.w3.eth.accounts[0],
                "to": self.stranger.address,
                "value": 10**18,  # type: ignore[typeddict-item]
            }
        )
        for call in (
            calls.set_terms(Terms(IEC.to_units(Decimal(50)), IEC.to_units(Decimal(20)), 2)),
            calls.set_members_only(True),
            calls.admit(self.robot.address),
            calls.admit(self.stranger.address),
            calls.set_policy(Policy.LOWEST_PRICE),
            calls.grant_role(Role.AUDITOR, self.stranger.address),
            calls.set_budget(Role.OPERATOR, IEC.to_units(Decimal(500)), 3600),
            # Less than there is in the treasury.
            calls.set_budget(Role.TREASURER, IEC.to_units(Decimal(10)), 7200),
            calls.suspend_provider(BANNED),
            calls.set_min_window(KIND, 300),
            calls.set_verdict_windows(KIND, 1200, 86_400),
            calls.set_audit(KIND, 3600, Silence.EXECUTOR),
        ):
            self.send(self.operator, call)
        offer = self.client.calls.register_service(KIND, IEC.to_units(Decimal(80)), 2**95, True, "")
        self.send(self.robot, offer)
        self.post()

    def judge(self) -> None:
        """Task 1 is proven and accepted."""
        task = self.client.task(1)
        self.send(self.robot, self.client.calls.submit_proof(1, task.attempt, PROOF, "file:///proof"))
        verdict = self.client.calls.post_verdict(
            1, task.attempt, PROOF, Verdict.ACCEPTED, task.price, REPORT, "file:///report", "right"
        )
        self.send(self.oracle, verdict)

    def opened(self) -> None:
        """Its administrator waits. The robot works on task 1, and service 2 is a stranger's."""
        bond = IEC.to_units(Decimal(20))
        self.client.w3.eth.send_transaction(
            {
                "from": self.client.w3.eth.accounts[0],
                "to": self.stranger.address,
                "value": 10**18,  # type: ignore[typeddict-item]
            }
        )
        self.send(self.robot, self.client.calls.transfer(self.stranger.address, bond))
        self.client.send(self.stranger, self.client.calls.approve(self.client.task_manager, bond))
        for account, price in ((self.robot, 80), (self.stranger, 5000)):
            offer = self.client.calls.register_service(KIND, IEC.to_units(Decimal(price)), 2**95, True, "")
            self.client.send(account, offer)
        self.post()

    def migrate(self) -> Deployment:
        return migrate(self.site, connect(self.site.chain.url), self.said.append)

    def record(self) -> Deployment:
        return Deployment.load(self.site.data_dir, CHAIN_ID)

    def new(self) -> ChainClient:
        return ChainClient(self.site.chain.url, self.record())


@pytest.fixture(scope="module")
def worked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("worked")
    with founded(folder) as organization:
        Lab(organization.site).worked()
    return folder


@pytest.fixture
def lab(worked: Path, tmp_path: Path) -> Iterator[Lab]:
    with resumed(worked, tmp_path) as site:
        yield Lab(site)


def test_while_a_task_runs_on_nothing_moves_and_no_other_is_posted(lab: Lab) -> None:
    before, balance = lab.record(), lab.client.balance(lab.client.organization)
    with pytest.raises(TasksRunOn) as waiting:
        lab.migrate()
    assert waiting.value.details["tasks"] == [1]
    assert waiting.value.details["last_deadline_s"] == lab.client.task(1).deadline
    assert lab.record() == before and lab.client.balance(lab.client.organization) == balance
    with pytest.raises(ContractReverted) as refused:
        lab.post()
    assert refused.value.name == "UnknownKind"
    # Starting the site meanwhile does not allow the kinds again.
    lab.deploy()
    assert not lab.client.is_kind_allowed(KIND)
    lab.judge()
    assert lab.client.task(1).state is TaskState.SETTLED


def test_tasks_that_nobody_does_hold_up_nobody_and_cost_nobody_anything(lab: Lab) -> None:
    """Else whoever posts one would keep the organization where it is."""
    old, amount = lab.client, IEC.to_units(Decimal(1))
    lab.judge()
    lab.send(lab.robot, old.calls.transfer(lab.stranger.address, amount))
    old.send(lab.stranger, old.calls.approve(old.task_manager, amount))
    old.send(lab.stranger, old.calls.register_task(lab.request(1)))
    lab.post(1)
    treasury = old.balance(old.organization)
    lab.migrate()
    assert old.task(2).state is TaskState.OPEN and old.task(3).state is TaskState.CANCELLED
    assert lab.new().balance(lab.new().organization) == treasury + amount
    old.send(lab.stranger, old.calls.cancel_task(2))
    assert old.balance(lab.stranger.address) == amount and old.balance(old.task_manager) == 0


def test_everything_moves_once_the_tasks_have_ended(lab: Lab) -> None:
    old = lab.client
    with pytest.raises(TasksRunOn):
        lab.migrate()
    lab.judge()
    treasury, robot = old.balance(old.organization), old.balance(lab.robot.address)
    bond = IEC.to_units(Decimal(50))
    lab.migrate()
    new = lab.new()
    assert new.organization != old.organization
    assert new.deployment.follows == old.organization
    # The money is where it was, and still worth something.
    assert new.deployment.address("IECoin") == old.deployment.address("IECoin")
    assert (old.balance(old.organization), new.balance(new.organization)) == (0, treasury)
    assert new.balance(lab.robot.address) == robot + bond
    assert old.balance(old.task_manager) == 0
    # Rules of the site file, and those of the chain.
    assert all(new.is_kind_allowed(kind) for kind in kinds_of(lab.site))
    assert new.terms() == old.terms() and new.members_only()
    assert new.policy() == new.deployment.address(Policy.LOWEST_PRICE)
    assert new.budget(Role.OPERATOR).amount == IEC.to_units(Decimal(500))
    assert _windows(old.kind(KIND)) == (300, 1200, 86_400, 3600, Silence.EXECUTOR)
    # Windows move as they were set. Silence pays the executor only where the site file says so.
    assert _windows(new.kind(KIND)) == (300, 1200, 86_400, 3600, Silence.CREATOR)
    assert new.is_suspended(BANNED) and not new.is_suspended(lab.robot.address)
    assert new.is_member(lab.robot.address) and new.is_member(lab.stranger.address)
    assert new.has_role(Role.AUDITOR, lab.stranger.address)
    assert new.has_role(Role.ORACLE, lab.oracle.address)
    assert not new.has_role(Role.ORACLE, old.task_manager)
    # What the robot is known for.
    assert new.work(lab.robot.address) == old.work(lab.robot.address) == (100 * 10**9, 0)
    # The old contracts stay readable, and their record is kept.
    assert old.task(1).state is TaskState.SETTLED
    assert old.service(1).state is ServiceState.RETIRED
    kept = lab.site.data_dir / "deployments" / f"{CHAIN_ID}-{old.organization}.json"
    assert Deployment.model_validate_json(kept.read_text()).is_same(old.deployment)
    # And it works: the robot offers again and is matched.
    new.send(lab.robot, new.calls.register_service(KIND, IEC.to_units(Decimal(80)), 2**95, True, ""))
    new.send(lab.operator, new.organization_calls.register_task(lab.request()))
    assert new.task(1).state is TaskState.ASSIGNED
    # Preparing the site again changes nothing, and its token is not taken for another one.
    block = new.w3.eth.block_number
    lab.deploy()
    assert new.w3.eth.block_number == block and lab.record().is_same(new.deployment)


def _windows(rules: KindRules) -> tuple[object, ...]:
    verdict = rules.min_verdict_window, rules.max_verdict_window
    return rules.min_window, *verdict, rules.audit_window, rules.silence


@pytest.mark.long
def test_many_members_move_in_as_many_transactions_as_they_take(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them in one could take more gas than a transaction, or a block, may have."""
    together: list[int] = []
    at_once = contracts.at_once

    def counted(client: ChainClient, calls: Sequence[Call]) -> Sequence[Call]:
        together.append(len(calls))
        return at_once(client, calls)

    monkeypatch.setattr(contracts, "at_once", counted)
    monkeypatch.setattr(migration, "_MOST_TOGETHER", 4)
    members = [Account.create().address for _ in range(9)]
    admissions = [lab.client.organization_calls.admit(one) for one in members]
    for call in at_once(lab.client, admissions):
        lab.send(lab.operator, call)
    lab.judge()
    # What the site file says is told in larger steps.
    monkeypatch.setattr(contracts, "_MOST_TOGETHER", 4)
    lab.migrate()
    assert max(together) == 4
    assert all(lab.new().is_member(one) for one in members)


@pytest.fixture
def judged(tmp_path: Path) -> Iterator[Lab]:
    """Three oracles judge, of which two have to agree."""
    oracles = [JudgeConfig(name=name) for name in ("anna", "bert", "carl")]
    with founded(tmp_path, oracles=oracles) as organization:
        yield Lab(organization.site)


@pytest.mark.long
def test_an_organization_does_not_move_with_a_key_that_its_judge_has_no_more(judged: Lab) -> None:
    """Somebody else may have it."""
    old = judged.client
    key, other = keystores.address(judged.site, "bert-device"), Account.create().address
    judged.send(judged.operator, old.calls.change_key(key, other))
    with pytest.raises(KeyRevoked, match="the key of bert was revoked"):
        judged.migrate()
    assert old.is_kind_allowed(KIND)
    judged.send(judged.operator, old.calls.change_key(other, key))  # it was found again
    judged.migrate()
    assert judged.new().judge(key) is not None


def test_a_judge_that_takes_a_revoked_devices_key_makes_it_no_good_one(judged: Lab) -> None:
    """Any judge may change to any key, also one who is about to leave."""
    old = judged.client
    bert, device = (keystores.address(judged.site, f"{name}-device") for name in ("bert", "itrash"))
    judged.send(judged.operator, old.organization_calls.revoke_device(device, Revocation.COMPROMISED))
    judged.send(judged.operator, old.calls.change_key(bert, device))
    others = [one for one in judged.site.oracles if one.name != "bert"]
    judged.site = judged.site.model_copy(update={"oracles": others})
    with pytest.raises(KeyRevoked, match="the key of itrash was revoked"):
        judged.migrate()


@pytest.mark.long
def test_a_judge_that_was_unseated_for_one_kind_does_not_judge_it_again(judged: Lab) -> None:
    old = judged.client
    now = old.quorum(KIND)
    judged.send(judged.operator, old.calls.set_quorum(KIND, 2, 2, now.rotation, now.judges & ~(1 << 1)))
    with pytest.raises(JudgeUnseated, match="bert does not judge") as refused:
        judged.migrate()
    assert refused.value.details["kind"] == KIND
    judged.send(judged.operator, old.calls.set_quorum(KIND, 2, 3, now.rotation, now.judges))
    judged.migrate()
    assert judged.new().quorum(KIND).count == 3


def test_a_judge_that_was_unseated_does_not_judge_again_in_the_new_organization(judged: Lab) -> None:
    old = judged.client
    for kind in kinds_of(judged.site):
        if (now := old.quorum(kind)).votes:
            told = old.calls.set_quorum(kind, 2, 2, now.rotation, now.judges & ~(1 << 1))
            judged.send(judged.operator, told)
    with pytest.raises(JudgeUnseated, match="bert does not judge"):
        judged.migrate()
    assert old.is_kind_allowed(KIND)
    others = [one for one in judged.site.oracles if one.name != "bert"]
    judged.site = judged.site.model_copy(update={"oracles": others})
    judged.migrate()
    assert judged.new().quorum(KIND).count == 2


@pytest.mark.long
def test_nobody_who_alone_judged_does_so_where_several_oracles_have_to_agree(lab: Lab) -> None:
    lab.send(lab.operator, lab.client.organization_calls.grant_role(Role.ORACLE, lab.stranger.address))
    lab.judge()
    judged = lab.oracle.address, lab.stranger.address
    # The key of the one that judged is not at hand any more.
    (lab.site.data_dir / "keys" / "oracle.json").unlink()
    oracles = [JudgeConfig(name=name) for name in ("anna", "bert", "carl")]
    lab.site = lab.site.model_copy(update={"oracles": oracles})
    wallets.ensure_wallets(lab.site)
    lab.migrate()
    new = lab.new()
    assert new.has_role(Role.ORACLE, new.committee) and new.quorum(KIND).votes == 2
    assert not any(new.has_role(Role.ORACLE, one) for one in judged)


def test_what_people_judge_is_accepted_and_judged_by_people_in_the_new_organization(lab: Lab) -> None:
    calls = lab.client.organization_calls
    rules = [bytes([number]) * 32 for number in (1, 2)]
    for call in (
        # A kind that the site file does not list, one that it lets the oracle judge, and one that was ended.
        *(calls.allow_kind("window_cleaning", Review.AUDITOR, one) for one in rules),
        calls.allow_kind("battery_charging", Review.AUDITOR, bytes(32)),
        calls.allow_kind("singing", Review.AUDITOR, bytes(32)),
        calls.disallow_kind("singing"),
    ):
        lab.send(lab.operator, call)
    with pytest.raises(TasksRunOn):
        lab.migrate()
    assert not lab.client.is_kind_allowed("window_cleaning")
    lab.judge()
    lab.migrate()
    new = lab.new()
    for kind, current in (("window_cleaning", rules), ("battery_charging", [])):
        assert new.is_kind_allowed(kind) and new.kind(kind).review is Review.AUDITOR
        assert new.current_rules(kind) == current
    assert not new.is_kind_allowed("singing")
    assert new.work(lab.robot.address) == lab.client.work(lab.robot.address)
    assert list(contracts.left_folder(lab.site).glob("deployments/*")) == []


def test_an_organization_does_not_move_with_a_key_that_it_revoked(lab: Lab) -> None:
    """The new one knows of no revocation, and would trust it again."""
    lab.judge()
    device = keystores.address(lab.site, "itrash-device")
    lab.send(lab.operator, lab.client.organization_calls.revoke_device(device, Revocation.COMPROMISED))
    before = lab.record()
    with pytest.raises(KeyRevoked, match="the key of itrash was revoked"):
        lab.migrate()
    assert lab.client.is_kind_allowed(KIND) and lab.record() == before
    (lab.site.data_dir / "keys" / "itrash-device.json").unlink()
    wallets.ensure_wallets(lab.site)
    # A keystore that cannot be read keeps nobody else waiting: its key is not registered.
    (lab.site.data_dir / "keys" / "mocap-device.json").write_text("{")
    lab.migrate()
    assert lab.new().device(keystores.address(lab.site, "itrash-device")).revoked_at == 0


@pytest.mark.long
def test_what_the_token_once_refused_to_the_treasury_moves_with_it(tmp_path: Path) -> None:
    with running_chain("anvil", tmp_path) as site:
        lab = Lab(site)
        lab.deploy()
        old, provider = lab.client, lab.client.w3.provider
        offer = old.calls.register_service(KIND, IEC.to_units(Decimal(80)), 2**95, True, "")
        lab.send(lab.robot, offer)
        lab.post()
        token = old.deployment.address("IECoin")
        code = old.w3.eth.get_code(token).to_0x_hex()
        # It answers everything with false.
        provider.make_request(RPCEndpoint("anvil_setCode"), [token, "0x600060005260206000f3"])
        lab.judge()
        provider.make_request(RPCEndpoint("anvil_setCode"), [token, code])
        refused, treasury = IEC.to_units(Decimal(20)), old.balance(old.organization)
        assert old.pending_payments(old.organization) == refused
        lab.migrate()
        new = lab.new()
        assert new.balance(new.organization) == treasury + refused
        assert old.pending_payments(old.organization) == 0


@pytest.mark.long
def test_an_interrupted_migration_goes_on_and_nothing_happens_twice(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = lab.client
    lab.judge()
    treasury, send = old.balance(old.organization), transactions.send
    failures = 0
    for _ in range(60):
        count = 0

        def fail_once(*args: Any, **options: Any) -> Any:
            nonlocal count
            count += 1
            if count == 2:
                raise ChainUnavailable("gone")
            return send(*args, **options)

        monkeypatch.setattr(transactions, "send", fail_once)
        try:
            lab.migrate()
        except ChainUnavailable:
            failures += 1
            continue
        break
    else:
        raise AssertionError("it does not come to an end")
    assert failures > 5
    new = lab.new()
    assert (old.balance(old.organization), new.balance(new.organization)) == (0, treasury)
    assert new.work(lab.robot.address) == old.work(lab.robot.address)
    assert new.is_member(lab.stranger.address)
    for budget in (old.budget(Role.TREASURER), new.budget(Role.TREASURER)):
        assert (budget.amount, budget.period) == (IEC.to_units(Decimal(10)), 7200)
    assert not (lab.site.data_dir / "deployments" / "left" / f"{CHAIN_ID}.json").exists()


@pytest.mark.long
def test_run_once_too_often_it_does_not_move_again_and_later_it_does(lab: Lab) -> None:
    lab.judge()
    first = lab.migrate()
    with pytest.raises(JustMoved):
        lab.migrate()
    assert lab.new().is_kind_allowed(KIND)
    new = lab.new()
    new.send(lab.robot, new.calls.register_service(KIND, IEC.to_units(Decimal(80)), 2**95, True, ""))
    new.send(lab.operator, new.organization_calls.register_task(lab.request()))
    with pytest.raises(TasksRunOn):
        lab.migrate()
    task = new.task(1)
    new.send(lab.robot, new.calls.submit_proof(1, task.attempt, PROOF, "file:///proof"))
    verdict = new.calls.post_verdict(1, 1, PROOF, Verdict.ACCEPTED, task.price, REPORT, "r", "right")
    new.send(lab.oracle, verdict)
    second = lab.migrate()
    assert second.follows == first.contracts["Organization"]
    assert len({*first.contracts.values()} & {*second.contracts.values()}) == 1  # the token
    assert lab.new().work(lab.robot.address)[0] == 200 * 10**9


BOND = IEC.to_units(Decimal(50))


@pytest.fixture
def waiting(lab: Lab) -> Lab:
    """Task 2 waits: service 2, the stranger's, costs too much for it."""
    old = lab.client
    lab.judge()
    lab.send(lab.robot, old.calls.transfer(lab.stranger.address, BOND))
    old.send(lab.stranger, old.calls.approve(old.task_manager, BOND))
    old.send(lab.stranger, old.calls.register_service(KIND, IEC.to_units(Decimal(5)), 2**95, True, ""))
    lab.send(lab.robot, old.calls.register_task(lab.request(1)))
    return lab


@pytest.mark.long
def test_a_task_that_waits_is_not_taken_where_nobody_judges_any_more(waiting: Lab) -> None:
    """Its provider would prove nothing, and be paid by silence."""
    old, stranger = waiting.client, waiting.stranger
    waiting.migrate()
    assert any("service 2 of somebody else is suspended" in text for text in waiting.said)
    for state in (ServiceState.ACTIVE, ServiceState.PAUSED):
        with pytest.raises(ContractReverted) as refused:
            old.send(stranger, old.calls.update_service(2, 0, state))
        assert refused.value.name == "ServiceIsSuspended"
    old.send(stranger, old.calls.match_task(2))
    assert old.task(2).state is TaskState.OPEN
    # The provider is no worse off, here or there.
    old.send(stranger, old.calls.update_service(2, 0, ServiceState.RETIRED))
    assert old.balance(stranger.address) == BOND
    assert not waiting.new().is_suspended(stranger.address)


@pytest.mark.long
def test_a_task_that_is_taken_at_the_last_moment_ends_first(
    waiting: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, stranger = waiting.client, waiting.stranger

    def taken(_folder: Path) -> None:
        if old.service(2).price:
            old.send(stranger, old.calls.update_service(2, 0, ServiceState.ACTIVE))

    monkeypatch.setattr(migration, "lock_holder", taken)
    with pytest.raises(TasksRunOn) as running:
        waiting.migrate()
    assert running.value.details["tasks"] == [2]
    assert waiting.record().is_same(old.deployment)
    assert old.service(2).state is ServiceState.SUSPENDED
    old.send(stranger, old.calls.abandon_task(2, 1))
    waiting.migrate()
    assert waiting.new().deployment.follows == old.organization
    assert old.task(2).state is TaskState.OPEN
    assert sum("service 2 of somebody else is suspended" in text for text in waiting.said) == 1


@pytest.mark.long
def test_an_organization_goes_on_with_the_token_that_it_has(lab: Lab) -> None:
    lab.judge()
    other = TokenConfig(address=lab.client.deployment.address("Organization"), decimals=18)
    economy = lab.site.economy.model_copy(update={"token": other})
    with pytest.raises(OtherToken) as refused:
        migrate(lab.site.model_copy(update={"economy": economy}), lab.client.w3, lab.said.append)
    assert refused.value.details["found"] == lab.client.deployment.address("IECoin")
    lab.migrate()


@pytest.mark.long
def test_until_another_one_is_founded_the_organization_may_stay(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(NotDeployed):
        cancel(lab.site, lab.said.append)
    for kind in ("window_cleaning", "battery_charging"):
        lab.send(lab.operator, lab.client.organization_calls.allow_kind(kind, Review.AUDITOR, bytes(32)))
    with pytest.raises(TasksRunOn):
        lab.migrate()
    assert not lab.client.is_kind_allowed("window_cleaning")
    cancel(lab.site, lab.said.append)
    lab.deploy()
    assert lab.client.is_kind_allowed(KIND)
    for kind in ("window_cleaning", "battery_charging"):
        rules = lab.client.kind(kind)
        assert (rules.allowed, rules.review) == (True, Review.AUDITOR)
    lab.judge()
    send = transactions.send

    def fail_to_tell(w3: Any, account: Any, **options: Any) -> Any:
        if options.get("to") not in (None, PROXY, lab.record().registry, lab.client.organization):
            raise ChainUnavailable("gone")
        return send(w3, account, **options)

    services = wallets.load(lab.site, "panther1")
    lab.send(services, lab.client.calls.update_service(1, 0, ServiceState.RETIRED))
    with monkeypatch.context() as broken, pytest.raises(ChainUnavailable):
        broken.setattr(transactions, "send", fail_to_tell)
        lab.migrate()
    with pytest.raises(Founded):
        cancel(lab.site, lab.said.append)
    lab.migrate()


def test_only_the_administrator_moves_an_organization(lab: Lab, tmp_path: Path) -> None:
    other = lab.site.model_copy(update={"data_dir": tmp_path / "other"})
    wallets.ensure_wallets(other)
    lab.record().save(other.data_dir)
    with pytest.raises(NotAdministrator) as refused:
        migrate(other, lab.client.w3, lab.said.append)
    assert refused.value.details["administrator"] == lab.operator.address
    assert lab.client.is_kind_allowed(KIND)
    with pytest.raises(NotDeployed):
        cancel(other, lab.said.append)


@pytest.mark.long
def test_the_bridge_must_not_run_when_the_organization_moves(lab: Lab) -> None:
    lab.judge()
    folder = lab.site.data_dir / BRIDGE
    folder.mkdir(parents=True, exist_ok=True)
    lock = lock_instance(folder)
    with pytest.raises(SiteIsUp):
        lab.migrate()
    os.close(lock)
    assert lab.record().follows is None
    lab.migrate()


@pytest.mark.long
def test_the_new_organization_may_have_a_delay(lab: Lab) -> None:
    lab.judge()
    governance = lab.site.governance.model_copy(update={"delay_s": 3600})
    lab.site = lab.site.model_copy(update={"governance": governance})
    lab.migrate()
    new = lab.new()
    assert new.administrator() == new.deployment.address("OrganizationTimelock")
    assert new.decision_delay_s() == 3600
    # What was told the old one by its key, its founder had the timelock tell the new one.
    assert new.terms() == lab.client.terms() and new.is_suspended(BANNED) and new.members_only()
    assert new.work(lab.robot.address) == lab.client.work(lab.robot.address)
    assert new.balance(new.organization) > 0 == lab.client.balance(lab.client.organization)
    with pytest.raises(JustMoved):
        lab.migrate()
    assert new.is_kind_allowed(KIND)
    assert not Deployment.path(contracts.left_folder(lab.site), CHAIN_ID).exists()


DELAY_S = 1800
"""Less than the task's window."""
NO_TERMS = TermsConfig(bond_iec=Decimal(0), penalty_iec=Decimal(0), max_failures=0)
PATIENCE = GovernanceConfig(
    delay_s=DELAY_S, budgets={"treasurer": BudgetConfig(iec=Decimal(200))}, terms=NO_TERMS
)


class Patient(NamedTuple):
    """A laboratory whose administrator waits, and its time."""

    lab: Lab
    clock: list[int]

    def pass_delay(self) -> None:
        self.clock[0] += DELAY_S + 1

    def waits(self) -> str:
        """The text of what is proposed, for which a run waits."""
        with pytest.raises(DelayRuns) as caught:
            self.lab.migrate()
        assert caught.value.details["ready_s"] > self.clock[0]
        return str(caught.value.details["proposed"])


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("opened")
    with founded(folder, governance=PATIENCE) as organization:
        Lab(organization.site).opened()
    return folder


@pytest.fixture
def patient(opened: Path, tmp_path: Path) -> Iterator[Patient]:
    clock = [GENESIS_S]
    with resumed(opened, tmp_path, lambda: clock[0], governance=PATIENCE) as site:
        yield Patient(Lab(site), clock)


@pytest.mark.long
def test_an_administrator_who_waits_moves_the_organization_by_what_it_proposes(patient: Patient) -> None:
    lab, old = patient.lab, patient.lab.client
    assert "no new tasks" in patient.waits()
    kinds = len(kinds_of(lab.site))
    # Whether the second service is suspended is decided at the same time, and done when no task runs.
    assert old.is_kind_allowed(KIND) and len(old.pending_operations()) == kinds + 1
    assert "no new tasks" in patient.waits() and len(old.pending_operations()) == kinds + 1
    patient.pass_delay()
    with pytest.raises(TasksRunOn):
        lab.migrate()
    assert not old.is_kind_allowed(KIND) and old.service(2).state is ServiceState.ACTIVE
    lab.judge()
    treasury, budget = old.balance(old.organization), old.budget(Role.TREASURER)
    assert treasury > budget.amount > 0
    assert "treasury" in patient.waits()
    assert [old.service(number).state for number in (1, 2)] == [ServiceState.RETIRED, ServiceState.SUSPENDED]
    assert lab.record().is_same(old.deployment)
    lab.send(lab.robot, old.calls.transfer(old.organization, 1))  # a gift holds up nothing
    assert "treasury" in patient.waits() and len(old.pending_operations()) == 1
    patient.pass_delay()
    lab.migrate()
    new = lab.new()
    assert new.deployment.follows == old.organization and new.decision_delay_s() == DELAY_S
    assert (old.balance(old.organization), new.balance(new.organization)) == (0, treasury + 1)
    assert new.work(lab.robot.address) == old.work(lab.robot.address) == (80 * 10**9, 0)
    assert old.pending_operations() == {}
    assert not old.has_role(Role.TREASURER, old.deployment.address("OrganizationTimelock"))
    for one in (old, new):
        there = one.budget(Role.TREASURER)
        assert (there.amount, there.period) == (budget.amount, budget.period)


@pytest.mark.long
def test_what_is_not_needed_any_more_is_withdrawn(patient: Patient) -> None:
    lab, old = patient.lab, patient.lab.client
    patient.waits()
    old.send(lab.stranger, old.calls.update_service(2, 0, ServiceState.RETIRED))
    patient.waits()
    assert len(old.pending_operations()) == len(kinds_of(lab.site))
    cancel(lab.site, lab.said.append)
    assert old.pending_operations() == {} and "propose kind" in lab.said[-1]
    assert old.is_kind_allowed(KIND) and lab.record().is_same(old.deployment)


@pytest.mark.long
def test_nobody_executes_later_what_was_proposed_before_the_organization_moved(patient: Patient) -> None:
    """Its provider would take a task that waits, prove nothing, and be paid by silence."""
    lab, old = patient.lab, patient.lab.client
    patient.waits()
    reinstated = [old.organization_calls.reinstate_service(2)]
    lab.send(lab.operator, old.governance_calls.schedule(reinstated, "again", bytes(32), DELAY_S))
    (proposed,) = waiting_for(old, "again").items()
    patient.pass_delay()
    with pytest.raises(TasksRunOn):
        lab.migrate()
    assert waiting_for(old, "again")  # as long as tasks run on it may be executed
    lab.judge()
    patient.waits()
    assert old.service(2).state is ServiceState.SUSPENDED and not waiting_for(old, "again")
    with pytest.raises(ContractReverted):
        old.send(lab.stranger, old.governance_calls.perform(proposed[1], proposed[0]))
    patient.pass_delay()
    lab.migrate()
    assert lab.new().deployment.follows == old.organization


@pytest.mark.long
def test_what_is_executed_while_others_are_withdrawn_is_seen(
    patient: Patient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kind that the organization never had: tasks of it would be posted where nobody judges any more."""
    lab, old = patient.lab, patient.lab.client
    patient.waits()
    allowed = [old.organization_calls.allow_kind("washing", Review.AUDITOR, bytes(32))]
    lab.send(lab.operator, old.governance_calls.schedule(allowed, "washing", bytes(32), DELAY_S))
    (proposed,) = waiting_for(old, "washing").items()
    patient.pass_delay()
    with pytest.raises(TasksRunOn):
        lab.migrate()
    lab.judge()
    withdraw_others = migration._withdraw_others

    def late(*args: Any) -> None:
        old.send(lab.stranger, old.governance_calls.perform(proposed[1], proposed[0]))
        withdraw_others(*args)

    monkeypatch.setattr(migration, "_withdraw_others", late)
    assert "no new tasks" in patient.waits()
    assert old.is_kind_allowed("washing") and lab.record().is_same(old.deployment)
    monkeypatch.undo()
    patient.pass_delay()
    patient.waits()
    assert not old.is_kind_allowed("washing")


@pytest.mark.long
def test_only_who_proposes_moves_an_organization_whose_administrator_waits(
    patient: Patient, tmp_path: Path
) -> None:
    other = patient.lab.site.model_copy(update={"data_dir": tmp_path / "other"})
    wallets.ensure_wallets(other)
    patient.lab.record().save(other.data_dir)
    with pytest.raises(NotAdministrator):
        migrate(other, patient.lab.client.w3, patient.lab.said.append)
    assert patient.lab.client.pending_operations() == {}


@pytest.mark.long
def test_where_members_decide_nobody_moves_the_organization(tmp_path: Path) -> None:
    governance = GovernanceConfig(kind="vote", delay_s=60, members=["panther1"])
    with founded(tmp_path, governance=governance) as organization:
        site = organization.site
        with pytest.raises(MembersDecide):
            migrate(site, connect(site.chain.url), lambda _text: None)
        assert all(Organization(site).client.is_kind_allowed(kind) for kind in kinds_of(site))
        assert not Deployment.path(contracts.left_folder(site), CHAIN_ID).exists()
