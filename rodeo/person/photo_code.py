"""The code that a person's photo should show: it did not exist before the assignment, nor did the photo."""

from __future__ import annotations

from hashlib import sha256

ALPHABET = "34679ACDEFGHJKMNPQRTVWXY"
"""Without what handwriting confuses: 0 O, 1 I L, 2 Z, 5 S, 8 B, U."""
_CHARACTERS = 5


def photo_code(nonce: str) -> str:
    """Five characters from an assignment's nonce (0x, 32 bytes), for example `K7-3FQ`.

    One of eight million: nobody guesses the code of an assignment that is yet to come. It tells photos of
    different assignments apart, it is no secret.
    """
    number = int.from_bytes(sha256(b"photo code" + bytes.fromhex(nonce.removeprefix("0x"))).digest())
    code = ""
    for _ in range(_CHARACTERS):
        number, index = divmod(number, len(ALPHABET))
        code += ALPHABET[index]
    return f"{code[:2]}-{code[2:]}"
