"""The lab without the simulator (tests/reallab) as a running site: its world, its bin, the site's processes.

The world gets no site file, but what a person would have measured: where the bin's compartments, its camera
and the items are, in a file of JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from deploy.certificates import ensure_certificates
from rodeo.bus.messages import DaoEvent, Status
from rodeo.bus.session import DaoEvents
from rodeo.errors import BusError
from rodeo.host.instance import PARENT_VARIABLE
from rodeo.lab.config import gripper_body
from rodeo.lab.items import shape_of
from rodeo.lab.layout import BinLayout, dock_parking
from rodeo.lab.world import arm_model, robot_model
from rodeo.site import tls, topics
from rodeo.site.config import Site
from rodeo.site.names import robot_process
from rodeo.site.processes import processes_of
from rodeo.site.topics import BODY
from rodeo_testing.waiting import HANG_S, wait_until
from services.charger.modbus import MAPS
from services.robot_sim.camera import RENDERINGS
from services.robot_sim.urdf import to_urdf
from tests.support.site import RunningSite, free_port

ROOT = Path(__file__).parents[2]
REALLAB = ROOT / "deploy" / "sites" / "reallab.toml"
PROGRAMS = ROOT / "tests" / "reallab"
_PATHS = (ROOT, PROGRAMS, ROOT / "tests" / "foreign_robot", ROOT / "examples")
PORTS = ("natnet", "meter", "cells", "camera", "robot", "relay")
FINE = ("resolution_wh = 10.0", "resolution_wh = 0.1")
"""The register of an SDM120 moves in steps that confirm no charge of so small a battery."""
CHARGED = 0.7
"""State of charge with which a case begins: the robot buys no charge by itself."""
SPEAKERS = ("oracle", "charger", "mocap", "itrash")
RELAY = "relay"
CABLES = ("meter", "cells", "camera")
"""Devices on TCP whose cables can be pulled. The robot's is between it and the router."""


def write_reallab(folder: Path, ports: dict[str, int], extra: str = "") -> Path:
    """The site of `deploy/sites/reallab.toml`, its devices on these ports of loopback."""
    path, meter = folder / "site.toml", folder / "meter.toml"
    meter.write_text((MAPS / "sdm120.toml").read_text().replace(*FINE))
    path.write_text(
        f"""extends = {json.dumps(str(REALLAB))}
data_dir = {json.dumps(str(folder / "data"))}
chain.url = "http://127.0.0.1:{free_port()}"
console.port = {free_port()}
bus.router = "tls/127.0.0.1:{free_port()}"
mocap.settings = {{ local = "127.0.0.1", command_port = {ports["natnet"]} }}
{extra}
[[docks]]
name = "dock1"
pose = {{ x_m = 3.8, y_m = 4.8, yaw_rad = -1.5708 }}
meter = {{ source = "modbus", address = "tcp://127.0.0.1:{ports["meter"]}", model = "meter.toml" }}

[[robots]]
name = "arthur"
body = "ros2"
pose = {{ x_m = 3.6, y_m = 2.6 }}
battery = {{ capacity_wh = 30, capacity_ah = 0.82, soc = 0.72 }}

[[robots]]
name = "berta"
body = "ros2"
pose = {{ x_m = 6.0, y_m = 1.0, yaw_rad = 1.57 }}
"""
    )
    return path


def measured(site: Site, ports: dict[str, int], urdf: Path) -> dict[str, Any]:
    """What a person would have measured for the world."""
    bin_, dock = BinLayout(site.bins[0]), site.docks[0]
    config, parking = bin_.config, dock_parking(dock)
    half_m = [size / 2 for size in config.compartment_size_m]
    items = {}
    for item in site.items:
        half_x, _, half_z = shape_of(item).half_m
        items[item.id] = {
            "x_m": item.pose.x_m, "y_m": item.pose.y_m, "yaw_rad": item.pose.yaw_rad,
            "radius_m": half_x, "half_height_m": half_z, "mass_kg": item.mass_kg,
            "picture": str(RENDERINGS / f"{item.item_class}_{item.shape}.jpg"),
        }  # fmt: skip
    return {
        "ports": ports,
        "nothing": str(RENDERINGS / "empty.jpg"),
        "items": items,
        "bin": {
            "yaw_rad": config.pose.yaw_rad,
            "camera_m": bin_.camera,
            "show_m": bin_.show_point,
            "compartments": {
                name: dict(zip(("x_m", "y_m", "rim_m"), bin_.compartment(name), strict=True))
                | {"half_m": half_m}
                for name in config.compartments
            },
        },
        "parking": [(one.x_m, one.y_m) for one in (parking, bin_.parking)],
        "dock": {
            "x_m": parking.x_m,
            "y_m": parking.y_m,
            "yaw_rad": parking.yaw_rad,
            "near_m": dock.contact_tolerance_m,
            "near_rad": dock.contact_tolerance_rad,
            "voltage_v": dock.voltage_v,
            "current_a": dock.current_a,
        },
        "robots": [
            {
                "name": robot.name,
                "namespace": robot.namespace,
                "urdf": str(urdf),
                "hand": {"body": gripper_body(robot.name), "link": arm_model(robot.kinematics).hand},
                "pose": [robot.pose.x_m, robot.pose.y_m, robot.pose.yaw_rad],
                "battery": {
                    "capacity_ah": robot.battery.capacity_ah,
                    "resistance_ohm": robot.battery.resistance_ohm,
                    "idle_w": robot.battery.idle_power_w,
                    "soc": robot.battery.soc,
                },
                "bridge": relay(ports) if robot.name != site.robots[0].name else None,
            }
            for robot in site.robots
        ],
    }


