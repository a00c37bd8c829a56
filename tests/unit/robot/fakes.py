"""Public peers of the agent's surroundings: a body that moves by kinematics alone, and a bin that answers."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from eth_account import Account

from rodeo.bus.queries import SeenThing
from rodeo.bus.seen import SightReport
from rodeo.errors import NoResponder, RodeoError
from rodeo.evidence.attestation import Attestation, attest
from rodeo.host.clock import WallClock
from rodeo.kinds import SAME_PLACE_M
from rodeo.lab.config import ItemConfig, Pose2, PosturesConfig
from rodeo.lab.geometry import ahead
from rodeo.lab.items import rest_pose, shape_of
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import (
    CONTROL_PERIOD_S,
    GRIPPER_CLOSED_M,
    GRIPPER_OPEN_M,
    PAD_THICKNESS_M,
    arm_model,
    build_world,
)
from rodeo.robot.arm import Arm, Trajectory, Vector
from rodeo.robot.bin import Kind, Word
from rodeo.robot.errors import MotionFailed, NoAnswer
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.manipulator import MobileManipulator
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor, in_base_frame
from rodeo.robot.perception import View
from rodeo.robot.ros_body import Grip, Joints
from rodeo.site.config import Site
from rodeo.witness.chain import WitnessChain
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Claimant, Classification, Drop, Removal, Scope

READY_RAD = np.array(PosturesConfig().ready_rad)
_GRASP_RADIUS_M = 0.03


@dataclass(frozen=True)
class Pose3:
    """Position in the map (m) and orientation (w, x, y, z)."""

    position_m: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]


class ManualClock(WallClock):
    """Site time that passes when somebody waits for it."""

    def __init__(self) -> None:
        super().__init__()
        self.time_s = 1_000.0

    def now_s(self) -> float:
        return self.time_s

    def now_ns(self) -> int:
        return round(self.time_s * 1e9)

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        self.time_s = max(self.time_s, time_s)
        return stop is None or not stop.is_set()

    def wait_for(
        self,
        done: Callable[[], bool],
        stop: threading.Event | None = None,
        *,
        wall_s: float | None = None,
        **limits: Any,
    ) -> bool:
        happened = super().wait_for(done, stop, wall_s=wall_s, **limits)
        if not happened and wall_s is not None:
            self.time_s += max(wall_s, CONTROL_PERIOD_S)
        return happened


class KinematicBody:
    """A robot whose motions always reach their end; what its fingers close on moves with them.

    `slips`: number of lifts on which the item falls back. `blocked`: number of drives that fail.
    """

    def __init__(self, site: Site, clock: ManualClock) -> None:
        self.site = site
        self.clock = clock
        self.interrupts = Interrupts()
        self.base = site.robots[0].pose
        self.arm_rad: Vector = READY_RAD.copy()
        self.gripper_m = GRIPPER_OPEN_M
        self.items = {item.id: Pose3(*rest_pose(item)) for item in site.items}
        self.held: str | None = None
        self.slips = 0
        self.blocked = 0
        self.drives: list[Pose2] = []
        self.dropped_in: str | None = None
        self._arm = Arm(site.robots[0].limits)
        self._hang: Vector = np.zeros(3)

    wrong_clock = ""

    def unfit(self, work_s: float = 0.0) -> str:
        return ""

    def recent_base_pose(self) -> Pose2:
        return self.base

    def base_pose(self) -> Pose2:
        self.interrupts.check()
        return self.base

    def recent_gripper_m(self) -> float:
        return self.gripper_m

    def joints(self) -> Joints:
        self.interrupts.check()
        return Joints(self.arm_rad.copy(), self.gripper_m, self.recent_efforts_nm())

    def recent_efforts_nm(self) -> Vector:
        """As if the arm weighed nothing itself."""
        weight_n = next((9.81 * item.mass_kg for item in self.site.items if item.id == self.held), None)
        if weight_n is None:
            return np.zeros(len(self.arm_rad))
        turned = self.arm_rad + 1e-6 * np.eye(len(self.arm_rad))
        rises_m = [self._arm.forward(q).position_m[2] - self._pads()[2] for q in turned]
        return weight_n * np.array(rises_m) / 1e-6

    def navigate(self, goal: Pose2, feedback: Any = None) -> None:
        self.interrupts.check()
        self.clock.time_s += 10
        if self.blocked:
            self.blocked -= 1
            raise MotionFailed("there is no way", action="navigate")
        self.base = goal
        self.drives.append(goal)
        self._carry_along()

    def follow(self, plan: Callable[[Vector], Trajectory]) -> None:
        self.interrupts.check()
        trajectory = plan(self.arm_rad.copy())
        self.clock.time_s += trajectory.duration_s
        before_m = self._pads()[2]
        self.arm_rad = trajectory.positions[-1]
        self._carry_along()
        if self.held and self.slips and self._pads()[2] > before_m + 0.1:
            self.slips -= 1
            self.gripper_m = GRIPPER_CLOSED_M
            self._let_go()

    def grip(self, position_m: float, force_n: float) -> Grip:
        self.interrupts.check()
        self.clock.time_s += 1
        if position_m >= GRIPPER_OPEN_M:
            self.gripper_m = GRIPPER_OPEN_M
            self._let_go()
            return Grip(self.gripper_m, False)
        if self.held and self.gripper_m > GRIPPER_CLOSED_M:
            return Grip(self.gripper_m, True)
        pads = self._pads()
        for item in self.site.items:
            centre = in_base_frame(self.base, self.items[item.id].position_m)
            if np.linalg.norm(np.array(centre)[:2] - pads[:2]) < _GRASP_RADIUS_M and pads[2] < 0.12:
                self.held = item.id
                self._hang = np.array(centre) - pads
                self.gripper_m = shape_of(item).half_m[1] + PAD_THICKNESS_M
                return Grip(self.gripper_m, True)
        self.gripper_m = GRIPPER_CLOSED_M
        return Grip(self.gripper_m, False)

    def _pads(self) -> Vector:
        return self._arm.forward(self.arm_rad).position_m

    def _carry_along(self) -> None:
        if self.held:
            x_m, y_m, z_m = self._pads() + self._hang
            self._put(self.held, (*ahead(self.base, x_m, y_m), z_m))

    def _let_go(self) -> None:
        if self.held is None:
            return
        item = next(item for item in self.site.items if item.id == self.held)
        self.held = None
        self._fall(item)

    def _fall(self, item: ItemConfig) -> None:
        x_m, y_m, _ = self.items[item.id].position_m
        if name := BinLayout(self.site.bins[0]).compartment_at((x_m, y_m, 0.2)):
            self.dropped_in = name
        self._put(item.id, (x_m, y_m, 0.15 if name else rest_pose(item)[0][2]))

    def _put(self, item: str, position_m: tuple[float, float, float]) -> None:
        self.items[item] = Pose3(position_m, self.items[item].quat_wxyz)


class RayCamera:
    """The wrist camera of a `KinematicBody` in the site's world: depth by ray casting, with noise.

    `blind`: it sees nothing but floor; `colourless`: it sends no pictures.
    """

    WIDTH, HEIGHT, FOVY_RAD, NOISE = 80, 60, 1.239, 0.005

    def __init__(self, body: KinematicBody) -> None:
        self._body = body
        self._model = _world(body.site.model_dump_json())
        self._data = mujoco.MjData(self._model)
        self._chance = np.random.default_rng(1)
        self.blind = self.colourless = False
        self.looks = 0
        focal = self.HEIGHT / 2 / np.tan(self.FOVY_RAD / 2)
        cx, cy = (self.WIDTH - 1) / 2, (self.HEIGHT - 1) / 2
        self._intrinsics = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
        columns, rows = np.meshgrid(np.arange(self.WIDTH), np.arange(self.HEIGHT))
        rays = np.stack([(columns - cx) / focal, (rows - cy) / focal, np.ones(columns.shape)], axis=-1)
        self._rays = rays.reshape(-1, 3)

    def picture(self) -> bytes:
        if self.colourless:
            raise NoAnswer("the wrist camera sends no pictures")
        return b"\x00\x01\x00\x00"

    def look(self) -> list[View]:
        self._body.interrupts.check()
        self.looks += 1
        self._put_everything()
        name = self._body.site.robots[0].name
        site = self._data.site(f"{name}/wrist_camera_optical_frame")
        position, rotation = site.xpos.copy(), site.xmat.reshape(3, 3).copy()
        lengths = np.linalg.norm(self._rays, axis=1)
        directions = (self._rays / lengths[:, None]) @ rotation.T
        count = len(directions)
        geoms, distances = np.full(count, -1, np.int32), np.full(count, -1.0)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            position,
            directions.ravel(),
            None,
            True,
            -1,
            geoms,
            distances,
            None,
            count,
            5.0,
        )
        depth = np.where(distances >= 0, distances / lengths, np.nan)
        depth *= 1 + self._chance.normal(0, self.NOISE, count)
        return [View(depth.reshape(self.HEIGHT, self.WIDTH), self._intrinsics, position, rotation)]

    def _put_everything(self) -> None:
        model, data = self._model, self._data
        for item, pose in self._body.items.items():
            joint = model.joint(item).qposadr[0]
            x, y, z = (0.0, 0.0, -5.0) if self.blind else pose.position_m
            data.qpos[joint : joint + 7] = [x, y, z, *pose.quat_wxyz]
        put(self._body, model, data)


def put(body: KinematicBody, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put the robot into a world as it stands."""
    robot, half = body.site.robots[0].name, body.base.yaw_rad / 2
    joint = model.joint(f"{robot}/base").qposadr[0]
    height_m = model.qpos0[joint + 2]
    data.qpos[joint : joint + 7] = [body.base.x_m, body.base.y_m, height_m, np.cos(half), 0, 0, np.sin(half)]
    for name, value in zip(arm_model().joints, body.arm_rad, strict=True):
        data.qpos[model.joint(f"{robot}/{name}").qposadr[0]] = value
    for name, side in zip(arm_model().fingers, (1, -1), strict=True):
        data.qpos[model.joint(f"{robot}/{name}").qposadr[0]] = side * body.gripper_m
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def manipulator(site: Site, body: KinematicBody, camera: RayCamera, memory: Memory) -> MobileManipulator:
    """What a behaviour may do with the body and its camera."""
    ros: Any = body
    eyes: Any = camera
    arm = Arm(site.robots[0].limits)
    chance = np.random.default_rng(1)
    return MobileManipulator(ros, arm, eyes, Floor(site), memory, body.clock, chance, threading.Event())


