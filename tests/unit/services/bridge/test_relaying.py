"""What a bridge notes of a request that it sends for somebody else."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from eth_account import Account

from rodeo.bus.messages import SignedRequest, TypedSignature
from rodeo.chain import signed_requests
from rodeo.chain.encoding import Call
from rodeo.chain.signed_requests import AbandonTask, AcceptTask, CancelTask, Challenge, Said, SubmitProof
from rodeo.commands.desk import Desk
from rodeo.commands.errors import NoPermit, NotSigned, OtherContracts
from rodeo.commands.relaying import Requests
from rodeo.errors import InvalidRequest
from rodeo.signing import typed_data
from services.bridge.wallet import Wallet, parse

ROBOT = Account.from_key("0x" + "01" * 32)
CONTRACT = "0x" + "11" * 20
NONCE = "0x" + "ab" * 32
JUDGE = "0x" + "22" * 20
DEPLOYMENT = SimpleNamespace(
    chain_id=1, address=lambda _name: CONTRACT, contracts={"DisputeJudge": JUDGE, "TaskManager": CONTRACT}
)


@pytest.fixture
def wallet() -> Wallet:
    unused: Any = SimpleNamespace()

    def called(*_: Any) -> Call:
        return Call(CONTRACT, "0x", "called")  # type: ignore[arg-type]

    client: Any = SimpleNamespace(
        deployment=DEPLOYMENT,
        calls=SimpleNamespace(submit_proof_for=called, cancel_task_for=called),
    )
    index: Any = SimpleNamespace(tasks=SimpleNamespace(get=lambda _task_id: {"nonce": NONCE}))
    return Wallet(Desk("bob", client, index, unused, unused, unused, unused), unused)


def signed(said: Said) -> dict[str, Any]:
    domain = signed_requests.domain("RODEO SignedRequests", 1, CONTRACT)
    request = SignedRequest(request=TypedSignature(typed_data=said.typed_data(domain)))
    return signed_requests.sign(request, ROBOT).model_dump(mode="json")


def test_a_proof_that_is_sent_for_somebody_is_known_by_its_task_and_assignment(wallet: Wallet) -> None:
    """After a restart, or a reorganization, it is sent again if the task still has this assignment. Without
    its task it would never be, and neither would all that the wallet sends later."""
    proof = SubmitProof(
        executor=ROBOT.address,
        task_id=7,
        attempt=2,
        proof_hash="0x" + "cd" * 32,
        uri="file:///proof",
        nonce=1,
        deadline=2_000_000_000,
    )
    (order,) = wallet.orders(parse("relay", {"signed": signed(proof)}))
    assert (order.task_id, order.attempt, order.assignment) == (7, 2, NONCE)


def test_what_is_no_proof_is_sent_again_whatever_becomes_of_its_task(wallet: Wallet) -> None:
    cancelled = CancelTask(creator=ROBOT.address, task_id=7, nonce=1, deadline=2_000_000_000)
    (order,) = wallet.orders(parse("relay", {"signed": signed(cancelled)}))
    assert (order.task_id, order.attempt, order.assignment) == (7, None, None)


TASK = {
    "kind": "0x" + b"waste_disposal".ljust(32, b"\0").hex(),
    "reward": "5",
    "executionWindow": "3600",
    "verdictWindow": "3600",
    "maxAttempts": "3",
    "rules": "0x" + "00" * 32,
    "serviceId": "0",
    "provider": "0x" + "00" * 20,
    "params": "{}",
}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("kind", "0x" + "ff" * 32),
        ("kind", "0x" + "00" * 32),
        ("maxAttempts", "256"),
        ("serviceId", str(2**32)),
        ("executionWindow", str(2**32)),
        ("params", "\ud800"),
    ],
)
def test_what_no_contract_takes_is_an_invalid_request(wallet: Wallet, field: str, value: str) -> None:
    """Anybody may have written the file."""
    message = {"creator": ROBOT.address, "request": TASK | {field: value}, "nonce": "1", "deadline": "1"}
    domain = signed_requests.domain("RODEO SignedRequests", 1, CONTRACT)
    typed = {"primaryType": "RegisterTask", "domain": domain, "message": message}
    with pytest.raises(InvalidRequest) as refused:
        wallet.orders(parse("relay", {"signed": {"request": {"typed_data": typed}}}))
    assert list(refused.value.details["fields"]) == [f"request.{field}"]


def token(name: str, version: str) -> Any:
    """A client of an organization that pays with such a token."""
    separator = typed_data.separator(signed_requests.domain(name, 1, CONTRACT, version))
    return SimpleNamespace(
        deployment=DEPLOYMENT,
        task_manager=CONTRACT,
        token=SimpleNamespace(
            name=lambda: name,
            permit_nonce=lambda _owner: 0,
            permit_domain=lambda: separator,
            allowance=lambda *_: 0,
        ),
        tasks=SimpleNamespace(is_request_nonce_used=lambda *_: False),
        calls=SimpleNamespace(register_task_for=lambda *_: None),
    )


def with_permit(permit: TypedSignature) -> SignedRequest:
    """A request to post TASK, with a permit."""
    message = {"creator": ROBOT.address, "request": TASK, "nonce": "1", "deadline": "1"}
    domain = signed_requests.domain("RODEO SignedRequests", 1, CONTRACT)
    typed = signed_requests.RegisterTask.model_validate(message).typed_data(domain)
    return SignedRequest(request=TypedSignature(typed_data=typed, signature="0x" + "00" * 65), permit=permit)


@pytest.mark.parametrize(("name", "version"), [("IECoin", "1"), ("USD Coin", "2")])
def test_a_permit_is_signed_for_the_version_of_the_token(name: str, version: str) -> None:
    """One for another version is worth nothing, and only whoever sends it would hear that."""
    permit = Requests(token(name, version)).permit(ROBOT.address, CONTRACT, 7, 2_000_000_000)
    assert permit["message"]["value"] == "7"  # and not all that the owner will ever have
    assert permit["domain"] == {
        "name": name,
        "version": version,
        "chainId": 1,
        "verifyingContract": CONTRACT,
    }


def test_where_nobody_knows_how_the_token_takes_permits_none_is_signed() -> None:
    with pytest.raises(NoPermit):
        Requests(token("Odd", "odd")).permit(ROBOT.address, CONTRACT, 7, 2_000_000_000)


def test_a_permit_is_not_sent_where_nobody_knows_how_the_token_takes_them() -> None:
    """Also one that names no contracts."""
    permit = TypedSignature(typed_data={"message": {}}, signature="0x" + "00" * 65)
    with pytest.raises(NoPermit):
        Requests(token("Odd", "odd")).calls(with_permit(permit))


def test_a_permit_is_sent_once_and_not_after_another_one_of_its_wallet() -> None:
    """It is for one reward, so a later request has its own. The first of two that were signed together
    makes the second's permit void."""
    client = token("IECoin", "1")
    client.calls = SimpleNamespace(permit=lambda *_: "permit", register_task_for=lambda *_: "register")
    requests = Requests(client)
    permit = signed_requests.sign(
        with_permit(TypedSignature(typed_data=requests.permit(ROBOT.address, CONTRACT, 5, 2_000_000_000))),
        ROBOT,
    )
    assert requests.calls(permit) == ["permit", "register"]
    client.token.permit_nonce = lambda _owner: 1
    with pytest.raises(NotSigned) as refused:
        requests.calls(permit)
    assert refused.value.details == {"owner": ROBOT.address, "signed_for_nonce": 0, "expected_nonce": 1}
    client.token.allowance = lambda *_: 5
    assert requests.calls(permit) == ["register"]
    client.token.allowance, client.tasks.is_request_nonce_used = lambda *_: 4, lambda *_: True
    assert requests.calls(permit) == ["register"]  # which fails, and nobody pays for a permit


