"""Providers of devices: processes, certificates and access rules of each mix of simulated and real ones."""

from __future__ import annotations

from pathlib import Path

import pytest
import zenoh

from deploy.access import access_control, everybody
from rodeo.errors import ConfigError
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site
from rodeo.site.processes import processes_of
from rodeo.site.providers import unprovided
from rodeo.site.topics import BIN_CAPTURE, BIN_LOAD, DOCK_ENABLE, DOCK_OUTPUT, MOCAP_POSE, Topic
from rodeo_cli.site_check import check
from tests.support.site import LAB

WALL = 'clock.source = "wall"\n'
CAMERAS = 'mocap.source = "ros2"\nmocap.address = "vrpn_mocap/{body}/pose"\n'
POSE = "pose = { x_m = 5.2, y_m = 4.45, yaw_rad = -1.5708 }"
BIN = f'bins = [{{ name = "itrash", {POSE}, source = "SOURCE" }}]\n'
DOCK = 'docks = [{ name = "dock1", pose = { x_m = 0.2, y_m = 2.6 }, meter = { source = "SOURCE" } }]\n'
ROBOT = 'robots = [{ name = "panther1", pose = { x_m = 1.4, y_m = 1.3 }, body = "SOURCE" }]\n'

REAL = WALL + CAMERAS + "".join(one.replace("SOURCE", "ros2") for one in (BIN, DOCK, ROBOT))
SIMULATED = ('mocap.source = "sim"\n', *(one.replace("SOURCE", "sim") for one in (BIN, DOCK, ROBOT)))
MIXES = {
    "one robot is real": ("", ROBOT.replace("SOURCE", "ros2")),
    "the cameras are real": (WALL + "".join(SIMULATED[1:]), CAMERAS),
    "the bin is real": (WALL + SIMULATED[0] + SIMULATED[2] + SIMULATED[3], BIN.replace("SOURCE", "ros2")),
    "the dock is on Modbus": (
        WALL + SIMULATED[0] + SIMULATED[1] + SIMULATED[3],
        DOCK.replace('"SOURCE"', '"modbus", address = "tcp://192.168.1.20:502"'),
    ),
    "the dock is real": (WALL + SIMULATED[0] + SIMULATED[1] + SIMULATED[3], DOCK.replace("SOURCE", "ros2")),
}
"""What is real -> the rest of the site file, and the lines that say so."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "site.toml"


def load(path: Path, text: str) -> Site:
    path.write_text(f'extends = "{LAB}"\ndata_dir = "data"\n{text}')
    return Site.load(path)


def started(site: Site) -> set[str]:
    return {one.name for one in processes_of(site)}


def writers(site: Site, topic: Topic) -> set[str]:
    """Those who may publish the topic of panther1, itrash or dock1, or serve it."""
    key = topic.pattern(bin="itrash", dock="dock1", body="item1", compartment="blue")
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(site)["rules"]}
    return {
        name
        for name in everybody(site)
        if any(
            zenoh.KeyExpr(one).intersects(zenoh.KeyExpr(f"0/{key}/x/y")) for one in rules[f"{name} writes"]
        )
    }


def test_a_simulated_site_has_the_processes_and_certificates_that_it_had(path: Path) -> None:
    site = load(path, "")
    assert "robot_sim" in started(site) and "mocap" not in started(site)
    assert {one for one in everybody(site) if "." in one} == {"body.panther1"}
    for topic in (MOCAP_POSE, BIN_LOAD, BIN_CAPTURE, DOCK_OUTPUT, DOCK_ENABLE):
        assert writers(site, topic) == {"robot_sim"}
    assert list(unprovided(site)) == []


def test_a_site_of_real_devices_has_no_simulator_and_nobody_may_be_one(path: Path) -> None:
    site = load(path, REAL)
    assert "mocap" in started(site) and "robot_sim" not in {*started(site), *everybody(site)}
    drivers = {"driver.mocap", "driver.itrash", "driver.dock1", "body.panther1"}
    assert {one for one in everybody(site) if "." in one} == drivers
    assert writers(site, MOCAP_POSE) == {"mocap"}
    for topic in (BIN_LOAD, BIN_CAPTURE):
        assert writers(site, topic) == {"driver.itrash"}
    for topic in (DOCK_OUTPUT, DOCK_ENABLE):
        assert writers(site, topic) == {"driver.dock1"}
    assert check(path) == []


@pytest.mark.parametrize("mix", MIXES)
def test_in_a_mixed_lab_one_line_says_which_device_is_real(path: Path, mix: str) -> None:
    rest, line = MIXES[mix]
    site = load(path, rest + line)
    assert "robot_sim" in started(site)
    assert ("mocap" in started(site)) is (mix == "the cameras are real")
    assert writers(site, MOCAP_POSE) == {"mocap" if mix == "the cameras are real" else "robot_sim"}
    assert writers(site, BIN_LOAD) == {"driver.itrash" if mix == "the bin is real" else "robot_sim"}
    docks = {"the dock is real": "driver.dock1", "the dock is on Modbus": "charger"}
    assert writers(site, DOCK_OUTPUT) == {docks.get(mix, "robot_sim")}
    assert list(unprovided(site)) == []


def test_a_driver_of_cameras_may_publish_its_own_topics_and_nothing_that_is_signed(path: Path) -> None:
    site = load(path, REAL)
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(site)["rules"]}
    said = [one for one in rules["driver.mocap writes"] if "/vrpn_mocap/" in one]
    assert any(
        zenoh.KeyExpr(one).includes(zenoh.KeyExpr("0/vrpn_mocap/panther1/gripper/pose/t/h")) for one in said
    )
    assert not [one for one in rules["driver.mocap writes"] if one.startswith("rodeo/")]


@pytest.mark.parametrize(("text", "process"), [("", "robot_sim"), (REAL, "mocap")])
def test_one_process_has_the_key_of_motion_capture(path: Path, text: str, process: str) -> None:
    site = load(path, text)
    key = zenoh.KeyExpr("rodeo/lab/witness/mocap/statement")
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(site)["rules"]}
    signing = [
        name
        for name in everybody(site)
        if any(zenoh.KeyExpr(one).intersects(key) for one in rules[f"{name} writes"])
    ]
    assert signing == [process]
    assert [one.name for one in served_by(site, process) if one.what == "mocap"] == ["mocap"]


def test_what_a_real_clock_leaves_open_is_named_with_the_line_to_write(path: Path) -> None:
    load(path, WALL)
    found = {str(one).partition(": ")[2].partition(": nobody")[0]: one.text for one in check(path)}
    assert found.keys() == {
        f"warning: {one}" for one in ("mocap.source", "bins.0.source", "docks.0.meter.source")
    }
    texts = " ".join(found.values())
    for key in ("mocap/*/pose", "itrash/*/load", "itrash/camera/capture", "dock1/output", "dock1/enable"):
        assert key in texts
    assert '"ros2", for a driver with the certificate driver.dock1, or source = "sim"' in texts


def test_a_bin_with_a_camera_of_its_own_waits_for_none_on_the_bus(path: Path) -> None:
    camera = 'camera = { source = "video", address = "0" }'
    site = load(path, WALL + f'bins = [{{ name = "itrash", {POSE}, {camera} }}]\n')
    text = dict(unprovided(site))["bins", 0, "source"]
    assert "itrash/presence" in text and "camera" not in text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('mocap.address = "panther1/{body}/pose"', "others may publish below panther1"),
        ('mocap.address = "tf"', "write the topic of its driver"),
        ('mocap.address = "mocap/{body}/pose"', "others may publish below mocap"),
        ('mocap.address = "itrash/poses"', "others may publish below itrash"),
        ('mocap.address = "lab/{body}/pose"', "others may publish below lab"),
    ],
)
def test_nobody_else_can_publish_where_a_driver_of_cameras_does(path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError) as failed:
        load(path, f'mocap.source = "ros2"\n{text}\n')
    assert words in failed.value.details["fields"]["mocap.address"]


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ('mocap.source = "optitrac"', "mocap.source", "no such source of motion capture"),
        (CAMERAS + 'mocap.settings = { typ = "PoseStamped" }', "mocap.settings", "typ"),
        (CAMERAS + 'mocap.bodies = { item9 = "Can" }', "mocap.bodies.item9", "nothing called item9"),
        (CAMERAS + "lab.mocap = false", "mocap.source", "lab.mocap = false says that there is none"),
    ],
)
def test_a_source_that_cannot_be_is_an_error_of_the_site_file(
    path: Path, text: str, place: str, words: str
) -> None:
    path.write_text(f'extends = "{LAB}"\ndata_dir = "data"\n{text}\n')
    (found,) = [one for one in check(path) if one.severity == "error"]
    assert f"{place}: " in str(found) and words in found.text
