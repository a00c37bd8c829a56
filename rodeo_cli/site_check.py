"""Problems of a site file that are found before it runs, with their lines."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from rodeo.errors import ConfigError, InvalidRequest
from rodeo.kinds import DEFAULT_PRICE_IEC, NOT_INSTALLED, KindError, declared, installed, load
from rodeo.lab.config import DockConfig, Pose2, PosturesConfig
from rodeo.lab.geometry import Rectangle, facing, seen_from
from rodeo.lab.layout import (
    ITEM_RADIUS_M,
    PICK_DISTANCE_M,
    BinLayout,
    dock_floor,
    dock_parking,
    footprint,
    furniture_floor,
)
from rodeo.site.config import Site, check_environment, read_tables
from rodeo.site.faults import ONE_HOST, faults, placed
from rodeo.site.file import ANSWER_WALL_S
from rodeo.site.names import BRIDGE, ORACLE, bridge_wallets
from rodeo.site.providers import SIM, devices, unprovided
from rodeo.site.sections import STAKE_COVERS, interface_of
from rodeo.site.tls import openness
from rodeo.text.site_problems import Place, close, dotted, explained
from rodeo_cli.toml_lines import lines_of

_TOUCH_M = 0.01
"""Things that stand against each other may overlap by the rounding of their places."""
_LONGEST_ROOM_M = 100.0
_TALLEST_BIN_M, _MOST_DOCK, _FASTEST_M_S, _DEAREST_EUR_KWH = 5.0, 1000.0, 10.0, 5.0
_SIDES = 16
"""Directions from which the robot may come to an item."""


@dataclass(frozen=True)
class Finding:
    """Something wrong (`error`: the site is refused) or doubtful (`warning`) in a site file."""

    severity: Literal["error", "warning"]
    path: Path
    line: int | None
    place: Place
    text: str

    def __str__(self) -> str:
        where = f"{self.path}:{self.line}" if self.line else str(self.path)
        what = f"{dotted(self.place)}: " if self.place else ""
        return f"{where}: {self.severity}: {what}{self.text}"

    def to_json(self) -> dict[str, str | int | None]:
        """An entry of `rodeo site check --json`; `place` is the setting with its tables, joined by dots."""
        return {
            "severity": self.severity,
            "file": str(self.path),
            "line": self.line,
            "place": dotted(self.place),
            "text": self.text,
        }


def check(path: Path) -> list[Finding]:
    """Everything that is wrong or doubtful in the site file at `path`; empty for a good one."""
    try:
        check_environment()
        tables = read_tables(path)
    except ConfigError as error:
        at_fault = Path(error.details.get("path", path))  # perhaps a file that this one extends
        return [Finding("error", at_fault, error.details.get("line"), (), error.message)]
    files = list(_files(path))

    def finding(severity: Literal["error", "warning"], place: Place, text: str) -> Finding:
        return Finding(severity, *_stands(files, place), place, text)

    try:
        site = Site(**tables)
    except ValidationError as error:
        return [finding("error", place, text) for place, text in explained(error, Site).items()]
    refused = (faults(site), _lacking(site), _cameras(site), _meters(site), _models(site))
    if wrong := {place: text for found in refused for place, text in dict(found).items()}:
        return [finding("error", place, text) for place, text in wrong.items()]
    return [
        finding("warning", place, text)
        for place, text in (
            *((("bus", "open"), why) for why in [undecided_on_open_bus(site)] if why),
            *unprovided(site),
            *_other_units(site),
            *_demo(site),
            *_unseen(site),
            *_one_host(site),
            *_minds(site),
            *_unaffordable(site),
            *_hurried(site),
            *_standby(site),
            *_unpriced(site),
            *_overlaps(site),
            *_unreachable(site),
            *_thin_stakes(site),
            *_coarse_meters(site),
        )
    ]


def _models(site: Site) -> Iterator[tuple[Place, str]]:
    """Where a robot's own model, or its postures, are those of no arm that we can move."""
    usual = PosturesConfig()
    own = [one for one in enumerate(site.robots) if one[1].kinematics or one[1].postures != usual]
    for number, robot in own:
        if not interface_of(robot).arm:
            continue
        from rodeo.robot.arm import Arm  # MuJoCo takes its time to load

        try:
            Arm(robot.limits, robot.kinematics, robot.postures)
        except ConfigError as error:
            posture = error.details.get("posture")
            where: Place = ("postures", posture) if posture else ("kinematics",)
            said = "; ".join(f"{name} {value}" for name, value in error.details.items() if name != "posture")
            yield ("robots", number, *where), f"{error.message} ({said})" if said else error.message


