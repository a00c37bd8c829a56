"""Which of the rates that a robot declares is that of a topic, and what a proof accepts of it."""

from __future__ import annotations

from rodeo.lab.rates import FASTEST_HZ, RATE_SHARE, TALKATIVE, RatesConfig
from rodeo.site import topics
from rodeo.site.topics import Topic

SETTING = {
    topics.ODOM.key: "odom_hz",
    topics.JOINT_STATES.key: "joint_states_hz",
    topics.ARM_STATE.key: "controllers_hz",
    topics.GRIPPER_STATE.key: "controllers_hz",
    topics.BATTERY_STATE.key: "battery_hz",
    topics.POSE.key: "pose_hz",
}
"""Key of a topic -> the setting that declares its rate."""


def declared_hz(rates: RatesConfig, topic: Topic) -> float:
    """Rate of a topic of the robot, or of another one; 0 on demand."""
    return float(getattr(rates, SETTING[topic.key])) if topic.key in SETTING else topic.rate_hz or 0.0


def accepted_hz(rates: RatesConfig, topic: Topic) -> tuple[float, float]:
    """The least and the most at which work can be proved."""
    return RATE_SHARE * (topic.rate_hz or 0.0), min(FASTEST_HZ, TALKATIVE * declared_hz(rates, topic))
