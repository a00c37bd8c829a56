"""Robots whose drivers have the vices of `drivers.toml`, and what becomes of their numbers and their work."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import replace
from functools import cache, partial, reduce
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import patch

import numpy as np

from rodeo.errors import RodeoError
from rodeo.host.stamps import set_stamp
from rodeo.lab.config import BatteryConfig, RobotConfig
from rodeo.recording.door import MessageDoor
from rodeo.robot import ros_body
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.receipts import Gauge
from rodeo.robot.ros_body import RosBody
from rodeo.ros2 import readings, types
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.readings import Unknown
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import Topic
from rodeo.witness.motion import MotionLog
from rodeo.witness.motion import Sample as Seen
from rodeo_kinds.waste_disposal.harness.workshop import CleaningWorkshop
from rodeo_testing.recordings import Sample, Take, shifted_by
from services.charger.session import Session, SessionLimits, SessionState
from services.itrash.steps import Steps
from tests.outside.rows import Row
from tests.support.site import LAB

START_S = 1_800_000_000.0
ARM = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")
FINGERS = ("left_finger", "right_finger")
WHEELS = ("fl_wheel_joint", "fr_wheel_joint", "rl_wheel_joint", "rr_wheel_joint")
PARTS = {"arm": ARM, "fingers": FINGERS, "wheels": WHEELS}
POSITIONS = {name: 0.1 * (number + 1) for number, name in enumerate(ARM)} | {
    "left_finger": 0.03,
    "right_finger": -0.03,
}
TOPICS = {
    "odom": topics.ODOM,
    "joint_states": topics.JOINT_STATES,
    "arm": topics.ARM_STATE,
    "gripper": topics.GRIPPER_STATE,
    "battery": topics.BATTERY_STATE,
    "load": topics.BIN_LOAD,
}


class NotThere(Exception):
    """What had to work did not."""


def outcome(row: Row, folder: Path) -> str:
    """Empty where it works, else what is said."""
    folder.mkdir()
    try:
        DEEDS[row.how](row.given)
    except (NotThere, RodeoError) as error:
        return f"{getattr(error, 'code', 'refused')}: {error}"
    return ""


# -- what a driver sends -------------------------------------------------------------------------------


def _header(time_s: float, frame: str = "") -> Any:
    return types.new("std_msgs/msg/Header", stamp=types.time_message(round(time_s * 1e9)), frame_id=frame)


def _number(value: Any) -> float:
    """TOML says "nan" and "inf" as numbers; a driver's text may be anything."""
    return float(value)


def battery(time_s: float, fields: dict[str, Any]) -> Any:
    said = {"voltage": 40.0, "current": -2.0, "percentage": 0.8, "power_supply_status": 2} | fields
    return types.new(topics.BATTERY_STATE.type, header=_header(time_s), **said)


def pose(time_s: float, fields: dict[str, Any]) -> Any:
    at = dict(zip("xyz", fields.get("at", (1.0, 1.0, 0.0)), strict=True))
    turn = dict(zip("xyzw", fields.get("turn", (0.0, 0.0, 0.0, 1.0)), strict=True))
    inner = types.new(
        "geometry_msgs/msg/Pose",
        position=types.new("geometry_msgs/msg/Point", **at),
        orientation=types.new("geometry_msgs/msg/Quaternion", **turn),
    )
    header = _header(time_s + fields.get("stamp_off_s", 0.0), fields.get("frame", "map"))
    return types.new(topics.POSE.type, header=header, pose=inner)


def _stamp_s(time_s: float, fields: dict[str, Any]) -> float:
    """With a clock that ticks each `tick_s`, and one message of `late_every` `back_s` late."""
    if tick_s := fields.get("tick_s"):
        time_s = START_S + math.floor((time_s - START_S) / tick_s + 1e-6) * tick_s
    late = (round((time_s - START_S) * 100) % fields.get("late_every", 2) == 1) * fields.get("back_s", 0.0)
    return time_s + fields.get("stamp_off_s", 0.0) - late


