"""Approvals of IECoin that are signed instead of sent (EIP-2612): the spender's transaction carries them."""

from __future__ import annotations

from typing import NamedTuple

from eth_account.signers.local import LocalAccount
from eth_utils import to_checksum_address

from rodeo.chain.client import ChainClient


class Permit(NamedTuple):
    """What `permit` and `registerTaskWithPermit` take after the amount."""

    deadline: int
    """Last block time at which it counts, s."""
    v: int
    r: bytes
    s: bytes


def sign_permit(
    client: ChainClient, owner: LocalAccount, amount: int, deadline: int, spender: str | None = None
) -> Permit:
    """`owner` lets `spender` (the TaskManager unless another is named) take `amount` wei.

    Reads the owner's nonce from the node, so it is good for the owner's next permit only. A permit replaces
    what the owner approved before: not for a wallet that has approved the spender once and for all.
    """
    signed = owner.sign_typed_data(
        domain_data={
            "name": "IECoin",
            "version": "1",
            "chainId": client.deployment.chain_id,
            "verifyingContract": client.deployment.address("IECoin"),
        },
        message_types={
            "Permit": [
                {"name": "owner", "type": "address"},
                {"name": "spender", "type": "address"},
                {"name": "value", "type": "uint256"},
                {"name": "nonce", "type": "uint256"},
                {"name": "deadline", "type": "uint256"},
            ]
        },
        message_data={
            "owner": owner.address,
            "spender": to_checksum_address(spender or client.task_manager),
            "value": amount,
            "nonce": client.permit_nonce(owner.address),
            "deadline": deadline,
        },
    )
    return Permit(deadline, signed.v, signed.r.to_bytes(32), signed.s.to_bytes(32))
