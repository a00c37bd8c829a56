"""Signatures are those that coincurve 21, which RODEO used before, made of the same keys and digests."""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from eth_account import Account
from eth_account.messages import encode_defunct, encode_typed_data
from eth_keys import KeyAPI
from eth_keys.backends import NativeECCBackend, get_backend
from eth_keys.exceptions import BadSignature

from rodeo.chain import signed_requests
from rodeo.errors import WalletError
from rodeo.evidence.seal import RunningHash, final_typed_data
from rodeo.signing import keys, keystores, secp256k1, typed_data
from rodeo.signing.ecc_backend import Libsecp256k1
from rodeo.site.config import Site
from rodeo_testing.assignments import BINDING


class Vector(NamedTuple):
    """All in hex, as coincurve 21.0.0 gave it."""

    key: str
    digest: str
    signature: str
    der: str
    public_key: str


VECTORS = [
    Vector(
        key="0000000000000000000000000000000000000000000000000000000000000001",
        digest="cc108cd840c2a5b39d87efcb8604b27db6c1eeed5ca7fb7b3290eb61c3a28dab",
        signature="5f02086f7790194c78812591b6b79ecd544bc9b5036055da02fec39a44949163"
        "542cf14574d5bd9a5728fc848cc8f2095809a2015928887525dadec381da623900",
        der="304402205f02086f7790194c78812591b6b79ecd544bc9b5036055da02fec39a449491"
        "630220542cf14574d5bd9a5728fc848cc8f2095809a2015928887525dadec381da6239",
        public_key="79be667ef9dcbbac55a06295ce870b07029bfcdb2dce28d959f2815b16f81798"
        "483ada7726a3c4655da4fbfc0e1108a8fd17b448a68554199c47d08ffb10d4b8",
    ),
    Vector(
        key="0000000000000000000000000000000000000000000000000000000000000002",
        digest="553e2d437feb40b95a9923ab9db22a5ca88a9115e65a5008e3555f95358d8903",
        signature="48c2573720b3c8fa4cf9301060837eb61e63795da82eb4a38119a06fc6bab5da"
        "387e1974feb389275941a11efb2af9cd98a46349c87eec50eb6a624a26f6bb5500",
        der="3044022048c2573720b3c8fa4cf9301060837eb61e63795da82eb4a38119a06fc6bab5"
        "da0220387e1974feb389275941a11efb2af9cd98a46349c87eec50eb6a624a26f6bb55",
        public_key="c6047f9441ed7d6d3045406e95c07cd85c778e4b8cef3ca7abac09b95c709ee5"
        "1ae168fea63dc339a3c58419466ceaeef7f632653266d0e1236431a950cfe52a",
    ),
    Vector(
        key="b135be3e959c50d69c417401e553727ad606358ef7bf7df6aa593400cd778a01",
        digest="0c10809a7a20b6bd0dcdec331679552b7b41e53c79a9fe73927567fb85545849",
        signature="c55de47afc8a913afe811af88371561578e0ad7b0ca9f7b3ab29f24bb7087adb"
        "0aba80498f14e68aea224db2737a0c8cbc0777be32e702e1a75cf7e316ef02aa01",
        der="3045022100c55de47afc8a913afe811af88371561578e0ad7b0ca9f7b3ab29f24bb708"
        "7adb02200aba80498f14e68aea224db2737a0c8cbc0777be32e702e1a75cf7e316ef02aa",
        public_key="0db4570521f28d105db9a127898562c12e052a63b2d6c760f881c80c746e644e"
        "fcb84b56849e447747151c7369b9fe98b6ac6ba6b7d4cd6c6473aca88661daba",
    ),
    Vector(
        key="fffffffffffffffffffffffffffffffebaaedce6af48a03bbfd25e8cd0364140",
        digest="c930b6132bf68e9c4aee8774558b373691dbdc9ccbb03ef39feafb7bd48c5d94",
        signature="8f1bd665ebd25e881760578ad0021d9f385f42876ea32e14205ee756481a186c"
        "6f2e2e69593ff90b34dadd3fbe1ebe842223a5abb5085838de0507912b5cc13001",
        der="30450221008f1bd665ebd25e881760578ad0021d9f385f42876ea32e14205ee756481a"
        "186c02206f2e2e69593ff90b34dadd3fbe1ebe842223a5abb5085838de0507912b5cc130",
        public_key="79be667ef9dcbbac55a06295ce870b07029bfcdb2dce28d959f2815b16f81798"
        "b7c52588d95c3b9aa25b0403f1eef75702e84bb7597aabe663b82f6f04ef2777",
    ),
]
"""The smallest keys, any key, and the largest."""


