"""Signatures on votes."""

from decimal import Decimal

import pytest
from eth_account import Account

from rodeo.bus.messages import Vote
from rodeo.judging import votes
from rodeo.money.currency import IEC, Currency

JUDGE = Account.from_key("0x" + "11" * 32)
COMMITTEE = "0x" + "00" * 19 + "07"
VOTE = Vote(
    task_id=7,
    attempt=1,
    proof_sha256="0x" + "3d" * 32,
    report_sha256="0x" + "4c" * 32,
    rules_sha256="0x" + "5b" * 32,
    ruling="accepted",
    amount_iec=Decimal(80),
    reason="accepted",
)


def test_a_vote_is_the_judges_who_signed_it() -> None:
    signature = votes.sign(VOTE, JUDGE, 31_337, COMMITTEE, IEC)
    assert len(signature) == 2 + 2 * 64
    assert votes.signer(VOTE, signature, 31_337, COMMITTEE, IEC) == JUDGE.address


@pytest.mark.parametrize(
    "change",
    [
        {"task_id": 8},
        {"attempt": 2},
        {"proof_sha256": "0x" + "00" * 32},
        {"report_sha256": "0x" + "00" * 32},
        {"rules_sha256": "0x" + "00" * 32},
        {"ruling": "rejected"},
        {"ruling": "undecided"},
        {"fault": "oracle"},
        {"amount_iec": Decimal(79)},
        {"reason": "paid for"},
    ],
    ids=lambda change: "-".join(map(str, *change.items())),
)
def test_of_a_changed_vote_it_is_not(change: dict[str, object]) -> None:
    signature = votes.sign(VOTE, JUDGE, 31_337, COMMITTEE, IEC)
    changed = VOTE.model_copy(update=change)
    assert votes.signer(changed, signature, 31_337, COMMITTEE, IEC) != JUDGE.address


def test_for_another_chain_or_committee_it_is_not() -> None:
    signature = votes.sign(VOTE, JUDGE, 31_337, COMMITTEE, IEC)
    assert votes.signer(VOTE, signature, 1, COMMITTEE, IEC) != JUDGE.address
    assert votes.signer(VOTE, signature, 31_337, "0x" + "00" * 20, IEC) != JUDGE.address


def test_bytes_that_are_no_signature_are_nobodys() -> None:
    assert votes.signer(VOTE, "0x" + "00" * 64, 31_337, COMMITTEE, IEC) is None
    assert votes.signer(VOTE, "0x" + "ff" * 64, 31_337, COMMITTEE, IEC) is None


def test_of_an_amount_that_the_token_cannot_pay_it_is_nobodys() -> None:
    finer = VOTE.model_copy(update={"amount_iec": Decimal("0.0000001")})
    signature = votes.sign(finer, JUDGE, 31_337, COMMITTEE, IEC)
    assert votes.signer(finer, signature, 31_337, COMMITTEE, Currency(6)) is None
