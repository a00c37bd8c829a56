"""A number that is not finite, or an orientation that is no rotation, is unknown in every subscriber."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rodeo.bus.messages import Status
from rodeo.errors import RodeoError
from rodeo.host.http import problem
from rodeo.robot import ros_body
from rodeo.robot.errors import BodySilent, MotionFailed
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.ros_body import RosBody
from rodeo.ros2 import readings, types
from rodeo.ros2.readings import Unknown
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.text.strict_json import encode
from rodeo_experiments.lab import Lab
from rodeo_experiments.progress import Meters
from services.charger.terminals import BusTerminals
from services.console.heartbeats import number as finite
from services.console.live import Newest
from services.console.replay import _rounded
from services.robot_agent.energy import EnergyMeter
from services.robot_agent.upkeep import Upkeep
from services.robot_sim.actions import _goal_pose
from services.robot_sim.plane import _entity_state
from services.robot_sim.planner import GoalOutsideMap
from tests.support.site import LAB
from tests.unit.robot.fakes import ManualClock

NAN, INF = math.nan, math.inf
NO_NUMBERS = (NAN, INF, -INF)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
NO_ROTATIONS = [
    (0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 2.0),
    (0.0, 0.0, 0.6, 0.6),
    (NAN, 0.0, 0.0, 1.0),
    (0.0, INF, 0.0, 1.0),
]
BATTERY, JOINTS = topics.BATTERY_STATE.type, topics.JOINT_STATES.type


def pose(x_m: float = 1.0, turn: tuple[float, ...] = UPRIGHT) -> Any:
    made = types.new("geometry_msgs/msg/PoseStamped")
    made.header.frame_id = "map"
    made.pose.position.x = x_m
    orientation = made.pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = turn
    return made


def battery(percentage: float = 0.5, voltage: float = 25.0, current: float = -2.0) -> Any:
    return types.new(BATTERY, percentage=percentage, voltage=voltage, current=current)


BAD_POSES = [*(pose(x_m) for x_m in NO_NUMBERS), *(pose(turn=turn) for turn in NO_ROTATIONS)]


def test_finite_numbers_in_their_range_are_known() -> None:
    assert readings.pose(pose().pose) and readings.pose(pose(turn=(0.6, 0.0, 0.0, -0.8)).pose)
    assert [readings.battery(battery(one)).soc for one in (0.0, 1.0)] == [0.0, 1.0]
    assert readings.power(battery())[1:] == (25.0, -2.0)
    assert readings.joints([joints()], ("waist",)).positions == {"waist": 0.1}


@pytest.mark.parametrize("message", BAD_POSES)
def test_a_pose_without_place_or_rotation_is_unknown(message: Any) -> None:
    with pytest.raises(Unknown):
        readings.pose(message.pose)


@pytest.mark.parametrize("percentage", [*NO_NUMBERS, -0.1, 87.0])
def test_a_charge_outside_its_range_is_unknown(percentage: float) -> None:
    with pytest.raises(Unknown):
        readings.battery(battery(percentage))


# -- the robot's mind -----------------------------------------------------------------------------------

ARM = [
    "waist",
    "shoulder",
    "elbow",
    "forearm_roll",
    "wrist_angle",
    "wrist_rotate",
    "left_finger",
    "right_finger",
]


def joints(angle_rad: float = 0.1, name: list[str] = ARM) -> Any:
    positions = np.full(len(name), 0.1)
    positions[0] = angle_rad
    return types.new(JOINTS, name=name, position=positions)


class Robot:
    """A mind's body whose topics the test speaks on; a wait of its clock lets the next message come."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.heard: dict[str, list[Callable[[Any], None]]] = {}
        self.clock = ManualClock()
        self.grip = SimpleNamespace(position=0.01, stalled=True)
        monkeypatch.setattr(ros_body, "ActionClient", lambda *_names, **_how: None)
        wall_s = time.monotonic()
        monkeypatch.setattr(ros_body.time, "monotonic", lambda: wall_s + self.clock.now_s())
        monkeypatch.setattr("rodeo.host.clock.time.monotonic", lambda: wall_s + self.clock.now_s())
        node: Any = SimpleNamespace(raw_subscription=self._subscribe, client=lambda *_name: None)
        site = Site.load(LAB)
        self.body = RosBody(node, site, site.robots[0], self.clock, Interrupts())

    def _subscribe(self, topic: str, _type: str, heard: Callable[[Any], None], *, inline: bool) -> Any:
        self.heard.setdefault(topic, []).append(heard)
        return SimpleNamespace(close=lambda: None)

    def say(self, topic: str, message: Any) -> None:
        for heard in self.heard[topic]:
            heard(SimpleNamespace(cdr=types.serialize(message), gid=b""))


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    return Robot(monkeypatch)


