"""What an exploring robot sees on the floor that no site file lists. A part of `bench.unlisted`.

`SIGHT_LABS` (20) labs with furniture at random places and ten things each: the twelve shapes, up to a quarter
larger or smaller, at random places where a robot can get at them. A robot explores each lab for EXPLORES_S of
site time as the deployed mind does. Its camera is the simulator's, noise included.
Its base drives the simulator's routes without errors. Then all things are taken away, and it explores for
GONE_S.

`sight_found_share` of the things is reported, to within FOUND_M of where it lies; `sight_twice` were reported
more than once. `sight_found_s` is the median of the time of exploring until then. `sight_size_error_m` is the
median, over what was found, of the largest error of the three extents, and `sight_size_error_p95_m` what 95 %
stay below; `sight_place_error_m` and `sight_place_error_p95_m` are those of the place. `sight_kept_share` of
what was found was not withdrawn while it lay there, and `sight_withdrawn_share` was when it was gone.
`sight_false_per_h` are reports in an hour of exploring, in PEOPLE_LABS labs without things in which three
people stand and walk, for BUSY_S each; `sight_false_beside_things` are reports of nothing in the other labs.
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

# The lab chooses MuJoCo's OpenGL back end, which counts only before the first import of mujoco.
from rodeo.site.config import Site

# isort: split
import mujoco
import numpy as np

from rodeo.bus.queries import SeenThing
from rodeo.lab.config import SHAPE_NAMES, FurnitureConfig, ItemConfig, Pose2
from rodeo.lab.geometry import quaternion_of
from rodeo.lab.items import rest_pose, shape_of
from rodeo.lab.layout import BinLayout, dock_parking
from rodeo.lab.render import encode
from rodeo.lab.sensors import DepthCamera
from rodeo.lab.world import CAMERA_SITE, world_spec
from rodeo.robot.behaviour import Estimate, Robot
from rodeo.robot.errors import MotionFailed, Unreachable
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import View
from rodeo.ros2 import types
from rodeo_kinds.waste_disposal.behaviour import WasteDisposal
from services.robot_agent.idle import Idle
from services.robot_agent.machine import Machine
from services.robot_agent.news import News
from services.robot_sim.messages import compressed_image
from services.robot_sim.planner import Map, PlanningFailed, plan
from tests.support.site import LAB
from tests.unit.robot.fakes import KinematicBody, ManualClock, SeenBook, manipulator, put

LABS = int(os.environ.get("SIGHT_LABS", "20"))
THINGS = 10
PEOPLE_LABS = 6
PEOPLE = 3
EXPLORES_S, GONE_S, BUSY_S = 900.0, 600.0, 1800.0
WORKERS = 2
FOUND_M = 0.15
_SHAPES = [(kind, shape) for kind, shapes in SHAPE_NAMES.items() for shape in shapes]
_SCALES = 0.75, 1.25
_APART_M = 0.4
"""Between two things: nearer together the organization takes them for one."""
_OPEN_M = 0.12
_FURNITURE = (("desk", (1.4, 0.75, 0.74)), ("shelf", (0.4, 1.4, 1.1)), ("crate", (0.5, 0.5, 0.45)))
_AISLE_M = 1.1
"""Between two pieces of furniture, so that a robot gets through."""
_FRAMES, _FRAME_S = 3, 0.2
"""Pictures for which a look waits, and site time for each. The last two are used."""
_LEG_M, _SHOE_M = (0.055, 0.4), (0.13, 0.045, 0.04)
"""A leg's radius and half height; half of a shoe."""
_WALKS_M_S, _STRIDE_M, _STANDS_S = 1.0, 0.25, (3.0, 90.0)
_PLACE_TRIES = 10_000


def run() -> dict[str, float]:
    with multiprocessing.get_context("spawn").Pool(WORKERS) as pool:
        busy = pool.map_async(false_finds, range(PEOPLE_LABS), chunksize=1)
        labs = pool.map(explored, range(LABS), chunksize=1)
        hours, false = np.sum(busy.get(), axis=0)
    found = [one for lab in labs for one in lab.found]
    places_m, sizes_m, after_s = np.array([(one.place_off_m, one.size_off_m, one.after_s) for one in found]).T
    return {
        "sight_found_share": len(found) / (LABS * THINGS),
        "sight_found_s": float(np.median(after_s)),
        "sight_twice": float(sum(lab.twice for lab in labs)),
        "sight_size_error_m": float(np.median(sizes_m)),
        "sight_size_error_p95_m": float(np.quantile(sizes_m, 0.95)),
        "sight_place_error_m": float(np.median(places_m)),
        "sight_place_error_p95_m": float(np.quantile(places_m, 0.95)),
        "sight_kept_share": sum(lab.kept for lab in labs) / len(found),
        "sight_withdrawn_share": sum(lab.withdrawn for lab in labs) / len(found),
        "sight_false_per_h": float(false / hours),
        "sight_false_beside_things": float(sum(lab.false for lab in labs)),
    }


