"""Robots with other arms than ours: one joint fewer, one more."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

from rodeo.lab.config import PosturesConfig
from rodeo.lab.world import ROBOT_XML
from rodeo.site.config import Site

JOINTS = {
    5: ("waist", "shoulder", "elbow", "wrist_angle", "wrist_rotate"),
    7: ("waist", "shoulder", "upper_arm_roll", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"),
}


def with_arm(site: Site, joints: int, folder: Path) -> Site:
    """`site` with one robot whose arm has so many joints; its MJCF is written to `folder`."""
    tree = Xml.parse(ROBOT_XML)
    if joints == 5:
        _remove(tree.getroot(), "forearm_roll")
    else:
        _add_roll(tree.getroot())
    path = folder / f"arm{joints}.xml"
    tree.write(path)
    postures = PosturesConfig(**{
        name: _fitted(getattr(PosturesConfig(), name), joints) for name in PosturesConfig.model_fields
    })  # fmt: skip
    robot = site.robots[0].model_copy(update={"kinematics": path, "postures": postures})
    return site.model_copy(update={"robots": [robot]})


def _fitted(posture: tuple[float, ...], joints: int) -> tuple[float, ...]:
    return (*posture[:3], *posture[4:]) if joints == 5 else (*posture[:2], 0.0, *posture[2:])


def _remove(robot: Xml.Element, joint: str) -> None:
    for parent in list(robot.iter()):
        for child in list(parent):
            if child.tag in ("joint", "intvelocity") and joint in (child.get("name"), child.get("joint")):
                parent.remove(child)


def _add_roll(robot: Xml.Element) -> None:
    """A roll of the upper arm, halfway along it."""
    upper = next(body for body in robot.iter("body") if body.get("name") == "upper_arm_link")
    forearm = next(body for body in upper if body.get("name") == "upper_forearm_link")
    upper.remove(forearm)
    roll = Xml.SubElement(upper, "body", name="upper_arm_roll_link", pos="0 0 0.15", gravcomp="1")
    Xml.SubElement(roll, "inertial", mass="0.1", pos="0 0 0", diaginertia="0.0001 0.0001 0.0001")
    Xml.SubElement(
        roll,
        "joint",
        name="upper_arm_roll",
        axis="0 0 1",
        range="-3.14158 3.14158",
        armature="0.1",
        actuatorfrcrange="-10 10",
    )
    forearm.set("pos", "0.05955 0 0.15")
    roll.append(forearm)
    servo = {"class": "arm", "kp": "400", "kv": "20"}
    actuators = robot.find("actuator")
    assert actuators is not None
    Xml.SubElement(actuators, "intvelocity", servo, name="upper_arm_roll", joint="upper_arm_roll")