def test_an_acceptance_and_a_return_are_sent_as_what_they_are(wallet: Wallet) -> None:
    calls: Any = wallet.desk.client.calls
    calls.accept_task_for = lambda *told: Call(CONTRACT, "0x", f"accept{told[:4]}")  # type: ignore[arg-type]
    calls.abandon_task_for = lambda *told: Call(CONTRACT, "0x", f"abandon{told[:4]}")  # type: ignore[arg-type]
    for kind, name in ((AcceptTask, "accept"), (AbandonTask, "abandon")):
        said = kind(executor=ROBOT.address, task_id=7, attempt=2, nonce=5, deadline=2_000_000_000)
        (order,) = wallet.orders(parse("relay", {"signed": signed(said)}))
        assert order.call.name == f"{name}{(ROBOT.address, 7, 2, 5)}" and order.task_id == 7


def challenge(judge: str = JUDGE) -> Challenge:
    return Challenge(
        challenger=ROBOT.address,
        judge=judge,
        task_id=7,
        attempt=2,
        instance=1,
        reason="it is in the bin",
        nonce=5,
        deadline=2_000_000_000,
    )


def test_a_challenge_is_sent_with_the_permit_for_its_stake() -> None:
    client = token("IECoin", "1")
    client.calls = SimpleNamespace(permit=lambda *said: said, challenge_for=lambda *said: said)
    requests = Requests(client)
    domain = signed_requests.domain("RODEO SignedRequests", 1, CONTRACT)
    permit = requests.permit(ROBOT.address, JUDGE, 20, 2_000_000_000)
    request = SignedRequest(
        request=TypedSignature(typed_data=challenge().typed_data(domain)),
        permit=TypedSignature(typed_data=permit),
    )
    sent: list[Any] = requests.calls(signed_requests.sign(request, ROBOT))
    permitted, (challenger, against, nonce, deadline, _) = sent
    assert permitted[:3] == (ROBOT.address, JUDGE, 20)
    assert (challenger, nonce, deadline) == (ROBOT.address, 5, 2_000_000_000)
    assert (against.judge, against.task_id, against.attempt, against.instance) == (JUDGE, 7, 2, 1)
    assert against.reason == "it is in the bin"
    client.token.allowance = lambda owner, spender: 20 if (owner, spender) == (ROBOT.address, JUDGE) else 0
    assert len(requests.calls(signed_requests.sign(request, ROBOT))) == 1  # somebody has sent the permit


def test_attack_a_challenge_is_sent_to_no_contract_that_only_its_signer_knows(wallet: Wallet) -> None:
    """Whatever that does, the sender would pay its gas."""
    for judge in ("0x" + "33" * 20, CONTRACT):
        with pytest.raises(OtherContracts) as refused:
            wallet.orders(parse("relay", {"signed": signed(challenge(judge))}))
        assert refused.value.details == {"judge": judge, "expected": JUDGE}