def joints(time_s: float, fields: dict[str, Any]) -> Any:
    names = [name for part in fields.get("parts", PARTS) for name in PARTS[part]]
    names = names[::-1] if fields.get("reversed") else names
    names = [name for name in names if name not in fields.get("without", ())]
    names += fields.get("again", [])
    positions = [fields.get("other", POSITIONS.get(name, 0.0)) for name in names]
    said = fields.get("positions", {}) | {
        name: math.nan for part in fields.get("nowhere", ()) for name in PARTS[part]
    }
    for name, value in said.items():
        positions[names.index(name)] = value
    columns = {"position": positions, "velocity": [0.0] * len(names), "effort": [1.0] * len(names)}
    columns |= {one: [] for one in fields.get("empty", ())}
    columns |= {one: [math.nan] * len(names) for one in fields.get("unmeasured", ())}
    named = [fields.get("prefix", "") + name for name in names]
    arrays = {name: np.array(one, float) for name, one in columns.items()}
    return types.new(
        topics.JOINT_STATES.type,
        header=_header(_stamp_s(time_s, fields), fields.get("frame", "")),
        name=named,
        **arrays,
    )


MESSAGES: dict[str, Callable[[float, dict[str, Any]], Any]] = {
    "battery": battery,
    "pose": pose,
    "joints": joints,
}


class Lab:
    """A clock that runs while somebody waits, drivers that send meanwhile, and the node that hears."""

    def __init__(self, streams: Sequence[dict[str, Any]]) -> None:
        self._time_s = START_S
        self._streams = streams
        self._sent = [0] * len(streams)
        self._heard: dict[str, list[Callable[[MessageInfo], None]]] = {}

    # as a clock
    def now_s(self) -> float:
        return self._time_s

    def now_ns(self) -> int:
        return round(self._time_s * 1e9)

    def notify(self) -> None:
        """Nobody waits in another thread."""

    def wait_until(self, time_s: float, _stop: object = None) -> bool:
        while self._time_s < time_s:
            self._time_s = min(self._time_s + 0.001, time_s)
            for number, stream in enumerate(self._streams):
                due = math.floor((self._time_s - START_S) * stream.get("hz", 50.0) + 1e-6)
                while self._sent[number] < min(due, stream.get("most", 10**9)):
                    self._sent[number] += 1
                    self._send(number, stream)
        return True

    def _send(self, number: int, stream: dict[str, Any]) -> None:
        kind = stream["message"]
        at_s = START_S + self._sent[number] / stream.get("hz", 50.0)
        fields = stream.get("first", stream) if self._sent[number] == 1 else stream
        cdr = types.serialize(MESSAGES[kind](at_s, {k: v for k, v in fields.items() if k not in _OWN}))
        info = MessageInfo(cdr, self.now_ns(), self._sent[number], bytes([number]) * 16)
        for callback in self._heard.get(_NAMES[kind], []):
            callback(info)

    # as a node
    def raw_subscription(self, topic: str, _type: str, callback: Any, **_options: Any) -> Any:
        self._heard.setdefault(topic, []).append(callback)
        return SimpleNamespace(close=lambda: None)

    def subscription(self, topic: str, typename: str, callback: Any, **_options: Any) -> None:
        self.raw_subscription(
            topic, typename, lambda info: callback(types.deserialize(info.cdr, typename), info)
        )

    def client(self, *_names: str) -> Any:
        return SimpleNamespace(wait_for_server=lambda _wait_s: False)


_OWN = ("message", "hz", "most", "first")
_NAMES = {
    "battery": "panther1/battery_state",
    "joints": "panther1/joint_states",
    "pose": "mocap/panther1/pose",
}


@cache
def _site() -> Site:
    return Site.load(LAB)


@contextmanager
def _body(
    streams: Sequence[dict[str, Any]], fields: dict[str, Any] | None = None
) -> Iterator[tuple[RosBody, Lab]]:
    lab, site = Lab(streams), _site()
    fake_time = SimpleNamespace(monotonic=lambda: lab.now_s(), time=lab.now_s)
    with (
        patch.object(ros_body, "ActionClient", lambda *_a, **_k: None),
        patch.object(ros_body, "time", fake_time),
        patch("rodeo.host.clock.time", fake_time),
    ):
        wall = site.clock.model_copy(update={"source": "wall", "speed": 1.0, "idle_speed": 1.0})
        robot = RobotConfig.model_validate(site.robots[0].model_dump() | (fields or {}))
        site = site.model_copy(update={"clock": wall, "robots": [robot]})
        yield RosBody(cast(Any, lab), site, site.robots[0], cast(Any, lab), Interrupts()), lab