def _files(path: Path) -> Iterator[tuple[Path, dict[Place, int]]]:
    """The file and those that it extends, with the lines of what they say."""
    text = path.read_text()
    yield path, lines_of(text)
    base = tomllib.loads(text).get("extends")
    if isinstance(base, str):
        extended = path.parent / base
        yield from _files(Path(os.path.relpath(extended)) if not path.is_absolute() else extended.resolve())


def _stands(files: list[tuple[Path, dict[Place, int]]], place: Place) -> tuple[Path, int | None]:
    """File and line of `place`, or of the nearest around it."""
    entry = next((number for number, step in enumerate(place) if isinstance(step, int)), len(place))
    for length in range(len(place), 0, -1):
        for path, lines in files:
            # A list is one file's as a whole.
            if place[:length] in lines and (length > entry or place[:entry] in lines):
                owner = next(p for p, known in files if place[: min(entry, length)] in known)
                if owner == path:
                    return path, lines[place[:length]]
    return files[0][0], None


def _other_units(site: Site) -> Iterator[tuple[Place, str]]:
    """Numbers that are possible, and more likely meant in another unit."""
    length_m, width_m = site.lab.size_m
    if max(length_m, width_m) > _LONGEST_ROOM_M:
        text = f"a room of {length_m:g} m by {width_m:g} m: {length_m:g} cm are {length_m / 100:g} m"
        yield ("lab", "size_m"), text
    if (share := site.lab.mass_tolerance or 0) > 1:
        yield ("lab", "mass_tolerance"), f"{share:g} is a share, 1 is all of an item's mass: 50 % are 0.5"
    for place, value, most, (unit, smaller, factor) in _measures(site):
        if value > most:
            yield place, f"{value:g} {unit} are unlikely; {value:g} {smaller} are {value * factor:g} {unit}"
    for place, _, pose in placed(site):
        if abs(pose.yaw_rad) > math.tau:
            turn = f"{pose.yaw_rad:g} rad are more than a turn: {pose.yaw_rad:g} degrees"
            yield (*place, "pose"), f"{turn} are {math.radians(pose.yaw_rad):.4f} rad"


_CM, _MV, _MA = ("m", "cm", 0.01), ("V", "mV", 0.001), ("A", "mA", 0.001)
_CM_S, _CT = ("m/s", "cm/s", 0.01), ("EUR/kWh", "ct/kWh", 0.01)


def _measures(site: Site) -> Iterator[tuple[Place, float, float, tuple[str, str, float]]]:
    """Numbers, the most that each is likely to be, and its unit with a smaller one that may be meant."""
    for number, one in enumerate(site.bins):
        for setting in ("rim_height_m", "camera_height_m", "show_distance_m"):
            yield ("bins", number, setting), getattr(one, setting), _TALLEST_BIN_M, _CM
    for number, dock in enumerate(site.docks):
        yield ("docks", number, "voltage_v"), dock.voltage_v, _MOST_DOCK, _MV
        yield ("docks", number, "current_a"), dock.current_a, _MOST_DOCK, _MA
    for number, robot in enumerate(site.robots):
        for setting in ("linear_m_s", "cruise_m_s"):
            yield ("robots", number, "limits", setting), getattr(robot.limits, setting), _FASTEST_M_S, _CM_S
    for number, tariff in enumerate(site.economy.electricity):
        place = "economy", "electricity", number, "eur_kwh"
        yield place, float(tariff.eur_kwh), _DEAREST_EUR_KWH, _CT


