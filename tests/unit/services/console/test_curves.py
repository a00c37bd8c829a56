"""Curves of a recording miss no peak, and checks stand at the seconds that they speak of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rodeo.checks.report import Finding, at_most, equal, skipped
from rodeo.display.checked import GROUPS, lines
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.lab.world import arm_model
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_testing.assignments import BINDING, ROBOT
from services.console.curves import MOMENTS, carried, checks_at
from services.console.replay import track
from tests.support.site import LAB
from tests.unit.robot.fakes import ManualClock

RATE_HZ, MESSAGES = 20, 400
"""More messages than instants."""


def report(**findings: Finding) -> dict[str, Any]:
    return {"checks": [{"name": name} | found.model_dump(mode="json") for name, found in findings.items()]}


def test_a_peak_of_one_message_is_on_the_curve_with_the_limit_of_its_check_and_at_its_second(
    tmp_path: Path,
) -> None:
    clock, site, path = ManualClock(), Site.load(LAB), tmp_path / "proof.mcap"
    clock.time_s = 1.8e9
    robot, arm = site.robots[0], arm_model(None)
    with Recorder(path, BINDING, ROBOT, clock) as recorder:

        def write(topic: topics.Topic, message: Any) -> None:
            stamp_ns = round(clock.time_s * 1e9)
            name = topic.name(ns=robot.namespace)
            recorder.write_ros(name, topic.type, types.serialize(message), stamp_ns, stamp_ns)

        for number in range(MESSAGES):
            clock.time_s += 1 / RATE_HZ
            odom = types.new(topics.ODOM.type)
            odom.pose.pose.orientation.w = 1.0
            odom.twist.twist.linear.x = -1.9 if number == 203 else 0.5
            write(topics.ODOM, odom)
            joints = types.new(topics.JOINT_STATES.type, name=[*arm.joints, *arm.fingers])
            joints.position = np.zeros(len(joints.name))
            joints.effort = np.array([0.0] * len(arm.joints) + [4.0, -5.0 if number == 107 else 1.0])
            write(topics.JOINT_STATES, joints)
    Recorder.finish(path, BINDING, ROBOT, clock)
    checked = report(base_speed=at_most(1.9, 2.1, "m/s", ""), gripper_force=at_most(5.0, 4.5, "N", ""))
    shown = track(open_proof(path), site, checked)
    speed, grip, room = shown["curves"]
    assert (speed["name"], speed["unit"], speed["limit"], max(speed["values"])) == ("speed", "m/s", 2.1, 1.9)
    assert (grip["limit"], max(grip["values"]), min(grip["values"])) == (4.5, 5.0, 4.0)
    low, high = arm.ranges_rad.T
    assert room["values"][0] == pytest.approx(float(np.minimum(-low, high).min()), abs=0.001)
    placed = {one["moment"]: one for one in shown["checks"]}
    assert placed["highest speed"]["t"] == pytest.approx(203 / RATE_HZ, abs=0.6)
    assert placed["highest grip force"]["failed"] and not placed["highest speed"]["failed"]
    assert placed["highest grip force"]["t"] == pytest.approx(107 / RATE_HZ, abs=0.6)
    assert track(open_proof(path), site)["checks"] == []


def test_the_item_that_rose_is_gripped_when_the_fingers_stop_and_lifted_when_it_has_left_the_floor() -> None:
    items: dict[str, Any] = {"lies": {"z": [0.0] * 6}, "unseen": {"z": [None] * 6}}
    items["rises"] = {"z": [0.1, 0.1, 0.1, 0.12, 0.2, 0.3]}
    t = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    gap_m = np.array([0.11, 0.09, 0.06, 0.06, 0.06, 0.06])
    assert carried(items, gap_m, t) == {"lifted": (4.0, "rises"), "gripped": (2.0, "rises")}
    assert carried(items, None, t) == {"lifted": (4.0, "rises")}
    assert carried({"lies": items["lies"]}, gap_m, t) == {}


def test_a_moment_is_as_bad_as_the_worst_of_its_checks_and_what_was_not_asked_is_left_out() -> None:
    carry = {"grasp": at_most(1, 2, "m", ""), "transport": at_most(3, 2, "m", "")}
    checked = lines(report(**carry, dropped=skipped(""), nonce=equal(1, 1, "")))
    moments = {"lifted": 30.0, "fell into the bin": 50.0}
    assert checks_at(moments, [], [0.0], checked) == [
        {"t": 30.0, "moment": "lifted", "failed": True, "checks": ["grasp passed", "transport failed"]}
    ]


def test_a_check_speaks_of_one_moment_at_most_and_has_a_group() -> None:
    placed = [name for names in MOMENTS.values() for name in names.split()]
    assert len(placed) == len(set(placed))
    assert set(placed) <= {name for names in GROUPS.values() for name in names.split()}
