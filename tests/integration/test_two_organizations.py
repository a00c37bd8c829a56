"""One wallet that works in two organizations on one chain, each with its own contracts, data and bridge."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from web3 import HTTPProvider, Web3
from web3.types import Wei

from rodeo.signing import keystores
from tests.support.dao import Dao
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long

ORDERS = 10
SHARED = 'bridge.shared_wallets = ["panther1"]\n'
WALL_TIME = "clock.speed = 1\nclock.idle_speed = 1\n"

Both = tuple[Dao, Dao]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Both]:
    """The second one's site has the first one's chain for somebody else's node, and the robot's keystore."""
    home, guest = (tmp_path_factory.mktemp(name) for name in ("home", "guest"))
    first = Dao(RunningSite(write_site(home, chain_backend, SHARED)))
    path = write_site(guest, "external", f'org = "annex"\n{SHARED}{WALL_TIME}')
    url = first.site.chain.url
    path.write_text(re.sub("chain.url = .*", f'chain.url = "{url}"', path.read_text()))
    keys = guest / "data" / "keys"
    keys.mkdir(parents=True)
    for name in ("panther1.json", "passphrase"):
        shutil.copy(first.site.data_dir / "keys" / name, keys)
    second = Dao(RunningSite(path))
    try:
        first.start()
        give_gas_money(second)
        second.running.start("router", ready=False)
        # It sends with the robot's wallet as well.
        second.running.deploy_contracts()
        second.running.start("bridge")
        yield first, second
    finally:
        first.close()
        second.running.stop()
        first.running.stop()


def give_gas_money(dao: Dao) -> None:
    w3 = Web3(HTTPProvider(dao.site.chain.url))
    for name in keystores.wallet_names(dao.site):
        account = keystores.address(dao.site, name)
        paid = w3.eth.send_transaction({"from": w3.eth.accounts[0], "to": account, "value": Wei(10**18)})
        w3.eth.wait_for_transaction_receipt(paid)


def sent_by_robot(dao: Dao) -> int:
    return dao.client().w3.eth.get_transaction_count(keystores.address(dao.site, "panther1"))


def pay(dao: Dao, amount: int, request_id: str) -> dict[str, Any]:
    return dao.command("panther1", "transfer", to="oracle", amount_iec=f"{amount}", request_id=request_id)


def test_the_wallet_takes_tasks_proves_them_and_is_paid_in_both(both: Both) -> None:
    first, second = both
    assert keystores.address(first.site, "panther1") == keystores.address(second.site, "panther1")
    assert not set(first.client().deployment.contracts.values()) & set(
        second.client().deployment.contracts.values()
    )
    for dao in both:
        dao.command("panther1", "register_service", kind="waste_disposal", price_iec="60")
    # Both are at work at the same time.
    before = [dao.balances()["panther1"] for dao in both]
    tasks = [dao.post() for dao in both]
    for dao, task in zip(both, tasks, strict=True):
        assert dao.task(task)["executor_name"] == "panther1"
        dao.prove(task)
    for dao, task in zip(both, tasks, strict=True):
        dao.judge(task, accepted=True)
        assert dao.task(task)["state"] == "settled"
    assert [dao.balances()["panther1"] for dao in both] == [paid + 60 for paid in before]


def test_what_both_bridges_send_with_it_at_the_same_time_is_done_once_each(both: Both) -> None:
    before = [dao.balances()["oracle"] for dao in both]
    sent = sent_by_robot(both[0])
    with ThreadPoolExecutor(2 * ORDERS) as threads:
        # Different amounts, so that one that is lost does not hide another that is doubled.
        jobs = [
            threads.submit(pay, dao, 2**number, f"at once {number}")
            for number in range(ORDERS)
            for dao in both
        ]
        replies = [job.result() for job in jobs]
    assert len({reply["tx_hash"] for reply in replies}) == 2 * ORDERS
    assert sent_by_robot(both[0]) == sent + 2 * ORDERS
    assert [dao.balances()["oracle"] for dao in both] == [paid + 2**ORDERS - 1 for paid in before]
    # Asked again, they are the same ones.
    assert pay(both[0], 1, "at once 0") == replies[0] and pay(both[1], 1, "at once 0") == replies[1]


def test_a_bridge_that_was_away_while_the_wallet_worked_for_the_other_organization_goes_on(
    both: Both, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = both
    before = pay(first, 1, "before")
    first.running.kill("bridge")
    for number in range(3):
        pay(second, 1, f"alone {number}")
    first.running.start("bridge")
    assert pay(first, 1, "before") == before
    pay(first, 1, "after")

    first.running.kill("bridge")
    pay(second, 1, "alone again")
    with monkeypatch.context() as changed:
        changed.setenv("RODEO__BRIDGE__SHARED_WALLETS", "[]")
        first.running.start("bridge", ready=False)
        status = first.running.wait_for_status("bridge", lambda status: "journal" in status.reason)
    assert status.reason.startswith("the journal lacks 1 transactions that its wallets have sent")
    assert not status.ready
    first.running.kill("bridge")
    first.running.start("bridge")
    pay(first, 1, "after again")