@lru_cache(maxsize=8)
def _world(site_json: str) -> mujoco.MjModel:
    return build_world(Site.model_validate_json(site_json))


class SeenBook:
    """Keeps what robots see as the bridge does, in memory."""

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self.reported: list[SeenThing] = []
        """Each as it was reported first."""
        self.kept: list[SeenThing] = []

    def things(self, state: str) -> list[SeenThing]:
        return [one for one in self.kept if one.state in state.split(",")]

    def report(self, seen: SightReport) -> SeenThing:
        now_s = self._clock.now_s()
        for one in self.things("open,posted,dismissed"):
            if math.dist((one.x_m, one.y_m), (seen.x_m, seen.y_m)) < SAME_PLACE_M:
                return self._keep(one, last_s=now_s)
        new = SeenThing(
            **seen.model_dump(),
            id=len(self.kept),
            robot="panther1",
            first_s=now_s,
            last_s=now_s,
            state="open",
        )
        self.reported.append(new)
        self.kept.append(new)
        return new

    def gone(self, thing_id: int) -> SeenThing:
        return self._keep(self.kept[thing_id], state="gone")

    def _keep(self, thing: SeenThing, **changes: Any) -> SeenThing:
        self.kept[thing.id] = thing.model_copy(update=changes)
        return self.kept[thing.id]