POSE, CHARGE, ANGLES = "mocap/panther1/pose", "panther1/battery_state", "panther1/joint_states"
SENSES: list[tuple[str, Any, Any, str]] = [
    *((POSE, message, pose(), "base_pose") for message in BAD_POSES),
    *((CHARGE, battery(value), battery(), "battery") for value in (*NO_NUMBERS, 87.0)),
    *((ANGLES, joints(value), joints(), "joints") for value in NO_NUMBERS),
    (ANGLES, joints(name=["front_left_wheel"]), joints(), "joints"),
    (ANGLES, types.new(JOINTS, name=ARM), joints(), "joints"),
]


@pytest.mark.parametrize(("topic", "bad", "good", "sense"), SENSES)
def test_what_a_body_does_not_know_is_shown_waited_for_and_then_a_reason(
    robot: Robot, topic: str, bad: Any, good: Any, sense: str
) -> None:
    ask = getattr(robot.body, sense)
    robot.say(topic, bad)
    vitals = robot.body.vitals()
    assert not {"soc", "docked"} & vitals.keys()
    json.loads(encode(vitals), parse_constant=lambda name: pytest.fail(name))
    assert robot.body.recent_base_pose() is None and robot.body.recent_gripper_m() is None
    goes_on = robot.clock.wait_until

    def hear(time_s: float, stop: threading.Event | None = None) -> bool:
        robot.say(topic, bad)
        return goes_on(time_s, stop)

    robot.clock.wait_until = hear  # type: ignore[method-assign]
    with pytest.raises(BodySilent) as silent:
        ask()
    assert (
        topic in silent.value.message
        and robot.body.unknown.removeprefix(f"{topic}: ") in silent.value.message
    )
    assert topic in str(robot.body.vitals()["unknown"])
    bad = good
    ask()
    assert "unknown" not in robot.body.vitals() and robot.body.unknown == ""


@pytest.mark.parametrize("position", NO_NUMBERS)
def test_a_gripper_that_does_not_say_where_it_is_has_failed(robot: Robot, position: float) -> None:
    robot.body._execute = lambda *_: SimpleNamespace(position=position, stalled=True)  # type: ignore[method-assign]
    with pytest.raises(MotionFailed):
        robot.body.grip(0.0, 5.0)


@pytest.mark.parametrize("voltage", NO_NUMBERS)
def test_what_a_robot_learns_of_its_consumption_stays_finite(voltage: float) -> None:
    upkeep: Any = Upkeep.__new__(Upkeep)
    heard: list[tuple[float, float]] = []
    upkeep._body, upkeep._lock = SimpleNamespace(recent_base_pose=lambda: None), threading.Lock()
    upkeep._meter, upkeep._readings, upkeep._working = EnergyMeter(), 0, True
    for number, message in enumerate((battery(), battery(voltage=voltage), battery(), battery())):
        message.header.stamp.sec = number
        upkeep._on_battery(message)
        heard.append((upkeep._meter.energy_wh, upkeep._meter.duration_s))
    assert heard[1] == heard[0] and heard[3] == (pytest.approx(3 * 50 / 3600), 3.0)


