"""An organization's contracts are created at addresses known beforehand, in few transactions, and found."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from eth_account.signers.local import LocalAccount
from eth_utils import to_checksum_address
from web3 import Web3
from web3.types import TxReceipt

from deploy import contracts, founding, gas_money
from rodeo.chain import artifacts, registry
from rodeo.chain.client import ChainClient, connect
from rodeo.chain.contracts.types import Role
from rodeo.chain.deployment import Deployment
from rodeo.chain.node import transactions
from rodeo.chain.node.errors import ChainUnavailable, ContractReverted
from rodeo.chain.registry import Registry
from rodeo.errors import ConfigError
from rodeo.kinds import kinds_of
from rodeo.signing import keystores, wallets
from rodeo.site.config import Site
from rodeo.site.deploying import deployment_under_way
from rodeo.site.sections import DisputesConfig, GovernanceConfig, JudgeConfig, ParticipantConfig
from tests.support.organization import CHAIN_ID, Organization, running_chain

pytestmark = pytest.mark.long


def told(site: Site) -> list[str]:
    said: list[str] = []
    contracts.run(site, threading.Event(), said.append)
    return said


def sent(site: Site, w3: Web3, name: str = "organization") -> int:
    return int(w3.eth.get_transaction_count(Web3.to_checksum_address(keystores.address(site, name))))


def record(site: Site) -> Deployment:
    return Deployment.load(site.data_dir, CHAIN_ID)


def another(site: Site, folder: Path, **changes: Any) -> Site:
    """A site of its own on the same chain, with keys and records of its own."""
    return site.model_copy(update={"org": "other", "data_dir": folder, **changes})


def as_elsewhere(site: Site, **changes: Any) -> Site:
    """The chain is not this site's own."""
    return site.model_copy(update={"chain": site.chain.model_copy(update={"backend": "external", **changes})})


