"""A meter's record as other software reads it: OCMF 1.2, the Open Charge Metering Format of S.A.F.E. e.V.

The text is `OCMF|{data}|{signature}`. The signature is ECDSA on secp256k1 over the SHA-256 of exactly that
data, with the device's key, DER in hex. The data is made of nothing but the record, so that there
is one text for each record, and who holds the record can tell whether its text says the same.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from hashlib import sha256
from typing import Any

from rodeo.evidence.errors import BadStatement
from rodeo.signing import keys, secp256k1
from rodeo.witness.statement import MeterRecord

ALGORITHM = "ECDSA-secp256k1-SHA256"
REGISTER = "01-00:B0.08.00*FF"
"""OBIS code, OCMF 1.2 table 25: total energy at the meter."""
EXTENSION = "XR"
"""Field for what the format does not know: the record's binding and heads."""
_TRANSACTION = {"opening": "B", "step": "C", "pause": "S", "close": "E"}
"""Reason of a record -> TX, OCMF 1.2 table 7."""


def data(record: MeterRecord) -> str:
    """The data of the record's text. PG counts the records in the device's life, as `seq` does.

    Raises BadStatement when the record has a time that no calendar has.
    """
    try:
        read_at = datetime.fromtimestamp(round(record.until_s * 1000) / 1000, UTC)
    except (OverflowError, OSError, ValueError) as error:
        raise BadStatement("no such time", until_s=record.until_s) from error
    fields: dict[str, Any] = {
        "FV": "1.2",
        "GI": "RODEO dock",
        "GS": record.device,
        "PG": f"T{record.seq}",
        "MV": "RODEO",
        "MM": "dock meter",
        "MS": record.device,
        "IS": True,
        "IL": "TRUSTED",
        "IT": "CENTRAL",
        "ID": record.robot,
        "RD": [
            {
                "TM": read_at.isoformat(timespec="milliseconds")
                .replace(".", ",")
                .replace("+00:00", "+0000 S"),
                "TX": _TRANSACTION[record.reason],
                "RV": record.register_wh,
                "RI": REGISTER,
                "RU": "Wh",
                "RT": "DC",
                "EF": "",
                "ST": "G",
            }
        ],
        EXTENSION: {
            "chain_id": record.chain_id,
            "task_manager": record.task_manager,
            "organization": record.organization,
            "task_id": record.task_id,
            "attempt": record.attempt,
            "recording": record.recording,
            "page": record.page,
            "begin_wh": record.begin_wh,
            "previous": record.previous,
            "heads": [[one.address, one.chain, one.index, one.digest] for one in record.heads],
        },
    }
    # A bar is the format's own separator.
    return json.dumps(fields, separators=(",", ":")).replace("|", "\\u007c")


def sign(text: str, key: bytes) -> str:
    """The OCMF text with this data, signed with the 32 bytes of a device's private key."""
    signature = secp256k1.sign_der(sha256(text.encode()).digest(), key)
    signed = {"SA": ALGORITHM, "SE": "hex", "SD": signature.hex()}
    return f"OCMF|{text}|{json.dumps(signed, separators=(',', ':'))}"


def check(record: MeterRecord, address: str) -> None:
    """Raises BadStatement unless the record's text says what the record says, signed by `address`."""
    expected = data(record)
    parts = record.ocmf.split("|")
    if len(parts) != 3 or parts[:2] != ["OCMF", expected]:
        raise BadStatement("the OCMF text does not match the record", page=record.page, ocmf=record.ocmf[:64])
    if not _is_signed(expected, parts[2], address):
        raise BadStatement("the OCMF text is not signed by its device", page=record.page, device=address)


def _is_signed(text: str, signature: str, address: str) -> bool:
    """Whether `address` may have signed: two keys fit an ECDSA signature."""
    try:
        fields = json.loads(signature)
        if (fields["SA"], fields["SE"], len(fields)) != (ALGORITHM, "hex", 3):
            return False
        compact = secp256k1.compact(bytes.fromhex(fields["SD"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return False  # what is no signature has no signer
    return any(_signer(text, compact + bytes([parity])) == address.lower() for parity in (0, 1))


def _signer(text: str, recoverable: bytes) -> str | None:
    """The lower-case address of the key that this signature fits; None if there is none."""
    try:
        return keys.address_of(secp256k1.recover(sha256(text.encode()).digest(), recoverable)).lower()
    except ValueError:
        return None
