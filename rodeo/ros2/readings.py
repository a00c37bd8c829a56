"""The door through which every number of a device enters: its unit, its range, and how long it must hold.

ROS 2 drivers say NaN for what they have not measured, zeros before the first measurement, and whatever their
firmware has where the definition of a message allows no such thing. What such a message says is unknown, and
the next one may be good: each function here raises `Unknown` with the reason, or has None for what is unknown
beside numbers that are known. Nothing else reads the numbers of a device's message.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

from rodeo.errors import RodeoError
from rodeo.host.stamps import stamp_s

UNIT_SLACK = 0.01
"""How far the norm of an orientation may be from 1, as tf2 has it."""
SILENT_WALL_S = 3.0
"""A publisher without valid messages for this time is dropped: its process was restarted."""
MOST_PUBLISHERS = 4
"""Publishers of one robot's joints."""
CHARGE_HOLDS_S = 30.0
"""A state of charge counts once the gauge has published it for this time: a gauge that measures voltage
reports full when current begins to flow."""
_MORE_CHARGE = 2.0
"""Times the charge that flowed into a battery, by its own current, that it may say that it has gained."""
_CHARGE_STEP = 0.05
"""What a gauge corrects at once besides."""


class Unknown(RodeoError):
    """A device's message does not say what it is asked for."""


def why_unknown(read: Callable[[Any], Any], message: Any) -> str:
    """Why this cannot be read, "" where it can."""
    try:
        read(message)
    except Unknown as error:
        return error.message
    return ""


class Quantity(NamedTuple):
    """What a number must be to be one."""

    name: str
    unit: str
    least: float
    most: float

    def of(self, value: Any) -> float | None:
        """The number, None where it is none."""
        number = float(value)
        return number if self.least <= number <= self.most else None  # False for NaN

    def known(self, value: Any) -> float:
        """The number. Raises Unknown."""
        found = self.of(value)
        if found is None:
            raise Unknown(
                f"the {self.name} is {float(value):g} {self.unit}".rstrip()
                + f", and not between {self.least:g} and {self.most:g}"
            )
        return found


_FULL_SLACK = 0.05
"""Gauges show a little more than full."""
CHARGE = Quantity("percentage", "", 0.0, 1.0 + _FULL_SLACK)
VOLTAGE = Quantity("voltage", "V", -10.0, 1e3)
CURRENT = Quantity("current", "A", -1e3, 1e3)
"""Drivers that say mV and mA are outside soon."""
FORCE = Quantity("force", "N", -1e4, 1e4)
JOINT = Quantity("position", "rad or m", -1e3, 1e3)
FARTHEST_M = 1e4
"""From the map's origin, along each axis."""


# -- poses -----------------------------------------------------------------------------------------------


def is_rotation(*quaternion: float) -> bool:
    """Whether the four numbers, in any order, are a unit quaternion."""
    return abs(math.hypot(*quaternion) - 1) <= UNIT_SLACK  # False for NaN and infinity, too


def pose(message: Any) -> Any:
    """A geometry_msgs/msg/Pose that is one. Raises Unknown."""
    at, turn = message.position, message.orientation
    if not all(abs(one) <= FARTHEST_M for one in (at.x, at.y, at.z)):
        raise Unknown(f"the position is ({at.x:g}, {at.y:g}, {at.z:g})")
    if not is_rotation(turn.x, turn.y, turn.z, turn.w):
        raise Unknown(
            f"the orientation ({turn.x:g}, {turn.y:g}, {turn.z:g}, {turn.w:g}) is no unit quaternion"
        )
    return message


# -- power -----------------------------------------------------------------------------------------------


class Power(NamedTuple):
    """Where current flows: at the time of the message's own stamp."""

    time_s: float
    voltage_v: float
    current_a: float
    """Positive into the robot."""


def power(message: Any) -> Power:
    """Voltage and current in a sensor_msgs/msg/BatteryState. Raises Unknown."""
    return Power(
        stamp_s(message.header.stamp), VOLTAGE.known(message.voltage), CURRENT.known(message.current)
    )


class Battery(NamedTuple):
    """What a gauge says, None for what it does not know."""

    time_s: float
    soc: float
    """State of charge, 0 to 1."""
    voltage_v: float | None
    current_a: float | None
    """Positive while it charges."""
    charging: bool


def battery(message: Any, full: float = 1.0) -> Battery:
    """A sensor_msgs/msg/BatteryState that says how full the battery is, `full` being full. Raises Unknown."""
    try:
        soc = CHARGE.known(message.percentage / full)
    except Unknown as error:
        if message.percentage > 1 + _FULL_SLACK:
            raise Unknown(
                f"the percentage is {message.percentage:g}, and full is {full:g}: set percentage_full in the "
                "robot's battery to what its driver calls full, such as percentage_full = 100"
            ) from error
        raise
    if not (soc or message.voltage):
        raise Unknown("the battery says nothing but zeros")
    return Battery(
        stamp_s(message.header.stamp),
        min(soc, 1.0),
        VOLTAGE.of(message.voltage),
        CURRENT.of(message.current),
        message.power_supply_status == 1,
    )


