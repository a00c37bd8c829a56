"""What makes a recording tamper-evident: a running hash over every message, signed while it grows.

The running hash is SHA-256 over the messages in file order, seals included. One message adds

    channel digest (32) | record length (8) | sequence (4) | log time (8) | publish time (8) | payload

in the little-endian form of the MCAP message record; the channel digest covers topic, message encoding,
schema name, schema encoding and schema text, so that the same bytes under another name hash differently.

Seals are messages on the channel `rodeo/seal`:

- the opening seal (index 0) is the first message and carries the binding to task, attempt and nonce;
- interim seals are attestations (`SealHead`): `hash` is the running hash of the `messages` before it,
  `previous` the SHA-256 of the seal before it, `recording` the SHA-256 of the opening seal;
- the final seal is the last message: EIP-712 typed data that a contract could check, too.
"""

from __future__ import annotations

import hashlib
import struct
from functools import lru_cache
from typing import Annotated, Any, Literal

from eth_utils.address import to_checksum_address
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from rodeo.evidence.attestation import Attestation, attest, recover, verify_attestation
from rodeo.evidence.errors import BadAttestation, BrokenSeal, UnsealedProof
from rodeo.signing import keys, typed_data
from rodeo.text.strict_json import read_json, write_json

SEAL_PERIOD_NS = 1_000_000_000
"""Longest stretch of recorded time that one seal leaves unsigned."""
QUIET_SEAL_PERIOD_NS = 3_000_000_000
"""The same of a recording whose statements, which are signed at once, are all that matters: a charge's. Every
seal costs whoever opens the file."""

# Remembered: every seal of a file names the same few, and hashing is slow.
_checksummed = lru_cache(maxsize=1024)(to_checksum_address)
Address = Annotated[str, Field(pattern=r"^0x[0-9a-fA-F]{40}$"), AfterValidator(_checksummed)]
Bytes32 = Annotated[str, Field(pattern=r"^0x[0-9a-fA-F]{64}$"), AfterValidator(str.lower)]


class Binding(BaseModel):
    """The assignment that a recording proves. `nonce` (0x, 32 bytes) did not exist before this assignment."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    chain_id: int = Field(ge=1, lt=2**53)
    task_manager: Address
    organization: Address
    device: str = Field(min_length=1, max_length=64)
    """Name of the device that records."""
    task_id: int = Field(ge=0, lt=2**53)
    attempt: int = Field(ge=1, lt=2**32)
    executor: Address
    nonce: Bytes32


_PARTS_AT_ONCE = 300
"""A call of the hash costs more than the bytes of one message."""


class SealHead(BaseModel):
    """The payload of the opening seal and of every interim seal, in the file and on the bus."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    type: Literal["recording.seal"] = "recording.seal"
    version: Literal[1] = 1
    chain_id: int
    task_manager: Address
    organization: Address
    device: str
    recording: str | None
    """Hex SHA-256 of the opening seal; None in the opening seal itself."""
    index: int = Field(ge=0)
    messages: int = Field(ge=0)
    hash: str
    previous: str | None
    time_ns: str
    """Decimal string, because it exceeds 2**53, the largest exact JSON number."""
    binding: Binding | None = None
    """Only in the opening seal."""


class RunningHash:
    """SHA-256 over the messages added so far, and how many they were."""

    def __init__(self) -> None:
        self._sha256 = hashlib.sha256()
        self._pending: list[bytes | memoryview] = []
        self.messages = 0

    def add(self, channel_digest: bytes, length_field: bytes | memoryview, tail: bytes | memoryview) -> None:
        """One message: its MCAP record's length field (8 bytes) and what follows the channel id in it."""
        self._pending += (channel_digest, length_field, tail)
        self.messages += 1
        if len(self._pending) >= _PARTS_AT_ONCE:
            self._absorb()

    def hexdigest(self) -> str:
        self._absorb()
        return self._sha256.copy().hexdigest()

    def _absorb(self) -> None:
        self._sha256.update(b"".join(self._pending))
        self._pending.clear()


