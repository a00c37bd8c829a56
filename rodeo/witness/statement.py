"""What devices sign about what they saw: one model for each kind of statement, with one header for all.

A witness signs one chain of statements. Each names the digest of the one before and lists the newest head of
every other device that it heard since. So the chains of a site's devices hold each other in order, whatever
their clocks say.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from rodeo.evidence.attestation import Attestation, canonical_json
from rodeo.evidence.errors import BadStatement

Digest = Annotated[str, Field(pattern=r"^0x[0-9a-f]{64}$")]
Address = Annotated[str, Field(pattern=r"^0x[0-9a-fA-F]{40}$")]
Name = Annotated[str, Field(min_length=1, max_length=64)]
MAX_HEADS = 64
"""In one statement: more devices than a site has."""


MAX_STALLS = 64
"""In one statement of motion capture; of a second or two there are a handful."""
MAX_OCMF = 24_000
"""Characters of a record's text with `MAX_HEADS` heads."""
MAX_CLASSES = 1000
"""Most classes of one classification: as many as the largest public data set has."""
MAX_LOOKS = 9
"""Pictures that one classification combines."""
MAX_CLAIMANTS = 8
"""Most claimants of one showing: more robots than can stand around a bin."""


class _Model(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True, serialize_by_alias=True
    )


class Scope(_Model):
    """For which organization on which chain a statement is made."""

    chain_id: int
    task_manager: Address
    organization: Address


class Head(_Model):
    """The newest link of another device's chain, as its listener heard it."""

    device: Name
    address: Address
    chain: Digest | None
    """Digest of a recording's opening seal; None for the chain of a witness."""
    index: int = Field(ge=0)
    """Index of the seal, or `seq` of the statement."""
    digest: Digest
    """Digest of the seal message's bytes, or of the statement's payload."""


class Header(Scope):
    """Fields of every statement."""

    version: Literal[1] = 1
    device: Name
    seq: int = Field(ge=1, lt=2**53)
    """Counts the statements of the device, without gaps."""
    previous: Digest | None
    """`payload_digest` of the previous statement; None in the first."""
    time_s: float
    """Site time of signing."""
    heads: tuple[Head, ...] = Field(default=(), max_length=MAX_HEADS)
    """The newest head of every other chain that the device heard since its last statement. The head of a
    witness is repeated in the next statements (`rodeo.witness.heads.TOLD`)."""
    inputs: Literal["sensor", "closed_bus", "open_bus"]
    """Source of the device's readings. On an open bus anybody may have published them."""


class Motion(Header):
    """The poses of every body that motion capture saw in (`start_us`, `end_us`].

    A body that is neither in `tracks` nor in `resting` was not seen in that time. Every body that is seen
    has a signed pose at least every `rodeo.witness.poses.REST_PERIOD_US`.
    """

    type: Literal["mocap.motion"] = "mocap.motion"
    start_us: int = Field(ge=0)
    """Site time; the end of the previous statement, unless the device was off in between."""
    end_us: int = Field(ge=0)
    tracks: dict[str, str]
    """Body -> its poses (`rodeo.witness.poses`)."""
    resting: dict[str, Annotated[int, Field(ge=1)]]
    """Body -> `seq` of the statement in which it came to rest. Since then it stayed within
    `rodeo.witness.poses.REST_M` and `REST_RAD` of the last pose in that statement."""
    unseen_us: dict[str, Annotated[int, Field(ge=1)]] = {}
    """Resting body -> time from its last sighting to `end_us`, if it is longer than
    `rodeo.witness.motion.STEP_US`."""
    stalls_us: tuple[tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]], ...] = Field(
        default=(), max_length=MAX_STALLS
    )
    """Intervals (site time) in which a simulated lab stood still: its machine stalled, and its clock
    skipped that time to follow wall time. Nothing moved meanwhile. A real lab has none."""


class Claimant(_Model):
    """A robot that presented itself to the bin before it showed an item."""

    device: Name
    address: Address
    recording: Digest
    """Digest of its recording's opening seal."""
    task_id: int = Field(ge=1)
    attempt: int = Field(ge=1)


class Look(_Model):
    """A picture of the item, taken before the last one."""

    image_sha256: Digest
    """Hash of the picture as the camera encoded it."""
    taken_s: float
    """Site time of the picture."""


class Classification(Header):
    """The item that the bin was shown."""

    type: Literal["bin.classification"] = "bin.classification"
    number: int = Field(ge=1)
    """Counts the classifications of this bin. A drop refers to it."""
    item_class: str = Field(alias="class", max_length=32)
    probabilities: dict[str, float] = Field(max_length=MAX_CLASSES)
    compartment: Name
    full: bool
    """True if that compartment is full, so that nothing may be dropped."""
    image_sha256: Digest
    """Hash of the picture as the camera encoded it."""
    model_sha256: Digest
    """Identifies the network: `network_sha256` of its weights and preprocessing."""
    thresholds_sha256: Digest
    """Hash of its preprocessing alone, which has the thresholds."""
    claimants: tuple[Claimant, ...] = Field(max_length=MAX_CLAIMANTS)
    """Robots that presented themselves before, the newest first. Motion capture shows which of them stood
    at the bin."""
    shown_s: float
    """Site time of the picture."""
    earlier: tuple[Look, ...] = Field(default=(), max_length=MAX_LOOKS - 1)
    """The other pictures that were combined with it, the oldest first. Each is another picture."""
    another_angle: bool = False
    """True if the bin is not sure and would like to see the item from another side."""

    @model_validator(mode="after")
    def _each_picture_counts_once(self) -> Classification:
        hashes = [*(look.image_sha256 for look in self.earlier), self.image_sha256]
        if len(set(hashes)) < len(hashes):
            raise ValueError("a picture is named twice")
        times_s = [*(look.taken_s for look in self.earlier), self.shown_s]
        if times_s != sorted(times_s):
            raise ValueError("the pictures are not in the order of their times")
        return self

    @property
    def looks(self) -> tuple[Look, ...]:
        """All pictures that were combined, the oldest first."""
        return (*self.earlier, Look(image_sha256=self.image_sha256, taken_s=self.shown_s))