def _live(given: dict[str, Any]) -> None:
    """The robot's mind asks its body."""
    with _body(given["streams"], given.get("robot")) as (body, lab):
        lab.wait_until(START_S + given.get("after_s", 1.0))
        asked = given["asks"]
        found: Any
        expected: Any = given.get("is")
        if asked == "soc":
            found = body.battery().soc
        elif asked == "arm":
            joints = body.joints()
            found = [*np.round(joints.arm_rad, 6), round(joints.gripper_m, 6)]
            expected = [*(POSITIONS[name] for name in ARM), POSITIONS["left_finger"]]
        else:
            found = body.base_pose().x_m
        if not np.allclose(found, expected, atol=1e-6):
            raise NotThere(f"{asked} is {found}, and not {expected}")


def _ready(given: dict[str, Any]) -> None:
    """The robot's mind looks whether it can work with this body at all."""
    with _body(given["streams"], given.get("robot")) as (body, lab):
        for step in range(1, 11):
            lab.wait_until(START_S + step / 2)
            said = body.unfit()
        if said:
            raise NotThere(said)


# -- the recorder --------------------------------------------------------------------------------------


def _door(topic: Topic) -> Any:
    return MessageDoor(topic, 15.0, lambda: 0.0)


def _recorded(given: dict[str, Any]) -> None:
    """A recorder hears this publisher, or these, for some seconds."""
    streams, seconds = given["streams"], given.get("seconds", 4.0)
    topic = TOPICS[given.get("topic", "joint_states")]
    door = _door(topic)
    times = sorted(
        (START_S + step / stream.get("hz", 50.0), number, step)
        for number, stream in enumerate(streams)
        for step in range(1, int(seconds * stream.get("hz", 50.0)) + 1)
    )
    refused: list[str] = []
    for time_s, number, step in times:
        stream = streams[number]
        said = {key: value for key, value in stream.items() if key not in _OWN}
        message = _of(topic, time_s, said)
        info = MessageInfo(types.serialize(message), round(time_s * 1e9), step, bytes([number]) * 16)
        if (why := door.refusal(info, round(time_s * 1e9))) is not None:
            refused.append(str(why))
    if refused:
        raise NotThere(f"{len(refused)} of {len(times)} were left out: {refused[0]}")


def _of(topic: Topic, time_s: float, fields: dict[str, Any]) -> Any:
    if topic is topics.JOINT_STATES:
        return joints(time_s, fields)
    if topic is topics.BATTERY_STATE:
        return battery(time_s, fields)
    message = types.new(topic.type, header=_header(time_s, "panther1/odom"))
    if topic is topics.ODOM:
        message.pose.pose.orientation.w = 1.0
        message.pose.covariance = np.full(36, fields.get("covariance", 0.0))
        message.twist.twist.linear.x = _number(fields.get("speed", 0.0))
    return message


# -- a film, judged ------------------------------------------------------------------------------------


@cache
def _workshop() -> CleaningWorkshop:
    return CleaningWorkshop(_site(), Path(tempfile.mkdtemp(prefix="drivers")))


def _film(given: dict[str, Any]) -> None:
    """Honest work of a robot that speaks like this is judged."""
    shop = _workshop()
    take = shop.take
    for name, factor in given.get("times", {}).items():
        take = at_rate(take, TOPICS[name], factor)
    if parts := given.get("split"):
        take = _split(take, parts)
    if given.get("prefix"):
        take = take.edited("panther1/joint_states", lambda s: _renamed(s, given["prefix"]))
    for name, fields in given.get("unmeasured", {}).items():
        take = take.edited(TOPICS[name].name(ns="panther1"), partial(_unmeasured, fields))
    if every := given.get("stamped_again"):
        take = take.edited("panther1/joint_states", partial(_stamped_again, every))
    report = shop.judged(replace(shop.submitted(take), site=_declaring(shop.site, given.get("rates"))))
    if not report.accepted:
        raise NotThere(report.reason)


def _unmeasured(fields: dict[str, Any], sample: Sample) -> Sample:
    """`fields` of joints, or of a controller's feedback, are NaN in every so many messages."""
    if sample.sequence % fields.get("every", 1):
        return sample
    message = deepcopy(sample.message)
    for name in fields.get("all", ()):
        inner = reduce(getattr, name.split(".")[:-1], message)
        column = getattr(inner, name.rpartition(".")[2])
        setattr(inner, name.rpartition(".")[2], np.full(len(column), np.nan))
    for part in fields.get("nowhere", ()):
        message.position = np.where(np.isin(message.name, PARTS[part]), np.nan, message.position)
        message.effort = np.where(np.isin(message.name, PARTS[part]), np.nan, message.effort)
    return replace(sample, message=message)


