"""What devices that have no part in a cleaning say of it, for a forger or against an honest robot: it neither
helps nor harms anybody."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo.bus.messages import Device
from rodeo.evidence.attestation import Attestation, attest
from rodeo.witness.statement import digest
from rodeo_kinds.waste_disposal.harness.film import watched
from rodeo_kinds.waste_disposal.harness.workshop import HARNESS, ITEM_POSE, CleaningWorkshop
from rodeo_testing.assignments import BIN, BINDING, METER, MOCAP
from rodeo_testing.recordings import Take, Witnesses
from rodeo_testing.workshop import (
    STRANGER,
    Edit,
    Submission,
    displaced,
    edited_between,
    middle_s,
    said,
    stated,
    with_more_devices,
)

OTHER_BIN = Device(address=STRANGER.address, role="bin", owner="0x" + "66" * 20, name="itrash9")
"""A device of another lab of the organization."""
_SAID: dict[str, Any] = {"type": "bin.watch", "drop": 1, "compartment": "blue"}


def _statement(take: Take, signer: LocalAccount, device: str, *heads: dict[str, Any]) -> Attestation:
    """What such a device signs at the end of the recording, by its own sensors."""
    time_s = take.end_s - 0.5
    payload = {
        "version": 1,
        "chain_id": BINDING.chain_id,
        "task_manager": BINDING.task_manager,
        "organization": BINDING.organization,
        "device": device,
        "seq": 9,
        "previous": "0x" + "11" * 32,
        "time_s": time_s,
        "heads": list(heads),
        "inputs": "sensor",
        "after_s": time_s - 10.0,
        "until_s": time_s,
    }
    return attest(payload | _SAID, signer)


def of_a_meter(take: Take, *heads: dict[str, Any]) -> Take:
    """With a statement that a dock's meter made meanwhile."""
    return said(take, stated(take, _statement(take, METER, "dock1", *heads), 1.0))


def of_another_bin(take: Take, *heads: dict[str, Any]) -> Take:
    return said(take, stated(take, _statement(take, STRANGER, OTHER_BIN.name, *heads), 1.0))


def a_false_head(number: int = 12) -> dict[str, Any]:
    """A statement in the name of motion capture, which never signed it."""
    return {
        "device": "mocap",
        "address": MOCAP.address,
        "chain": None,
        "index": number,
        "digest": "0x" + "ab" * 32,
    }


def _home(shop: CleaningWorkshop) -> Take:
    """After the drop the item goes home."""
    begin_s = shop.take.of("bin/drop")[0].message["settled_s"] + 2.0
    return edited_between(shop.take, ITEM_POSE, begin_s, math.inf, lambda s: displaced(s, x=-1.0))


def _beside_another_bin(shop: CleaningWorkshop, take: Take, **changes: Any) -> Submission:
    path = shop.sealed(take, **changes)
    return Submission(with_more_devices(shop.chain_record(), OTHER_BIN), path)


# -- one digest against another ---------------------------------------------------------------------------


@HARNESS.spoiling(role="bystander")
def a_meter_lists_motion_capture_otherwise(shop: CleaningWorkshop) -> Submission:
    """A dock's meter lists a digest of the motion capture that this never signed."""
    return shop.submitted(of_a_meter(shop.take, a_false_head()))


@HARNESS.spoiling(role="creator")
def another_bin_lists_motion_capture_otherwise(shop: CleaningWorkshop) -> Submission:
    """The same by a bin at which the work is not done."""
    return _beside_another_bin(shop, of_another_bin(shop.take, a_false_head()))


@HARNESS.spoiling(role="bystander")
def a_meter_lists_the_bin_otherwise(shop: CleaningWorkshop) -> Submission:
    """The same against the bin that the item fell into."""
    head = a_false_head(2) | {"device": "itrash", "address": BIN.address}
    return shop.submitted(of_a_meter(shop.take, head))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def taken_home_while_a_meter_lists_another_digest(shop: CleaningWorkshop) -> Submission:
    """The item goes home, and an accomplice's meter lists a digest that motion capture never signed."""
    return shop.submitted(of_a_meter(_home(shop), a_false_head()))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def taken_home_while_another_bin_lists_another_digest(shop: CleaningWorkshop) -> Submission:
    """The same with the bin of another lab."""
    return _beside_another_bin(shop, of_another_bin(_home(shop), a_false_head()))


