"""How a judge signs what it finds, and that it sits: EIP-712, for one committee on one chain, in 64 bytes
(EIP-2098)."""

from __future__ import annotations

from typing import Any

from rodeo.bus.messages import Vote
from rodeo.chain.contracts.abi import Fault, Finding, Ruling
from rodeo.chain.contracts.types import hex_bytes
from rodeo.money.currency import Currency, InvalidAmount
from rodeo.signing import keys, secp256k1, typed_data

_TYPES = {
    "Finding": [
        {"name": "taskId", "type": "uint256"},
        {"name": "attempt", "type": "uint8"},
        {"name": "proofHash", "type": "bytes32"},
        {"name": "reportHash", "type": "bytes32"},
        {"name": "rulesHash", "type": "bytes32"},
        {"name": "ruling", "type": "uint8"},
        {"name": "fault", "type": "uint8"},
        {"name": "amount", "type": "uint96"},
        {"name": "reason", "type": "string"},
    ],
    "Possession": [{"name": "key", "type": "address"}, {"name": "owner", "type": "address"}],
}
"""As `contracts/src/judges/CommitteeJudge.sol` hashes them."""
_PARITY = 0x80
"""In the first byte of s, which of two keys signed."""


def sign(vote: Vote, signer: keys.Signer, chain_id: int, committee: str, currency: Currency) -> str:
    """The signature of `signer`, 64 bytes as 0x hex."""
    return keys.sign_short(_digest(vote, chain_id, committee, currency), signer)


def signer(vote: Vote, signature: str, chain_id: int, committee: str, currency: Currency) -> str | None:
    """The address whose signature of `vote` this is; None where it is nobody's."""
    signed = bytearray.fromhex(signature.removeprefix("0x"))
    signed.append(signed[32] >> 7)
    signed[32] &= ~_PARITY
    try:
        key = secp256k1.recover(_digest(vote, chain_id, committee, currency), bytes(signed))
    except (ValueError, InvalidAmount):
        return None
    return keys.address_of(key)


def possession(key: keys.Signer, owner: str, chain_id: int, committee: str) -> tuple[bytes, bytes]:
    """By which the key agrees to sit in the committee for `owner`: r, and s with its parity (EIP-2098)."""
    said = {"key": key.address, "owner": owner}
    signed = keys.sign_short(_digest_of("Possession", said, chain_id, committee), key)
    raw = bytes.fromhex(signed[2:])
    return raw[:32], raw[32:]


def finding(vote: Vote, currency: Currency) -> Finding:
    """What the contracts are told. Raises InvalidAmount."""
    ruling = Ruling.NONE if vote.ruling == "undecided" else Ruling[vote.ruling.upper()]
    return Finding(
        task_id=vote.task_id,
        attempt=vote.attempt,
        proof_hash=hex_bytes(vote.proof_sha256),
        report_hash=hex_bytes(vote.report_sha256),
        rules_hash=hex_bytes(vote.rules_sha256),
        ruling=ruling,
        fault=Fault[vote.fault.upper()],
        amount=currency.to_units(vote.amount_iec),
        reason=vote.reason,
    )


def _digest(vote: Vote, chain_id: int, committee: str, currency: Currency) -> bytes:
    said = finding(vote, currency)
    fields = {
        "taskId": said.task_id,
        "attempt": said.attempt,
        "proofHash": vote.proof_sha256,
        "reportHash": vote.report_sha256,
        "rulesHash": vote.rules_sha256,
        "ruling": said.ruling.value,
        "fault": said.fault.value,
        "amount": said.amount,
        "reason": said.reason,
    }
    return _digest_of("Finding", fields, chain_id, committee)


def _digest_of(type_name: str, said: dict[str, Any], chain_id: int, committee: str) -> bytes:
    domain = {
        "name": "RODEO CommitteeJudge",
        "version": "1",
        "chainId": chain_id,
        "verifyingContract": committee,
    }
    return typed_data.digest_of(domain, {type_name: _TYPES[type_name]}, type_name, said)
