"""The deployment record, and deploying again."""

from __future__ import annotations

import json
import subprocess
import threading
from decimal import Decimal
from pathlib import Path

import pytest
from eth_utils import to_bytes

from deploy import contracts
from deploy.contracts import WithoutGasMoney
from rodeo.chain import artifacts
from rodeo.chain.client import ChainClient, connect
from rodeo.chain.contracts.abi import Instance, Terms
from rodeo.chain.contracts.events import Transfer
from rodeo.chain.contracts.types import Role, kind_to_bytes32
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.chain.governance import batch_id
from rodeo.chain.node.errors import ChainError, ContractReverted, DeploymentMismatch, NotDeployed
from rodeo.chain.proposals import WHY, Operation
from rodeo.judging import votes
from rodeo.kinds import kinds_of
from rodeo.money.currency import IEC
from rodeo.signing import keys, keystores, wallets
from rodeo.site.sections import AppealConfig, DisputesConfig, GovernanceConfig, JudgeConfig, ParticipantConfig
from tests.support.organization import CHAIN_ID, GENESIS_S, Organization, running_chain
from tests.support.views import view

pytestmark = pytest.mark.long

CONTRACTS = (*artifacts.CONTRACTS, "DisputeJudge", *artifacts.GOVERNANCE, artifacts.REGISTRY)


def judges_of(organization: Organization) -> dict[str, str]:
    """What the chain says: kind -> the contract that judges it."""
    client = organization.client
    names = {address: name for name, address in client.deployment.contracts.items()}
    numbers = {kind: client.rules.kind(kind).number for kind in kinds_of(organization.site)}
    return {kind: names[client.judges.numbered(number)] for kind, number in numbers.items()}


def handover_delay_s(client: ChainClient) -> int:
    """Between the announcement of another administrator and the handover."""
    return int(view(client, "Organization", "defaultAdminDelay"))


def test_the_organization_is_set_up_as_the_site_says(organization: Organization) -> None:
    client, site = organization.client, organization.site
    minted = {
        log.event.to: log.event.value
        for log in client.logs(0, client.w3.eth.block_number)
        if isinstance(log.event, Transfer) and int(log.event.sender, 16) == 0
    }
    initial, supply = IEC.to_units(site.economy.initial_iec), IEC.to_units(site.economy.supply_iec)
    assert minted == {
        client.organization: initial,
        organization.robot.address: initial,
        organization.operator.address: supply - 2 * initial,
    }
    assert client.token.total_supply() == supply
    assert client.rules.has_role(Role.ADMINISTRATOR, organization.operator.address)
    assert client.rules.has_role(Role.OPERATOR, organization.operator.address)
    assert client.rules.has_role(Role.ORACLE, organization.oracle.address)
    assert not client.rules.has_role(Role.ORACLE, organization.operator.address)
    assert all(client.rules.is_kind_allowed(kind) for kind in kinds_of(site))
    assert judges_of(organization) == {
        name: "AuditorJudge" if kind.judge == "auditor" else "OracleJudge"
        for name, kind in kinds_of(site).items()
    }
    assert client.judges.auditors() == client.deployment.address("AuditorJudge")
    robot = client.devices.device(keystores.address(site, "panther1-device"))
    assert (robot.role, robot.owner) == ("robot", organization.robot.address)
    meter = client.devices.device(keystores.address(site, "dock1-device"))
    assert (meter.role, meter.owner) == ("meter", client.organization)
    assert meter.registrar == organization.operator.address and meter.revoked_at == 0