def _stamped_again(every: int, sample: Sample) -> Sample:
    """One message of so many has the stamp of the one before."""
    if sample.sequence % every:
        return sample
    message = deepcopy(sample.message)
    set_stamp(message, sample.time_ns - 20_000_000)
    return replace(sample, message=message)


def _declaring(site: Site, rates: dict[str, float] | None) -> Site:
    if rates is None:
        return site
    robot = RobotConfig.model_validate(site.robots[0].model_dump() | {"rates": rates})
    return site.model_copy(update={"robots": [robot, *site.robots[1:]]})


def at_rate(take: Take, topic: Topic, factor: float) -> Take:
    """Messages of `topic` so many times as often, with what was between two of them in between."""
    name = topic.name(ns="panther1")
    own = take.of(name)
    period_ns = own[1].time_ns - own[0].time_ns
    if factor < 1:
        kept = own[:: round(1 / factor)]
        again = [replace(sample, sequence=number) for number, sample in enumerate(kept)]
    else:
        again = []
        for one, other in pairwise(own):
            for step in range(round(factor)):
                share = step / factor
                made = shifted_by(
                    replace(one, message=_between(one.message, other.message, share)),
                    round(share * period_ns),
                )
                again.append(replace(made, sequence=len(again)))
    others = [sample for sample in take.samples if sample.topic != name]
    return Take(sorted([*others, *again], key=lambda sample: sample.time_ns))


def _between(one: Any, other: Any, share: float) -> Any:
    """Numbers between those of two messages; what is not a number is the first one's."""
    if isinstance(one, float):
        return one + share * (other - one)
    if isinstance(one, np.ndarray):
        same = one.shape == other.shape and one.dtype == float
        return one + share * (other - one) if same else one
    if hasattr(one, "__dataclass_fields__") and "sec" not in one.__dataclass_fields__:
        names = [name for name in one.__dataclass_fields__ if name != "__msgtype__"]
        return replace(
            one, **{name: _between(getattr(one, name), getattr(other, name), share) for name in names}
        )
    return one


def _part(sample: Sample, names: Sequence[str]) -> Sample:
    message = sample.message
    at = [message.name.index(name) for name in names]
    columns = {one: getattr(message, one)[at] for one in ("position", "velocity", "effort")}
    return replace(sample, message=replace(message, name=list(names), **columns))


def _split(take: Take, parts: Sequence[Sequence[str]]) -> Take:
    """Joint states from several publishers, of which each knows some of the joints."""
    name, samples = "panther1/joint_states", list[Sample]()
    for sample in take.samples:
        if sample.topic != name:
            samples.append(sample)
            continue
        for number, part in enumerate(parts):
            mine = [joint for one in part for joint in PARTS[one]]
            late = shifted_by(_part(sample, mine), number * 3_000_000)
            samples.append(late)
    return Take(sorted(samples, key=lambda sample: sample.time_ns))


def _renamed(sample: Sample, prefix: str) -> Sample:
    return replace(
        sample, message=replace(sample.message, name=[prefix + name for name in sample.message.name])
    )


# -- a charge ------------------------------------------------------------------------------------------


def _charge(given: dict[str, Any]) -> None:
    """A dock delivers 400 W while the robot's gauge says this; the robot signs each second."""
    config = BatteryConfig()
    gauge, limits = Gauge(config), SessionLimits(42.0, 1.0, 1e6, given.get("target", 0.95), math.inf)
    session = Session(SessionState(wait_until_s=math.inf), limits)
    said = [value for value, seconds in given["says"] for _ in range(seconds)]
    energy_wh = 0.0
    for second, value in enumerate(said):
        time_s = START_S + second
        flows = second >= 10
        current_a = 10.0 if flows else 0.0
        flow = {"current": given.get("current", current_a), "percentage": value}
        with suppress(Unknown):
            found = readings.battery(battery(time_s, flow))
            if found.voltage_v is not None and found.current_a is not None:
                gauge.reading(found.time_s, found.voltage_v, found.current_a, found.soc)
        energy_wh += 40.0 * current_a / 3600
        if gauge.latest is not None:
            session.signed(gauge.latest.soc)
        session.reading(time_s, 40.0, current_a, True, energy_wh, True)
        session.contactor(session.contactor_wanted, time_s)
    ended = None if session.state.end is None else session.state.end.value
    if ended != given.get("ends"):
        raise NotThere(f"the charge ended with {ended} after {energy_wh:.1f} Wh")


