from __future__ import annotations

from typing import Any

import pytest
import rfc8785
from eth_account import Account
from eth_account.messages import encode_defunct
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rodeo.evidence.attestation import Attestation, attest, canonical_json, verify_attestation
from rodeo.evidence.errors import BadAttestation

_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.text('az09 _"\\\x7f\x1f'),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(st.dictionaries(st.text(max_size=4), _VALUES, max_size=5))
@example({"soc": 42.0, "zero": -0.0, "small": 1e-5, "large": 1e16, "v": [0.0001, 5e-324]})
@example({"the first whole number that stands for two": 2.0**53})
@example({"no number of JSON": float("-inf")})
@example({"the last that Python writes without an exponent": -9007199254740994.0})
def test_the_canonical_form_is_that_of_rfc_8785(payload: dict[str, Any]) -> None:
    try:
        expected = rfc8785.dumps(payload)
    except rfc8785.CanonicalizationError:
        with pytest.raises(BadAttestation):
            canonical_json(payload)
    else:
        assert canonical_json(payload) == expected


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


@pytest.mark.parametrize("value", [float("nan"), 2**60, object(), "\ud800", {"\ud800": 1}])
def test_what_json_cannot_say_exactly_is_not_signed(value: object) -> None:
    with pytest.raises(BadAttestation):
        attest({"value": value}, Account.create())


def test_a_signature_is_the_one_that_other_wallets_make_and_accept() -> None:
    account, payload = Account.create(), {"class": "glass", "index": 3}
    message = encode_defunct(canonical_json(payload))
    signed = attest(payload, account)
    assert signed.signature == "0x" + account.sign_message(message).signature.hex()
    assert Account.recover_message(message, signature=signed.signature) == account.address


@pytest.mark.parametrize("v", range(256))
def test_the_last_byte_of_a_signature_has_one_of_four_values(v: int) -> None:
    signed = attest({"a": 1}, Account.create())
    right = int(signed.signature[-2:], 16)
    other = signed.model_copy(update={"signature": f"{signed.signature[:-2]}{v:02x}"})
    if v in (right, right - 27):
        assert verify_attestation(other) == signed.signer
    else:
        with pytest.raises(BadAttestation):
            verify_attestation(other)
