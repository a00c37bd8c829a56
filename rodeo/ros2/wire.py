"""What rmw_zenoh puts on the wire around a message: keys, attachments, liveliness tokens, QoS.

Format: rmw_zenoh's design document (ros2/rmw_zenoh, docs/design.md), branch jazzy.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from typing import Literal, NamedTuple

from rodeo.ros2 import definitions
from rodeo.ros2.errors import MalformedMessage

EntityKind = Literal["MP", "MS", "SS", "SC"]
"""Message publisher, message subscriber, service server, service client."""

_ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number, source time in ns, length of the gid (always 16), gid: 33 bytes."""


@dataclass(frozen=True)
class QoS:
    """The quality of service a ROS 2 endpoint offers or asks for."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10

    def encode(self) -> str:
        """As in liveliness tokens; rmw_zenoh leaves default values empty."""
        reliability = "2" if self.reliability == "best_effort" else ""
        durability = "1" if self.durability == "transient_local" else ""
        return f"{reliability}:{durability}:,{self.depth}:,:,:,,"


DEFAULT = QoS()
SENSOR_DATA = QoS(reliability="best_effort", depth=5)
LATCHED = QoS(durability="transient_local", depth=1)


class Attachment(NamedTuple):
    """Travels beside each message, request and response; a tuple, of which there are thousands a second."""

    sequence: int
    source_time_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return attachment(self.sequence, self.source_time_ns, self.gid)

    @classmethod
    def decode(cls, data: bytes) -> Attachment:
        """Raises MalformedMessage."""
        if len(data) != _ATTACHMENT.size or data[16] != 16:
            raise MalformedMessage("not an rmw_zenoh attachment", length_bytes=len(data))
        sequence, source_time_ns, _, gid = _ATTACHMENT.unpack(data)
        return cls(sequence, source_time_ns, gid)


def attachment(sequence: int, source_time_ns: int, gid: bytes) -> bytes:
    """An encoded Attachment, of which there are thousands a second."""
    return _ATTACHMENT.pack(sequence, source_time_ns, 16, gid)


def data_key(domain_id: int, name: str, typename: str) -> str:
    """Key of a topic or service; `name` is fully qualified, its leading slash optional."""
    return f"{domain_id}/{name.strip('/')}/{definitions.dds_type(typename)}/{definitions.type_hash(typename)}"


def _mangle(name: str) -> str:
    return name.replace("/", "%") or "%"


@dataclass(frozen=True)
class NodeEntity:
    """A node as its liveliness tokens name it in the ROS graph."""

    domain_id: int
    session_id: str
    node_id: int
    namespace: str
    name: str

    def token(self) -> str:
        return self._token(self.node_id, "NN")

    def endpoint_token(self, entity_id: int, kind: EntityKind, name: str, typename: str, qos: QoS) -> str:
        """The token of one of its publishers, subscribers, services or clients."""
        return (
            f"{self._token(entity_id, kind)}/{_mangle('/' + name.strip('/'))}/"
            f"{definitions.dds_type(typename)}/{definitions.type_hash(typename)}/{qos.encode()}"
        )

    def _token(self, entity_id: int, kind: str) -> str:
        place = f"{self.domain_id}/{self.session_id}/{self.node_id}/{entity_id}"
        return f"@ros2_lv/{place}/{kind}/%/{_namespace(self.namespace)}/{self.name}"


def servers_expression(domain_id: int, name: str, typename: str) -> str:
    """Key expression that matches the liveliness tokens of every server of a service."""
    return (
        f"@ros2_lv/{domain_id}/*/*/*/SS/*/*/*/{_mangle('/' + name.strip('/'))}/"
        f"{definitions.dds_type(typename)}/{definitions.type_hash(typename)}/*"
    )


def publishers_expression(domain_id: int, topic: str) -> str:
    """Key expression that matches the liveliness tokens of every publisher of a topic, whatever its type."""
    return f"@ros2_lv/{domain_id}/*/*/*/MP/*/*/*/{_mangle('/' + topic.strip('/'))}/**"


def clients_expression(domain_id: int, name: str) -> str:
    """Key expression that matches the liveliness tokens of every client of a service, whatever its type."""
    return f"@ros2_lv/{domain_id}/*/*/*/SC/*/*/*/{_mangle('/' + name.strip('/'))}/**"


def gid_of(token: str) -> bytes:
    """The 16 bytes by which an endpoint of ours signs its messages, from its liveliness token."""
    return hashlib.blake2b(token.encode(), digest_size=16).digest()


def node_of(token: str) -> str:
    """The name of the node of an endpoint, with its namespace, from its liveliness token."""
    namespace, name = token.split("/")[7:9]
    return namespace.replace("%", "/").rstrip("/") + "/" + name


def session_of(token: str) -> str:
    """The Zenoh session that declared a liveliness token of the ROS graph."""
    return token.split("/")[2]


def _namespace(namespace: str) -> str:
    return _mangle(f"/{namespace.strip('/')}" if namespace.strip("/") else "")
