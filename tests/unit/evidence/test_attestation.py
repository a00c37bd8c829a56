from __future__ import annotations

import pytest
from eth_account import Account
from eth_account.messages import encode_defunct

from rodeo.evidence import Attestation, attest, verify_attestation
from rodeo.evidence.errors import BadAttestation


def test_the_signer_of_a_statement_is_recovered() -> None:
    account = Account.create()
    statement = attest({"class": "metal", "time_s": 12.5, "seq": 3}, account)
    assert verify_attestation(statement) == account.address


def test_a_statement_survives_json_and_key_order() -> None:
    account = Account.create()
    statement = attest({"b": 1.0, "a": {"y": [1, 2], "x": "ü"}}, account)
    again = Attestation.model_validate_json(statement.model_dump_json())
    shuffled = again.model_copy(update={"payload": {"a": {"x": "ü", "y": [1, 2]}, "b": 1}})
    assert verify_attestation(shuffled) == account.address


def test_any_wallet_can_check_it_as_a_personal_signature() -> None:
    account = Account.create()
    statement = attest({"a": 1}, account)
    assert (
        Account.recover_message(encode_defunct(b'{"a":1}'), signature=statement.signature) == account.address
    )


def test_a_changed_statement_is_refused_with_both_addresses() -> None:
    account = Account.create()
    forged = attest({"class": "metal"}, account).model_copy(update={"payload": {"class": "glass"}})
    with pytest.raises(BadAttestation) as caught:
        verify_attestation(forged)
    assert caught.value.details["signer"] == account.address
    assert caught.value.details["recovered"] != account.address


def test_anothers_name_under_a_signature_is_refused() -> None:
    forged = attest({"a": 1}, Account.create()).model_copy(update={"signer": Account.create().address})
    with pytest.raises(BadAttestation):
        verify_attestation(forged)


@pytest.mark.parametrize("signature", ["", "0x", "0x00", "not hex", "0x" + "ff" * 65])
def test_a_malformed_signature_is_refused(signature: str) -> None:
    forged = attest({"a": 1}, Account.create()).model_copy(update={"signature": signature})
    with pytest.raises(BadAttestation):
        verify_attestation(forged)


@pytest.mark.parametrize("value", [float("nan"), 2**60, object()])
def test_what_json_cannot_say_exactly_is_not_signed(value: object) -> None:
    with pytest.raises(BadAttestation):
        attest({"value": value}, Account.create())
