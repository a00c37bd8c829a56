"""Types: hashes as ROS 2 publishes them, CDR both ways, MCAP schema texts that other tools parse."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rodeo.ros2 import definitions, types
from rodeo.ros2.errors import MalformedMessage, UnknownType
from rodeo.ros2.interfaces import ACTIONS, MESSAGES, SERVICES

# Hashes that rosidl generated for ROS 2 Jazzy: rmw_zenoh's design document (String, AddTwoInts) and the
# headers generated for std_srvs, action_msgs and control_msgs.
PUBLISHED = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "example_interfaces/srv/AddTwoInts": "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "action_msgs/srv/CancelGoal": "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    "control_msgs/action/FollowJointTrajectory_SendGoal": (
        "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"
    ),
    "control_msgs/action/FollowJointTrajectory_GetResult": (
        "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b"
    ),
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage": (
        "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71"
    ),
}
DECLARED = [
    *MESSAGES,
    *(f"{service}_Response" for service in SERVICES),
    *(f"{a}_FeedbackMessage" for a in ACTIONS),
]
STANDARD = ["nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState"]


@pytest.mark.parametrize(("typename", "digest"), PUBLISHED.items())
def test_the_hash_is_the_one_that_ros_2_computes(typename: str, digest: str) -> None:
    assert definitions.type_hash(typename) == f"RIHS01_{digest}"


@pytest.mark.parametrize("typename", STANDARD + DECLARED)
def test_a_new_message_survives_cdr(typename: str) -> None:
    message = types.new(typename)
    cdr = types.serialize(message)
    assert types.serialize(types.deserialize(cdr, typename)) == cdr


def test_fields_survive_cdr() -> None:
    sent = types.new("sensor_msgs/msg/JointState", name=["waist", "elbow"], position=np.array([0.5, -1.25]))
    got = types.deserialize(types.serialize(sent), "sensor_msgs/msg/JointState")
    assert got.name == ["waist", "elbow"]
    assert got.position.tolist() == [0.5, -1.25]
    assert got.effort.size == 0


@pytest.mark.parametrize("typename", STANDARD + DECLARED)
def test_the_schema_text_describes_the_same_type_to_another_parser(typename: str) -> None:
    parsed = get_types_from_msg(definitions.schema_text(typename), typename.replace("/srv/", "/msg/"))
    store = get_typestore(Stores.EMPTY)
    store.register(parsed)
    read = store.deserialize_cdr(types.serialize(types.new(typename)), typename.replace("/srv/", "/msg/"))
    assert read is not None


def test_an_unknown_type_is_named() -> None:
    with pytest.raises(UnknownType) as caught:
        definitions.type_hash("no_msgs/msg/Such")
    assert caught.value.details == {"type": "no_msgs/msg/Such"}


def test_a_misspelt_field_is_named() -> None:
    with pytest.raises(UnknownType) as caught:
        types.new("geometry_msgs/msg/Twist", lineal=None)
    assert caught.value.details["fields"] == ["lineal"]


@pytest.mark.parametrize(
    "cdr", [b"", b"\x00\x01\x00\x00", b"\x07\x07\x00\x00abcd", b"\x00\x01\x00\x00" + b"\xff" * 64]
)
def test_bytes_that_are_no_message_are_malformed(cdr: bytes) -> None:
    with pytest.raises(MalformedMessage) as caught:
        types.deserialize(cdr, "sensor_msgs/msg/JointState")
    assert caught.value.details["length_bytes"] == len(cdr)


def test_a_big_endian_message_is_read_as_the_little_endian_one() -> None:
    twist = types.new("geometry_msgs/msg/TwistStamped")
    twist.header.frame_id, twist.twist.linear.x = "map", 0.25
    cdr = bytes(types.STORE.serialize_cdr(twist, twist.__msgtype__, little_endian=False))
    assert cdr[1] == 0
    assert types.deserialize(cdr, twist.__msgtype__) == twist


def test_a_type_is_made_ready_before_its_first_message() -> None:
    typename = "sensor_msgs/msg/MagneticField"
    types.STORE.cache.pop(typename, None)  # other tests of this process use all types
    types.prepare(typename)
    assert typename in types.STORE.cache
    with pytest.raises(UnknownType):
        types.prepare("sensor_msgs/msg/Nothing")


@pytest.mark.parametrize(("time_ns", "sec"), [(2**31 * 10**9, 2**31 - 1), (-(2**40) * 10**9, -(2**31))])
def test_a_time_that_the_message_cannot_hold_is_its_last_or_first(time_ns: int, sec: int) -> None:
    message = types.time_message(time_ns)
    assert types.deserialize(types.serialize(message), message.__msgtype__).sec == sec