def _demo(site: Site) -> Iterator[tuple[Place, str]]:
    """Problems that keep `rodeo demo` from posting its tasks."""
    if site.demo is None:
        return
    kinds = {one.name: one for one in site.kinds}
    if site.demo.kind not in kinds:
        # Of a file that is extended the demo often stays behind, with a kind that the new list leaves out.
        if site.demo.kind not in installed():
            yield ("demo", "kind"), f"[[kinds]] does not list {site.demo.kind}{close(site.demo.kind, kinds)}"
        return
    kind = declared(kinds[site.demo.kind])
    params = site.demo.params
    try:
        params = kind.complete(site, params)
    except InvalidRequest as error:
        yield ("demo", "params"), error.message
    for field, text in kind.problems(site, params).items():
        yield ("demo", "params", field), text


def _unseen(site: Site) -> Iterator[tuple[Place, str]]:
    if site.things and SIM not in {site.clock.source, *(one.source for one in devices(site))}:
        yield (
            ("things",),
            "nobody knows of them: they exist in a simulator only, and nothing here is simulated",
        )


def _one_host(site: Site) -> Iterator[tuple[Place, str]]:
    """Warn if wallets are spread over several bridges while those that check each other share the site's own
    bridge. If they share one of [[bridges]], the site file is refused (`rodeo.site.faults`)."""
    together = {"organization", ORACLE} <= set(bridge_wallets(site)[BRIDGE])
    if site.bridges and together and not site.oracles:
        yield ("bridges",), ONE_HOST.format("the site's own bridge")


def _minds(site: Site) -> Iterator[tuple[Place, str]]:
    """Minds that cannot keep up with the clock, or take no tasks."""
    spoken_for = {name for owner in site.ros for name in owner.participants}
    for number, robot in enumerate(site.robots):
        if robot.mind is None:
            continue
        place = "robots", number, "mind"
        if robot.name not in spoken_for:
            yield place, f"no [[ros]] lists {robot.name}, so its mind cannot take its tasks over ROS 2"
        if not site.clock.keeps_wall_time:
            yield place, f"the clock waits for no {robot.mind}: set clock.speed and clock.idle_speed to 1"


# -- the room --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Box:
    place: Place
    name: str
    floor: Rectangle

    def depth_m(self, other: _Box) -> float:
        """Depth of their overlap along the axis where it is least (separating axes)."""
        return min(
            min(max(a), max(b)) - max(min(a), min(b))
            for axis in (self.floor.pose.yaw_rad, other.floor.pose.yaw_rad)
            for turn in (axis, axis + math.pi / 2)
            for a, b in [[_along(box.floor.corners, turn) for box in (self, other)]]
        )


def _along(corners: list[tuple[float, float]], turn_rad: float) -> list[float]:
    axis = Pose2(x_m=0, y_m=0, yaw_rad=turn_rad)
    return [seen_from(axis, *corner)[0] for corner in corners]


def _boxes(site: Site) -> Iterator[_Box]:
    for number, one in enumerate(site.lab.furniture):
        place: Place = ("lab", "furniture", number)
        yield _Box(place, one.name, furniture_floor(one))
    for number, bin_ in enumerate(site.bins):
        yield _Box(("bins", number), bin_.name, BinLayout(bin_).floor)
    for number, dock in enumerate(site.docks):
        yield _Box(("docks", number), dock.name, dock_floor(dock))
    for number, robot in enumerate(site.robots):
        if robot.body == "sim":
            yield _Box(("robots", number), robot.name, footprint(robot.pose))
    for table, lying in (("items", site.items), ("things", site.things)):
        for number, item in enumerate(lying):
            yield _Box((table, number), item.id, Rectangle(item.pose, ITEM_RADIUS_M, ITEM_RADIUS_M))


def _overlaps(site: Site) -> Iterator[tuple[Place, str]]:
    boxes = list(_boxes(site))
    # Walls meet, and the lab's own.
    walls = {one.name for one in site.lab.furniture if one.kind == "wall"}
    for one, other in combinations(boxes, 2):
        if not {one.name, other.name} <= walls and one.depth_m(other) > _TOUCH_M:
            yield (*other.place, "pose"), f"{other.name} overlaps {one.name}"
    length_m, width_m = site.lab.size_m
    for box in (one for one in boxes if one.name not in walls):
        x_m, y_m = zip(*box.floor.corners, strict=True)
        if max(-min(x_m), -min(y_m), max(x_m) - length_m, max(y_m) - width_m) > _TOUCH_M:
            yield (*box.place, "pose"), f"{box.name} reaches into a wall"