def channel_digest(
    topic: str, message_encoding: str, schema_name: str, schema_encoding: str, schema_data: bytes
) -> bytes:
    """What the running hash knows of a channel: 32 bytes."""
    digest = hashlib.sha256()
    for part in (
        topic.encode(),
        message_encoding.encode(),
        schema_name.encode(),
        schema_encoding.encode(),
        schema_data,
    ):
        digest.update(struct.pack("<I", len(part)) + part)
    return digest.digest()


class SealChain:
    """Writes seals, each naming the one before, as the bytes of the next `rodeo/seal` message."""

    def __init__(self, binding: Binding, account: keys.Signer) -> None:
        self._binding = binding
        self._account = account
        self._index = 0
        self._previous: str | None = None
        self.recording: str | None = None
        """Hex SHA-256 of the opening seal, once there is one."""

    def next(self, running: RunningHash, time_ns: int) -> bytes:
        """The opening or an interim seal over everything in `running`."""
        binding = self._binding
        head = SealHead(
            chain_id=binding.chain_id,
            task_manager=binding.task_manager,
            organization=binding.organization,
            device=binding.device,
            recording=self.recording,
            index=self._index,
            messages=running.messages,
            hash=running.hexdigest(),
            previous=self._previous,
            time_ns=str(time_ns),
            binding=binding if self._index == 0 else None,
        )
        payload = head.model_dump(exclude=None if self._index == 0 else {"binding"})
        data = attest(payload, self._account).model_dump_json().encode()
        self.adopt(data)
        return data

    def adopt(self, data: bytes) -> None:
        """Continue after the seal `data`, which is already in the file."""
        self._index += 1
        self._previous = hashlib.sha256(data).hexdigest()
        self.recording = self.recording or self._previous

    def final(self, running: RunningHash) -> bytes:
        """The closing seal."""
        typed = final_typed_data(self._binding, running)
        signature = keys.sign(typed_data.digest(typed), self._account)
        seal = {"typed_data": typed, "signer": self._account.address, "signature": signature}
        return write_json(seal)


def final_typed_data(binding: Binding, running: RunningHash) -> dict[str, Any]:
    """EIP-712 `ProofSeal` of the assignment and all messages before the final seal."""
    return {
        "types": {
            "EIP712Domain": [
                {"name": "name", "type": "string"},
                {"name": "version", "type": "string"},
                {"name": "chainId", "type": "uint256"},
                {"name": "verifyingContract", "type": "address"},
            ],
            "ProofSeal": [
                {"name": "taskId", "type": "uint256"},
                {"name": "attempt", "type": "uint32"},
                {"name": "executor", "type": "address"},
                {"name": "nonce", "type": "bytes32"},
                {"name": "messagesHash", "type": "bytes32"},
                {"name": "messages", "type": "uint64"},
            ],
        },
        "primaryType": "ProofSeal",
        "domain": {
            "name": "RODEO",
            "version": "1",
            "chainId": binding.chain_id,
            "verifyingContract": binding.task_manager,
        },
        "message": {
            "taskId": binding.task_id,
            "attempt": binding.attempt,
            "executor": binding.executor,
            "nonce": binding.nonce,
            "messagesHash": "0x" + running.hexdigest(),
            "messages": running.messages,
        },
    }