def relay(ports: dict[str, int]) -> str:
    """Where the second robot's bridge connects."""
    return f"tcp/127.0.0.1:{ports['relay']}"


def _ends(event: DaoEvent) -> bool:
    """Whether its task is over: a ruling that pays nobody stands for as long as it may be challenged."""
    if event.name == "Ruled":
        return bool(event.args["ruling"] != "accepted")
    return event.name in ("TaskSettled", "TaskRequeued", "TaskFailed")


def _port(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


class RealLab:
    """A running lab. Use as a context manager."""

    def __init__(self, folder: Path, extra: str = "") -> None:
        self.ports = {name: free_port() for name in PORTS}
        self.running = RunningSite(write_reallab(folder, self.ports, extra))
        self.site = self.running.site
        urdf = folder / "robot.urdf"
        urdf.write_text(to_urdf(robot_model(), "robot"))
        self._world_file = folder / "world.json"
        inside = {name: free_port() for name in CABLES} | {"robot": _port(self.site.bus.router)}
        told = measured(self.site, self.ports, urdf) | {"inside": inside}
        self._world_file.write_text(json.dumps(told))
        self._orders = 0
        self._written: dict[str, int] = {}
        """Process -> length of its log when the lab was tidy."""
        self._logs = self.site.data_dir / "logs"
        self._logs.mkdir(parents=True, exist_ok=True)
        self._world: subprocess.Popen[bytes] | None = None
        self.events: list[DaoEvent] = []
        self._posted: set[int | None] = set()
        self._changed = threading.Condition()
        self._heard: DaoEvents | None = None

    @property
    def robots(self) -> tuple[str, str]:
        """The robot that runs rmw_zenoh, and the one with a stock DDS behind a relay."""
        first, second = self.site.robots
        return first.name, second.name

    @property
    def agents(self) -> tuple[str, str]:
        """The processes that are their minds."""
        first, second = self.robots
        return robot_process(self.site, first), robot_process(self.site, second)

    def __enter__(self) -> Self:
        ensure_certificates(self.site)
        try:
            self.running.start("router")
            self._start_relay()
            self.running.start_founded("bridge", ready=False)
            self._start_world()
            self._start_bin()
            others = [one.name for one in processes_of(self.site)]
            left = [one for one in others if one not in self.running.children]
            self.running.start(*left, ready=False)
            self.running.wait_ready(*others)
            self._heard = DaoEvents(self.running.bus, self.site.org, self._on_event)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._heard is not None:
            self._heard.close()
        if self._world is not None:
            self._world.kill()
            self._world.wait()
        self.running.stop()

    def _environment(self, **more: str) -> dict[str, str]:
        return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, _PATHS)), **more}

    def _program(self, name: str, *words: str, log: str, env: dict[str, str]) -> subprocess.Popen[bytes]:
        with (self._logs / f"{log}.log").open("ab") as output:
            return subprocess.Popen(
                [sys.executable, str(PROGRAMS / name), *words],
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=env,
            )

    def _start_relay(self) -> None:
        """Start the relay on the second robot's computer, where the robot's bridge finds it."""
        words = [
            "ros2",
            "relay",
            self.robots[1],
            "--listen",
            relay(self.ports),
            "--site",
            str(self.running.path),
        ]
        with (self._logs / f"{RELAY}.log").open("ab") as output:
            self.running.children[RELAY] = subprocess.Popen(
                [sys.executable, "-m", "rodeo_cli", *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def _start_world(self) -> None:
        shown = tls.identity(self.site, f"{BODY}.{self.robots[0]}")
        assert shown is not None
        settings = {
            "mode": "client",
            "connect/endpoints": [f"tls/127.0.0.1:{self.ports['robot']}"],
            **{f"transport/link/tls/{key}": value for key, value in shown.zenoh().items()},
        }
        override = ";".join(f"{key}={json.dumps(value)}" for key, value in settings.items())
        env = self._environment(ZENOH_CONFIG_OVERRIDE=override)
        env.pop(PARENT_VARIABLE, None)
        wait_until(lambda: "are carried" in self.log(RELAY), lambda: self.log(RELAY))
        self._world = self._program("world.py", str(self._world_file), log="world", env=env)
        wait_until(lambda: "the lab is there" in self.log("world"), lambda: self.log("world"))

    def _start_bin(self, **more: str) -> None:
        env = self._environment(
            **more,
            LAB_CELLS=str(self.ports["cells"]),
            LAB_CAMERA=f"http://127.0.0.1:{self.ports['camera']}/",
            **{PARENT_VARIABLE: str(os.getpid())},
        )
        name = self.site.bins[0].name
        program = self._program("lab_bin.py", "--site", str(self.running.path), log=name, env=env)
        self.running.children[name] = program

    @property
    def pids(self) -> list[int]:
        """Its processes now, each of which has a session of its own."""
        world = [] if self._world is None else [self._world]
        return [one.pid for one in (*world, *self.running.children.values())]

    def log(self, name: str) -> str:
        return self.running.log(name)

    @contextmanager
    def clock_ahead(self, process: str, ahead_s: float) -> Iterator[None]:
        """The computer of a process has another time; it is started again for that."""
        late = {"LAB_CLOCK_AHEAD_S": str(ahead_s)}
        self._restart(process, late)
        try:
            yield
        finally:
            self._restart(process, {})
            self.running.wait_ready(process)

    def _restart(self, name: str, more: dict[str, str]) -> None:
        self.running.kill(name)
        path = os.pathsep.join([str(PROGRAMS / "late")] * bool(more) + [str(one) for one in _PATHS])
        if name == self.site.bins[0].name:
            self._start_bin(**more, PYTHONPATH=path)
            return
        entry = next(one for one in processes_of(self.site) if one.name == name)
        with (self._logs / f"{name}.log").open("ab") as output:
            self.running.children[name] = subprocess.Popen(
                [sys.executable, "-m", entry.module, "--site", str(self.running.path), *entry.arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, **more, "PYTHONPATH": path, PARENT_VARIABLE: str(os.getpid())},
            )

    # -- what people do ------------------------------------------------------------------------------------

    def order(self, device: str, what: str = "", value: Any = None) -> None:
        """Set something of a device of the world, or have an item laid back to its place."""
        assert self._world is not None and self._world.stdin is not None
        self._orders += 1
        number = self._orders
        order = {"number": number, "device": device, "what": what, "value": value}
        self._world.stdin.write(json.dumps(order).encode() + b"\n")
        self._world.stdin.flush()
        wait_until(lambda: f"done: {number};" in self.log("world"), lambda: self.log("world"))

    def clean(self, item_id: str) -> int:
        """Post the task to clean an item away; its number."""
        pose = next(one.pose for one in self.site.items if one.id == item_id)
        params = {"item_id": item_id, "x_m": pose.x_m, "y_m": pose.y_m}
        request = {"kind": "waste_disposal", "reward_iec": "100", "params": params, "max_attempts": 1}
        key = topics.COMMAND.name(org=self.site.org, participant="organization", command="register_task")
        task_id = int(self.running.bus.query(key, request, timeout_s=HANG_S)["task_id"])
        self._posted.add(task_id)
        return task_id

    def charge(self) -> int:
        """Order the first robot to the dock; the number of the charge that it buys."""
        posted = self._posted | {one.task_id for one in self.events}
        self.tell(self.robots[0], "charge")

        def bought() -> int | None:
            return next((one.task_id for one in self.events if one.task_id not in posted), None)

        with self._changed:
            task_id = self._changed.wait_for(bought, HANG_S)
        assert task_id is not None, self.log(self.agents[0])
        return task_id

    def tell(self, robot: str, order: str) -> None:
        """Give an order to a robot, as `rodeo robot` does."""
        key = topics.ROBOT_ORDER.name(org=self.site.org, robot=robot, order=order)
        self.running.bus.query(key, timeout_s=HANG_S)

    def stand_by(self) -> None:
        """Let the second robot take no work."""
        self.tell(self.robots[1], "pause")
        assert self.sees(self.agents[1], lambda status: "paused" in status.activity, HANG_S)

    def join(self) -> None:
        """Let the second robot work again; returns when it has offered its work."""
        self.tell(self.robots[1], "resume")
        assert self.sees(self.agents[1], lambda status: "idle" in status.activity, HANG_S)

    def send_away(self) -> None:
        """Let the second robot stand by, and switch its computers off."""
        self.stand_by()
        self.running.kill(self.agents[1])
        self.running.kill(RELAY)
        self.order("second", "is_on", False)

    def tidy(self) -> None:
        """Put the items back, and leave the battery room for a short charge, while the robot has nothing to
        do."""
        assert self.sees(self.agents[0], lambda status: status.ready and "idle" in status.activity, HANG_S)
        for item in self.site.items:
            self.order(item.id)
        self.order("power", "soc", CHARGED)
        self._written = {name: len(self._text(name)) for name in (self.agents[0], *SPEAKERS)}

    def sees(self, process: str, holds: Callable[[Status], bool], limit_s: float) -> bool:
        """Whether this holds for a status of the process within the time: that of now, or one that it
        publishes."""
        key, seen = topics.STATUS.name(org=self.site.org, process=process), threading.Event()

        def look(_key: str, data: dict[str, Any]) -> None:
            if holds(Status.model_validate(data)):
                seen.set()

        subscriber = self.running.bus.subscribe_json(key, look)
        try:
            with suppress(BusError):  # it does not answer yet, or no more
                look(key, self.running.bus.query(key))
            return seen.wait(limit_s)
        finally:
            subscriber.undeclare()

    def said(self, task_id: int) -> str:
        """Why a task was not paid: the judge's reason, and what processes have warned of since `tidy`."""
        lines = (
            line for name, size in self._written.items() for line in self._text(name)[size:].splitlines()
        )
        warned = [line for line in lines if " WARNING " in line or " ERROR " in line]
        return "\n".join([str(self.task(task_id)["reason"] or ""), *warned])

    def _text(self, name: str) -> str:
        return (self._logs / f"{name}.log").read_text(errors="replace")

    def task(self, task_id: int) -> dict[str, Any]:
        return self.running.bus.query(topics.STATE.name(org=self.site.org, what=f"task/{task_id}"))

    def _on_event(self, event: DaoEvent) -> None:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def ended(self, task_id: int, limit_s: float = HANG_S) -> DaoEvent | None:
        """The event with which the task ended; None if none comes in time."""

        def found() -> DaoEvent | None:
            return next((one for one in self.events if one.task_id == task_id and _ends(one)), None)

        with self._changed:
            self._changed.wait_for(found, limit_s)
            return found()

    def paid(self, task_id: int) -> dict[str, Any]:
        """The task once it is paid, at its first attempt."""
        ended, settled = self.ended(task_id), self.task(task_id)
        right = (
            ended is not None
            and ended.name == "TaskSettled"
            and (settled["verdict"], settled["attempt"]) == ("accepted", 1)
        )
        assert right, self.story(task_id)
        return settled

    def story(self, task_id: int) -> str:
        """What a person would read of a task that did not end as it should."""
        told = [(one.name, one.task_id) for one in self.events]
        names = (*self.agents, *SPEAKERS, RELAY, "world")
        logs = (f"{name}:\n{self.log(name)}" for name in names)
        return "\n".join([str(told), str(self.task(task_id)), *logs])


def work(lab: RealLab) -> Iterator[dict[str, Any]]:
    """Two cleanings and a charge: each task once it is paid. The second robot begins when the first has left
    the bin to it, and cleans while the first is charged."""
    far, near = lab.site.items
    lab.stand_by()
    first = lab.clean(near.id)
    assert lab.sees(lab.agents[0], lambda status: "stays in the bin" in status.activity, HANG_S), lab.story(
        first
    )
    lab.join()
    second = lab.clean(far.id)
    yield lab.paid(first)
    charge = lab.charge()
    yield lab.paid(second)
    yield lab.paid(charge)


def run(folder: Path) -> None:
    """`make lab`: start it, have two items cleaned away and a robot charged, and say what came of it."""
    begun_s = time.monotonic()
    with RealLab(folder) as lab:
        names = ", ".join(sorted(one.name for one in processes_of(lab.site)))
        print(f"The lab runs after {time.monotonic() - begun_s:.0f} s: {names}", flush=True)
        for task in work(lab):
            done = f"{task['executor_name']} is paid for {task['kind']} of task {task['id']}"
            print(f"{done} after {time.monotonic() - begun_s:.0f} s", flush=True)
