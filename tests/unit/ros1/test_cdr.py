"""Messages of ROS 1 become ROS 2's CDR and are the same when they come back; what is malformed is refused."""

from __future__ import annotations

import json
import math
import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rodeo_ros1.cdr import Codec, Codecs
from rodeo_ros1.errors import ConfigError, Malformed
from rodeo_ros1.layouts import Layouts
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rodeo.interfaces.package import interfaces, register
from rodeo.interfaces.ros1 import TABLE
from rodeo.ros2 import definitions, types
from rodeo.site import topics
from tests.noetic_robot.definitions import definitions as ros1_definitions
from tests.noetic_robot.definitions import messages_of

ROOT = Path(__file__).parents[3]
LAYOUTS = Layouts.load()
INSTANTS = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
NOTHING = "structure_needs_at_least_one_member"
UNKNOWN = ("seq", NOTHING)
"""Fields that the relay does not fill in: the publisher's number, and the one that empty messages have."""
FORMS = {"msg": [""], "srv": ["_Request", "_Response"], "action": ["_Goal", "_Result", "_Feedback"]}


MORE = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message\n",
}
"""Definitions that Debian has, and rosbags has not."""


def _noetic() -> Any:
    """rosbags' types of Noetic, and those that the robot has beside them."""
    store = get_typestore(Stores.ROS1_NOETIC)
    added: dict[str, Any] = {}
    for full_name, text in (ros1_definitions(ROOT / "rodeo_ros1" / "rodeo_msgs") | MORE).items():
        package, form, name = full_name.split("/")
        parts = (
            dict(zip((f"{name}Request", f"{name}Response"), text.split("---\n"), strict=True))
            if form == "srv"
            else messages_of(name, text)
            if form == "action"
            else {name: text}
        )
        for part, content in parts.items():
            # Within a package an action's parts have no prefix, which only genmsg understands.
            added |= get_types_from_msg(content, f"{package}/msg/{part}")
    store.register({name: definition for name, definition in added.items() if "Action" not in name})
    return store


NOETIC = _noetic()


def slot_type(descriptor: Any) -> str:
    kind, detail = descriptor
    if kind == definitions.BASE:
        return str(detail[0])
    if kind == definitions.NAME:
        return INSTANTS.get(detail, detail.replace("/msg/", "/"))
    element, count = detail
    return f"{slot_type(element)}[{count or ''}]"


_classes: dict[str, Any] = {}


def message_class(package: str, name: str) -> Any:
    """A class like genpy's, of which a new object has no fields yet: the codec sets all that it knows."""
    typename = f"{package}/msg/{name}"
    if typename not in _classes:
        fields = [one for one in NOETIC.fielddefs[typename][1] if one[0] != NOTHING]
        members = {
            "__slots__": [field for field, _ in fields],
            "_slot_types": [slot_type(kind) for _, kind in fields],
        }
        _classes[typename] = type(name, (), {"typename": typename, **members})
    return _classes[typename]


def instant(seconds: int, nanoseconds: int) -> Any:
    return SimpleNamespace(secs=seconds, nsecs=nanoseconds)


def codec_of(typename: str) -> Codec:
    package, _, name = name_in_ros1(typename).split("/")
    return Codecs(LAYOUTS, message_class, instant, instant).codec(typename, message_class(package, name))


def name_in_ros1(typename: str) -> str:
    package, form, name = typename.split("/")
    base, _, part = name.partition("_")
    package, base = LAYOUTS.ros1_name(f"{package}/{form}/{base}")
    return f"{package}/msg/{base}{part}"


def is_message(typename: str) -> bool:
    return "/msg/" in typename or typename.endswith(
        ("_Request", "_Response", "_Goal", "_Result", "_Feedback")
    )


def relayed() -> list[str]:
    """Every type of the table that ROS 1 has."""
    table = json.loads((ROOT / TABLE).read_text())["types"]
    return [
        name
        for name in table
        if name not in INSTANTS and name_in_ros1(name) in NOETIC.fielddefs and is_message(name)
    ]


