"""How an oracle signs its vote: EIP-712, for one committee on one chain, in 64 bytes (EIP-2098)."""

from __future__ import annotations

from eth_account import Account
from eth_account.messages import SignableMessage, encode_typed_data
from eth_account.signers.local import LocalAccount
from eth_keys.exceptions import BadSignature, ValidationError

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
_PARITY = 1 << 255


def sign(vote: Vote, account: LocalAccount, chain_id: int, committee: str, currency: Currency) -> str:
    """The signature of `account`, 64 bytes as 0x hex."""
    signed = account.sign_message(_message(vote, chain_id, committee, currency))
    vs = signed.s | (_PARITY if signed.v == 28 else 0)
    return "0x" + signed.r.to_bytes(32).hex() + vs.to_bytes(32).hex()


def signer(vote: Vote, signature: str, chain_id: int, committee: str, currency: Currency) -> str | None:
    """The address whose signature of `vote` this is; None where it is nobody's."""
    r, vs = (int.from_bytes(bytes.fromhex(part)) for part in (signature[2:66], signature[66:]))
    v = 28 if vs & _PARITY else 27
    try:
        found: str = Account.recover_message(
            _message(vote, chain_id, committee, currency), vrs=(v, r, vs & ~_PARITY)
        )
    except (BadSignature, ValidationError, InvalidAmount):
        return None
    return found


def _message(vote: Vote, chain_id: int, committee: str, currency: Currency) -> SignableMessage:
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
    return encode_typed_data(domain, _TYPES, said)