def _lacking(site: Site) -> Iterator[tuple[Place, str]]:
    known = installed()
    for number, one in enumerate(site.kinds):
        if one.judge is not None:
            continue
        if one.name not in known:
            text = f"{NOT_INSTALLED} (installed: {', '.join(known)}){close(one.name, known)}"
            yield ("kinds", number, "name"), text
        elif missing := load(one.name).lacks(site):
            yield ("kinds", number, "name"), f"{one.name} needs what the site lacks: write [[{missing}]]"
    machines = [name for name in ("robots", "docks") if getattr(site, name)]
    by_machines = [one.name for one in site.kinds if one.judge is None]
    if machines and all(name in known and load(name).provides != "energy" for name in by_machines):
        yield (
            ("kinds",),
            f"no kind provides energy, which {' and '.join(machines)} need: also list {_providers(known)}. "
            "What a file lists replaces the list of the file that it extends",
        )


def _cameras(site: Site) -> Iterator[tuple[Place, str]]:
    """What the source of motion capture says of its settings."""
    if site.mocap.source in (None, SIM) or not site.lab.mocap:
        return
    from services.mocap.sources import chosen_settings, load

    try:
        kind = load(str(site.mocap.source))
    except ConfigError as error:
        yield ("mocap", "source"), str(error)
        return
    try:
        chosen_settings(kind, site.mocap)
    except ConfigError as error:
        yield ("mocap", "settings"), str(error)


def _on_modbus(site: Site) -> list[tuple[int, DockConfig]]:
    return [(number, dock) for number, dock in enumerate(site.docks) if dock.meter.source == "modbus"]


def _meters(site: Site) -> Iterator[tuple[Place, str]]:
    """Maps of registers that cannot be read."""
    for number, dock in _on_modbus(site):
        from services.charger.modbus import RegisterMap

        try:
            RegisterMap.load(dock.meter.model)
        except ConfigError as error:
            yield ("docks", number, "meter", "model"), str(error)


def _coarse_meters(site: Site) -> Iterator[tuple[Place, str]]:
    """Robots whose orders a meter's register cannot confirm."""
    for number, dock in _on_modbus(site):
        from services.charger.job import unsold
        from services.charger.lies import least_order_wh
        from services.charger.modbus import RegisterMap

        step_wh = RegisterMap.load(dock.meter.model).resolution_wh
        for text in unsold(site, dock, least_order_wh(step_wh)):
            yield ("docks", number, "meter"), text


def undecided_on_open_bus(site: Site) -> str:
    """Reason why no work judged by the oracle is paid there; empty on a closed bus, or where people judge."""
    known = installed()
    judged = [
        one.name
        for one in site.kinds
        if one.judge is None and one.name in known and load(one.name).judge == "oracle"
    ]
    if not judged or not (why := openness(site)):
        return ""
    return f"{' and '.join(judged)}: {why}"


def _thin_stakes(site: Site) -> Iterator[tuple[Place, str]]:
    """A judge's vote accepts only what its stake covers: else nobody rules, and nobody is paid."""
    known = installed()
    prices = {
        one.name: load(one.name).price_iec if one.price_iec is None else one.price_iec
        for one in site.kinds
        if one.judge is None and one.name in known
    }
    places: list[Place] = [("disputes", "judge_stake_iec"), ("disputes", "appeal", "judge_stake_iec")]
    for place, instance in zip(places, site.disputes.instances if site.disputes else (), strict=False):
        covered = STAKE_COVERS * instance.judge_stake_iec
        for name, price in prices.items():
            if 0 < covered < price:
                yield (
                    place,
                    f"a stake of {instance.judge_stake_iec} IEC covers {covered} IEC of accepted work, and "
                    f"one {name} costs {price} IEC: no vote for it would count",
                )


def _providers(known: Iterable[str]) -> str:
    """The installed kinds that provide energy; what cannot be loaded is none."""
    found = []
    for name in known:
        with suppress(KindError):
            if load(name).provides == "energy":
                found.append(name)
    return " or ".join(found) or "one that does"


