"""An assignment as the chain tells it, with the keys of everybody who has a part in it."""

from __future__ import annotations

from decimal import Decimal
from secrets import token_bytes
from typing import TYPE_CHECKING, Any

import coincurve
from eth_account import Account
from eth_account.datastructures import SignedMessage
from eth_account.messages import SignableMessage, _hash_eip191_message
from eth_account.signers.local import LocalAccount
from eth_keys import keys
from hexbytes import HexBytes

from rodeo.dao import CHARGING, CLEANING
from rodeo.evidence import Binding
from rodeo.messages import Device, Task
from services.oracle.case import Ledger

if TYPE_CHECKING:
    from tests.support.recordings import Take


class DeviceKey(LocalAccount):
    """A new key that signs the same as eth-account's, at a fifth of the cost: it is parsed once. A charge has
    a thousand seals."""

    def __init__(self) -> None:
        super().__init__(keys.PrivateKey(token_bytes(32)), Account())
        self._signing = coincurve.PrivateKey(bytes(self.key))

    def sign_message(self, signable_message: SignableMessage) -> SignedMessage:
        digest = _hash_eip191_message(signable_message)
        signature = self._signing.sign_recoverable(digest, hasher=None)
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


def ledger(take: Take, kind: str, params: dict[str, Any], **task: Any) -> Ledger:
    """The chain's view of an assignment during which `take` was filmed."""
    executor = EXECUTOR if kind == CLEANING else ORGANIZATION
    fields: dict[str, Any] = {
        "id": BINDING.task_id,
        "kind": kind,
        "state": "submitted",
        "attempt": BINDING.attempt,
        "max_attempts": 3,
        "creator": ORGANIZATION,
        "creator_name": "organization",
        "executor": executor,
        "executor_name": "panther1" if kind == CLEANING else "organization",
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
        "verdict_window_s": 3600,
        "nonce": BINDING.nonce,
        "proof_sha256": None,
        "proof_uri": None,
        "verdict": None,
        "reason": None,
        "report_sha256": None,
        "report_uri": None,
    }
    return Ledger(
        chain_id=BINDING.chain_id,
        task_manager=BINDING.task_manager,
        organization=BINDING.organization,
        task=Task(**(fields | task)),
        devices=devices(),
    )


def cleaning_ledger(take: Take, params: dict[str, Any] | None = None, **task: Any) -> Ledger:
    return ledger(take, CLEANING, params or {"item_id": "item1", "x_m": 4.6, "y_m": 1.2}, **task)


ORDERED_WH = 100.0


def charging_ledger(take: Take, params: dict[str, Any] | None = None, **task: Any) -> Ledger:
    """Ordered from 86 % on, unless `params` say otherwise."""
    ordered = {"robot": "panther1", "dock": "dock1", "soc_from": 0.86, "soc_target": 0.95}
    return ledger(take, CHARGING, ordered | {"energy_wh": ORDERED_WH} | (params or {}), **task)