@HARNESS.forgery("stays_in_bin", "where the item is", role="holder of two keys")
def taken_home_while_the_bin_lists_another_digest(shop: CleaningWorkshop) -> Submission:
    """The same with the bin that the item fell into, whose owner helps."""

    return shop.restated(_home(shop), _relinked(lambda one: one | {"heads": _false_heads(one)}))


def _false_heads(payload: dict[str, Any]) -> list[dict[str, Any]]:
    """What the bin lists of motion capture is false."""
    return [
        a_false_head(head["index"]) if head["address"] == MOCAP.address else head for head in payload["heads"]
    ]


def _relinked(change: Callable[[dict[str, Any]], dict[str, Any]]) -> Edit:
    """The witnesses' own chains of other statements."""
    keys: dict[str, LocalAccount] = {one.address: one for one in (BIN, MOCAP)}
    last, true = dict[str, str](), dict[str, str]()

    def edit(one: Attestation) -> Attestation:
        if one.signer not in keys:
            return one
        payload = change(one.payload)
        heads = [head | {"digest": true.get(head["digest"], head["digest"])} for head in payload["heads"]]
        previous = last.get(one.signer, payload["previous"])
        signed = attest(payload | {"heads": heads, "previous": previous}, keys[one.signer])
        true[digest(one)] = last[one.signer] = digest(signed)
        return signed

    return edit


# -- silent, or left out ----------------------------------------------------------------------------------


def _without_motion_capture(shop: CleaningWorkshop, until_s: float) -> Witnesses:
    """Nothing that it said after that is in the recording, nor what the bin said."""

    def edit(one: Attestation) -> Attestation | None:
        told = one.payload["device"] in ("mocap", "itrash") and one.signer != STRANGER.address
        return None if told and one.payload["time_s"] > until_s else one

    return Witnesses(edit=edit)


@HARNESS.forgery("stays_in_bin", "to the end of the recording", role="executor")
def left_out_while_a_meter_goes_on(shop: CleaningWorkshop) -> Submission:
    """The item goes home after the drop. Motion capture's word since is left out, and a genuine statement of
    a meter, which never hears this motion capture, is in the recording."""
    until_s = shop.take.of("bin/drop")[0].message["settled_s"] + 2.0
    take = of_a_meter(_home(shop), a_false_head() | {"device": "mocap9", "address": "0x" + "44" * 20})
    return shop.submitted(take, witnesses=_without_motion_capture(shop, until_s))


@HARNESS.forgery("stays_in_bin", "to the end of the recording", role="executor")
def left_out_while_another_bin_goes_on(shop: CleaningWorkshop) -> Submission:
    """The same with the statement of a bin of another lab."""
    until_s = shop.take.of("bin/drop")[0].message["settled_s"] + 2.0
    return _beside_another_bin(
        shop, of_another_bin(_home(shop)), witnesses=_without_motion_capture(shop, until_s)
    )


@HARNESS.forgery("bin_witnessed", "nothing signed by this witness", role="executor")
def left_out_from_the_middle_of_the_carry_on(shop: CleaningWorkshop) -> Submission:
    """The item goes home instead of into the bin. Nothing that motion capture or bin said since is there."""
    take = of_a_meter(shop.take)
    return shop.submitted(take, witnesses=_without_motion_capture(shop, middle_s(shop.take, 0.45)))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def left_out_while_the_bin_hears_nothing(shop: CleaningWorkshop) -> Submission:
    """The same, and the bin's genuine statements list nothing of the motion capture, which it never heard."""
    until_s = shop.take.of("bin/drop")[0].message["settled_s"] + 3.0

    signed = _relinked(lambda one: one | {"heads": _heard_by_the_deaf(one)})

    def edit(one: Attestation) -> Attestation | None:
        late = one.payload["device"] == "mocap" and one.payload["time_s"] > until_s
        return None if late else signed(one)

    return shop.restated(watched(_home(shop)), edit)


def _heard_by_the_deaf(payload: dict[str, Any]) -> list[dict[str, Any]]:
    return [head for head in payload["heads"] if head["address"] != MOCAP.address]
