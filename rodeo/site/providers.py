"""Providers: each device of a site, and the process or certificate that speaks for its hardware.

    sim      `robot_sim` publishes what the device measures, and takes its commands
    ros2     a driver of somebody else's does, with a certificate of the device's own: `body.<robot>`,
             `driver.<bin>`, `driver.<dock>`; for motion capture `driver.mocap`, to whom `mocap` listens
    others   the process that has the device's key speaks with the hardware itself: `mocap`, `charger`
    nobody   the clock is real, and the site file says nothing

Process table, certificates and access rules follow from this table, and no other process knows it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

from rodeo.site import topics
from rodeo.site.file import SiteFile
from rodeo.site.names import bin_process, body_identity, dock_process
from rodeo.site.topics import DRIVER, Topic
from rodeo.text.site_problems import Place

SIM, ROS2 = "sim", "ros2"

SIMULATOR = "robot_sim"
"""Process that provides what is simulated."""
MOTION_CAPTURE = "mocap"
"""Motion capture: the device, its process, and the first part of its keys."""

What = Literal["mocap", "bin", "dock", "robot"]


class Device(NamedTuple):
    """A device of the site."""

    what: What
    name: str
    source: str | None
    """Value of its `source`, or `body`; None where nobody provides it."""
    place: Place
    """Where the site file says so."""


def devices(site: SiteFile) -> list[Device]:
    """Everything on the site that measures or moves."""
    unsaid = SIM if site.clock.source == "sim" else None
    found = [Device("mocap", MOTION_CAPTURE, site.mocap.source or unsaid, ("mocap", "source"))]
    return [
        *(found if site.lab.mocap else ()),
        *(
            Device("bin", one.name, one.source or unsaid, ("bins", number, "source"))
            for number, one in enumerate(site.bins)
        ),
        *(
            Device("dock", one.name, one.meter.source or unsaid, ("docks", number, "meter", "source"))
            for number, one in enumerate(site.docks)
        ),
        *(
            Device("robot", one.name, one.body, ("robots", number, "body"))
            for number, one in enumerate(site.robots)
        ),
    ]


def driver_identity(device: str) -> str:
    """The driver of `device` on the bus: the name in its certificate."""
    return f"{DRIVER}.{device}"


def provider(site: SiteFile, device: Device) -> str | None:
    """The process or certificate that publishes what the device measures; None where nobody does."""
    if device.source is None:
        return None
    if device.what == "robot":
        return body_identity(device.name)
    if device.source == SIM:
        return SIMULATOR
    if device.what == "mocap":
        return MOTION_CAPTURE
    if device.source == ROS2:
        return driver_identity(device.name)
    return dock_process(site, device.name) if device.what == "dock" else bin_process(site, device.name)


def provided_by(site: SiteFile, process: str, what: What) -> list[str]:
    """Names of the devices of which `process` publishes what they measure."""
    return [one.name for one in devices(site) if one.what == what and provider(site, one) == process]


def is_simulated(site: SiteFile, what: What, name: str) -> bool:
    """Whether `robot_sim` provides the device."""
    return any(one[:2] == (what, name) and one.source == SIM for one in devices(site))


def wants_simulator(site: SiteFile) -> bool:
    """Whether anything on the site is simulated, if only its time."""
    return site.clock.source == "sim" or any(one.source == SIM for one in devices(site))


def drivers(site: SiteFile) -> list[str]:
    """The certificates of drivers beside those of robots' bodies."""
    return [driver_identity(one.name) for one in devices(site) if one.what != "robot" and one.source == ROS2]


_READ: dict[What, tuple[str, tuple[Topic, ...], str]] = {
    "mocap": (
        "the robots' minds and the oracle read",
        (topics.MOCAP_POSE, topics.WITNESS_STATEMENT),
        'source = "natnet" and address, or another source of services/mocap/sources',
    ),
    "bin": (
        "itrash reads",
        (topics.BIN_PRESENCE, topics.BIN_LOAD, topics.BIN_IMAGE, topics.BIN_CAPTURE),
        'source = "ros2", for a driver with the certificate {driver}',
    ),
    "dock": (
        "charger reads",
        (topics.DOCK_OUTPUT, topics.DOCK_ENABLE),
        'source = "modbus" and address, or "ros2", for a driver with the certificate {driver}',
    ),
}
"""Kind of device -> who reads it, the topics, and the line of a site file that says who provides it."""


def unprovided(site: SiteFile) -> Iterator[tuple[Place, str]]:
    """Where the site file leaves out who provides a device; the topics that somebody reads and nobody
    provides, and what to write."""
    pictures = {one.name: one.camera.source == "bus" for one in site.bins}
    for device in devices(site):
        if provider(site, device) is not None:
            continue
        reader, read, line = _READ[device.what]
        names = {device.what: device.name, "org": site.org, "device": device.name}
        keys = [
            one.pattern(**names)
            for one in read
            if pictures.get(device.name, True) or one not in (topics.BIN_IMAGE, topics.BIN_CAPTURE)
        ]
        told = f"{', '.join(keys[:-1])} and {keys[-1]}"
        written = line.format(driver=driver_identity(device.name))
        yield (
            device.place,
            f'nobody provides {told}, which {reader}: write {written}, or source = "sim"',
        )
