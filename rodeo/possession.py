"""How a device's key agrees to its owner: EIP-712, for one registry on one chain, in 64 bytes (EIP-2098)."""

from __future__ import annotations

from eth_account.messages import encode_typed_data
from eth_account.signers.local import LocalAccount

_TYPES = {
    "Possession": [
        {"name": "device", "type": "address"},
        {"name": "owner", "type": "address"},
        {"name": "nonce", "type": "uint256"},
    ]
}
"""As `contracts/src/DeviceRegistry.sol` hashes it."""
_PARITY = 1 << 255


def sign(account: LocalAccount, owner: str, nonce: int, chain_id: int, registry: str) -> str:
    """The signature of the device key `account`, 64 bytes as 0x hex. `nonce`: how often it was registered."""
    domain = {
        "name": "RODEO DeviceRegistry",
        "version": "1",
        "chainId": chain_id,
        "verifyingContract": registry,
    }
    said = {"device": account.address, "owner": owner, "nonce": nonce}
    signed = account.sign_message(encode_typed_data(domain, _TYPES, said))
    vs = signed.s | (_PARITY if signed.v == 28 else 0)
    return "0x" + signed.r.to_bytes(32).hex() + vs.to_bytes(32).hex()
