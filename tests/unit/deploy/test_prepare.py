"""`rodeo site prepare`: from a site file to contracts on its chain, each step said, as often as one likes."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from decimal import Decimal
from functools import partial
from pathlib import Path

import pytest
from eth_utils import to_checksum_address
from typer.testing import CliRunner
from web3 import Web3

from deploy import contracts
from deploy import prepare as module
from deploy.contracts import OtherRelease, WithoutGasMoney
from deploy.prepare import prepare
from rodeo.chain import artifacts
from rodeo.chain.client import connect
from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import ChainUnavailable
from rodeo.signing import keystores, wallets
from rodeo.site.config import Site
from rodeo_cli import app
from rodeo_cli.wallets import accounts
from rodeo_testing.waiting import HANG_S
from tests.support.organization import CHAIN_ID, running_chain
from tests.support.site import write_site

pytestmark = pytest.mark.long

ELSEWHERE = "clock.speed = 1\nclock.idle_speed = 1"
CHEAP = 2
"""Work factor of keystores that are only there; for a node elsewhere each takes a second to make."""
NEEDED = re.compile(r"^gas money: (0x[0-9a-fA-F]{40}) (\S+): holds 0; send at least (\S+) more to it$")


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """File of a site on somebody's node, which runs."""
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "secret")
    node, own = tmp_path / "node", tmp_path / "own"
    node.mkdir()
    own.mkdir()
    with running_chain("eth-tester", node) as theirs:
        for number, name in enumerate(("ORGANIZATION", "PANTHER1", "ORACLE"), 1):
            monkeypatch.setenv(keystores.KEY_VARIABLE + name, f"0x{number:064x}")
        path = write_site(own, "external", ELSEWHERE)
        path.write_text(re.sub("chain.url = .*", f'chain.url = "{theirs.chain.url}"', path.read_text()))
        yield path


def pay(w3: Web3, address: str, ether: str) -> None:
    sent = w3.eth.send_transaction(
        {
            "from": w3.eth.accounts[0],
            "to": to_checksum_address(address),
            "value": Web3.to_wei(ether, "ether"),
        }
    )
    w3.eth.wait_for_transaction_receipt(sent, poll_latency=0.05)


def test_a_site_on_a_chain_elsewhere_is_prepared_with_the_amounts_that_it_names(elsewhere: Path) -> None:
    said: list[str] = []
    with pytest.raises(WithoutGasMoney) as empty:
        prepare(elsewhere, said.append, threading.Event())
    needed = {found[2]: (found[1], found[3]) for line in said if (found := NEEDED.match(line))}
    site = Site.load(elsewhere)
    assert {name: address for name, (address, _) in needed.items()} == {
        name: keystores.address(site, name) for name in keystores.wallet_names(site)
    }
    assert all(name in empty.value.message for name in needed)
    w3 = connect(site.chain.url)
    for address, amount in needed.values():
        pay(w3, address, amount)

    said.clear()
    prepare(elsewhere, said.append, threading.Event())
    Deployment.load(site.data_dir, CHAIN_ID).verify(w3)
    assert not any("send at least" in line for line in said), "what it asked for was enough"
    assert any(line.startswith("contracts: TaskManager at 0x") for line in said)
    assert said[-1] == f"the site is prepared: `rodeo up --site {elsewhere}` starts it"

    said.clear()
    block = w3.eth.block_number
    prepare(elsewhere, said.append, threading.Event())
    assert w3.eth.block_number == block, "the second time there is nothing to send"
    assert said[0].startswith("keystores: all present in ")


def test_a_participant_for_whom_others_send_needs_no_gas_money(elsewhere: Path) -> None:
    with elsewhere.open("a") as file:
        file.write('\n[[participants]]\nname = "alice"\n')
    said: list[str] = []
    with pytest.raises(WithoutGasMoney) as empty:
        prepare(elsewhere, said.append, threading.Event())
    assert "alice" not in empty.value.message
    site = Site.load(elsewhere)
    w3 = connect(site.chain.url)
    for name in ("organization", "panther1", "oracle"):
        pay(w3, keystores.address(site, name), "1")
    said.clear()
    prepare(elsewhere, said.append, threading.Event())
    Deployment.load(site.data_dir, CHAIN_ID).verify(w3)
    (alices,) = [line for line in said if line.startswith("gas money: ") and " alice: " in line]
    assert alices.endswith("more to it (not needed if others send for it)")