def _unaffordable(site: Site) -> Iterator[tuple[Place, str]]:
    cap_iec = site.agent.daily_spending_cap_iec
    for care in site.agent.maintenance:
        if care.reward_iec > cap_iec:
            yield (
                ("agent", "daily_spending_cap_iec"),
                f"{care.kind} is rewarded with {care.reward_iec} IEC, and a robot may spend {cap_iec} IEC a "
                "day: it is never posted",
            )


def _standby(site: Site) -> Iterator[tuple[Place, str]]:
    for number, robot in enumerate(site.robots):
        off_w, on_w = robot.battery.standby_power_w, robot.battery.idle_power_w
        if off_w > on_w:
            yield (
                ("robots", number, "battery", "standby_power_w"),
                f"{robot.name} draws more power switched off ({off_w:g} W) than idle ({on_w:g} W)",
            )


def _hurried(site: Site) -> Iterator[tuple[Place, str]]:
    """Grace periods, and people's windows, that may be over before anybody knows of the task."""
    clock = site.clock
    if not clock.keeps_wall_time and clock.idle_speed == 0 and "bridge" not in clock.holders:
        yield (
            ("clock", "idle_speed"),
            "the clock may jump over a task's whole grace period before its executor hears of it: list "
            '"bridge" in clock.holders, too',
        )
    known = installed()
    for number, one in enumerate(site.kinds):
        # What people do they answer by the wall clock, for which the simulator slows the site's clock down.
        if one.judge is not None or one.name not in known:
            continue
        if (grace_s := declared(one).grace_period_s) < site.answer_s:
            # As in `answer_s`: another robot may be given a task while one charges. 0 is as fast as it goes.
            idles = len(site.robots) > 1 and (clock.idle_speed or math.inf) > (clock.speed or math.inf)
            faster = "idle_speed" if idles else "speed"
            yield (
                ("kinds", number),
                f"a task of {one.name} can be given back for {grace_s} s of site time, and a process may "
                f"need {site.answer_s:g} s for that, {ANSWER_WALL_S:g} s on the wall clock: lower "
                f"clock.{faster}, or raise grace_s",
            )


def _unpriced(site: Site) -> Iterator[tuple[Place, str]]:
    """Kinds whose attempts count in records by a price that nobody chose."""
    known = installed()
    for number, one in enumerate(site.kinds):
        if one.judge is None and one.name not in known:
            continue
        if not declared(one).price_iec:
            yield (
                ("kinds", number),
                f"{one.name} has no price_iec, so an attempt counts up to {DEFAULT_PRICE_IEC} IEC in its "
                "provider's record: say what the work costs",
            )


def _unreachable(site: Site) -> Iterator[tuple[Place, str]]:
    # Imported here: scipy takes half a second, and most files fail before.
    from services.robot_sim.planner import Map, PlanningFailed, plan

    def reaches(start: Pose2, goals: list[Pose2]) -> bool:
        for goal in goals:
            try:
                plan(floor, start, goal)
            except PlanningFailed:
                continue
            return True
        return False

    robot = next((robot for robot in site.robots if robot.body == "sim"), None)
    if robot is None or max(site.lab.size_m) > _LONGEST_ROOM_M:  # a map of it would not fit into memory
        return
    floor, start = Map.of(site), robot.pose
    wanted: list[tuple[Place, str, list[Pose2]]] = [
        *(
            (("bins", number, "pose"), f"the bin {one.name}", [BinLayout(one).parking])
            for number, one in enumerate(site.bins)
        ),
        *(
            (("docks", number, "pose"), f"the dock {one.name}", [dock_parking(one)])
            for number, one in enumerate(site.docks)
        ),
        *(
            (("places", number, "pose"), f"the place {one.name}", [one.pose])
            for number, one in enumerate(site.places)
        ),
    ]
    for number, item in enumerate(site.items):
        around = [
            facing(item.pose.model_copy(update={"yaw_rad": turn * math.tau / _SIDES}), PICK_DISTANCE_M)
            for turn in range(_SIDES)
        ]
        wanted.append((("items", number, "pose"), item.id, [pose for pose in around if floor.fits(pose)]))
    for place, name, goals in wanted:
        if not reaches(start, goals):
            yield place, f"{robot.name} finds no way to {name} from where it starts"
