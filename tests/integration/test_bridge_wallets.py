"""The signer of each request: several wallets in one bridge, one that lives elsewhere, and a bridge per
robot."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount
from web3 import HTTPProvider, Web3
from web3.types import Wei

from rodeo.bus.messages import SignedRequest, TypedSignature
from rodeo.commands.relaying import RevokeRequest
from rodeo.commands.services import RegisterService, SetPayout, UpdateService
from rodeo.commands.tasks import CancelTask, RegisterTask, SubmitProof
from rodeo.commands.treasury import Transfer
from rodeo.dao import Participant
from rodeo.errors import NoResponder, RemoteError
from rodeo.host.instance import GAVE_UP, PARENT_VARIABLE
from rodeo.signing import keystores
from rodeo_testing.waiting import HANG_S
from tests.support import command
from tests.support.dao import PARAMS, Dao, founded
from tests.support.site import NewSite, readyz

pytestmark = pytest.mark.long

ALICE: LocalAccount = Account.from_key("0x" + "a1" * 32)
CAROL: LocalAccount = Account.from_key("0x" + "ca" * 32)
"""Has IEC and no gas money."""
LIMITS = '[bridge.limits.oracle]\ndaily_iec = "10"\n'


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    alice, bob = f'name = "alice", address = "{ALICE.address}"', 'name = "bob", kinds = ["waste_disposal"]'
    carol = f'name = "carol", address = "{CAROL.address}"'
    extra = f"participants = [{{ {alice} }}, {{ {bob} }}, {{ {carol} }}]\n{LIMITS}"
    with founded(new_site(extra)) as organization:
        w3 = Web3(HTTPProvider(organization.site.chain.url))
        paid = w3.eth.send_transaction(
            {"from": w3.eth.accounts[0], "to": ALICE.address, "value": Wei(10**18)}
        )
        w3.eth.wait_for_transaction_receipt(paid)
        for name in ("alice", "bob", "carol", "oracle"):
            organization.command("organization", "transfer", to=name, amount_iec="200")
        yield organization


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
    # What has come back may not be spent again, nor what is still to come be given away.
    cheap = dao.command("oracle", "register_task", **task("cheap", reward_iec="1").model_dump(mode="json"))
    dao.command("oracle", "cancel_task", task_id=cheap["task_id"])
    for name, fields in (
        ("raise_reward", {"task_id": cheap["task_id"], "reward_iec": "4"}),
        ("set_payout", {"payout": "bob"}),
    ):
        with pytest.raises(RemoteError) as refused:
            dao.command("oracle", name, **fields)
        assert refused.value.code == "daily_limit_reached", name
    dao.command("oracle", "transfer", to="bob", amount_iec="3")


def task(request_id: str, **fields: Any) -> RegisterTask:
    wanted = {"kind": "waste_disposal", "reward_iec": "50", "params": PARAMS, "allow_wait": True}
    return RegisterTask.model_validate(wanted | {"request_id": request_id} | fields)


def signed_by_carol(dao: Dao, request: RegisterTask, valid_s: int = 3600) -> SignedRequest:
    carol = Participant(dao.running.bus, dao.site.org, "carol", CAROL)
    return carol.sign("register_task", request, valid_s)


def relay(dao: Dao, participant: str, signed: SignedRequest) -> dict[str, Any]:
    # As somebody reads it from a file.
    return dao.command(participant, "relay", signed=json.loads(signed.model_dump_json()))


def relay_fails(dao: Dao, signed: SignedRequest) -> RemoteError:
    before = dao.balances()
    with pytest.raises(RemoteError) as refused:
        relay(dao, "bob", signed)
    assert dao.balances() == before
    return refused.value


def test_who_has_no_gas_money_signs_and_another_one_sends(dao: Dao) -> None:
    w3, before = Web3(HTTPProvider(dao.site.chain.url)), dao.balances()
    signed = signed_by_carol(dao, task("carols"))
    assert (
        signed.permit is not None
        and dao.client().token.allowance(CAROL.address, dao.client().task_manager) == 0
    )
    assert signed.permit.typed_data["message"]["value"] == str(50 * 10**18)
    task_id = relay(dao, "bob", signed)["task_id"]
    assert (dao.task(task_id)["creator_name"], dao.task(task_id)["state"]) == ("carol", "open")
    assert dao.balances() == {**before, "carol": before["carol"] - 50}
    assert dao.client().token.allowance(CAROL.address, dao.client().task_manager) == 0
    assert relay_fails(dao, signed).code == "nonce_used"
    # The same request once more is the same. It would need a permit of its own, which nobody sends.
    again = signed_by_carol(dao, task("carols"))
    assert again.request.typed_data["message"]["nonce"] == signed.request.typed_data["message"]["nonce"]
    assert again.permit is not None and relay_fails(dao, again).code == "nonce_used"
    assert dao.client().token.allowance(CAROL.address, dao.client().task_manager) == 0

    carol = Participant(dao.running.bus, dao.site.org, "carol", CAROL)
    relay(dao, "bob", carol.sign("cancel_task", CancelTask(task_id=task_id), 3600))
    assert dao.task(task_id)["state"] == "cancelled" and dao.balances() == before
    assert w3.eth.get_balance(CAROL.address) == 0


def test_nobody_sends_what_was_not_signed(dao: Dao) -> None:
    signed = signed_by_carol(dao, task("carols other"))

    def with_request(signature: str | None = signed.request.signature, **typed: Any) -> SignedRequest:
        data = signed.request.typed_data | typed
        return SignedRequest(
            request=TypedSignature(typed_data=data, signature=signature), permit=signed.permit
        )

    message = signed.request.typed_data["message"]
    dearer = message | {"request": message["request"] | {"reward": "199000000000000000000"}}
    for changed in (dearer, message | {"creator": ALICE.address}, message | {"deadline": "99999999999"}):
        refused = relay_fails(dao, with_request(message=changed))
        assert refused.code == "not_signed_by", refused
    domain = signed.request.typed_data["domain"]
    for elsewhere in (domain | {"chainId": 1}, domain | {"verifyingContract": ALICE.address}, None):
        assert relay_fails(dao, with_request(domain=elsewhere)).code == "other_contracts"
    assert relay_fails(dao, with_request(primaryType="Permit")).code == "invalid_request"
    assert relay_fails(dao, with_request(message=message | {"more": "1"})).code == "invalid_request"
    assert relay_fails(dao, with_request(message=message | {"nonce": str(2**256)})).code == "invalid_request"
    assert relay_fails(dao, with_request(signature=None)).code == "not_signed"
    assert relay_fails(dao, with_request(signature="0x")).code == "not_signed_by"
    relay(dao, "bob", signed)


def test_a_signed_request_is_revoked_or_expires(dao: Dao) -> None:
    asked = task("alices other")
    signed = alice(dao).sign("register_task", asked, 3600)
    nonce = int(signed.request.typed_data["message"]["nonce"])
    alice(dao).command("revoke_request", RevokeRequest(nonce=nonce))
    assert dao.client().tasks.is_request_nonce_used(ALICE.address, nonce)
    assert relay_fails(dao, signed).code == "nonce_used"
    late = alice(dao).sign("register_task", task("alices late"), 60)
    dao.set_clock(Web3(HTTPProvider(dao.site.chain.url)).eth.get_block("pending")["timestamp"] + 120)
    # Its permit expires at the same time, and is sent first where it is needed.
    assert relay_fails(dao, late).code in {"request_expired", "erc2612_expired_signature"}


def test_a_proof_is_sent_by_somebody_who_is_not_its_executor(dao: Dao) -> None:
    (service,) = dao.state("services", provider="bob")["services"]
    task_id = dao.post("100", service_id=service["id"])
    bob = Participant(dao.running.bus, dao.site.org, "bob")
    proof = SubmitProof(
        task_id=task_id,
        attempt=1,
        proof_sha256="0x" + "a" * 64,
        proof_uri=f"{dao.site.store_url}/{'a' * 64}.mcap",
    )
    relay(dao, "oracle", bob.sign("submit_proof", proof, 3600))
    assert dao.task(task_id)["state"] == "submitted" and dao.task(task_id)["executor_name"] == "bob"
    with pytest.raises(RemoteError) as refused:
        bob.sign("submit_proof", proof.model_copy(update={"nonce": "0x" + "7" * 64}), 3600)
    assert refused.value.code == "assignment_changed"


@pytest.mark.parametrize("who", ["organization", "oracle"])
def test_a_contract_and_a_limited_wallet_sign_nothing_for_others(dao: Dao, who: str) -> None:
    with pytest.raises(RemoteError) as refused:
        Participant(dao.running.bus, dao.site.org, who).sign("register_task", task("theirs"), 3600)
    assert refused.value.code == "cannot_sign"


def test_the_command_line_signs_into_a_file_and_sends_it(dao: Dao, tmp_path: Path) -> None:
    file, path = tmp_path / "task.json", dao.running.path

    def rodeo(*arguments: str, status: int = 0) -> str:
        done = command.rodeo("task", *arguments, "--site", str(path), env=os.environ, timeout_s=HANG_S)
        assert done.returncode == status, done.stderr
        return done.stdout + done.stderr

    create = ["create", "waste_disposal", "--reward", "40", "--wait", "--params", json.dumps(PARAMS)]
    before = dao.balances()
    assert f"rodeo task relay {file}" in rodeo(*create, "--as", "bob", "--sign", str(file))
    assert dao.balances() == before
    assert "is posted" in rodeo("relay", str(file), "--as", "oracle")
    assert dao.balances() == {**before, "bob": before["bob"] - 40}

    rodeo(*create, "--as", "bob", "--sign", str(file))
    assert "any more" in rodeo("revoke", str(file), "--as", "bob")
    assert "sign each `typed_data`" in rodeo(*create, "--as", "carol", "--sign", str(file))
    assert "not_signed" in rodeo("relay", str(file), status=1)
    file.write_text("{}")
    assert "invalid_request" in rodeo("relay", str(file), status=1)
    assert "no such folder" in rodeo(*create, "--sign", str(tmp_path / "none" / "task.json"), status=1)


def test_what_a_participant_earns_goes_where_its_key_cannot_take_it(dao: Dao) -> None:
    def paid(who: str) -> tuple[str | None, str | None]:
        wallet = dao.state("wallet", account=who)
        return wallet["payout"], wallet["payout_name"]

    def retired(service_id: int) -> UpdateService:
        return UpdateService(service_id=service_id, state="retired")

    path = str(dao.running.path)
    done = command.rodeo(
        *("service", "payout", ALICE.address, "--as", "bob", "--site", path), env=os.environ, timeout_s=HANG_S
    )
    assert (done.returncode, "alone can change this" in done.stdout) == (0, True), done.stderr
    assert paid("bob") == (ALICE.address, "alice") and paid("alice") == (None, None)
    (known,) = [one for one in dao.state("participants")["participants"] if one["name"] == "bob"]
    assert known["payout_name"] == "alice"
    # Whoever has bob's key cannot take it back.
    with pytest.raises(RemoteError) as refused:
        dao.command("bob", "set_payout", payout="bob")
    assert refused.value.code == "not_payout"
    assert refused.value.details["payout"] == ALICE.address

    mistyped = CAROL.address[:-4] + CAROL.address[-4:].swapcase()
    for nobody in (mistyped, "nobody"):
        with pytest.raises(RemoteError) as refused:
            alice(dao).command("set_payout", SetPayout(provider="bob", payout=nobody))
        assert refused.value.code == "invalid_request"

    (service,) = dao.state("services", provider="bob")["services"]
    (waits,) = dao.state("tasks", executor="bob", state="submitted")["tasks"]
    before = dao.balances()
    dao.judge(waits["id"], accepted=True)
    price = float(waits["price_iec"])
    after = dao.balances()
    assert (after["alice"], after["bob"]) == (before["alice"] + price, before["bob"])
    (payment,) = dao.state("transfers", account="alice", task_id=waits["id"])["transfers"]
    assert payment["reason"] == "payment"

    # bob's key is lost: alice has the bond back.
    alice(dao).command("update_service", retired(service["id"]))
    dao.command("organization", "set_terms", bond_iec="50")
    before = dao.balances()
    bonded = dao.command("bob", "register_service", kind="waste_disposal", price_iec="60")["service_id"]
    with pytest.raises(RemoteError) as refused:
        dao.command("oracle", "update_service", service_id=bonded, state="retired")
    assert refused.value.code == "not_provider"
    alice(dao).command("update_service", retired(bonded))
    dao.command("organization", "set_terms")
    after = dao.balances()
    assert (after["alice"], after["bob"]) == (before["alice"] + 50, before["bob"] - 50)
    alice(dao).command("set_payout", SetPayout(provider="bob", payout="bob"))
    assert paid("bob") == (None, None)


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


def test_a_bridge_whose_keystore_has_an_address_and_no_key_says_which_one_and_gives_up(dao: Dao) -> None:
    path = keystores.keystore_path(dao.site, "bob")
    whole = path.read_text()
    dao.running.kill("bridge")
    path.write_text(json.dumps({"address": json.loads(whole)["address"]}))
    try:
        dao.running.start("bridge", ready=False)
        # Starting it again would not help: its launcher leaves it.
        assert dao.running.children["bridge"].wait(timeout=HANG_S) == GAVE_UP
        told = dao.running.log("bridge")
        assert f"wallet_error: this is not a keystore (name='bob', path='{path}')" in told
    finally:
        path.write_text(whole)
    dao.running.start("bridge")
    assert dao.balances()["bob"] > 0


def test_a_robots_own_bridge_has_its_wallet_alone(dao: Dao) -> None:
    """Last: it takes the site's bridge away."""
    running = dao.running
    running.kill("bridge")
    own = {
        "RODEO__BRIDGES": '[{"name": "bob", "wallets": ["bob"]}]',
        PARENT_VARIABLE: str(os.getpid()),
    }
    log = running.site.data_dir / "logs" / "bridge.bob.log"
    with open(log, "ab") as output:
        child = subprocess.Popen(
            [sys.executable, "-m", "services.bridge", "--site", str(running.path), "--bridge", "bob"],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, **own},
        )
    running.children["bridge.bob"] = child
    running.wait_ready("bridge.bob")
    before = dao.client().token.balance(dao.client().organization)
    dao.command("bob", "transfer", to="organization", amount_iec="1")
    assert dao.client().token.balance(dao.client().organization) == before + 10**18
    for key in (f"rodeo/{dao.site.org}/wallet/oracle/transfer", f"rodeo/{dao.site.org}/state/chain"):
        with pytest.raises(NoResponder):
            running.bus.query(key, {})
    running.kill("chain")
    url = running.status("bridge.bob").metrics_url
    running.wait_for_status("bridge.bob", lambda status: not status.ready)
    assert readyz(url)[0] == 503