def fail_once(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Let the transaction with this number, from 1, not get to the chain."""
    count, send = 0, transactions.send

    def counted(*args: Any, **options: Any) -> Any:
        nonlocal count
        count += 1
        if count == number:
            raise ChainUnavailable("gone")
        return send(*args, **options)

    monkeypatch.setattr(transactions, "send", counted)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with running_chain("eth-tester", tmp_path) as found:
        yield found


def test_an_organization_takes_five_transactions_of_its_founder_and_the_next_one_four(
    site: Site, tmp_path: Path
) -> None:
    w3 = connect(site.chain.url)
    told(site)
    # The registry, three with contracts, one with all settings of the organization.
    assert sent(site, w3) == 5
    client = Organization(site).client
    for name, kind in kinds_of(site).items():
        rules = client.rules.kind(name)
        windows = rules.min_window, rules.max_window, rules.grace
        assert windows == (*kind.windows_s, kind.grace_period_s), name
        price = client.rules.reference_price(name)
        assert price == site.economy.currency.to_units(kind.reference_price_iec) > 0, name
    assert all(client.services.is_proven(keystores.address(site, robot.name)) for robot in site.robots)
    assert not client.services.is_proven(keystores.address(site, "oracle"))
    second = another(site, tmp_path / "second")
    told(second)
    assert sent(second, w3) == 4
    deployed = record(site), record(second)
    assert deployed[0].registry == deployed[1].registry == registry.known_address()
    assert not {*deployed[0].contracts.values()} & {*deployed[1].contracts.values()}
    listed = Registry(w3, registry.known_address()).organizations()
    assert [(one.name, one.founder, one.address, one.founded_in) for one in listed] == [
        (one.org, keystores.address(one, "organization"), made.address("Organization"), made.block)
        for one, made in zip((site, second), deployed, strict=True)
    ]


def test_everybody_can_read_how_far_a_deployment_is(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    send = transactions.send

    def note(*args: Any, **options: Any) -> Any:
        seen.append(str(deployment_under_way(site)))
        return send(*args, **options)

    monkeypatch.setattr(transactions, "send", note)
    told(site)
    of = founding.count_contracts(site) + 2
    assert seen[:2] == [
        f"deploying contracts, 2 of {of}: OrganizationRegistry",
        f"deploying contracts, 3 of {of}: IECoin",
    ]
    assert seen[-1] == f"deploying contracts, {of} of {of}: roles, kinds of work and devices"
    assert deployment_under_way(site) is None
    # The second time nothing is left but to see that all is there.
    seen.clear()
    told(site)
    assert seen == []


def test_an_administrator_who_waits_takes_two_transactions_more(site: Site) -> None:
    """The timelock does not fit into the others, and what it does is scheduled and executed."""
    waits = site.model_copy(update={"governance": GovernanceConfig(delay_s=60)})
    told(waits)
    assert sent(waits, connect(site.chain.url)) == 7


def test_with_votes_and_disputes_no_transaction_has_more_gas_than_one_may_have(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """EIP-7825."""
    gas: list[int] = []
    send = transactions.send

    def note(*args: Any, **options: Any) -> Any:
        receipt = send(*args, **options)
        gas.append(receipt["gasUsed"])
        return receipt

    monkeypatch.setattr(transactions, "send", note)
    full = site.model_copy(
        update={
            "governance": GovernanceConfig(kind="vote", delay_s=60, members=["panther1", "organization"]),
            "oracles": [JudgeConfig(name=name) for name in ("anna", "bert", "carl")],
            "disputes": DisputesConfig(judges=["organization"], votes=1),
        }
    )
    wallets.ensure_wallets(full)
    w3 = connect(full.chain.url)
    gas_money.fund(w3, [keystores.address(full, name) for name in keystores.wallet_names(full)])
    founding.create_contracts(full, w3, wallets.load(full, "organization"), lambda _text: None)
    assert len(gas) > 1 and max(gas) * transactions.GAS_MARGIN < 2**24


def test_two_members_are_two_accounts(site: Site) -> None:
    address = "0x" + "a1" * 20
    named = [ParticipantConfig(name=name, address=address) for name in ("alice", "bob")]
    governance = GovernanceConfig(kind="vote", members=["organization", "alice", "bob"])
    wallets.ensure_wallets(site)
    with pytest.raises(contracts.MemberTwice) as twice:
        contracts.first_members(site.model_copy(update={"participants": named, "governance": governance}))
    assert twice.value.details[to_checksum_address(address)] == "bob"


@pytest.mark.parametrize("before", range(1, 5))
def test_an_interrupted_deployment_goes_on_with_the_contracts_that_are_there(
    site: Site, monkeypatch: pytest.MonkeyPatch, before: int
) -> None:
    """`before`: the transaction that does not get to the chain."""
    wallets.ensure_wallets(site)
    w3 = connect(site.chain.url)
    fail_once(monkeypatch, before)
    with pytest.raises(ChainUnavailable):
        told(site)
    there = sent(site, w3)
    assert there == before - 1
    told(site)
    assert sent(site, w3) == 5
    assert len(Registry(w3, registry.known_address()).organizations()) == 1


@pytest.mark.parametrize("before", [7, 6])
def test_an_interrupted_founding_goes_on_and_leaves_nothing_that_could_be_done_later(
    site: Site, monkeypatch: pytest.MonkeyPatch, before: int
) -> None:
    """`before`: the transaction that does not get to the chain: that gives the timelock what the site
    file says and its delay, or the next one, which executes it."""
    slow = site.model_copy(update={"governance": GovernanceConfig(delay_s=60)})
    wallets.ensure_wallets(slow)
    w3 = connect(slow.chain.url)
    fail_once(monkeypatch, before)
    with pytest.raises(ChainUnavailable):
        told(slow)
    there = ChainClient(slow.chain.url, Deployment.load(contracts.unfinished(slow), CHAIN_ID))
    # Until the end it is the founder's, as an organization without a delay is, and nobody else's.
    assert there.rules.administrator() == there.deployment.address("OrganizationTimelock")
    assert there.decisions.delay_s() == 0
    assert any("with a delay of 60 s" in one for one in told(slow))
    client = Organization(slow).client
    assert client.organization == there.organization and client.decisions.delay_s() == 60
    assert all(client.rules.is_kind_allowed(kind) for kind in kinds_of(slow))
    assert client.decisions.pending() == {}
    done = sent(slow, w3)
    told(slow)
    assert sent(slow, w3) == done


def test_an_organization_whose_record_is_lost_is_found_again(site: Site) -> None:
    told(site)
    before, w3 = record(site), connect(site.chain.url)
    transactions_before = sent(site, w3)
    Deployment.path(site.data_dir, CHAIN_ID).unlink()
    said = told(site)
    assert record(site).is_same(before)
    assert sent(site, w3) == transactions_before
    assert any("on the chain already" in text for text in said)


@pytest.mark.parametrize("said", [9_000_000, 1])
def test_where_contracts_count_other_blocks_than_the_node_those_of_the_node_are_recorded(
    site: Site, monkeypatch: pytest.MonkeyPatch, said: int
) -> None:
    """`said`: what the registry knows as the block of the founding, as Ethereum's on Arbitrum. Whoever began
    to read there would read for days, or miss events."""
    founded_in = Registry.founded_in

    def counted(found: Registry, founder: str, name: str, number: int) -> int:
        return said if founded_in(found, founder, name, number) else 0

    monkeypatch.setattr(Registry, "founded_in", counted)
    told(site)
    block = record(site).block
    w3 = connect(site.chain.url)
    assert w3.eth.get_block_transaction_count(block) == 1
    assert w3.eth.get_transaction_by_block(block, 0)["to"] == registry.known_address()
    Deployment.path(site.data_dir, CHAIN_ID).unlink()
    told(site)
    assert record(site).block == block


def test_a_role_that_was_revoked_on_chain_is_not_given_back(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    told(site)
    lab = Organization(site)
    calls = lab.client.organization_calls
    for role, account in ((Role.ORACLE, lab.oracle), (Role.AUDITOR, lab.operator)):
        lab.send(lab.operator, calls.revoke_role(role, account.address))
    lab.send(lab.operator, calls.vouch_for(lab.robot.address, False))
    told(site)
    assert not lab.client.services.is_proven(lab.robot.address), "nor does the founding vouch again"
    assert not lab.client.rules.has_role(Role.ORACLE, lab.oracle.address)
    assert not lab.client.rules.has_role(Role.AUDITOR, lab.operator.address)
    assert f"ORACLE_ROLE of {lab.oracle.address} was revoked on chain" in caplog.text
    lab.send(lab.operator, calls.grant_role(Role.AUDITOR, lab.operator.address))
    before = sent(site, lab.client.w3)
    told(site)
    assert (
        lab.client.rules.has_role(Role.AUDITOR, lab.operator.address) and sent(site, lab.client.w3) == before
    )


def test_a_record_of_another_chain_is_replaced_by_that_of_what_is_there(site: Site) -> None:
    told(site)
    before = record(site)
    Deployment.model_validate(before.model_dump() | {"genesis_hash": "0x" + "11" * 32}).save(site.data_dir)
    told(site)
    assert record(site).is_same(before)


def test_another_site_file_of_the_same_founder_founds_another_organization(site: Site) -> None:
    told(site)
    before, supply = record(site), Organization(site).client.token.total_supply()
    Deployment.path(site.data_dir, CHAIN_ID).unlink()
    economy = site.economy.model_copy(update={"supply_iec": site.economy.supply_iec + 1})
    changed = site.model_copy(update={"economy": economy})
    told(changed)
    after = record(changed)
    assert after.contracts["TaskManager"] != before.contracts["TaskManager"]
    listed = Registry(connect(site.chain.url), registry.known_address()).organizations()
    assert [one.number for one in listed] == [0, 1]
    assert Organization(changed).client.token.total_supply() == supply + 10**18


def test_addresses_are_the_same_on_every_chain(site: Site, tmp_path: Path) -> None:
    told(site)
    (tmp_path / "anvil").mkdir()
    with running_chain("anvil", tmp_path / "anvil") as elsewhere:
        same_keys = elsewhere.model_copy(update={"data_dir": tmp_path / "there"})
        (site.data_dir / "keys").rename(tmp_path / "keys")
        same_keys.data_dir.mkdir()
        (tmp_path / "keys").rename(same_keys.data_dir / "keys")
        told(same_keys)
        assert record(same_keys).contracts == record(site).contracts


def test_without_the_proxy_a_registry_is_put_on_the_chain_and_others_name_it(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "known to everybody")
    w3, first = connect(site.chain.url), as_elsewhere(site)
    second = as_elsewhere(another(site, tmp_path / "second"))
    wallets.make_missing(second, scrypt_n=2)
    for one in (first, second):
        for name in keystores.wallet_names(one):
            account = Web3.to_checksum_address(keystores.address(one, name))
            w3.eth.send_transaction({"from": w3.eth.accounts[0], "to": account, "value": 10**19})
    send = transactions.send

    def fail(_w3: Web3, account: Any, **options: Any) -> Any:
        if options.get("to") is not None:
            raise ChainUnavailable("gone")
        return send(_w3, account, **options)

    with monkeypatch.context() as broken, pytest.raises(ChainUnavailable):
        broken.setattr(transactions, "send", fail)
        said = list[str]()
        contracts.run(first, threading.Event(), said.append)
    # Only one is put there, however often the step is interrupted.
    told(first)
    found = record(first).registry
    assert found is not None and found != registry.known_address()
    assert any(f'`chain.registry = "{found}"`' in text for text in said)
    with pytest.raises(ConfigError, match="no registry of this release"):
        told(as_elsewhere(second, registry=record(first).address("TaskManager")))
    told(as_elsewhere(second, registry=found))
    assert [one.name for one in Registry(w3, Web3.to_checksum_address(found)).organizations()] == [
        first.org,
        second.org,
    ]


def test_a_registry_that_somebody_else_puts_there_first_is_the_one(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    w3 = connect(site.chain.url)
    wallets.ensure_wallets(site)
    other = wallets.load(site, "panther1")
    gas_money.fund(w3, [other.address])
    send, ahead = transactions.send, 0

    def overtaken(w3: Web3, account: LocalAccount, **message: Any) -> TxReceipt:
        nonlocal ahead
        if message.get("to") == registry.PROXY:
            ahead += send(w3, other, **message)["status"]
        return send(w3, account, **message)

    monkeypatch.setattr(founding.transactions, "send", overtaken)
    told(site)
    assert record(site).registry == registry.known_address()
    assert ahead == 1


def test_a_registry_of_other_code_is_not_taken_for_this_one(site: Site) -> None:
    """It would create other contracts under our names."""
    wallets.ensure_wallets(site)
    w3 = connect(site.chain.url)
    gas_money.fund(w3, [keystores.address(site, "organization")])
    founder = wallets.load(site, "organization")
    forged = bytearray(registry.creation_code())
    forged[-1] ^= 1  # the last hash
    made = transactions.send(w3, founder, data=Web3.to_hex(bytes(forged)))
    address = made["contractAddress"]
    assert address is not None and not Registry(w3, address).is_there
    named = site.model_copy(update={"chain": site.chain.model_copy(update={"registry": address})})
    with pytest.raises(ConfigError):
        told(named)


def test_what_the_registry_refuses_is_told(site: Site) -> None:
    told(site)
    w3, founder = connect(site.chain.url), wallets.load(site, "organization")
    found = Registry(w3, registry.known_address())
    (other,) = [registry.part("IECoin", [founder.address], [1])]
    call = found.create(site.org, 0, [other])
    with pytest.raises(ContractReverted) as refused:
        transactions.send(w3, founder, to=call.to, data=call.data)
    assert refused.value.name == "OtherArguments"


def test_names_are_shown_as_they_are_or_in_hex(site: Site) -> None:
    told(site)
    w3, founder = connect(site.chain.url), wallets.load(site, "organization")
    found = Registry(w3, registry.known_address())
    long = "a" * 33
    for name in (long, "\x1b[2J"):
        call = found.create(name, 0, [])
        transactions.send(w3, founder, to=call.to, data=call.data)
    shown = [one.name for one in found.organizations()]
    assert shown[0] == site.org
    assert all(name.startswith("0x") and len(name) == 66 for name in shown[1:])


def test_the_registry_creates_everything_that_a_contract_does_not_create_itself() -> None:
    built = {*artifacts.CONTRACTS, *artifacts.DISPUTES, *artifacts.GOVERNANCE}
    assert {*registry.PARTS} == built - artifacts.CREATED_BY.keys()
