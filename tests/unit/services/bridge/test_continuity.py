"""A journal that lacks what its wallets have sent is refused until somebody says otherwise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from eth_account.signers.local import LocalAccount

from rodeo.signing import keystores, wallets
from rodeo.site.config import Site
from services.bridge.continuity import Continuity, give_up_journal, open_journal
from services.bridge.errors import JournalDamaged, JournalIncomplete
from services.bridge.journal import Journal
from services.bridge.node import Node
from tests.support.deployed import DeployedChain


class Bridge:
    """panther1's wallet on a real chain, and its journal as one bridge after the other opens it."""

    def __init__(self, chain: DeployedChain, folder: Path) -> None:
        self.chain = chain
        self.site: Site = chain.site.model_copy(update={"data_dir": folder})
        self.account: LocalAccount = wallets.load(chain.site, "panther1")
        self.addresses = {"panther1": self.account.address}
        self.shared: list[str] = []
        self.client = chain.client()
        self.node = Node(chain.site.chain.url)
        # As a deployment says that ended now: other tests share the chain.
        self.sent = {self.account.address: self.nonce}
        self.folder = folder / "bridge"
        self.path = self.folder / "31337-abc" / "journal.sqlite"

    @property
    def nonce(self) -> int:
        return self.client.w3.eth.get_transaction_count(self.account.address)

    def open(self) -> Journal:
        return open_journal(self.path, self.folder, self.node, self.addresses, self.sent, self.shared)

    def send(self, journal: Journal | None) -> None:
        """One transaction, through the journal or without it."""
        nonce = self.nonce
        if journal is not None:
            journal.add(
                [
                    {
                        "wallet": "panther1",
                        "request_id": f"request {nonce}",
                        "command": "transfer",
                        "content_sha256": "",
                        "to": self.client.organization,
                        "data": b"",
                        "raw": b"",
                        "nonce": nonce,
                        "tx_hash": hex(nonce),
                    }
                ]
            )
        self.client.send(self.account, self.client.calls.transfer(self.client.organization, 1))


@pytest.fixture
def bridge(chain: DeployedChain, tmp_path: Path) -> Bridge:
    return Bridge(chain, tmp_path)


def delete(path: Path) -> None:
    path.unlink()


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("lose", [delete, empty])
def test_a_journal_that_is_gone_is_refused_until_it_is_back_or_given_up(
    bridge: Bridge, lose: Callable[[Path], None]
) -> None:
    journal = bridge.open()
    for _ in range(3):
        bridge.send(journal)
    journal.close()
    copy = bridge.path.read_bytes()
    for beside in bridge.path.parent.glob("journal.sqlite-*"):
        beside.unlink()

    lose(bridge.path)
    for _ in range(2):  # asking again does not make it whole
        with pytest.raises(JournalIncomplete, match="lacks 3 transactions") as refused:
            bridge.open()
    assert refused.value.details == {"path": str(bridge.path), "missing": {"panther1": 3}}
    assert not refused.value.restart_cures
    assert "rodeo up --new-journal" in refused.value.message

    bridge.path.write_bytes(copy)
    journal = bridge.open()
    assert len(journal.unfinished()) == 3
    journal.close()

    lose(bridge.path)
    give_up_journal(bridge.site)
    bridge.open().close()
    bridge.open().close()  # once given up, it is whole
    journal = bridge.open()
    bridge.send(journal)
    journal.close()
    lose(bridge.path)
    with pytest.raises(JournalIncomplete):  # the order was for one loss
        bridge.open()


def test_an_older_copy_is_refused(bridge: Bridge) -> None:
    journal = bridge.open()
    bridge.send(journal)
    journal.close()
    copy = bridge.path.read_bytes()
    journal = bridge.open()
    bridge.send(journal)
    journal.close()
    bridge.path.write_bytes(copy)
    with pytest.raises(JournalIncomplete) as refused:
        bridge.open()
    assert refused.value.details["missing"] == {"panther1": 1}


