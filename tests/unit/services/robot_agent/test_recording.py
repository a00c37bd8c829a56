"""Recording: every recorded topic of the table, as it came, and nothing of other items."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import zenoh

from rodeo import topics
from rodeo.bus import Bus, zenoh_config
from rodeo.clock import WallClock
from rodeo.config import Site
from rodeo.evidence import Recorder
from rodeo.ros2 import Node, types
from rodeo.topics import Form, Plane
from services.robot_agent.recording import Recording, recorded_topics, tells_of_disposal, when_released
from tests.support.assignments import BINDING, ROBOT
from tests.support.site import LAB, WAIT_S, free_port
from tests.unit.services.robot_agent.fakes import ManualClock

SITE = Site.load(LAB)


def test_every_recorded_topic_of_the_table_is_there_under_its_full_name() -> None:
    recorded = {name: topic.type for topic, name in recorded_topics(SITE, "panther1", ["item1"])}
    assert recorded["panther1/odom"] == "nav_msgs/msg/Odometry"
    assert recorded["mocap/item1/pose"] == "geometry_msgs/msg/PoseStamped"
    assert {f"itrash/{name}/load" for name in SITE.bin.compartments} <= recorded.keys()
    in_table = [t for t in topics.TOPICS if t.recorded and t.plane == Plane.ROBOT and t.form == Form.TOPIC]
    assert {t.type for t in in_table} == set(recorded.values())
    assert not any("{" in name for name in recorded)


def test_the_motion_capture_of_other_items_is_left_out() -> None:
    assert "mocap/item2/pose" not in {
        name: topic.type for topic, name in recorded_topics(SITE, "panther1", ["item1"])
    }


def test_a_task_without_an_item_of_this_site_still_records_the_robot() -> None:
    recorded = {name: topic.type for topic, name in recorded_topics(SITE, "panther1", [])}
    assert [name for name in recorded if name.startswith("mocap/")] == ["mocap/panther1/pose"]


START_S = 1.8e9


def fell(time_s: float) -> dict[str, Any]:
    return {"payload": {"seq": 1, "expected_compartment": None, "time_s": time_s}}


def test_a_release_is_as_late_as_it_was_last_noted(tmp_path: Path) -> None:
    path, clock = tmp_path / "recording.mcap", ManualClock()
    clock.time_s = START_S
    with Recorder(path, BINDING, ROBOT, clock) as recorder:
        recorder.write_json("rodeo/attestation", fell(START_S))
    assert when_released(path) is None

    for _ in range(2):  # the fingers did not open the first time
        clock.time_s += 10
        with Recorder.resume(path, BINDING, ROBOT, clock) as recorder:
            recorder.write_json("rodeo/event", {"event": "releasing", "item": "item1"})
    assert when_released(path) == START_S + 20


def test_only_what_fell_after_the_release_is_this_items_drop_whenever_it_was_told(tmp_path: Path) -> None:
    path, clock = tmp_path / "recording.mcap", ManualClock()
    clock.time_s = START_S
    with Recorder(path, BINDING, ROBOT, clock) as recorder:
        recorder.write_json("rodeo/event", {"event": "releasing", "item": "item1"})
        recorder.write_json("rodeo/attestation", fell(START_S - 10))
        recorder.write_json("rodeo/attestation", {"payload": {"body": "item1", "time_s": START_S + 3}})
    assert not tells_of_disposal(path, START_S)

    with Recorder.resume(path, BINDING, ROBOT, clock) as recorder:
        recorder.write_json("rodeo/attestation", fell(START_S + 2))
    assert tells_of_disposal(path, START_S)


def test_a_recording_begins_when_body_and_motion_capture_are_heard(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = zenoh.open(zenoh_config("router", listen=[endpoint]))
    path, begun = tmp_path / "recording.mcap", threading.Event()
    with Bus.open(endpoint, timeout_s=WAIT_S) as bus, Bus.open(endpoint, timeout_s=WAIT_S) as other:
        clock = WallClock()
        lab = Node(other.session, "lab", "", 0, clock)
        said = [
            (lab.publisher(name, topic.type), types.new(topic.type))
            for topic, name in recorded_topics(SITE, "panther1", ["item1"])
            if topic in (topics.ODOM, topics.JOINT_STATES, topics.MOCAP_POSE)
        ]

        def record() -> None:
            node = Node(bus.session, "recorder", "", 0, clock)
            recording = Recording(path, BINDING, ROBOT, clock, node, SITE, "panther1", ["item1"], bus)
            begun.set()
            recording.suspend()

        recorder = threading.Thread(target=record)
        recorder.start()
        pause, deadline_s = threading.Event(), time.monotonic() + WAIT_S
        while not all(publisher.matched for publisher, _ in said) and time.monotonic() < deadline_s:
            pause.wait(0.01)
        assert not path.exists()
        while not begun.is_set() and time.monotonic() < deadline_s:
            for publisher, message in said:
                publisher.publish(message)
            pause.wait(0.01)
        recorder.join(WAIT_S)
        assert begun.is_set() and path.exists()
    router.close()