@dataclass(frozen=True)
class Found:
    place_off_m: float
    size_off_m: float
    after_s: float


@dataclass(frozen=True)
class Lab:
    """What came of the exploring of one lab with things."""

    found: list[Found]
    twice: int
    false: int
    kept: int
    withdrawn: int


def explored(number: int) -> Lab:
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(Path(folder), number, THINGS, 0)
        began_s = scene.clock.now_s()
        scene.explore(EXPLORES_S)
        found: dict[str, Found] = {}
        twice = false = 0
        for report in scene.seen.reported:
            thing = min(scene.things, key=lambda one: one.away_m(report))
            if thing.away_m(report) > FOUND_M:
                false += 1
            elif thing.name in found:
                twice += 1
            else:
                after_s = report.first_s - began_s
                found[thing.name] = Found(thing.away_m(report), thing.size_off_m(report), after_s)
        kept = sum(one.state == "open" for one in scene.seen.kept)
        scene.take_all_away()
        scene.explore(GONE_S)
        left = sum(one.state == "open" for one in scene.seen.kept)
    return Lab(list(found.values()), twice, false, kept, kept - left)


def false_finds(number: int) -> tuple[float, int]:
    """Hours of exploring, and reports, in a lab with people and without things."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(Path(folder), 1000 + number, 0, PEOPLE)
        scene.explore(BUSY_S)
    return BUSY_S / 3600, len(scene.seen.reported)


@dataclass(frozen=True)
class Thing:
    """A shape that is `scale` times as large as usual."""

    item: ItemConfig
    scale: float

    @property
    def name(self) -> str:
        return self.item.id

    def away_m(self, seen: SeenThing) -> float:
        return math.dist((seen.x_m, seen.y_m), (self.item.pose.x_m, self.item.pose.y_m))

    def size_off_m(self, seen: SeenThing) -> float:
        shape = shape_of(self.item)
        x_m, y_m, z_m = (2 * self.scale * half_m for half_m in shape.half_m)
        size_m = (z_m, y_m, x_m) if shape.lies else (max(x_m, y_m), min(x_m, y_m), z_m)
        return max(abs(a - b) for a, b in zip(seen.size_m, size_m, strict=True))


class Person:
    """Two legs in shoes that stand for a while, then walk somewhere."""

    def __init__(self, name: str, chance: np.random.Generator, size_m: tuple[float, float]) -> None:
        self._chance, self._size_m = chance, size_m
        self.feet = f"{name}/left", f"{name}/right"
        self._from, self._to = self._somewhere(), self._somewhere()
        self._began_s, self._stands_s = 0.0, 0.0

    def add(self, spec: mujoco.MjSpec) -> None:
        for foot in self.feet:
            body = spec.worldbody.add_body(name=foot, mocap=True)
            radius_m, half_m = _LEG_M
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[radius_m, half_m, 0], pos=[0, 0, half_m + 0.02]
            )
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=list(_SHOE_M), pos=[0.06, 0, _SHOE_M[2]])

    def put(self, model: mujoco.MjModel, data: mujoco.MjData, now_s: float) -> None:
        way = np.subtract(self._to, self._from)
        walks_s = float(np.hypot(*way)) / _WALKS_M_S
        while now_s > self._began_s + self._stands_s + walks_s:
            self._began_s += self._stands_s + walks_s
            self._stands_s = self._chance.uniform(*_STANDS_S)
            self._from, self._to = self._to, self._somewhere()
            way = np.subtract(self._to, self._from)
            walks_s = float(np.hypot(*way)) / _WALKS_M_S
        walked_s = max(0.0, now_s - self._began_s - self._stands_s)
        ahead, yaw = way / max(np.hypot(*way), 1e-6), math.atan2(way[1], way[0])
        for side, foot in zip((1, -1), self.feet, strict=True):
            step_m = side * _STRIDE_M * math.sin(math.pi * walked_s * _WALKS_M_S / _STRIDE_M / 2)
            at = np.array(self._from) + ahead * (walked_s * _WALKS_M_S + step_m)
            at += side * 0.1 * np.array([-ahead[1], ahead[0]])
            number = model.body(foot).mocapid[0]
            data.mocap_pos[number], data.mocap_quat[number] = (*at, 0.0), quaternion_of(yaw)

    def _somewhere(self) -> tuple[float, float]:
        x_m, y_m = self._chance.uniform(0.3, 0.3 + np.subtract(self._size_m, 0.6))
        return float(x_m), float(y_m)


class Base(KinematicBody):
    """Drives the simulator's routes at the robot's speed."""

    def __init__(self, site: Site, clock: ManualClock, things: list[Thing]) -> None:
        super().__init__(site, clock)
        self.lab = Map.of(site).with_items([(one.item.pose.x_m, one.item.pose.y_m) for one in things])

    def navigate(self, goal: Pose2, feedback: Any = None) -> None:
        try:
            route = plan(self.lab, self.base, goal)
        except PlanningFailed as error:
            raise MotionFailed(error.message, action="navigate") from error
        limits = self.site.robots[0].limits
        turned = sum(
            abs(math.remainder(b - a, math.tau))
            for a, b in itertools.pairwise(_headings(self.base, route.way, goal))
        )
        self.clock.time_s += route.length_m / limits.cruise_m_s + turned / limits.cruise_rad_s + 2.0
        self.base = goal


def _headings(start: Pose2, way: Any, goal: Pose2) -> list[float]:
    legs = [
        math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in itertools.pairwise(way) if math.dist(a, b) > 1e-6
    ]
    return [start.yaw_rad, *legs, goal.yaw_rad]


class Eyes:
    """The wrist camera in a world with things and people."""

    def __init__(
        self, body: Base, model: mujoco.MjModel, people: list[Person], chance: np.random.Generator
    ) -> None:
        self._body, self._people, self._chance = body, people, chance
        self.model, self.data = model, mujoco.MjData(model)
        self._camera = DepthCamera(model, f"{body.site.robots[0].name}/{CAMERA_SITE}")
        self._photo = types.serialize(compressed_image(0, "", encode(np.zeros((48, 64, 3), np.uint8))))
        self._share = body.site.robots[0].noise.depth_share

    def look(self) -> list[View]:
        frames = []
        for _ in range(_FRAMES):
            self._body.clock.time_s += _FRAME_S
            frames.append(self._body.clock.time_s)
        views: list[View] = []
        depth_m = None
        for now_s in frames[1:]:
            if depth_m is None or self._people:
                for one in self._people:
                    one.put(self.model, self.data, now_s)
                put(self._body, self.model, self.data)
                depth_m = self._camera.image(self.data)
            noise = 1 + self._share * self._chance.standard_normal(depth_m.shape)
            frame = self.data.site(f"{self._body.site.robots[0].name}/{CAMERA_SITE}")
            turn = frame.xmat.reshape(3, 3).copy()
            measured_m = np.where(depth_m > 0, depth_m * noise, np.nan)
            views.append(View(measured_m, self._camera.lens.matrix, frame.xpos.copy(), turn))
        return views

    def picture(self) -> bytes:
        return self._photo


class Scene:
    """A lab, and a robot that explores it."""

    def __init__(self, folder: Path, number: int, things: int, people: int) -> None:
        chance = np.random.default_rng(number)
        lab = Site.load(LAB)
        furniture = _furnished(lab, chance)
        site = lab.model_copy(
            update={
                "items": [],
                "data_dir": folder,
                "lab": lab.lab.model_copy(update={"furniture": furniture}),
            }
        )
        self.things = _strewn(site, things, chance)
        walkers = [Person(f"person{one}", chance, site.lab.size_m) for one in range(people)]
        self.clock = ManualClock()
        self.body = Base(site, self.clock, self.things)
        self._eyes = Eyes(self.body, _world(site, self.things, walkers), walkers, chance)
        memory, floor = Memory(site, folder / "memory.json"), Floor(site)
        eyes: Any = self._eyes
        body: Any = self.body
        hands = manipulator(site, body, eyes, memory)
        self.seen = SeenBook(self.clock)
        seen: Any = self.seen
        none: Any = SimpleNamespace()
        bins: Any = {one.name: none for one in site.bins}
        robot = Robot(
            site.robots[0].name, site, hands, floor, memory, bins, self.clock, none,
            lambda way_m, ends_at: Estimate(way_m, way_m, ends_at), seen,
        )  # fmt: skip
        skills: Any = SimpleNamespace(behaviours={"waste_disposal": WasteDisposal(robot)})
        machine = Machine(site.robots[0], body, hands, floor, memory, self.body.interrupts, chance)
        process: Any = SimpleNamespace(site=site, clock=self.clock, stop=None)
        silent: Any = SimpleNamespace(report=lambda _text: None, ask=lambda: None)
        news = News(self.clock, none)
        self._idle = Idle(process, machine, news, silent, silent, none, none, skills)

    def explore(self, for_s: float) -> None:
        until_s, nothing = self.clock.now_s() + for_s, SimpleNamespace()
        situation: Any = nothing
        while self.clock.now_s() < until_s:
            self.clock.time_s += 0.1  # of a mind that looks, decides and acts
            self._idle.explore(situation)

    def take_all_away(self) -> None:
        for thing in self.things:
            joint = self._eyes.model.joint(thing.name).qposadr[0]
            self._eyes.data.qpos[joint + 2] = -5.0
        self.body.lab = Map.of(self.body.site)


def _furnished(site: Site, chance: np.random.Generator) -> tuple[FurnitureConfig, ...]:
    """Three to five pieces with aisles around them."""
    length_m, width_m = site.lab.size_m
    taken = [(site.robots[0].pose, 0.6)]
    taken += [(BinLayout(one).parking, 0.9) for one in site.bins]
    taken += [(dock_parking(one), 0.9) for one in site.docks]
    placed: list[FurnitureConfig] = []
    wanted = int(chance.integers(3, 6))
    for _ in range(_PLACE_TRIES):
        if len(placed) == wanted:
            break
        kind, size_m = _FURNITURE[chance.integers(len(_FURNITURE))]
        yaw = chance.choice([0, math.pi / 2]) + chance.choice([0, chance.uniform(-0.4, 0.4)])
        pose = Pose2(
            x_m=chance.uniform(0.4, length_m - 0.4), y_m=chance.uniform(0.4, width_m - 0.4), yaw_rad=yaw
        )
        reach_m = math.hypot(*size_m[:2]) / 2
        gaps = [
            math.dist((pose.x_m, pose.y_m), (at.x_m, at.y_m)) - reach_m - other_m for at, other_m in taken
        ]
        if min(gaps) > _AISLE_M / 2:
            name = f"{kind}{len(placed)}"
            placed.append(
                FurnitureConfig.model_validate({"name": name, "kind": kind, "pose": pose, "size_m": size_m})
            )
            taken.append((pose, reach_m + _AISLE_M / 2))
    return tuple(placed)


def _strewn(site: Site, count: int, chance: np.random.Generator) -> list[Thing]:
    """Things where a robot can get at them."""
    floor, start = Floor(site), site.robots[0].pose
    things: list[Thing] = []
    for _ in range(_PLACE_TRIES):
        if len(things) == count:
            return things
        x_m, y_m = chance.uniform((0, 0), site.lab.size_m)
        apart = all(
            math.dist((x_m, y_m), (one.item.pose.x_m, one.item.pose.y_m)) > _APART_M for one in things
        )
        if floor.clearance_m(x_m, y_m) < _OPEN_M or not apart:
            continue
        places = [*((one.item.pose.x_m, one.item.pose.y_m) for one in things), (x_m, y_m)]
        if not _reachable(floor, Map.of(site).with_items(places), start, places):
            continue
        kind, shape = _SHAPES[chance.integers(len(_SHAPES))]
        pose = Pose2(x_m=x_m, y_m=y_m, yaw_rad=chance.uniform(-3, 3))
        item = ItemConfig(id=f"thing{len(things)}", item_class=kind, shape=shape, pose=pose)
        things.append(Thing(item, chance.uniform(*_SCALES)))
    raise AssertionError(f"no room for {count} things in {site.lab.furniture}")


def _reachable(floor: Floor, lab: Map, start: Pose2, places: list[tuple[float, float]]) -> bool:
    try:
        for place in places:
            others = [one for one in places if one != place]
            plan(lab, start, floor.grasp_poses(place, others, start)[0])
    except (Unreachable, PlanningFailed):
        return False
    return True


def _world(site: Site, things: list[Thing], people: list[Person]) -> mujoco.MjModel:
    spec = world_spec(site.model_copy(update={"items": [one.item for one in things]}))
    for thing in things:
        body = spec.body(thing.name)
        (x_m, y_m, z_m), _ = rest_pose(thing.item)
        body.pos = [x_m, y_m, z_m * thing.scale]
        for geom in body.geoms:
            geom.size, geom.pos = geom.size * thing.scale, geom.pos * thing.scale
    for one in people:
        one.add(spec)
    return spec.compile()
