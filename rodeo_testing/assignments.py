"""An assignment as the chain records it, with the keys of everybody who has a part in it."""

from __future__ import annotations

from decimal import Decimal
from secrets import token_bytes
from typing import Any, Protocol

from eth_account import Account
from eth_account.datastructures import SignedMessage
from eth_account.messages import SignableMessage, _hash_eip191_message
from eth_account.signers.local import LocalAccount
from eth_keys import keys
from hexbytes import HexBytes

from rodeo.bus.messages import Device, Task
from rodeo.checks.case import ChainRecord
from rodeo.evidence.seal import Binding
from rodeo.signing import secp256k1


class Take(Protocol):
    """From when to when something was filmed (`rodeo_testing.recordings.Take`)."""

    @property
    def start_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...


class DeviceKey(LocalAccount):
    """A new key that signs the same as eth-account's, at a fifth of the cost: a charge has 1000."""

    def __init__(self) -> None:
        super().__init__(keys.PrivateKey(token_bytes(32)), Account())

    def sign_message(self, signable_message: SignableMessage) -> SignedMessage:
        digest = _hash_eip191_message(signable_message)
        signature = secp256k1.sign(digest, bytes(self.key))
        r, s, v = signature[:32], signature[32:64], signature[64] + 27
        numbers = int.from_bytes(r), int.from_bytes(s), v
        return SignedMessage(HexBytes(digest), *numbers, HexBytes(signature[:64] + bytes([v])))


ROBOT, BIN, METER, MOCAP = (DeviceKey() for _ in range(4))
EXECUTOR = Account.create().address
ORGANIZATION = Account.create().address

BINDING = Binding(
    chain_id=31337,
    task_manager="0x" + "12" * 20,
    organization=ORGANIZATION,
    device="panther1",
    task_id=7,
    attempt=1,
    executor=EXECUTOR,
    nonce="0x" + "cd" * 32,
)
CHARGE_BINDING = BINDING.model_copy(update={"executor": ORGANIZATION, "device": "dock1"})


def devices() -> list[Device]:
    return [
        Device(address=ROBOT.address, role="robot", owner=EXECUTOR, name="panther1"),
        Device(address=BIN.address, role="bin", owner=ORGANIZATION, name="itrash"),
        Device(address=METER.address, role="meter", owner=ORGANIZATION, name="dock1"),
        Device(address=MOCAP.address, role="mocap", owner=ORGANIZATION, name="mocap"),
    ]


def chain_record(take: Take, kind: str, params: dict[str, Any], **task: Any) -> ChainRecord:
    """The chain's view of an assignment during which `take` was filmed; `task` replaces fields of it."""
    fields: dict[str, Any] = {
        "id": BINDING.task_id,
        "kind": kind,
        "state": "submitted",
        "attempt": BINDING.attempt,
        "max_attempts": 3,
        "creator": ORGANIZATION,
        "creator_name": "organization",
        "executor": EXECUTOR,
        "executor_name": "panther1",
        "service_id": 1,
        "reward_iec": Decimal(100),
        "price_iec": Decimal(100),
        "paid_iec": Decimal(0),
        "params": params,
        "description": "",
        "registered": take.start_s - 5,
        "assigned": take.start_s - 3,
        "proof_submitted": take.end_s + 3,
        "settled": None,
        "execution_deadline": take.start_s + 3600,
        "verdict_deadline": take.end_s + 3600,
        "execution_window_s": 7200,
        "grace_s": 180,
        "verdict_window_s": 3600,
        "nonce": BINDING.nonce,
        "proof_sha256": None,
        "proof_uri": None,
        "verdict": None,
        "reason": None,
        "report_sha256": None,
        "report_uri": None,
    }
    return ChainRecord(
        chain_id=BINDING.chain_id,
        task_manager=BINDING.task_manager,
        organization=BINDING.organization,
        task=Task(**(fields | task)),
        devices=devices(),
    )