SCOPE = Scope(chain_id=31337, task_manager="0x" + "12" * 20, organization="0x" + "34" * 20)
CLAIMANT = Claimant(
    device="panther1", address="0x" + "aa" * 20, recording="0x" + "0b" * 32, task_id=7, attempt=1
)


class Notes:
    """What is kept of the work. `deaf`: number of times that no witness knows of it; `blind`: motion capture
    fell silent."""

    def __init__(self, interrupts: Interrupts) -> None:
        self._interrupts = interrupts
        self.claimant = CLAIMANT
        self.notes: list[dict[str, Any]] = []
        self.awaited: list[str] = []
        self.pictures: list[str] = []
        self.places: dict[str, tuple[float, float]] = {}
        self.deaf = 0
        self.motion_s: list[tuple[float, float]] = []
        """From when on motion capture was waited for, and how long."""
        self.blind = False

    def note(self, payload: dict[str, Any]) -> None:
        self.notes.append(payload)

    def picture(self, of: str, cdr: bytes) -> None:
        self.pictures.append(of)

    def await_witness(self, item: str) -> None:
        self._interrupts.check()
        self.awaited.append(item)
        if self.deaf:
            self.deaf -= 1
            raise NoAnswer("motion capture does not list this recording", item=item)

    def await_motion(self, after_s: float, latest_s: float) -> bool:
        self._interrupts.check()
        self.motion_s.append((after_s, latest_s))
        return not self.blind


