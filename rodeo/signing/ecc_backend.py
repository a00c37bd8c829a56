"""The curve as the backend of eth_keys, which eth-account and py-evm use. `rodeo` selects it."""

from __future__ import annotations

from eth_keys.backends import BaseECCBackend
from eth_keys.datatypes import BaseSignature, NonRecoverableSignature, PrivateKey, PublicKey, Signature
from eth_keys.exceptions import BadSignature

from rodeo.signing import secp256k1


class Libsecp256k1(BaseECCBackend):
    """eth_keys' own without coincurve is pure Python, which takes 10 to 100 ms for a signature."""

    def ecdsa_sign(self, msg_hash: bytes, private_key: PrivateKey) -> Signature:
        return Signature(secp256k1.sign(msg_hash, private_key.to_bytes()), backend=self)

    def ecdsa_sign_non_recoverable(self, msg_hash: bytes, private_key: PrivateKey) -> NonRecoverableSignature:
        return NonRecoverableSignature(secp256k1.sign(msg_hash, private_key.to_bytes())[:64], backend=self)

    def ecdsa_verify(self, msg_hash: bytes, signature: BaseSignature, public_key: PublicKey) -> bool:
        return secp256k1.verify(msg_hash, signature.to_bytes()[:64], public_key.to_bytes())

    def ecdsa_recover(self, msg_hash: bytes, signature: Signature) -> PublicKey:
        try:
            found = secp256k1.recover(msg_hash, signature.to_bytes())
        except ValueError as error:
            raise BadSignature(str(error)) from error
        return PublicKey(found, backend=self)

    def private_key_to_public_key(self, private_key: PrivateKey) -> PublicKey:
        return PublicKey(secp256k1.public_key(private_key.to_bytes()), backend=self)

    def decompress_public_key_bytes(self, compressed_public_key_bytes: bytes) -> bytes:
        return secp256k1.decompress(compressed_public_key_bytes)

    def compress_public_key_bytes(self, uncompressed_public_key_bytes: bytes) -> bytes:
        return secp256k1.compress(uncompressed_public_key_bytes)