def test_what_the_deployment_step_sends_later_is_not_missed(bridge: Bridge) -> None:
    bridge.open().close()
    bridge.send(None)
    bridge.sent[bridge.account.address] += 1
    bridge.open().close()


def test_what_somebody_sends_by_hand_while_the_bridge_looks_on_is_not_missed(bridge: Bridge) -> None:
    journal = bridge.open()
    bridge.send(None)
    Continuity(journal, bridge.node, bridge.addresses, bridge.sent).note(lambda _name: 0)
    journal.close()
    bridge.open().close()

    bridge.send(None)  # while no bridge runs
    with pytest.raises(JournalIncomplete, match="used the wallets without this bridge"):
        bridge.open()


def test_a_wallet_that_joins_with_a_past_is_taken_as_it_is(bridge: Bridge) -> None:
    bridge.send(None)
    del bridge.sent[bridge.account.address]
    bridge.open().close()


def test_what_a_shared_wallet_sends_for_others_while_no_bridge_runs_is_not_missed(bridge: Bridge) -> None:
    bridge.shared = ["panther1"]
    journal = bridge.open()
    bridge.send(journal)
    journal.close()
    for _ in range(2):
        bridge.send(None)
        bridge.open().close()
    # What it had sent until the bridge was opened last is known, whatever the site file says from then on.
    bridge.shared = []
    bridge.open().close()
    bridge.send(None)
    with pytest.raises(JournalIncomplete, match=r"bridge\.shared_wallets"):
        bridge.open()


def test_a_lost_journal_is_noticed_by_the_wallets_that_are_not_shared(
    bridge: Bridge, chain: DeployedChain
) -> None:
    deployer = keystores.address(chain.site, "organization")
    bridge.addresses["organization"], bridge.sent[deployer] = deployer, 0
    bridge.shared = ["organization"]
    journal = bridge.open()
    bridge.send(journal)
    journal.close()
    delete(bridge.path)
    with pytest.raises(JournalIncomplete) as refused:
        bridge.open()
    assert refused.value.details["missing"] == {"panther1": 1}


def test_a_damaged_journal_that_is_given_up_is_kept(bridge: Bridge) -> None:
    bridge.open().close()
    bridge.path.write_bytes(b"no database at all" * 1000)
    with pytest.raises(JournalDamaged, match="--new-journal"):
        bridge.open()
    give_up_journal(bridge.site)
    bridge.open().close()
    assert bridge.path.with_name("journal.sqlite.given-up-1").read_bytes().startswith(b"no database")


@pytest.mark.parametrize("shared", [[], ["panther1"]])
def test_a_wallet_that_another_bridge_of_the_site_served_brings_its_requests_along(
    bridge: Bridge, shared: list[str]
) -> None:
    bridge.shared = shared
    journal = bridge.open()
    bridge.send(journal)
    (asked,) = journal.unfinished()
    journal.close()

    bridge.folder = bridge.folder.with_name("bridge-panther1")
    bridge.path = bridge.folder / "31337-abc" / "journal.sqlite"
    journal = bridge.open()
    assert asked.request_id is not None
    found = journal.find("panther1", asked.request_id)
    assert found is not None and found.tx_hash == asked.tx_hash
    journal.close()


def test_one_wallet_that_cannot_be_counted_does_not_hide_what_others_sent(bridge: Bridge) -> None:
    journal = bridge.open()
    other = "0x" + "34" * 20
    continuity = Continuity(journal, bridge.node, {"other": other, **bridge.addresses}, bridge.sent)
    bridge.send(None)
    bridge.chain.node.fault = lambda method, params, answer: (
        None if params and params[0] == other else answer(method, params)
    )
    continuity.note(lambda _name: 0)
    assert set(journal.accounted()) == {"panther1"} and journal.accounted()["panther1"].nonce == bridge.nonce
    journal.close()
