"""How an oracle signs its vote: EIP-712, for one committee on one chain, in 64 bytes (EIP-2098)."""

from __future__ import annotations

from rodeo import keys, secp256k1, typed_data
from rodeo.chain.abi import Verdict
from rodeo.currency import Currency, InvalidAmount
from rodeo.messages import Vote

_TYPES = {
    "Vote": [
        {"name": "taskId", "type": "uint256"},
        {"name": "attempt", "type": "uint8"},
        {"name": "proofHash", "type": "bytes32"},
        {"name": "reportHash", "type": "bytes32"},
        {"name": "rulesHash", "type": "bytes32"},
        {"name": "verdict", "type": "uint8"},
        {"name": "amount", "type": "uint256"},
        {"name": "reason", "type": "string"},
    ]
}
"""As `contracts/src/OracleCommittee.sol` hashes it."""
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


def _digest(vote: Vote, chain_id: int, committee: str, currency: Currency) -> bytes:
    domain = {
        "name": "RODEO OracleCommittee",
        "version": "1",
        "chainId": chain_id,
        "verifyingContract": committee,
    }
    said = {
        "taskId": vote.task_id,
        "attempt": vote.attempt,
        "proofHash": vote.proof_sha256,
        "reportHash": vote.report_sha256,
        "rulesHash": vote.rules_sha256,
        "verdict": Verdict[vote.outcome.upper()].value,
        "amount": currency.to_units(vote.amount_iec),
        "reason": vote.reason,
    }
    return typed_data.digest_of(domain, _TYPES, "Vote", said)
