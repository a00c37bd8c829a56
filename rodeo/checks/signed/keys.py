"""Which keys count, and for what: one rule for witnesses, for both sides of a charge and for who sealed.

not revoked    everything that the key signed
superseded     what it signed before it was revoked
compromised    what stood before it was revoked: on chain, because the proof was submitted before, or in
               the chain of another witness, which lists it. The rest is undecided, never rejected: nobody
               can tell who signed it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from rodeo.bus.messages import Device
from rodeo.checks.signed.statements import Said, Testimony
from rodeo.witness.statement import Head, Receipt


def counts_until_s(device: Device, submitted_s: float) -> float:
    """The device's own time (s) up to which its statements count in a proof submitted at `submitted_s`."""
    if device.revoked is None or (device.revoked_because == "compromised" and not taken(device, submitted_s)):
        return math.inf
    return device.revoked


def taken(device: Device, submitted_s: float) -> bool:
    """Whether somebody else may have signed with it before the proof stood on chain."""
    if device.revoked is None or device.revoked_because != "compromised":
        return False
    return submitted_s >= device.revoked


def heads_listed(others: Iterable[Testimony], before_s: float) -> Iterator[Head]:
    """What witnesses listed before a time, each by its own clock."""
    for other in others:
        for said in other.said:
            if said.statement.time_s < before_s:
                yield from said.statement.heads


def not_standing(testimony: Testimony, device: Device, others: Iterable[Testimony]) -> list[Said]:
    """Which statements under a key that was taken stood in no other witness's chain before it was revoked.

    A statement stood there if it was listed, or if the one that names it as `previous` stood.
    """
    assert device.revoked is not None
    others = list(others)
    listed = {
        (head.index, head.digest)
        for head in heads_listed(others, device.revoked)
        if head.chain is None and head.address.lower() == testimony.address
    }
    # A receipt names the record that it countersigns.
    countersigned = {
        said.statement.record
        for other in others
        for said in other.said
        if isinstance(said.statement, Receipt) and said.statement.time_s < device.revoked
    }
    fallen: list[Said] = []
    named: tuple[int, str | None] | None = None
    for one in reversed(testimony.said):
        seq = one.statement.seq
        if (seq, one.digest) in listed or one.digest in countersigned or named == (seq, one.digest):
            named = seq - 1, one.statement.previous
        else:
            fallen.append(one)
            named = None
    return fallen[::-1]
