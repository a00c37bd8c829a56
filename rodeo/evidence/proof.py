"""A sealed recording, read back and found to be what its signer sealed."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import file_digest
from pathlib import Path
from typing import Any

from rodeo.evidence.attestation import Attestation
from rodeo.evidence.container import Limits
from rodeo.evidence.errors import CorruptProof, LayoutChanged, ProofNotFound, UnsealedProof
from rodeo.evidence.reader import SealedReader
from rodeo.evidence.seal import Binding
from rodeo.evidence.series import Payloads, Table, tables
from rodeo.ros2.readings import MOST_PUBLISHERS
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL, JOINT_STATES
from rodeo.text.strict_json import read_json


class TopicMessages:
    """The messages of one topic in file order, as columns."""

    def __init__(self, topic: str, ros_type: str) -> None:
        self.topic = topic
        self.ros_type = ros_type
        """Empty for JSON channels."""
        self.log_ns = array("Q")
        self.publish_ns = array("Q")
        self.sequence = array("I")
        self.data = Payloads()
        self._tables: list[Table] | LayoutChanged | None = None

    def __len__(self) -> int:
        return len(self.data)

    def table(self) -> Table:
        """The one of its tables that most messages are in. Raises LayoutChanged."""
        return self.tables()[0]

    def tables(self) -> list[Table]:
        """The ROS messages as columns, read once, also where they cannot be: joints a table for each of their
        publishers, everything else one table. Raises LayoutChanged."""
        if self._tables is None:
            most = MOST_PUBLISHERS if self.ros_type == JOINT_STATES.type else 1
            try:
                self._tables = tables(self.data, self.log_ns, self.ros_type, self.topic, most, "name")
            except LayoutChanged as error:
                self._tables = error
        if isinstance(self._tables, LayoutChanged):
            raise self._tables
        return self._tables


@dataclass(frozen=True)
class Proof:
    """One complete recording. Topics are absolute ROS names (`/panther1/odom`) or JSON channels."""

    path: Path
    sha256: str
    """Hash of the file; 0x, 32 bytes."""
    size_bytes: int
    binding: Binding | None
    """None for a bag, which nobody sealed."""
    signer: str | None
    """Address of the device key that sealed it; None for a bag."""
    seals: int
    longest_unsealed_ns: int
    """Longest recorded time that one seal covers."""
    seal_digests: tuple[str, ...]
    """0x SHA-256 of each seal but the final one, by index; empty for a bag."""
    topics: dict[str, TopicMessages]
    order: array[int]
    """Index into `topics` (in order of appearance) of each message of the file."""

    def __iter__(self) -> Iterator[tuple[str, int, bytes]]:
        """(topic, log time in ns, payload) of every message in file order."""
        columns = list(self.topics.values())
        positions = [0] * len(columns)
        for index in self.order:
            column, position = columns[index], positions[index]
            positions[index] += 1
            yield column.topic, column.log_ns[position], column.data[position]

    @property
    def sealed(self) -> bool:
        return self.binding is not None

    @property
    def recording(self) -> str | None:
        """What others call this recording: the digest of its opening seal."""
        return self.seal_digests[0] if self.seal_digests else None

    @property
    def messages(self) -> int:
        return len(self.order)

    @property
    def start_ns(self) -> int:
        """Earliest log time."""
        return min(min(column.log_ns) for column in self.topics.values())

    @property
    def end_ns(self) -> int:
        """Latest log time."""
        return max(max(column.log_ns) for column in self.topics.values())

    def count(self, topic: str) -> int:
        """How many messages; 0 for a topic that is not there."""
        return len(self.topics[topic]) if topic in self.topics else 0

    def table(self, topic: str, ros_type: str) -> Table:
        """Those of its tables that most messages of a ROS topic are in. Raises LayoutChanged."""
        return self.tables(topic, ros_type)[0]

    def tables(self, topic: str, ros_type: str) -> list[Table]:
        """All messages of a ROS topic as columns, see `TopicMessages.tables`.

        Raises LayoutChanged when the topic is missing, has another type, or its messages differ in their
        strings or lengths.
        """
        column = self.topics.get(topic)
        if column is None:
            raise LayoutChanged("the topic is not in the recording", topic=topic)
        if column.ros_type != ros_type:
            raise LayoutChanged(
                "the topic has another type", topic=topic, found=column.ros_type[:200], expected=ros_type
            )
        return column.tables()

    def json(self, channel: str) -> list[dict[str, Any]]:
        """The objects on a JSON channel. Raises CorruptProof for what not every parser reads alike."""
        column = self.topics.get(channel)
        objects = []
        for index, data in enumerate(column.data if column else []):
            try:
                objects.append(read_json(data))
            except ValueError as error:
                raise CorruptProof(
                    "a message is not a JSON object", channel=channel, index=index, cause=str(error)[:500]
                ) from error
        return objects

    def events(self) -> list[dict[str, Any]]:
        """DAO events and the recorder's own, as recorded."""
        return self.json(EVENT_CHANNEL)

    def attestations(self) -> list[Attestation]:
        """Statements by other devices as recorded; `verify_attestation` proves one to be its signer's.

        What is no statement is left out: anybody may have put it there.
        """
        column = self.topics.get(ATTESTATION_CHANNEL)
        found = (_attestation(data) for data in (column.data if column else []))
        return [one for one in found if one is not None]


def _attestation(data: bytes) -> Attestation | None:
    try:
        return Attestation.model_validate(read_json(data))
    except ValueError:
        return None


def open_proof(path: Path | str, limits: Limits | None = None) -> Proof:
    """Read all of `path` and check it against its own seals.

    Raises ProofNotFound, ContainerError (truncated, corrupt, beyond `limits`) or SealError (not sealed, or
    changed after sealing). Who the signer is, and what the binding should be, is for the caller to ask.
    """
    path = Path(path)
    try:
        reader = SealedReader(path, limits)  # first: a file that is too large is not read
        with path.open("rb") as file:
            sha256 = "0x" + file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ProofNotFound("the proof cannot be read", path=str(path), cause=str(error)) from error
    topics: dict[str, TopicMessages] = {}
    indices: dict[str, int] = {}
    order = array("H")
    for topic, schema_name, message in reader:
        column = topics.get(topic)
        if column is None:
            column = topics[topic] = TopicMessages(topic, schema_name)
            indices[topic] = len(indices)
        column.log_ns.append(message.log_ns)
        column.publish_ns.append(message.publish_ns)
        column.sequence.append(message.sequence)
        column.data.append(message.data)
        order.append(indices[topic])
    audit = reader.audit
    if audit.binding is None or audit.signer is None or not audit.final:
        raise UnsealedProof("the recording has no final seal", messages=reader.running.messages)
    audit.check_signatures()
    return Proof(
        path,
        sha256,
        path.stat().st_size,
        audit.binding,
        audit.signer,
        audit.count,
        audit.longest_unsealed_ns,
        tuple("0x" + digest for digest in audit.digests),
        topics,
        order,
    )
