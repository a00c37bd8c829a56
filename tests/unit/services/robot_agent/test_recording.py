"""Recording: every recorded topic of the table, as it came, and nothing of other items."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import zenoh

from rodeo import topics
from rodeo.bus import Bus, zenoh_config
from rodeo.clock import WallClock
from rodeo.config import Site
from rodeo.evidence import Recorder
from rodeo.ros2 import Node, types
from rodeo.topics import Form, Plane
from services.robot_agent.recording import Recording, recorded_topics, tells_of_disposal, tells_of_release
from tests.support.assignments import BINDING, ROBOT
from tests.support.site import LAB, WAIT_S, free_port

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


def test_only_what_fell_after_the_release_is_this_items_drop(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    fell = {"payload": {"seq": 1, "expected_compartment": None}}
    recorder = Recorder(path, BINDING, ROBOT, WallClock())
    recorder.write_json("rodeo/attestation", fell)
    recorder.suspend()
    assert (tells_of_release(path), tells_of_disposal(path)) == (False, False)

    recorder = Recorder.resume(path, BINDING, ROBOT, WallClock())
    recorder.write_json("rodeo/event", {"event": "releasing", "item": "item1"})
    recorder.suspend()
    assert (tells_of_release(path), tells_of_disposal(path)) == (True, False)

    recorder = Recorder.resume(path, BINDING, ROBOT, WallClock())
    recorder.write_json("rodeo/attestation", fell)
    recorder.suspend()
    assert tells_of_disposal(path)


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