class AnsweringBin:
    """A bin that classifies at once. `silent`: number of times it says nothing; `unsure`: that it knows
    nothing; `wondering`: that it asks for another angle; `mistaken`: that it takes the robot for another;
    `full`: the compartments that take no more; `thefts`: number of drops after which something is taken out.
    """

    def __init__(self, clock: ManualClock, compartment: str, interrupts: Interrupts) -> None:
        self._interrupts = interrupts
        self._clock = clock
        self._compartment = compartment
        self._number = 0
        self.silent = 0
        self.unsure = 0
        self.wondering = 0
        self.mistaken = 0
        self.thefts = 0
        self.full: set[str] = set()
        self.shown = 0
        self.presented: list[Claimant] = []
        self.grasps_s: list[float] = []
        """What the robot said at each showing of when it took hold of the item."""
        self.combining: list[float] = []
        """Times of earlier pictures that the next classifications name, one in each."""
        self.disposals = True
        self.on_wait: Callable[[type], None] = lambda kind: None

    def present(self, claimant: Claimant, grasped_s: float) -> None:
        self.presented.append(claimant)
        self.grasps_s.append(grasped_s)

    def removed(self, drop: Drop) -> Removal | None:
        if not self.thefts:
            return None
        self.thefts -= 1
        payload = payload_of(
            Removal, 9, BIN, compartment=drop.compartment, weight_n=0.2, settled_s=drop.settled_s + 3
        )
        return Removal.model_validate(payload)

    def wait_for(self, kind: type[Kind], after_s: float, timeout_wall_s: float) -> Kind:
        self._interrupts.check()
        self.on_wait(kind)
        if kind is Classification and self.silent:
            self.silent -= 1
            raise NoAnswer("the bin sent no classification", timeout_s=timeout_wall_s)
        if kind is Drop and not self.disposals:
            raise NoAnswer("the bin sent no drop", timeout_s=timeout_wall_s)
        self._number += 1
        now_s = self._clock.now_s()
        assert now_s > after_s
        more: dict[str, Any] = {"compartment": self._compartment, "number": self._number}
        if kind is Classification:
            self.shown += 1
            if self.shown <= self.unsure:
                more |= {"class": "unknown", "compartment": "grey"}
            more["another_angle"] = self.shown <= self.wondering
            more["full"] = more["compartment"] in self.full
            named = CLAIMANT.model_copy(update={"task_id": 99}) if self.mistaken else CLAIMANT
            more |= {"claimants": [named.model_dump()], "shown_s": now_s}
            if self.combining:
                more["earlier"] = [{"image_sha256": "0x" + "ee" * 32, "taken_s": self.combining.pop(0)}]
            self.mistaken = max(self.mistaken - 1, 0)
        else:
            more["settled_s"] = now_s
        return kind.model_validate(payload_of(kind, self._number, BIN, **more))


BIN = Account.create()
"""The bin's device, as the organization registered it."""


