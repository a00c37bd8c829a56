"""Which recorded poses the lab's motion capture signed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from hashlib import sha256

import numpy as np
from pydantic import ValidationError

from rodeo.evidence import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation
from rodeo.evidence.proof import TopicMessages
from rodeo.evidence.series import Array
from rodeo.mocap import MocapStatement, payload_digest, pose_record

_Run = list[tuple[MocapStatement, Attestation]]


def signed(
    poses: TopicMessages, body: str, statements: Iterable[Attestation], signers: Collection[str] | None
) -> Array:
    """(n,) whether each recorded pose is covered by a statement of one of `signers` (lower-case addresses;
    None believes any) that agrees with it."""
    covered = np.zeros(len(poses), bool)
    records = [pose_record(*pose) for pose in zip(poses.sequence, poses.data, strict=True)]
    positions: dict[int, list[int]] = defaultdict(list)
    for index, sequence in enumerate(poses.sequence):
        positions[sequence].append(index)
    for run in _runs(body, statements):
        last = run[-1][1]
        if signers is not None and last.signer.lower() not in signers:
            continue
        try:
            verify_attestation(last)  # it names the digest of the one before, and that one of its own
        except BadAttestation:
            continue
        for statement, _ in run:
            # A publisher that restarted counts from the beginning, so a number may come twice.
            for start in positions[statement.first]:
                block = slice(start, start + statement.count)
                if "0x" + sha256(b"".join(records[block])).hexdigest() == statement.hash:
                    covered[block] = True
    return covered


def _runs(body: str, statements: Iterable[Attestation]) -> Iterator[_Run]:
    """The statements about `body` in stretches in which each names the one before."""
    run: _Run = []
    digest = ""
    for attestation in statements:
        payload = attestation.payload
        if payload.get("type") != "mocap" or payload.get("body") != body:
            continue
        try:
            statement = MocapStatement.model_validate(payload)
            own_digest = payload_digest(payload)
        except (ValidationError, BadAttestation):
            continue
        if run and (statement.previous != digest or attestation.signer != run[-1][1].signer):
            yield run
            run = []
        run.append((statement, attestation))
        digest = own_digest
    if run:
        yield run