@pytest.fixture(params=VECTORS)
def vector(request: pytest.FixtureRequest) -> Vector:
    found: Vector = request.param
    return found


def test_a_recoverable_signature_is_the_same_as_before(vector: Vector) -> None:
    signature = secp256k1.sign(bytes.fromhex(vector.digest), bytes.fromhex(vector.key))
    assert signature.hex() == vector.signature
    assert secp256k1.recover(bytes.fromhex(vector.digest), signature).hex() == vector.public_key


def test_a_signature_in_der_is_the_same_as_before(vector: Vector) -> None:
    der = secp256k1.sign_der(bytes.fromhex(vector.digest), bytes.fromhex(vector.key))
    assert der.hex() == vector.der
    assert secp256k1.compact(der).hex() == vector.signature[:-2]


def test_a_public_key_is_the_same_as_before(vector: Vector) -> None:
    public_key = secp256k1.public_key(bytes.fromhex(vector.key))
    assert public_key.hex() == vector.public_key
    assert secp256k1.decompress(secp256k1.compress(public_key)) == public_key


def test_what_is_no_signature_recovers_nothing() -> None:
    for signature in (b"", bytes(65), b"\xff" * 65, bytes(64) + b"\x02"):
        with pytest.raises(ValueError):
            secp256k1.recover(bytes(32), signature)


def test_eth_account_and_py_evm_use_it_and_not_the_backend_in_pure_python() -> None:
    assert isinstance(get_backend(), Libsecp256k1)
    assert isinstance(KeyAPI().backend, Libsecp256k1)


def test_the_backend_does_what_eth_keys_own_does(vector: Vector) -> None:
    native, ours = KeyAPI(NativeECCBackend()), KeyAPI(Libsecp256k1())
    digest, key = bytes.fromhex(vector.digest), ours.PrivateKey(bytes.fromhex(vector.key))
    signature = ours.ecdsa_sign(digest, key)
    assert signature.to_bytes() == native.ecdsa_sign(digest, key).to_bytes()
    short = ours.ecdsa_sign_non_recoverable(digest, key)
    assert short.to_bytes() == native.ecdsa_sign_non_recoverable(digest, key).to_bytes()
    public_key = ours.ecdsa_recover(digest, signature)
    assert public_key == native.ecdsa_recover(digest, signature) == key.public_key
    assert ours.ecdsa_verify(digest, short, public_key)
    assert not ours.ecdsa_verify(hashlib.sha256(digest).digest(), short, public_key)
    assert public_key.to_compressed_bytes() == native.private_key_to_public_key(key).to_compressed_bytes()
    assert ours.PublicKey.from_compressed_bytes(public_key.to_compressed_bytes()) == public_key
    with pytest.raises(BadSignature):
        ours.ecdsa_recover(digest, ours.Signature(bytes(65)))


def test_a_key_signs_a_personal_message_as_eth_account_does(vector: Vector) -> None:
    key, account = keys.Key(bytes.fromhex(vector.key)), Account.from_key(vector.key)
    assert key.address == account.address
    for text in (b"", b'{"a":1}', b"x" * 1000):
        expected = account.sign_message(encode_defunct(text)).signature.to_0x_hex()
        assert keys.sign(keys.personal_digest(text), key) == expected