class Charge:
    """The state of charge that is believed, of what a gauge says one after the other. One thread at a time.

    It follows what the gauge has said for `CHARGE_HOLDS_S`, and rises no more than what flowed into the
    battery allows, where the gauge knows its current.
    """

    def __init__(self, capacity_ah: float) -> None:
        self._capacity_ah = capacity_ah
        self._seconds: deque[tuple[int, float, float]] = deque()
        """Lowest and highest in each second of the last `CHARGE_HOLDS_S`."""
        self._soc = self._most = math.nan
        """What is believed, and what the current allows."""
        self._last: Battery | None = None

    def believed(self, said: Battery) -> float:
        """After this."""
        last, self._last = self._last, said
        seconds = math.inf if last is None else said.time_s - last.time_s
        if last is None or not 0 <= seconds <= CHARGE_HOLDS_S:
            # Nobody listened: what it says now is what is known.
            self._seconds.clear()
            self._soc, self._most = said.soc, said.soc + _CHARGE_STEP
        self._note(int(said.time_s), said.soc)
        lowest, highest = (pick(one[at] for one in self._seconds) for pick, at in ((min, 1), (max, 2)))
        self._soc = min(max(self._soc, lowest), highest)
        if last is None or last.current_a is None or said.current_a is None:
            self._most = self._soc + _CHARGE_STEP
            return self._soc
        flowed_ah = max(0.0, (last.current_a + said.current_a) / 2) * max(0.0, seconds) / 3600
        self._most += _MORE_CHARGE * flowed_ah / self._capacity_ah if seconds <= CHARGE_HOLDS_S else 0.0
        self._most = min(self._most, highest + _CHARGE_STEP)
        self._soc = min(self._soc, self._most)
        return self._soc

    def _note(self, second: int, soc: float) -> None:
        if self._seconds and self._seconds[-1][0] == second:
            _, lowest, highest = self._seconds.pop()
            self._seconds.append((second, min(lowest, soc), max(highest, soc)))
        else:
            self._seconds.append((second, soc, soc))
        while self._seconds[0][0] < second - CHARGE_HOLDS_S:
            self._seconds.popleft()


# -- joints ----------------------------------------------------------------------------------------------


def bare(name: str) -> str:
    """A joint's name without what a driver puts before it: `panther_arm/elbow` is `elbow`."""
    return name.rpartition("/")[2]


def positions(message: Any) -> dict[str, float]:
    """Joint -> its position in a sensor_msgs/msg/JointState; what is no number is left out. Raises Unknown
    where a joint has two positions."""
    found: dict[str, float] = {}
    for name, value in zip(message.name, message.position, strict=False):
        if (known := JOINT.of(value)) is None:
            continue
        if found.setdefault(bare(name), known) != known:
            raise Unknown(f"the joint {bare(name)} has two positions, {found[bare(name)]:g} and {known:g}")
    return found


class Gathered(NamedTuple):
    """What several publishers say of joints."""

    positions: dict[str, float]
    used: frozenset[int]
    """Which of the messages."""


def joints(messages: Sequence[Any], wanted: Collection[str]) -> Gathered:
    """The positions of these joints, each from the first of the publishers that says it. Raises Unknown."""
    found: dict[str, float] = {}
    used: set[int] = set()
    for number, message in enumerate(messages):
        said = positions(message)
        new = [name for name in wanted if name in said and name not in found]
        found |= {name: said[name] for name in new}
        used |= {number} if new else set()
    if missing := [name for name in wanted if name not in found]:
        raise Unknown(f"no position of {', '.join(missing)}")
    return Gathered(found, frozenset(used))


def efforts(messages: Sequence[Any]) -> dict[str, float]:
    """Joint -> its effort, from the first of the messages in which that is finite."""
    found: dict[str, float] = {}
    for message in messages:
        for name, effort in zip(message.name, message.effort, strict=False):
            if math.isfinite(effort):
                found.setdefault(bare(name), float(effort))
    return found


def are_joints(columns: Any) -> Any:
    """(n,) bool: which rows of positions or efforts (n, m) are numbers that a joint can have."""
    import numpy as np

    return (np.abs(columns) <= JOINT.most).all(axis=1)  # False for NaN


# -- sensors ---------------------------------------------------------------------------------------------


def distance_m(message: Any) -> float:
    """A sensor_msgs/msg/Range as REP 117 has it: infinite where nothing is near, the least where something is
    nearer than it measures. Raises Unknown."""
    value = float(message.range)
    if math.isinf(value):
        return value if value > 0 else float(message.min_range)
    if math.isnan(value) or value < message.min_range:
        raise Unknown(f"the range is {value:g} m, and not above {float(message.min_range):g} m")
    return value


def force_n(message: Any) -> float:
    """The force along z in a geometry_msgs/msg/WrenchStamped. Raises Unknown."""
    return FORCE.known(message.wrench.force.z)


_DEPTHS = {"32FC1": ("f4", 1.0), "16UC1": ("u2", 1e-3)}
"""Encoding of a depth picture (REP 118) -> its numbers, and one of them in m."""
_MOST_PIXELS = 1_000_000


def depth_m(image: Any) -> Any:
    """(h, w) depths in a sensor_msgs/msg/Image; NaN where nothing was measured. Raises Unknown."""
    import numpy as np

    height, width, step = int(image.height), int(image.width), int(image.step)
    data = np.asarray(image.data, np.uint8)
    kind, unit_m = _DEPTHS.get(image.encoding, ("u1", 0.0))
    row = np.dtype(kind).itemsize * width
    if not unit_m or step < row or not 0 < height * width <= _MOST_PIXELS:
        raise Unknown(
            "not a depth image", encoding=str(image.encoding)[:20], width=width, height=height, step=step
        )
    if data.size < height * step:
        raise Unknown("the depth picture is cut off", bytes=int(data.size), expected=height * step)
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    depths = rows.view((">" if image.is_bigendian else "<") + kind).astype(float) * unit_m
    return np.where(depths > 0, depths, np.nan)


def intrinsics(info: Any) -> Any:
    """(3, 3) of a sensor_msgs/msg/CameraInfo. Raises Unknown."""
    import numpy as np

    matrix = np.array(info.k, float).reshape(3, 3)
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise Unknown("the wrist camera does not say its focal lengths", k=matrix.ravel().tolist())
    return matrix
