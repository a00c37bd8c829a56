"""Whose key signs: several wallets in one bridge, one that lives elsewhere, and a bridge per robot."""

from __future__ import annotations

import os
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from decimal import Decimal

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount
from web3 import HTTPProvider, Web3
from web3.types import Wei

from rodeo.dao import Participant
from rodeo.errors import NoResponder, RemoteError
from rodeo.instance import PARENT_VARIABLE
from rodeo.messages import RegisterService, RegisterTask, Transfer
from tests.support.dao import PARAMS, Dao
from tests.support.site import RunningSite, readyz, write_site

ALICE: LocalAccount = Account.from_key("0x" + "a1" * 32)
LIMITS = '[bridge.limits.oracle]\ndaily_iec = "10"\n'


@pytest.fixture(scope="module")
def dao(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Dao]:
    alice, bob = f'name = "alice", address = "{ALICE.address}"', 'name = "bob", kinds = ["waste_disposal"]'
    extra = f"participants = [{{ {alice} }}, {{ {bob} }}]\n{LIMITS}"
    running = RunningSite(write_site(tmp_path_factory.mktemp("wallets"), chain_backend, extra))
    organization = Dao(running)
    try:
        organization.start()
        w3 = Web3(HTTPProvider(organization.site.chain.url))
        paid = w3.eth.send_transaction(
            {"from": w3.eth.accounts[0], "to": ALICE.address, "value": Wei(10**18)}
        )
        w3.eth.wait_for_transaction_receipt(paid)
        for name in ("alice", "bob", "oracle"):
            organization.command("organization", "transfer", to=name, amount_iec="200")
        yield organization
    finally:
        organization.stop()
        running.stop()


def alice(dao: Dao, account: LocalAccount = ALICE) -> Participant:
    return Participant(dao.running.bus, dao.site.org, "alice", account)


def test_a_participant_that_signs_for_itself_uses_the_same_commands(dao: Dao) -> None:
    task = RegisterTask(
        kind="waste_disposal", reward_iec=Decimal(50), params=PARAMS, allow_wait=True, request_id="alices"
    )
    # The first also approves the TaskManager: two transactions, both signed here.
    reply = alice(dao).command("register_task", task)
    assert alice(dao).command("register_task", task) == reply
    posted = dao.task(reply.task_id or 0)
    assert (posted["creator_name"], posted["state"], posted["reward_iec"]) == ("alice", "open", "50")
    assert dao.balances()["alice"] == 150
    alice(dao).command("transfer", Transfer(to="bob", amount_iec=Decimal(1)))
    assert dao.balances()["alice"] == 149
    with pytest.raises(RemoteError) as refused:
        alice(dao).command("transfer", Transfer(to="bob", amount_iec=Decimal(1000)))
    assert refused.value.code == "insufficient_funds"


def test_the_bridge_signs_nothing_for_it(dao: Dao) -> None:
    with pytest.raises(RemoteError) as refused:
        dao.command("alice", "transfer", to="bob", amount_iec="1")
    assert refused.value.code == "wallet_elsewhere"


def test_nobody_else_can_sign_for_it(dao: Dao) -> None:
    before = dao.balances()
    stranger: LocalAccount = Account.from_key("0x" + "b2" * 32)
    with pytest.raises(RemoteError) as refused:
        alice(dao, stranger).command("transfer", Transfer(to="bob", amount_iec=Decimal(1)))
    assert refused.value.code == "not_this_wallets"
    assert refused.value.details["signer"] == stranger.address
    for raw in ("0x00", "0x02c0", "0x" + "ff" * 100):
        with pytest.raises(RemoteError) as refused:
            dao.command("alice", "broadcast", raw=raw)
        assert refused.value.code == "not_this_wallets", raw
    assert dao.balances() == before


def test_each_wallet_of_the_bridge_pays_for_itself(dao: Dao) -> None:
    before = dao.balances()
    bob = Participant(dao.running.bus, dao.site.org, "bob")
    service = RegisterService(kind="waste_disposal", price_iec=Decimal(60), request_id="bobs")
    assert (bob.command("register_service", service).service_id or 0) > 0
    bob.command("transfer", Transfer(to="organization", amount_iec=Decimal(3)))
    after = dao.balances()
    assert after == {**before, "bob": before["bob"] - 3, "organization": before["organization"] + 3}


def test_a_wallet_spends_no_more_in_a_day_than_the_site_file_says(dao: Dao) -> None:
    dao.command("oracle", "transfer", to="bob", amount_iec="6")
    with pytest.raises(RemoteError) as refused:
        dao.command("oracle", "transfer", to="bob", amount_iec="6")
    assert refused.value.code == "daily_limit_reached"
    with pytest.raises(RemoteError) as refused:
        dao.command("oracle", "transfer", to="bob", amount_iec="6", dry_run=True)
    assert refused.value.code == "daily_limit_reached"
    dao.command("oracle", "transfer", to="bob", amount_iec="4")


def test_health_and_metrics_are_served_over_http(dao: Dao) -> None:
    url = dao.running.status("bridge").metrics_url
    assert readyz(url)[0] == 200
    with urllib.request.urlopen(f"{url}/metrics") as answer:
        metrics = answer.read().decode()
    assert "rodeo_ready 1.0" in metrics and "rodeo_bus_connected 1.0" in metrics
    assert "rodeo_bridge_blocks_behind 0.0" in metrics
    assert 'rodeo_bridge_queue_length{wallet="bob"}' in metrics
    assert 'rodeo_bridge_command_seconds_bucket{command="transfer"' in metrics
    assert 'rodeo_bridge_failures_total{code="daily_limit_reached"}' in metrics


def test_a_robots_own_bridge_has_its_wallet_alone(dao: Dao) -> None:
    """Last: it takes the site's bridge away."""
    running = dao.running
    running.kill("bridge")
    own = {
        "RODEO__BRIDGE__NAME": "bridge-bob",
        "RODEO__BRIDGE__WALLETS": '["bob"]',
        "RODEO__BRIDGE__PUBLIC": "false",
        PARENT_VARIABLE: str(os.getpid()),
    }
    log = running.site.data_dir / "logs" / "bridge-bob.log"
    with open(log, "ab") as output:
        child = subprocess.Popen(
            [sys.executable, "-m", "services.bridge", "--site", str(running.path)],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, **own},
        )
    running.children["bridge-bob"] = child
    running.wait_ready("bridge-bob")
    before = dao.client().balance(dao.client().organization)
    dao.command("bob", "transfer", to="organization", amount_iec="1")
    assert dao.client().balance(dao.client().organization) == before + 10**18
    for key in (f"rodeo/{dao.site.org}/wallet/oracle/transfer", f"rodeo/{dao.site.org}/state/chain"):
        with pytest.raises(NoResponder):
            running.bus.query(key, {})
    running.kill("chain")
    url = running.status("bridge-bob").metrics_url
    running.wait_for_status("bridge-bob", lambda status: not status.ready)
    assert readyz(url)[0] == 503
