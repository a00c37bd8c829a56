"""Errors of evidence.

EvidenceError
├── ContainerError          the file is not a proof that can be read
│   ├── TruncatedProof
│   ├── CorruptProof
│   └── ProofTooLarge       a size, count or time limit is exceeded
├── SealError               the file can be read, but is not what its signer sealed
│   ├── UnsealedProof
│   └── BrokenSeal
├── BadAttestation          the signature is not its signer's
├── BadStatement            what was signed is no statement of a device
├── BrokenJournal           a witness cannot continue with its chain
├── LayoutChanged           messages of one topic do not share one layout, or the topic has none
├── RecorderError
│   ├── RecorderFailed      the recording cannot be written
│   ├── RecordingExists     a new recording would overwrite another
│   └── RecordingSealed     the recording is already finished
└── StoreError
    ├── ProofUriNotAllowed
    ├── ProofNotFound
    ├── ProofHashMismatch
    ├── NoCopy              a device has no whole copy of the proof that it is asked for
    └── StoreUnavailable
"""

from __future__ import annotations

from rodeo.errors import RodeoError


class EvidenceError(RodeoError):
    """Root of everything that can be wrong with evidence."""

    machines = False


class ContainerError(EvidenceError):
    """The file is not a proof that can be read."""


class TruncatedProof(ContainerError):
    """The file ends before its records do."""


class CorruptProof(ContainerError):
    """A record does not follow the format or its checksum."""


class ProofTooLarge(ContainerError):
    """A limit on size, counts or times is exceeded; `details` carry value and limit."""


class SealError(EvidenceError):
    """The file is not what its signer sealed."""


class UnsealedProof(SealError):
    """The opening or the final seal is missing."""


class BrokenSeal(SealError):
    """A seal does not match the messages, the seals before it, or its signature."""


class BadAttestation(EvidenceError):
    """The statement is malformed or not signed by whom it names."""


class BadStatement(EvidenceError):
    """What a device signed does not fit the model of any statement."""


class BrokenJournal(EvidenceError):
    """The journal of a witness cannot be read or written: going on would sign one number twice."""

    restart_cures = False


class LayoutChanged(EvidenceError):
    """The messages of a topic cannot be read as one table."""


class RecorderError(EvidenceError):
    """The recorder cannot do what was asked."""


class RecorderFailed(RecorderError):
    """The recording cannot be written; the cause is chained."""


class RecordingExists(RecorderError):
    """A new recording would overwrite another."""


class RecordingSealed(RecorderError):
    """The recording is finished: nothing can be added."""


class StoreError(EvidenceError):
    """The store did not take or give the proof."""


class ProofUriNotAllowed(StoreError):
    """The URI does not name a content-addressed file directly inside a configured store."""


class ProofNotFound(StoreError):
    """The store has no such file."""


class ProofHashMismatch(StoreError):
    """The bytes are not those that the hash names."""


class NoCopy(StoreError):
    """The device has no whole copy of this proof."""


class StoreUnavailable(StoreError):
    """The store could not be reached or written."""

    machines = True