def random_value(chance: random.Random, descriptor: Any) -> Any:
    kind, detail = descriptor
    if kind == definitions.NAME:
        return random_message(chance, detail)
    if kind == definitions.BASE:
        name = detail[0]
        if name == "string":
            return "".join(chance.choice("aé☃ \n𝄞") for _ in range(chance.randrange(6)))
        if name == "bool":
            return chance.random() < 0.5
        if name.startswith("float"):
            return chance.choice([0.0, -1.5, math.inf, 0.25 * chance.randrange(-(2**20), 2**20)])
        # rosbags' byte has a sign, as in ROS 1.
        info = np.iinfo({"byte": "int8", "char": "uint8"}.get(name, name))
        return chance.choice([int(info.min), int(info.max), chance.randrange(0, 100)])
    element, count = detail
    length = count if kind == definitions.ARRAY else chance.randrange((count or 4) + 1)
    values = [random_value(chance, element) for _ in range(length)]
    if element[0] == definitions.BASE and element[1][0] != "string":
        return np.array(values, {"byte": "int8", "char": "uint8"}.get(element[1][0], element[1][0]))
    return values


def random_message(chance: random.Random, typename: str) -> Any:
    if typename in INSTANTS:
        return types.new(typename, sec=chance.randrange(2**31), nanosec=chance.randrange(10**9))
    fields = dict(definitions.definition(typename).fields)
    return types.new(typename, **{name: random_value(chance, kind) for name, kind in fields.items()})


def without(message: Any, typename: str, ros1: str) -> Any:
    """The message as it is after a way through ROS 1: what ROS 1 lacks is zero."""
    fields = {}
    there = dict(NOETIC.fielddefs[ros1][1])
    for name, kind in definitions.definition(typename).fields:
        renamed = LAYOUTS.ros1_field(typename, name)
        slot = next((one for one in (renamed, renamed.upper()) if one in there and one != NOTHING), None)
        if slot is not None:
            fields[name] = _without(getattr(message, name), kind, there[slot])
    return types.new(typename, **fields)


def _without(value: Any, kind: Any, ros1: Any) -> Any:
    if kind[0] == definitions.NAME and kind[1] not in INSTANTS:
        return without(value, kind[1], ros1[1])
    if kind[0] in (definitions.ARRAY, definitions.SEQUENCE) and kind[1][0][0] == definitions.NAME:
        return [_without(one, kind[1][0], ros1[1][0]) for one in value]
    return value


def to_noetic(value: Any, descriptor: Any) -> Any:
    """A value as the codec made it, as rosbags' Noetic wants it."""
    kind, detail = descriptor
    if kind == definitions.NAME:
        if detail in INSTANTS:
            return NOETIC.types[detail](value.secs, value.nsecs)
        fields = NOETIC.fielddefs[detail][1]
        return NOETIC.types[detail](
            **{name: 0 if name in UNKNOWN else to_noetic(getattr(value, name), one) for name, one in fields}
        )
    if kind == definitions.BASE:
        return value
    element = detail[0]
    if element[0] == definitions.BASE and element[1][0] != "string":
        dtype = {"byte": "int8", "char": "uint8"}.get(element[1][0], element[1][0])
        return np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.array(value, dtype)
    return [to_noetic(one, element) for one in value]


@pytest.mark.long
@pytest.mark.parametrize("typename", relayed())
def test_a_message_is_the_same_after_a_way_through_ros_1(typename: str) -> None:
    register()
    chance = random.Random(typename)
    codec = codec_of(typename)
    ros1 = name_in_ros1(typename)
    for _ in range(20):
        sent = random_message(chance, typename)
        got = codec.decode(types.serialize(sent))
        assert codec.encode(got) == types.serialize(without(sent, typename, ros1))
        # ROS 1's own format holds each of its values.
        wire = NOETIC.serialize_ros1(to_noetic(got, (definitions.NAME, ros1)), ros1)
        again = NOETIC.deserialize_ros1(wire, ros1)
        assert bytes(NOETIC.serialize_ros1(again, ros1)) == bytes(wire)


def test_the_interface_of_a_robot_is_relayed_whole() -> None:
    names = set(relayed())
    robot = [
        one
        for one in topics.TOPICS
        if one.plane is topics.Plane.ROBOT and one.writer in (topics.BODY, "robot_agent")
    ]
    parts = {topics.Form.TOPIC: [""], topics.Form.SERVICE: ["_Request", "_Response"]}
    for one in robot:
        wanted = parts.get(one.form, ["_Goal", "_Result", "_Feedback"])
        assert {f"{one.type}{part}" for part in wanted} <= names, one.key
    own = {f"{one.typename}{part}" for one in interfaces() for part in FORMS[one.form]}
    assert own <= names