# -- the other subscribers ------------------------------------------------------------------------------


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_a_dock_that_measures_nothing_is_silent_and_says_why(value: float) -> None:
    heard: list[Any] = []
    topics_: dict[str, Callable[[Any, Any], None]] = {}
    node: Any = SimpleNamespace(
        client=lambda *_: None,
        subscription=lambda topic, _type, on_message, inline: topics_.update({topic: on_message}),
    )
    terminals = BusTerminals(node, "dock", lambda message, _info: heard.append(message))
    (on_output,) = topics_.values()
    for message in (battery(voltage=value), battery(current=value)):
        on_output(message, None)
        assert "can be used: the" in terminals.silence
    assert not heard
    on_output(battery(), None)
    assert len(heard) == 1 and terminals.silence == ""


@pytest.mark.parametrize(
    ("topic", "bad", "good"),
    [
        *((topics.MOCAP_POSE, message, pose()) for message in BAD_POSES),
        *((topics.BATTERY_STATE, battery(value), battery()) for value in NO_NUMBERS),
    ],
)
def test_the_console_draws_what_is_known(topic: topics.Topic, bad: Any, good: Any) -> None:
    came: list[Any] = []

    def take() -> Any:
        if not came:
            return None
        payload = types.serialize(came.pop())
        return SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: payload), key_expr="a key")

    session: Any = SimpleNamespace(
        declare_subscriber=lambda *_: SimpleNamespace(handler=SimpleNamespace(try_recv=take))
    )
    newest = Newest(session, 0, topic.name(ns="panther1", body="panther1"), topic.type)
    came[:] = [bad]
    newest.read()
    assert newest.message is None and not newest.fresh
    came[:] = [good]
    newest.read()
    assert newest.message is not None and newest.fresh


def test_the_consoles_numbers_are_finite() -> None:
    assert [finite(value) for value in (*NO_NUMBERS, 0.5)] == [None, None, None, 0.5]
    assert _rounded(np.array([0.5, *NO_NUMBERS])) == [0.5, None, None, None]


def test_an_experiment_notes_finite_readings_and_poses() -> None:
    meters = Meters(Site.load(LAB))
    for value in NO_NUMBERS:
        meters.on_gauge("panther1", battery(value), None)
        meters.on_gauge("panther1", battery(voltage=value), None)
        meters.on_output("dock", battery(voltage=value), None)
    assert (meters.battery, meters.flows) == ([], [])
    lab: Any = Lab.__new__(Lab)
    lab._poses = {}
    for message in BAD_POSES:
        lab._on_pose("panther1", message, None)
    assert lab._poses == {}


@pytest.mark.parametrize("message", BAD_POSES)
def test_the_simulator_goes_to_no_such_pose_and_puts_nothing_there(message: Any) -> None:
    with pytest.raises(GoalOutsideMap):
        _goal_pose(message)
    state = types.new("simulation_interfaces/msg/EntityState", pose=message.pose)
    assert _entity_state(state) is None


# -- JSON -----------------------------------------------------------------------------------------------


def strict(text: bytes) -> Any:
    return json.loads(text, parse_constant=lambda name: pytest.fail(name))


def test_no_json_has_a_number_that_is_not_finite() -> None:
    said = {"soc": NAN, "list": [INF, 1.5, {"low": -INF}]}
    nulls = {"soc": None, "list": [None, 1.5, {"low": None}]}
    assert strict(encode(said)) == nulls
    status = {"process": "robot_agent", "pid": 1, "ready": True, "reason": "", "activity": ""}
    assert (
        strict(encode(Status(**status, since_s=0.0, time_s=0.0, progress=NAN, details=said)))["details"]
        == nulls
    )
    assert strict(bytes(problem(503, "not_ready", "unknown", said).body))["details"] == nulls
    assert strict(encode(RodeoError("unknown", soc=NAN).to_json()))["details"] == {"soc": None}