def test_an_administrator_is_slow_roles_have_budgets_and_a_guardian_is_named_by_default(
    tmp_path: Path,
) -> None:
    now_s, day_s = GENESIS_S, 24 * 3600
    with running_chain("eth-tester", tmp_path, lambda: now_s) as lab:
        alice = ParticipantConfig(name="alice", address="0x" + "a1" * 20)  # signs with a wallet of her own
        site = lab.model_copy(
            update={"governance": GovernanceConfig(guardian="alice"), "participants": [alice]}
        )
        organization = Organization(site)
        organization.deploy()
        client = organization.client
        assert client.rules.administrator() == client.deployment.address("OrganizationTimelock")
        assert client.decisions.delay_s() == handover_delay_s(client) == 2 * day_s
        for role, iec in ((Role.OPERATOR, 1000), (Role.TREASURER, 200)):
            budget = client.rules.budget(role)
            assert (budget.amount, budget.period) == (IEC.to_units(Decimal(iec)), day_s)
        assert client.rules.has_role(Role.GUARDIAN, "0x" + "a1" * 20)
        assert client.rules.terms() == Terms(IEC.to_units(Decimal(20)), IEC.to_units(Decimal(5)), 3)
        assert client.decisions.pending() == {}
        # The key that founded it tells it nothing at once any more.
        unlimited, key = client.organization_calls.set_budget(Role.OPERATOR, 0, 0), organization.operator
        schedule = client.governance_calls.schedule
        for call, reason in (
            (unlimited, "AccessControlUnauthorizedAccount"),
            (schedule([unlimited], "now", bytes(32), 2 * day_s - 1), "TimelockInsufficientDelay"),
        ):
            with pytest.raises(ContractReverted) as refused:
                organization.send(key, call)
            assert refused.value.name == reason
        organization.send(key, schedule([unlimited], "no limits", bytes(32), 2 * day_s))
        data = [to_bytes(hexstr=unlimited.data), b"no limits"]
        proposed = Operation([client.organization, WHY], [0, 0], data, bytes(32), bytes(32))
        assert client.decisions.pending() == {batch_id(proposed): proposed}
        perform = client.governance_calls.perform(proposed, batch_id(proposed))
        with pytest.raises(ContractReverted) as early:
            organization.send(organization.robot, perform)
        assert early.value.name == "TimelockUnexpectedOperationState"
        now_s += 2 * day_s + 1
        organization.send(organization.robot, perform)
        # What the administrator changes stays, however often the site is prepared, and nothing else is sent.
        block, said = client.w3.eth.block_number, list[str]()
        more = site.governance.model_copy(update={"guardian": "panther1", "delay_s": 60})
        contracts.run(site.model_copy(update={"governance": more}), threading.Event(), said.append)
        assert client.rules.budget(Role.OPERATOR).period == 0 and client.w3.eth.block_number == block
        assert "grantRole of the site file is not on chain: it takes a proposal of the administrator" in said
        assert any(f"is 60 and not {2 * day_s} as on chain" in one for one in said)


def test_an_organization_whose_administrator_acts_at_once_stays_so(
    organization: Organization,
) -> None:
    client, said = organization.client, list[str]()
    waits = organization.site.governance.model_copy(update={"delay_s": 60})
    block = client.w3.eth.block_number
    site = organization.site.model_copy(update={"governance": waits})
    contracts.run(site, threading.Event(), said.append)
    assert (
        client.w3.eth.block_number == block and client.rules.administrator() == organization.operator.address
    )
    assert any("the administrator's key acts at once in this organization" in one for one in said)


def test_the_demos_site_says_that_it_has_neither_delay_nor_budgets(organization: Organization) -> None:
    governance = organization.site.governance
    assert governance.model_fields_set >= {"delay_s", "budgets", "terms"}
    assert organization.client.rules.terms() == Terms(0, 0, 0)
    assert handover_delay_s(organization.client) == governance.delay_s == 0
    assert governance.budgets == {} and organization.client.rules.budget(Role.TREASURER).since == 0


