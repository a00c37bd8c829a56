"""What the cleaning's declaration says that the key table knows, too."""

from __future__ import annotations

from rodeo.site.topics import TOPICS, Form, Plane
from rodeo_kinds.waste_disposal import KIND


def test_a_proof_holds_every_topic_that_may_be_recorded_and_no_pose_that_nobody_signed() -> None:
    recorded = {topic for topic in TOPICS if topic.recorded and topic.form is Form.TOPIC}
    assert set(KIND.records) == {topic for topic in recorded if topic.plane is Plane.ROBOT}
    assert not any(topic.key.startswith("mocap/") for topic in KIND.records)