class BinBus:
    """A bus with a bin on it that answers with what it said last, and a bridge that knows its device.

    `away`: how many questions the bin leaves unanswered; `on_ask` is called before each. What is in
    `answers` is answered or raised first. What is published is in `published`.
    """

    def __init__(self) -> None:
        self.devices: list[dict[str, Any]] = [device(BIN.address)]
        self.bridge = True
        self.away = 0
        self.on_ask: Callable[[], None] = lambda: None
        self.answers: list[dict[str, Any] | RodeoError] = []
        self.said: list[dict[str, Any]] = []
        self.published: list[Attestation] = []
        self._hear: Callable[[str, bytes], None] = lambda _key, _payload: None

    def say(self, model: type[Word], time_s: float, key: Any = BIN, **more: Any) -> dict[str, Any]:
        """The bin's next statement, which nobody hears live."""
        attestation = attest(
            payload_of(model, len(self.said) + 1, key, time_s=time_s, about_s=time_s, **more), key
        )
        self.said.append(attestation.model_dump())
        return self.said[-1]

    def tell(self, attestation: dict[str, Any], device: str = "itrash") -> None:
        """Live, on the key of `device`."""
        self._hear(f"rodeo/lab/witness/{device}/statement", json.dumps(attestation).encode())

    def subscribe_bytes(self, key: str, callback: Any, *, inline: bool = False) -> Any:
        self._hear = callback
        return _Endpoint()

    def query(
        self, key: str, parameters: dict[str, Any] | None = None, *, timeout_s: float
    ) -> dict[str, Any]:
        if key.endswith("/devices"):
            if not self.bridge:
                raise NoResponder("no process serves this key", key=key)
            return {"devices": self.devices}
        self.on_ask()
        if self.away:
            self.away -= 1
            raise NoResponder("no process serves this key", key=key)
        if self.answers:
            answer = self.answers.pop(0)
            if isinstance(answer, RodeoError):
                raise answer
            return answer
        kinds = {"bin.classification": "classification", "bin.drop": "disposal"}
        return {kinds[a["payload"]["type"]]: a for a in self.said if a["payload"]["type"] in kinds}

    def query_all(
        self, key: str, *, parameters: dict[str, Any], timeout_s: float, most: int
    ) -> list[dict[str, Any]]:
        if self.away:
            return []
        return [{"statements": [one for one in self.said if one["payload"]["seq"] > parameters["after"]]}]


class _Endpoint:
    def undeclare(self) -> None:
        pass


class Voice:
    """The robot's own witness: signs into `folder`, publishes on `bus`."""

    def __init__(self, folder: Path, bus: BinBus) -> None:
        self._bus = bus
        self.account = Account.create()
        journal = Journal(folder / "statements.jsonl")
        self.chain: WitnessChain | None = WitnessChain(
            "panther1", self.account, SCOPE, "closed_bus", journal, HeadBook()
        )

    def publish(self, attestation: Attestation) -> None:
        self._bus.published.append(attestation)


def device(address: str, role: str = "bin", revoked: float | None = None) -> dict[str, Any]:
    """As the bridge tells of it."""
    return {"address": address, "role": role, "name": "itrash", "owner": "0x" + "ee" * 20, "revoked": revoked}


def payload_of(model: type[Word], seq: int, key: Any, **more: Any) -> dict[str, Any]:
    """What the bin signs, or whoever has `key`; `about_s` is when what it speaks of was over."""
    about_s = more.pop("about_s", 1_000.0)
    digest = "0x" + "cd" * 32
    own: dict[type[Word], dict[str, Any]] = {
        Classification: {
            "number": seq,
            "class": "metal",
            "probabilities": {"metal": 1.0},
            "full": False,
            "image_sha256": digest,
            "model_sha256": digest,
            "thresholds_sha256": digest,
            "claimants": [CLAIMANT.model_dump()],
            "shown_s": about_s,
        },
        Drop: {
            "number": seq,
            "classification": None,
            "expected_compartment": "yellow",
            "weight_n": 0.2,
            "after_s": about_s - 1,
            "settled_s": about_s,
            "correct": True,
            "claimants": [],
        },
        Removal: {"weight_n": 0.2, "after_s": about_s - 1, "settled_s": about_s},
    }
    head = {"device": "itrash", "seq": seq, "previous": None if seq == 1 else digest, "inputs": "closed_bus"}
    fields = SCOPE.model_dump() | head | {"compartment": "yellow", "time_s": about_s} | own[model] | more
    return model.model_validate(fields).model_dump(mode="json")
