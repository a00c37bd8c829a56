"""Recording: every recorded topic of the table, as it came, and nothing of other items."""

from __future__ import annotations

from rodeo import topics
from rodeo.config import Site
from rodeo.topics import Form, Plane
from services.robot_agent.recording import recorded_topics
from tests.support.site import LAB

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
