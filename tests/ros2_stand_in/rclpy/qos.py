"""Quality of service, as far as rmw_zenoh makes a difference."""

from __future__ import annotations

from enum import Enum

from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability


class ReliabilityPolicy(Enum):
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(Enum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class QoSProfile:
    def __init__(
        self,
        *,
        depth: int,
        reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
        durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
    ) -> None:
        self.depth, self.reliability, self.durability = depth, reliability, durability


def profile(qos: QoSProfile | int) -> QoSProfile:
    """A number is a depth."""
    return QoSProfile(depth=qos) if isinstance(qos, int) else qos


def encoded(qos: QoSProfile) -> str:
    """As in the tokens by which rmw_zenoh shows endpoints."""
    reliability, durability = QosReliability[qos.reliability.name], QosDurability[qos.durability.name]
    return QosProfile(reliability=reliability, durability=durability, history_depth=qos.depth).encode()


qos_profile_sensor_data = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
qos_profile_services_default = QoSProfile(depth=10)