def test_where_members_decide_nobody_else_does_from_the_beginning(tmp_path: Path) -> None:
    with running_chain("eth-tester", tmp_path) as lab:
        alice = ParticipantConfig(name="alice", address="0x" + "a1" * 20)
        governance = GovernanceConfig(kind="vote", delay_s=60, members=["panther1", "alice", "organization"])
        site = lab.model_copy(update={"governance": governance, "participants": [alice]})
        organization = Organization(site)
        organization.deploy()
        client = organization.client
        timelock = client.deployment.address("OrganizationTimelock")
        assert client.rules.administrator() == timelock and client.decisions.delay_s() == 60
        assert client.rules.has_role(Role.OPERATOR, timelock)
        votes = client.decisions.votes
        assert votes(organization.robot.address) == votes("0x" + "a1" * 20) == 1
        assert all(client.rules.is_kind_allowed(kind) for kind in kinds_of(site))
        # Its founder can do nothing any more, neither at once nor after the delay.
        founder, calls = organization.operator, client.governance_calls
        schedule, _execute = calls.found([], bytes(32))
        for call in (client.organization_calls.set_members_only(True), schedule):
            with pytest.raises(ContractReverted) as refused:
                client.send(founder, call)
            assert refused.value.name == "AccessControlUnauthorizedAccount"
        # What the site file asks for later is for the members to decide.
        block, said = client.w3.eth.block_number, list[str]()
        more = governance.model_copy(update={"guardian": "panther1"})
        contracts.run(site.model_copy(update={"governance": more}), threading.Event(), said.append)
        assert client.w3.eth.block_number == block
        assert "grantRole of the site file is not on chain: it takes a vote of the members" in said
        alone = site.model_copy(update={"governance": GovernanceConfig()})
        with pytest.raises(contracts.OtherGovernance) as other:
            contracts.run(alone, threading.Event())
        assert other.value.details == {"wanted": "administrator", "found": "vote"}