def test_names_that_ros_1_has_otherwise_carry_the_same_values() -> None:
    sent = types.new("sensor_msgs/msg/CameraInfo", d=np.array([0.5]), width=96)
    got = codec_of("sensor_msgs/msg/CameraInfo").decode(types.serialize(sent))
    assert (list(got.D), got.width) == ([0.5], 96)
    state = types.new("control_msgs/msg/JointTrajectoryControllerState", joint_names=["waist"])
    state.reference.positions = np.array([0.25])
    got = codec_of("control_msgs/msg/JointTrajectoryControllerState").decode(types.serialize(state))
    assert (got.joint_names, list(got.desired.positions)) == (["waist"], [0.25])
    goal = types.new("nav2_msgs/action/NavigateToPose_Goal")
    goal.pose.pose.position.x = 3.5
    got = codec_of("nav2_msgs/action/NavigateToPose_Goal").decode(types.serialize(goal))
    assert got.target_pose.pose.position.x == 3.5


def test_a_stamp_keeps_its_nanoseconds_and_one_that_ros_2_has_not_is_refused() -> None:
    codec = codec_of("std_msgs/msg/Header")
    sent = types.new("std_msgs/msg/Header", stamp=types.time_message(1_700_000_000_123_456_789))
    got = codec.decode(types.serialize(sent))
    assert (got.stamp.secs, got.stamp.nsecs) == (1_700_000_000, 123_456_789)
    got.stamp.secs = 2**31
    with pytest.raises(Malformed, match="Header"):
        codec.encode(got)
    for sec, nanosec in ((-1, 0), (0, 10**9)):
        stamp = types.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        with pytest.raises(Malformed, match="no time"):
            codec.decode(types.serialize(types.new("std_msgs/msg/Header", stamp=stamp)))


def test_a_duration_that_ros_1_counts_backwards_is_the_same() -> None:
    codec = codec_of("trajectory_msgs/msg/JointTrajectoryPoint")
    point = codec.decode(types.serialize(types.new("trajectory_msgs/msg/JointTrajectoryPoint")))
    point.time_from_start = instant(1, -250_000_000)
    got = types.deserialize(codec.encode(point), "trajectory_msgs/msg/JointTrajectoryPoint")
    assert (got.time_from_start.sec, got.time_from_start.nanosec) == (0, 750_000_000)


@pytest.mark.parametrize("typename", ["sensor_msgs/msg/JointState", "rodeo_msgs/srv/GetWallet_Request"])
def test_bytes_that_are_cut_changed_or_made_up_are_refused_or_read(typename: str) -> None:
    """Nothing else is raised, and nothing is allocated that is not there."""
    register()
    chance = random.Random(1)
    codec = codec_of(typename)
    cdr = types.serialize(random_message(chance, typename))
    made_up = [bytes(chance.randrange(256) for _ in range(chance.randrange(80))) for _ in range(500)]
    huge = b"\0\1\0\0" + b"\xff" * 40
    changed = [cdr[:at] + bytes([chance.randrange(256)]) + cdr[at + 1 :] for at in range(len(cdr))]
    refused = 0
    for sent in (*made_up, huge, *changed, *(cdr[:end] for end in range(len(cdr) - 1))):
        try:
            codec.decode(sent)
        except Malformed:
            refused += 1
    assert refused > 400


def test_more_than_an_unset_value_may_hold_is_refused_on_both_ways() -> None:
    register()
    codec = codec_of("rodeo_msgs/srv/GetWallet_Request")
    request = codec.decode(types.serialize(types.new("rodeo_msgs/srv/GetWallet_Request", account=["anna"])))
    request.account = ["anna", "ben"]
    with pytest.raises(Malformed, match="at most 1"):
        codec.encode(request)


def test_a_text_that_is_none_is_refused() -> None:
    codec = codec_of("std_msgs/msg/String")
    for text in ("\udc80", None, 5):
        with pytest.raises(Malformed):
            codec.encode(SimpleNamespace(data=text))


def test_a_robot_whose_message_is_another_is_told_so_at_the_start() -> None:
    class Odd:
        __slots__ = ("data",)
        _slot_types = ("float64",)

    with pytest.raises(ConfigError, match=r"String.data is string in ROS 2, and float64 in ROS 1"):
        Codecs(LAYOUTS, message_class, instant, instant).codec("std_msgs/msg/String", Odd)