def test_a_key_is_not_in_its_text(vector: Vector) -> None:
    assert vector.key not in repr(keys.Key(bytes.fromhex(vector.key)))


def _messages() -> list[dict[str, Any]]:
    """One of each kind of typed data that RODEO signs, but for votes and possession, which have tests."""
    address, domain = "0x" + "Ab" * 20, signed_requests.domain("RODEO", 31_337, "0x" + "12" * 20)
    task = signed_requests.TypedTask(
        kind="0x" + b"waste_disposal".ljust(32, b"\0").hex(),
        reward=2**255,
        execution_window=3600,
        verdict_window=60,
        max_attempts=2,
        rules="0x" + "cd" * 32,
        service_id=0,
        provider=address,
        params='{"item": "Dose für Öl"}',
    )
    said = [
        signed_requests.RegisterTask(creator=address, request=task, nonce=7, deadline=2**64),
        signed_requests.CancelTask(creator=address, task_id=1, nonce=4, deadline=2),
        signed_requests.SubmitProof(
            executor=address,
            task_id=1,
            attempt=1,
            proof_hash="0x" + "0f" * 32,
            uri="file:///a",
            nonce=5,
            deadline=3,
        ),
        signed_requests.AcceptTask(executor=address, task_id=1, attempt=1, nonce=6, deadline=3),
        signed_requests.AbandonTask(executor=address, task_id=1, attempt=1, nonce=6, deadline=3),
        signed_requests.Permit(owner=address, spender=address, value=2**256 - 1, nonce=0, deadline=1),
    ]
    return [*(one.typed_data(domain) for one in said), final_typed_data(BINDING, RunningHash())]


@pytest.mark.parametrize("typed", _messages(), ids=lambda typed: typed["primaryType"])
def test_typed_data_has_the_digest_that_eth_account_signs(typed: dict[str, Any]) -> None:
    account = Account.create()
    expected = account.sign_message(encode_typed_data(full_message=typed))
    assert typed_data.digest(typed) == expected.message_hash
    assert keys.sign(typed_data.digest(typed), account) == expected.signature.to_0x_hex()
    assert typed_data.separator(typed["domain"]) == encode_typed_data(full_message=typed).header


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("taskId", -1),
        ("taskId", 2**256),
        ("taskId", True),
        ("creator", "0x12"),
        ("deadline", None),
        ("more", 1),
    ],
)
def test_typed_data_that_does_not_fit_its_types_is_refused(name: str, value: object) -> None:
    typed = _messages()[1]
    with pytest.raises(ValueError):
        typed_data.digest(typed | {"message": typed["message"] | {name: value}})


def test_what_is_no_typed_data_is_refused() -> None:
    for typed in ({}, {"domain": {"colour": "red"}, "types": {}, "primaryType": "A", "message": {}}):
        with pytest.raises(ValueError):
            typed_data.digest(typed)


@pytest.mark.parametrize(("kdf", "work"), [("scrypt", 2), ("pbkdf2", 1)])
def test_a_keystore_of_eth_accounts_opens(site_path: Path, kdf: Any, work: int, monkeypatch: Any) -> None:
    site, account = Site.load(site_path), Account.create()
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "a passphrase, ü")
    path = keystores.keystore_path(site, "oracle")
    path.parent.mkdir(parents=True)
    keystore = Account.encrypt(account.key, "a passphrase, ü", kdf=kdf, iterations=work)
    path.write_text(json.dumps(keystore))
    assert keystores.open_key(site, "oracle").key == bytes(account.key)
    for wrong in ({"version": 4}, {"crypto": keystore["crypto"] | {"cipher": "aes-256-ctr"}}):
        path.write_text(json.dumps(keystore | wrong))
        with pytest.raises(WalletError, match="not a keystore"):
            keystores.open_key(site, "oracle")
