"""An organization that pays in a token with 6 decimals and without permit, which was there before it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from decimal import Decimal

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount
from web3 import HTTPProvider, Web3
from web3.types import Wei

from rodeo.commands.relaying import AllowPayments
from rodeo.commands.tasks import RegisterTask
from rodeo.dao import Participant
from rodeo.errors import RemoteError
from rodeo.signing import keystores
from rodeo_cli.formatting import iec
from rodeo_testing.waiting import HANG_S
from tests.support import command
from tests.support.dao import PARAMS, Dao, founded
from tests.support.plain_token import ADDRESS, PlainToken
from tests.support.site import NewSite, RunningSite

pytestmark = pytest.mark.long

TOKEN = 10**6
CAROL: LocalAccount = Account.from_key("0x" + "ca" * 32)


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    extra = (
        f'economy.token = {{ address = "{ADDRESS}", decimals = 6 }}\n'
        f'participants = [{{ name = "carol", address = "{CAROL.address}" }}]\n'
        "governance.budgets = {}\n"
    )

    def make_token(running: RunningSite) -> None:
        token = PlainToken(running.site.chain.url, 6)
        for name in ("organization", "panther1"):
            token.mint(keystores.address(running.site, name), 1000 * TOKEN)
        token.mint(CAROL.address, 50 * TOKEN)

    path = new_site(extra)
    with founded(path, before_contracts=make_token) as organization:
        # The treasury is paid in by the operator's own account.
        organization.command("organization", "deposit", amount_iec="400.000001")
        yield organization


def balances(dao: Dao) -> dict[str, Decimal]:
    return {one["name"]: Decimal(one["balance_iec"]) for one in dao.state("wallets")["wallets"]}


def test_a_task_goes_from_its_creation_to_its_payment(dao: Dao) -> None:
    client = dao.client()
    assert client.deployment.contracts["IECoin"] == ADDRESS and client.currency.decimals == 6
    assert balances(dao) == {
        "organization": Decimal("400.000001"),
        "panther1": 1000,
        "oracle": 0,
        "carol": 50,
    }
    dao.command("organization", "set_terms", bond_iec="20.5", penalty_iec="0.000001")
    service = dao.command("panther1", "register_service", kind="waste_disposal", price_iec="79.123456")
    offered = dao.state("services")["services"][0]
    assert (offered["price_iec"], offered["bond_iec"]) == ("79.123456", "20.5")
    assert client.services.service(service["service_id"]).price == 79_123_456

    task_id = dao.post("100.25")
    task = dao.task(task_id)
    assert (task["state"], task["reward_iec"], task["price_iec"]) == ("assigned", "100.25", "79.123456")
    assert client.tasks.task(task_id).reward == 100_250_000
    dao.prove(task_id)
    with pytest.raises(RemoteError) as refused:
        dao.verdict(task_id, "accepted", amount_iec="79.123457")
    assert refused.value.code == "invalid_amount" and refused.value.details["max_iec"] == "79.123456"
    dao.judge(task_id, accepted=True)
    task = dao.task(task_id)
    assert (task["state"], task["paid_iec"], task["refunded_iec"]) == ("settled", "79.123456", "21.126544")
    assert balances(dao)["panther1"] == Decimal(1000) - Decimal("20.5") + Decimal("79.123456")
    assert balances(dao)["organization"] == Decimal("400.000001") - Decimal("79.123456")
    reasons = [one["reason"] for one in dao.state("transfers", task_id=task_id)["transfers"]]
    assert sorted(reasons) == ["escrow", "payment", "surplus"]
    (reputation,) = [one["reputation"] for one in dao.state("services")["services"]]
    assert reputation == client.services.service(service["service_id"]).reputation > 32
    settled = next(event for event in dao.events if event.name == "TaskSettled")
    assert settled.args["paid_iec"] == "79.123456"
    supply = dao.state("wallets")["supply_iec"]
    assert supply == "2050" and Decimal(supply) * TOKEN == client.token.total_supply()


def test_what_is_finer_than_the_token_is_refused_and_not_rounded(dao: Dao) -> None:
    before = balances(dao)
    for participant, name, fields in (
        ("organization", "transfer", {"to": "carol", "amount_iec": "0.0000001"}),
        ("panther1", "update_service", {"service_id": 1, "price_iec": "0.1234567"}),
    ):
        with pytest.raises(RemoteError) as refused:
            dao.command(participant, name, **fields)
        assert refused.value.code == "invalid_amount"
        assert refused.value.details["decimals"] == 6
    assert balances(dao) == before


def test_who_signs_for_another_to_send_has_to_approve_first(dao: Dao) -> None:
    carol = Participant(dao.running.bus, dao.site.org, "carol", CAROL)
    request = RegisterTask(
        kind="waste_disposal", reward_iec=Decimal("12.5"), params=PARAMS, allow_wait=True, request_id="one"
    )
    with pytest.raises(RemoteError) as refused:
        carol.sign("register_task", request, 3600)
    assert refused.value.code == "no_permit"
    w3 = Web3(HTTPProvider(dao.site.chain.url))
    gas_money = w3.eth.send_transaction(
        {"from": w3.eth.accounts[0], "to": CAROL.address, "value": Wei(10**18)}
    )
    w3.eth.wait_for_transaction_receipt(gas_money)
    carol.command("allow_payments", AllowPayments())
    with pytest.raises(RemoteError) as refused:
        carol.command("allow_payments", AllowPayments())
    assert refused.value.code == "invalid_request"
    signed = carol.sign("register_task", request, 3600)
    assert signed.permit is None
    task_id = dao.command("oracle", "relay", signed=signed.model_dump(mode="json"))["task_id"]
    assert (dao.task(task_id)["creator_name"], dao.task(task_id)["reward_iec"]) == ("carol", "12.5")
    assert balances(dao)["carol"] == Decimal("37.5")


def test_the_command_line_shows_what_the_token_has(dao: Dao) -> None:
    path = str(dao.running.path)
    done = command.rodeo("wallet", "panther1", "--site", path, env=os.environ, timeout_s=HANG_S)
    assert done.returncode == 0 and iec(balances(dao)["panther1"]) in done.stdout, done.stdout + done.stderr