class SealAudit:
    """Follows a recording's seals while its messages are read. Raises BrokenSeal at the first that fails.

    Every seal is compared with the messages and the seal before it. Signatures are checked where they decide:
    at the opening seal, which names the signer, and at the last one, which covers all others
    (`check_signatures`).

    `binding` and `signer` are known after the opening seal; `final` is true after the final one;
    `longest_unsealed_ns` is the longest stretch of recorded time between two seals.
    """

    def __init__(self) -> None:
        self.binding: Binding | None = None
        self.signer: str | None = None
        self.final = False
        self.count = 0
        self.longest_unsealed_ns = 0
        self.digests: list[str] = []
        """Hex SHA-256 of each seal but the final one, by index: what others list as this file's heads."""
        self._previous: str | None = None
        self._last: dict[str, Any] = {}
        self._closing: dict[str, Any] = {}

    def see(self, data: bytes, running: RunningHash, unsealed_ns: int) -> None:
        """Check the seal message `data`, which follows the messages in `running`. Nothing was sealed for
        `unsealed_ns` before it."""
        try:
            fields = read_json(data)
            if "typed_data" in fields:
                self._see_final(fields, running)
            else:
                self._see(fields, running)
        except BadAttestation as error:
            raise BrokenSeal("a seal's signature is not valid", index=self.count, **error.details) from error
        except ValueError as error:
            raise BrokenSeal("a seal is malformed", index=self.count, cause=str(error)[:500]) from error
        self._last = fields
        self._previous = hashlib.sha256(data).hexdigest()
        if not self.final:
            self.digests.append(self._previous)
        self.longest_unsealed_ns = max(self.longest_unsealed_ns, unsealed_ns)
        self.count += 1

    def check_signatures(self) -> None:
        """Check the last seal's signature, and so everything that was read."""
        if not self._last:
            raise UnsealedProof("there is no seal")
        try:
            if self.final:
                recover(typed_data.digest(self._closing), str(self._last.get("signature")), str(self.signer))
            else:
                verify_attestation(Attestation.model_validate(self._last))
        except BadAttestation as error:
            details = {"index": self.count - 1, **error.details}
            raise BrokenSeal("the last seal's signature is not valid", **details) from error
        except ValueError as error:
            raise BrokenSeal("the last seal is malformed", cause=str(error)[:500]) from error

    def _see(self, fields: dict[str, Any], running: RunningHash) -> None:
        payload = fields.get("payload")
        if not isinstance(payload, dict):
            raise ValueError("no payload")
        binding = self.binding
        if binding is None:
            head = SealHead.model_validate(payload)
            if head.binding is None:
                raise ValueError("the opening seal has no binding")
            self.signer = verify_attestation(Attestation.model_validate(fields))
            binding = self.binding = head.binding
            stated = payload | {"binding": binding.model_dump()}
        else:
            # All but the time is compared here; the model would take long for thousands of seals.
            stated = payload
            if not isinstance(payload.get("time_ns"), str):
                raise ValueError("time_ns is not a string")
        expected = self._expected(running, binding)
        if stated != expected | {"time_ns": stated["time_ns"]}:
            for name in expected:
                self._require(name, stated, expected[name])
            raise ValueError(f"unknown fields {sorted(stated.keys() - expected.keys() - {'time_ns'})[:10]}")
        self._require("signer", fields, self.signer)

    def _expected(self, running: RunningHash, binding: Binding) -> dict[str, Any]:
        """What the next seal says, but for its time."""
        expected: dict[str, Any] = {
            "type": "recording.seal",
            "version": 1,
            "chain_id": binding.chain_id,
            "task_manager": binding.task_manager,
            "organization": binding.organization,
            "device": binding.device,
            "index": self.count,
            "messages": running.messages,
            "hash": running.hexdigest(),
            "previous": self._previous,
            "recording": self.digests[0] if self.digests else None,
        }
        return expected | ({"binding": binding.model_dump()} if self.count == 0 else {})

    def _see_final(self, fields: dict[str, Any], running: RunningHash) -> None:
        if self.binding is None:
            raise BrokenSeal("the final seal comes before the opening seal", index=self.count)
        self._closing = final_typed_data(self.binding, running)
        self._require("typed_data", fields, self._closing)
        self._require("signer", fields, self.signer)
        self.final = True

    def _require(self, name: str, found: dict[str, Any], expected: object) -> None:
        if name not in found or found[name] != expected:
            raise BrokenSeal(
                f"seal {self.count} does not match the recording: {name}",
                index=self.count,
                found=str(found.get(name))[:200],
                expected=str(expected)[:200],
            )