# -- witnesses -----------------------------------------------------------------------------------------


def _seen(given: dict[str, Any]) -> None:
    """Motion capture shows an item at rest for two seconds, and then this for two more."""
    log = MotionLog(["item1"], 0)
    for step in range(200):
        at, turn = (1.0, 2.0, 0.1), (1.0, 0.0, 0.0, 0.0)
        if step >= 100:
            at, turn = tuple(given.get("at", at)), tuple(given.get("turn", turn))
        log.add("item1", Seen(step * 20_000, cast(Any, at), cast(Any, turn)))
        if step % 50 == 49:
            fields = log.take(step * 20_000, step)
    last = fields
    if ("item1" in last.resting and not last.unseen_us) != given.get("rests", False):
        raise NotThere(f"it was signed: {last.resting} {last.unseen_us}")


def _depth(given: dict[str, Any]) -> None:
    """The wrist camera sends a picture of a wall 1.5 m away, with a pixel that it did not measure."""
    kinds = {"32FC1": "f4", "16UC1": "u2", "mono16": "u2", "8UC1": "u1"}
    order = ">" if given.get("big_endian") else "<"
    metres = np.full((4, 6), 1.5)
    metres[0, 0] = given.get("unmeasured", 0.0)
    unit = 1.0 if given["encoding"] == "32FC1" else 1000.0
    rows = (metres * unit).astype(order + kinds[given["encoding"]])
    padding = given.get("padding", 0)
    raw = np.hstack([rows.view("u1").reshape(4, -1), np.zeros((4, padding), "u1")])
    image = types.new(
        topics.WRIST_DEPTH.type,
        height=4,
        width=6,
        encoding=given["encoding"],
        is_bigendian=int(given.get("big_endian", False)),
        step=raw.shape[1],
        data=raw.ravel(),
    )
    found = readings.depth_m(image)
    if not np.allclose(found[1:], 1.5) or (np.isfinite(found[0, 0]) and found[0, 0] != 0):
        raise NotThere(f"another picture: {found[0, 0]} {found[1, 1]}")


def _bin(given: dict[str, Any]) -> None:
    """A bin's sensor says this; whether the bin takes it for a reading."""
    took: list[float] = []

    def take(value: float) -> list[Any]:
        took.append(value)
        return []

    bin_ = SimpleNamespace(
        presence=lambda value, _time_s: take(value),
        load=lambda _name, value, _time_s: take(value),
        memory=SimpleNamespace(unsigned=[]),
    )
    heard: dict[str, Callable[[Any, Any], None]] = {}
    node = SimpleNamespace(
        subscription=lambda topic, _type, callback, inline: heard.update({topic: callback})
    )
    steps, config, value = Steps(cast(Any, bin_), cast(Any, None)), _site().bins[0], _number(given["says"])
    steps.listen(cast(Any, node), config)
    if given["sensor"] == "presence":
        topic = topics.BIN_PRESENCE.name(bin=config.name)
        message = types.new(topics.BIN_PRESENCE.type, header=_header(START_S), range=value)
        message.min_range, message.max_range = 0.02, 2.0
    else:
        topic = topics.BIN_LOAD.name(bin=config.name, compartment=next(iter(config.compartments)))
        message = types.new(topics.BIN_LOAD.type, header=_header(START_S))
        message.wrench.force.z = value
    with patch.object(steps, "feed", lambda _sensor, step: step()):
        heard[topic](message, None)
    if bool(took) != given["taken"]:
        raise NotThere(f"the bin took {took}")


def _declare(given: dict[str, Any]) -> None:
    """A site file says these rates."""
    try:
        _declaring(_site(), given["rates"])
    except ValueError as error:
        raise NotThere(str(error)) from error


DEEDS: dict[str, Callable[[dict[str, Any]], None]] = {
    "live": _live,
    "ready": _ready,
    "recorded": _recorded,
    "film": _film,
    "charge": _charge,
    "seen": _seen,
    "depth": _depth,
    "bin": _bin,
    "declare": _declare,
}