class Drop(Header):
    """An item fell into the bin between `after_s` and `settled_s`."""

    type: Literal["bin.drop"] = "bin.drop"
    number: int = Field(ge=1)
    """Counts the drops of this bin."""
    classification: int | None
    """Number of the item's classification; None if the item was never shown."""
    compartment: Name
    expected_compartment: Name | None
    weight_n: float
    after_s: float
    settled_s: float
    correct: bool
    claimants: tuple[Claimant, ...] = Field(max_length=MAX_CLAIMANTS)
    """The claimants of the classification."""


class Removal(Header):
    """Weight that left a compartment between `after_s` and `settled_s`."""

    type: Literal["bin.removal"] = "bin.removal"
    compartment: Name
    weight_n: float
    """Weight that left the compartment, positive."""
    after_s: float
    settled_s: float


class Watch(Header):
    """The bin was there from `after_s` to `until_s`, after a drop, and stated what was taken out meanwhile.
    Whom it heard in that time, its heads say: who fell silent is not among them."""

    type: Literal["bin.watch"] = "bin.watch"
    drop: int = Field(ge=1)
    """Number of the drop."""
    compartment: Name
    after_s: float
    until_s: float


class Presentation(Header):
    """A robot tells the bin for which recording it shows the next item."""

    type: Literal["robot.presentation"] = "robot.presentation"
    bin: Name
    recording: Digest
    """Digest of the recording's opening seal."""
    task_id: int = Field(ge=1)
    attempt: int = Field(ge=1)
    grasped_s: float = 0.0
    """Site time at which the robot took hold of the item, 0 if it does not say. A bin combines no pictures
    across two grasps: those from before the last one prove nothing."""


class MeterRecord(Header):
    """The register of a dock's meter, and the readings that led to it: the seller's side of a charge."""

    type: Literal["meter.record"] = "meter.record"
    task_id: int = Field(ge=1)
    attempt: int = Field(ge=1)
    recording: Digest
    """Digest of the opening seal of the dock's recording."""
    robot: Name
    """Name of the robot that is charged."""
    page: int = Field(ge=1)
    """Counts the records of the recording, without gaps."""
    reason: Literal["opening", "step", "pause", "close"]
    contactor: Literal["open", "closed"]
    begin_wh: float = Field(ge=0)
    """The register when the session opened."""
    register_wh: float = Field(ge=0)
    """The register now. It never restarts."""
    until_s: float
    """Site time of the newest reading."""
    since_ms: int = Field(ge=0)
    readings: str = Field(max_length=24_000)
    """Readings since the previous record, from `since_ms` on (`rodeo.charging.metering`)."""
    soc: float | None = Field(ge=0, le=1)
    """State of charge that the robot signed last."""
    ocmf: str = Field(max_length=MAX_OCMF)
    """The same data as OCMF text, for other software (`rodeo.witness.ocmf`)."""


class Receipt(Header):
    """A robot countersigns a record of a dock's meter: the buyer's side of a charge."""

    type: Literal["robot.receipt"] = "robot.receipt"
    task_id: int = Field(ge=1)
    attempt: int = Field(ge=1)
    recording: Digest
    """The recording that the record names."""
    meter: Name
    meter_address: Address
    record: Digest
    """Digest of the `MeterRecord` that it countersigns."""
    begin_wh: float = Field(ge=0)
    register_wh: float = Field(ge=0)
    soc: float = Field(ge=0, le=1)
    """State of charge by the robot's own gauge."""
    reason: Literal["opening", "step", "close"]

    def repeats(self, record: MeterRecord, meter_address: str) -> bool:
        """Whether it repeats the record that it names, of the meter with this address. Only then it is
        valid for the seller."""
        return (*_of(self), self.meter, self.meter_address.lower(), self.begin_wh, self.register_wh) == (
            *_of(record),
            record.device,
            meter_address.lower(),
            record.begin_wh,
            record.register_wh,
        )


def _of(said: MeterRecord | Receipt) -> tuple[int, str, str, int, int, str]:
    """What a statement about a charge is about."""
    scope = said.chain_id, said.task_manager.lower(), said.organization.lower()
    return *scope, said.task_id, said.attempt, said.recording


Statement = Motion | Classification | Drop | Removal | Watch | Presentation | MeterRecord | Receipt
_STATEMENT: TypeAdapter[Statement] = TypeAdapter(Annotated[Statement, Field(discriminator="type")])


def parse(payload: dict[str, Any]) -> Statement:
    """The statement in a payload. Raises BadStatement, which names each wrong field."""
    try:
        return _STATEMENT.validate_python(payload)
    except ValidationError as error:
        fields = {".".join(map(str, one["loc"])): one["msg"] for one in error.errors()[:8]}
        raise BadStatement(
            "the payload is not a statement", type=str(payload.get("type"))[:64], **fields
        ) from error


def payload_digest(payload: dict[str, Any]) -> str:
    """0x SHA-256 of the payload's canonical JSON: the `previous` of the next statement.

    Raises BadAttestation when the payload has no canonical form.
    """
    return "0x" + sha256(canonical_json(payload)).hexdigest()


def digest(attestation: Attestation) -> str:
    """`payload_digest` of what was attested."""
    return payload_digest(attestation.payload)