@pytest.mark.parametrize("folder", ["", "deployments/unfinished"], ids=["founded", "half founded"])
def test_an_organization_of_another_release_is_replaced_only_where_its_record_was_moved_away(
    elsewhere: Path, folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = Site.load(elsewhere)
    wallets.make_missing(site, CHEAP)
    w3 = connect(site.chain.url)
    for name in keystores.wallet_names(site):
        pay(w3, keystores.address(site, name), "1")
    prepare(elsewhere, lambda _: None, threading.Event())
    before, block = Deployment.load(site.data_dir, CHAIN_ID), w3.eth.block_number
    record = Deployment.path(site.data_dir / folder, CHAIN_ID)
    record.parent.mkdir(parents=True, exist_ok=True)
    Deployment.path(site.data_dir, CHAIN_ID).replace(record)
    record.write_text(record.read_text().replace("{", '{"of_another_release": null,', 1))
    load = artifacts.load
    # The policies of this release are built from other sources.
    built = dataclasses.replace(load("HighestReputation"), name="LowestPrice")
    monkeypatch.setattr(artifacts, "load", lambda name: built if name == "LowestPrice" else load(name))
    for run in (partial(prepare, elsewhere, print), partial(contracts.run, site)):
        with pytest.raises(
            OtherRelease, match="move the record away and run `rodeo site prepare`"
        ) as refused:
            run(threading.Event())
        assert refused.value.details == {
            "organization": before.contracts["Organization"],
            "record": str(record),
        }
    assert record.exists() and w3.eth.block_number == block
    assert accounts(site)["problem"] == refused.value.message
    record.rename(elsewhere.with_name("kept.json"))
    prepare(elsewhere, print, threading.Event())
    new = Deployment.load(site.data_dir, CHAIN_ID)
    new.verify(w3)
    assert not set(new.contracts.values()) & set(before.contracts.values())


def test_it_waits_for_the_money_where_that_is_wanted(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_LOOK_S", 0.05)
    site = Site.load(elsewhere)
    wallets.make_missing(site, CHEAP)
    w3 = connect(site.chain.url)
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        if found := NEEDED.match(line):
            pay(w3, found[1], "1")

    prepare(elsewhere, say, threading.Event(), wait=True)
    assert [line for line in said if line.endswith("organization: holds 1")]
    Deployment.load(site.data_dir, CHAIN_ID).verify(w3)


def test_a_local_site_is_prepared_without_being_started(tmp_path: Path) -> None:
    path = write_site(tmp_path)
    said: list[str] = []
    prepare(path, said.append, threading.Event())
    site = Site.load(path)
    assert Deployment.load(site.data_dir, CHAIN_ID).chain_id == CHAIN_ID
    assert "chain: running the local chain until this command ends" in said
    with pytest.raises(ChainUnavailable):
        contracts.recorded(site, connect(site.chain.url))


def test_without_a_node_it_is_said_at_once_what_is_waited_for_and_then_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(contracts.NODE_S, "external", 1.0)
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "secret")
    path = write_site(tmp_path, "external", ELSEWHERE)
    url = Site.load(path).chain.url
    said: list[str] = []
    with pytest.raises(ChainUnavailable) as silent:
        contracts.run(Site.load(path), threading.Event(), said.append)
    assert said == [f"waiting for the node at {url}, 1 s at most"]
    assert silent.value.message == (
        f"no node answered at {url} for 1 s: start it, or correct `chain.url` in the site file"
    )


def test_addresses_are_whole_in_a_narrow_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_site(tmp_path, "external", ELSEWHERE)
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "secret")
    wallets.make_missing(Site.load(path), CHEAP)
    environment = {"COLUMNS": "80", "PATH": "", keystores.PASSPHRASE_VARIABLE: "secret"}
    done = subprocess.run(
        [sys.executable, "-m", "rodeo_cli", "site", "wallets", "--site", str(path)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=HANG_S,
    )
    site = Site.load(path)
    for name in [*keystores.wallet_names(site), *keystores.device_names(site)]:
        assert f"{keystores.address(site, name)}  {name} " in done.stdout, done.stderr
    assert f"no node answers at {site.chain.url}" in done.stdout


def test_accounts_are_json_with_what_they_hold_and_lack_for_gas(elsewhere: Path) -> None:
    site = Site.load(elsewhere)
    wallets.make_missing(site, CHEAP)
    pay(connect(site.chain.url), keystores.address(site, "oracle"), "2.5")
    done = CliRunner().invoke(app, ["site", "wallets", "--site", str(elsewhere), "--json"])
    document = json.loads(done.stdout)
    accounts = {one.pop("name"): one for one in document.pop("accounts")}
    assert document == {"chain_url": site.chain.url, "problem": ""}
    assert list(accounts) == [*keystores.wallet_names(site), *keystores.device_names(site)]
    assert all(one["address"] == keystores.address(site, name) for name, one in accounts.items())
    assert (
        accounts["oracle"].items()
        >= {"signs": "transactions", "holds_eth": "2.5", "missing_eth": "0"}.items()
    )
    assert accounts["organization"]["holds_eth"] == "0"
    assert Decimal(accounts["organization"]["missing_eth"]) > 0
    device = accounts[next(iter(keystores.device_names(site)))]
    assert device.items() >= {"signs": "evidence", "holds_eth": None, "missing_eth": None}.items()
