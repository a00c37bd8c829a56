"""How a device's key agrees to its owner: EIP-712, for one registry on one chain, in 64 bytes (EIP-2098)."""

from __future__ import annotations

from rodeo.signing import keys, typed_data

_TYPES = {
    "Possession": [
        {"name": "device", "type": "address"},
        {"name": "owner", "type": "address"},
        {"name": "nonce", "type": "uint256"},
    ]
}
"""As `contracts/src/DeviceRegistry.sol` hashes it."""


def sign(device: keys.Signer, owner: str, nonce: int, chain_id: int, registry: str) -> str:
    """The signature of the key `device`, 64 bytes as 0x hex. `nonce`: how often it was registered."""
    domain = {
        "name": "RODEO DeviceRegistry",
        "version": "1",
        "chainId": chain_id,
        "verifyingContract": registry,
    }
    said = {"device": device.address, "owner": owner, "nonce": nonce}
    return keys.sign_short(typed_data.digest_of(domain, _TYPES, "Possession", said), device)