def test_a_quorum_that_was_changed_on_chain_stays(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with running_chain("eth-tester", tmp_path) as lab:
        judges = [JudgeConfig(name=name) for name in ("anna", "bert", "carl")]
        site = lab.model_copy(update={"oracles": judges})
        organization = Organization(site)
        organization.deploy()
        client, (kind, *_) = organization.client, kinds_of(site)
        quorum = client.judges.quorum(kind)
        assert (quorum.votes, quorum.panel, quorum.seats) == (2, 3, 0b111) and not caplog.records
        assert judges_of(organization)[kind] == "OracleCommittee"
        calls, committee = client.judge_calls.committee(), client.deployment.address("OracleCommittee")
        organization.send(organization.operator, calls.set_quorum(kind, 2, 2, 0, 0b011))
        changed, bert, key = (
            client.judges.quorum(kind),
            keystores.address(site, "bert-device"),
            keys.Key(b"\x07" * 32),
        )
        agreed = votes.possession(key, keystores.address(site, "bert"), CHAIN_ID, committee)
        organization.send(organization.operator, calls.change_key(bert, key.address, *agreed))
        block = client.w3.eth.block_number
        organization.deploy()
        assert client.judges.quorum(kind) == changed and client.judges.seat(bert) is None
        assert client.w3.eth.block_number == block
        assert f"2 of 2 oracles judge {kind} on chain, and 2 of 3 in the site file" in caplog.text


def test_rulings_can_be_challenged_where_the_site_says_so(tmp_path: Path) -> None:
    with running_chain("eth-tester", tmp_path) as lab:
        people = [ParticipantConfig(name="alice"), ParticipantConfig(name="bob")]
        wanted = DisputesConfig(
            judges=["alice", "bob", "panther1"],
            votes=3,
            window_s=600,
            decision_s=900,
            judge_stake_iec=Decimal(5),
        )
        without = lab.model_copy(
            update={"oracles": [JudgeConfig(name=name) for name in ("anna", "bert")], "participants": people}
        )
        site = without.model_copy(update={"disputes": wanted})
        organization = Organization(site)
        organization.deploy()
        client, (kind, *_) = organization.client, kinds_of(site)
        deployment, disputes = client.deployment, client.deployment.address("DisputeJudge")
        assert judges_of(organization)[kind] == "DisputeJudge"
        assert not client.rules.has_role(Role.ORACLE, organization.oracle.address)
        assert client.judges.instances(kind) == [
            Instance(
                deployment.address("OracleCommittee"),
                600,
                0,
                IEC.to_units(Decimal(20)),
                IEC.to_units(Decimal(5)),
            ),
            Instance(deployment.address("DisputeCommittee"), 0, 900, 0, 0),
        ]
        assert [client.judges.stake(seat) for seat in range(3)] == [IEC.to_units(Decimal(5))] * 2 + [0]
        assert client.token.balance(disputes) == IEC.to_units(Decimal(10))
        quorum = client.judges.quorum(kind, "DisputeCommittee")
        assert (quorum.votes, quorum.panel, quorum.seats) == (3, 3, 0b111)
        alice = keystores.address(site, "alice")
        assert client.judges.seat(alice, "DisputeCommittee") is not None and client.judges.seat(alice) is None
        assert deployment.committees == ["OracleCommittee", "DisputeCommittee"]
        assert view(client, "DisputeJudge", "longestCase", kind_to_bytes32(kind)) == 600 + 900
        assert client.rules.kind(kind).min_verdict_window == 600 + 900 + site.oracle.verdict_within_s
        block = client.w3.eth.block_number
        organization.deploy()
        assert client.w3.eth.block_number == block
        appeal = AppealConfig(judges=["organization"], votes=1)
        with pytest.raises(contracts.WithoutDisputes, match=r"without \[disputes.appeal\]"):
            contracts.run(
                site.model_copy(update={"disputes": wanted.model_copy(update={"appeal": appeal})}),
                threading.Event(),
            )
        # Without the table, the oracles' word is final again; the contracts stay.
        number, installed = client.rules.kind(kind).number, client.rules.current_rules(kind)
        contracts.run(without, threading.Event())
        assert judges_of(organization)[kind] == "OracleCommittee" and client.rules.kind(kind).number > number
        assert client.rules.current_rules(kind) == installed
        assert client.judges.numbered(number) == disputes  # of tasks that were posted before


def test_the_site_file_names_who_decides_on_appeal(tmp_path: Path) -> None:
    with running_chain("eth-tester", tmp_path) as lab:
        names = ("alice", "bob", "carl", "dora")
        people = [ParticipantConfig(name=name) for name in names]
        appeal = AppealConfig(
            judges=["bob", "carl", "dora"],
            votes=3,
            window_s=700,
            decision_s=800,
            stake_iec=Decimal(30),
            judge_stake_iec=Decimal(4),
        )
        wanted = DisputesConfig(
            judges=["alice", "panther1"],
            votes=2,
            window_s=600,
            decision_s=900,
            judge_stake_iec=Decimal(5),
            appeal=appeal,
        )
        update = {"oracles": [JudgeConfig(name="anna")], "participants": people}
        site = lab.model_copy(update={**update, "disputes": wanted})
        organization = Organization(site)
        organization.deploy()
        client, (kind, *_) = organization.client, kinds_of(site)
        address, iec = client.deployment.address, IEC.to_units
        assert client.judges.instances(kind) == [
            Instance(address("OracleCommittee"), 600, 0, iec(Decimal(20)), iec(Decimal(5))),
            Instance(address("DisputeCommittee"), 700, 900, iec(Decimal(30)), iec(Decimal(4))),
            Instance(address("AppealCommittee"), 0, 800, 0, 0),
        ]
        quorum = client.judges.quorum(kind, "AppealCommittee")
        assert (quorum.votes, quorum.panel, quorum.seats) == (3, 3, 0b111)
        # The judges of challenges can be overturned now, and have a stake, too.
        assert [client.judges.stake(seat, "DisputeCommittee") for seat in range(3)] == [
            iec(Decimal(4))
        ] * 2 + [0]
        assert client.judges.stake(0) == iec(Decimal(5)) and client.judges.stake(0, "AppealCommittee") == 0
        shortest_s = 600 + 900 + 700 + 800 + site.oracle.verdict_within_s
        assert client.rules.kind(kind).min_verdict_window == shortest_s
        block = client.w3.eth.block_number
        organization.deploy()
        assert client.w3.eth.block_number == block


def test_founders_pay_the_first_stakes_of_oracles_also_where_members_decide(tmp_path: Path) -> None:
    with running_chain("eth-tester", tmp_path) as lab:
        alice = ParticipantConfig(name="alice")
        wanted = DisputesConfig(judges=["alice", "panther1"], votes=2, window_s=600, decision_s=900)
        site = lab.model_copy(
            update={
                "oracles": [JudgeConfig(name="anna")],
                "participants": [alice],
                "disputes": wanted,
                "governance": GovernanceConfig(kind="vote", delay_s=60, members=["panther1", "organization"]),
            }
        )
        organization = Organization(site)
        organization.deploy()
        client = organization.client
        disputes = client.deployment.address("DisputeJudge")
        assert (
            client.judges.stake(0) == client.token.balance(disputes) == IEC.to_units(wanted.judge_stake_iec)
        )
        (kind, *_) = kinds_of(site)
        assert client.judges.instances(kind)[0].judge_stake == client.judges.stake(0)


def test_stakes_for_which_the_founder_has_no_tokens_are_left_to_others(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with running_chain("eth-tester", tmp_path) as lab:
        alice = ParticipantConfig(name="alice")
        wanted = DisputesConfig(
            judges=["alice", "panther1"],
            votes=2,
            window_s=600,
            decision_s=900,
            judge_stake_iec=lab.economy.supply_iec,
        )
        site = lab.model_copy(
            update={
                "oracles": [JudgeConfig(name="anna")],
                "participants": [alice],
                "disputes": wanted,
            }
        )
        organization = Organization(site)
        organization.deploy()
        (kind, *_) = kinds_of(site)
        assert organization.client.judges.stake(0) == 0
        assert organization.client.judges.instances(kind)[0].judge_stake > 0
        assert "the stakes of 1 judges take" in caplog.text


def test_an_organization_is_not_founded_without_its_judges(tmp_path: Path) -> None:
    with running_chain("eth-tester", tmp_path) as lab:
        alice = keys.Key(b"\x0a" * 32)
        elsewhere = ParticipantConfig(name="alice", address=alice.address)
        wanted = DisputesConfig(judges=["alice", "panther1"], votes=2, window_s=600, decision_s=900)
        site = lab.model_copy(
            update={
                "oracles": [JudgeConfig(name="anna")],
                "participants": [elsewhere],
                "disputes": wanted,
                "governance": GovernanceConfig(delay_s=60),
            }
        )
        judged = [name for name, kind in kinds_of(site).items() if kind.judge == "oracle"]
        organization = Organization(site)
        with pytest.raises(contracts.WithoutJudges) as missing:
            organization.deploy()
        assert missing.value.details["kinds"] == judged
        # It continues with the key, and with the contracts that are there.
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(keystores.key_variable("alice"), "0x" + "0a" * 32)
            organization.deploy()
        client = organization.client
        assert client.decisions.delay_s() == 60 and {judges_of(organization)[one] for one in judged} == {
            "DisputeJudge"
        }
        assert client.judges.seat(alice.address, "DisputeCommittee") is not None


def test_disputes_are_not_added_to_an_organization_that_has_none(organization: Organization) -> None:
    site = organization.site.model_copy(update={"disputes": DisputesConfig(judges=["panther1"], votes=1)})
    with pytest.raises(contracts.WithoutDisputes):
        contracts.run(site, threading.Event())


def test_deploying_again_sends_nothing(organization: Organization) -> None:
    before = organization.client.w3.eth.block_number
    organization.deploy()
    assert organization.client.w3.eth.block_number == before


def test_installed_rules_that_were_retired_stay_so(
    organization: Organization, caplog: pytest.LogCaptureFixture
) -> None:
    client, (kind, *_) = organization.client, kinds_of(organization.site)
    (installed,) = client.rules.current_rules(kind)
    calls, other = client.organization_calls, bytes.fromhex("5e" * 32)

    def send(call: Call) -> None:
        client.send(organization.operator, call)

    send(calls.allow_kind(kind, client.deployment.address("OracleJudge"), other))
    send(calls.retire_rules(kind, installed))
    organization.deploy()
    assert client.rules.current_rules(kind) == [other]
    assert installed.hex() in caplog.text and f"rodeo organization kind {kind} --judge oracle" in caplog.text
    # A kind that is not allowed at all is allowed again, as the site file says, and needs rules.
    send(calls.disallow_kind(kind))
    organization.deploy()
    assert client.rules.current_rules(kind) == [installed]


def test_an_interrupted_deployment_goes_on_with_the_same_contracts(organization: Organization) -> None:
    site = organization.site
    deployment = Deployment.load(site.data_dir, CHAIN_ID)
    unfinished = Deployment.path(site.data_dir / "deployments" / "unfinished", CHAIN_ID)
    unfinished.parent.mkdir(parents=True, exist_ok=True)
    Deployment.path(site.data_dir, CHAIN_ID).replace(unfinished)
    organization.deploy()
    assert Deployment.load(site.data_dir, CHAIN_ID) == deployment
    assert not unfinished.exists()


def test_a_record_of_another_chain_does_not_verify(organization: Organization) -> None:
    other = organization.client.deployment.model_copy(update={"genesis_hash": "0x00"})
    with pytest.raises(DeploymentMismatch) as mismatch:
        other.verify(organization.client.w3)
    assert mismatch.value.details["recorded_genesis_hash"] == "0x00"


def test_a_record_of_other_code_does_not_verify(organization: Organization) -> None:
    contracts = organization.client.deployment.contracts
    swapped = contracts | {"TaskManager": contracts["ServiceManager"]}
    other = organization.client.deployment.model_copy(update={"contracts": swapped})
    with pytest.raises(DeploymentMismatch) as mismatch:
        other.verify(organization.client.w3)
    assert mismatch.value.details["contract"] == "TaskManager"


def test_no_record_means_not_deployed(tmp_path: Path) -> None:
    with pytest.raises(NotDeployed) as missing:
        Deployment.load(tmp_path, 5)
    assert missing.value.details["chain_id"] == 5


@pytest.mark.parametrize("text", ["", "{", '{"chain_id": 5}'])
def test_a_damaged_record_is_no_record(tmp_path: Path, text: str) -> None:
    path = Deployment.path(tmp_path, 5)
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(ChainError) as damaged:
        Deployment.load(tmp_path, 5)
    assert damaged.value.details["path"] == str(path)


def test_every_contract_fits_the_limit_of_eip_170() -> None:
    assert all(len(artifacts.load(name).deployed_code) <= 24_576 for name in CONTRACTS)


def test_on_a_chain_elsewhere_wallets_bring_their_own_keys_and_gas_money(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "known to everybody")
    with running_chain("eth-tester", tmp_path) as local:
        site = local.model_copy(update={"chain": local.chain.model_copy(update={"backend": "external"})})
        wallets.make_missing(site, scrypt_n=2)
        for path in (site.data_dir / "keys").glob("*.json"):
            keystore = json.loads(path.read_text())
            del keystore["address"]  # as Foundry writes them
            path.write_text(json.dumps(keystore))
        with pytest.raises(WithoutGasMoney) as caught:
            contracts.run(site, threading.Event())
        accounts = {name: keystores.address(site, name) for name in keystores.wallet_names(site)}
        assert caught.value.details == accounts
        w3 = connect(site.chain.url)
        for account in accounts.values():
            w3.eth.send_transaction({"from": w3.eth.accounts[0], "to": account, "value": 10**19})
        contracts.run(site, threading.Event())
        assert Organization(site).client.rules.is_kind_allowed(site.kinds[0].name)


def test_from_the_input_for_explorers_the_compiler_makes_what_is_deployed(tmp_path: Path) -> None:
    root = Path(__file__).parents[3]
    subprocess.run(["node", "contracts/build.mjs", "--standard-json", tmp_path], cwd=root, check=True)
    assert {path.stem for path in tmp_path.iterdir()} == {artifacts.load(name).name for name in CONTRACTS}
    for name in ("IECoin", "TaskQueues"):  # the largest takes the compiler minutes
        done = subprocess.run(
            ["node", "contracts/solc.mjs", "--standard-json"],
            cwd=root,
            input=(tmp_path / f"{name}.json").read_bytes(),
            capture_output=True,
            check=True,
        )
        compiled = json.loads(done.stdout)["contracts"][f"contracts/src/{name}.sol"][name]
        assert bytes.fromhex(compiled["evm"]["bytecode"]["object"]) == artifacts.load(name).bytecode
