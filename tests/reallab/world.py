"""The lab: one process that stands for its devices, and speaks nothing but their protocols.

    motion capture         NatNet 4.1, or 3.0, by UDP
    meter and contactor    Modbus TCP
    load cells             Modbus TCP
    camera                 MJPEG over HTTP
    first robot            ROS 2 by rmw_zenoh, see tests/foreign_robot
    second robot           the same with a stock DDS: the plain keys of zenoh-bridge-ros2dds

python tests/reallab/world.py WORLD.json; the file is described in tests/support/reallab.py. Lines of JSON on
its input unplug devices, or make them lie.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import queue
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from actions import ABORTED
from cable import Cable
from cells import Cells
from interfaces import PARTS, Network
from motive import Motive
from power import Battery, Power
from robot import IN_AND_OUT_M, Robot
from stock_dds import StockDds
from things import Things
from video import Video

from rodeo_testing.modbus import Panel

TURN_S = 0.02
APART_M = 1.0
"""Distance from another robot, middle to middle: nearer to it, a robot drives to no place."""
GOAL_OCCUPIED = 206
"""nav2_msgs/action/ComputePathToPose."""
NEAR_M = 0.3
"""So near to where it parks something is ahead of it."""
FASTEST_M_S, FASTEST_RAD_S = 0.7, 0.9
"""As the robot's owner allows it indoors: its work takes wall time."""


class LabRobot(Robot):
    """A robot in this world, by the machine's clock.

    Args:
        told: what is known of it.
        things: what it can take.
        parking: places which it drives into and out of straight.
    """

    def __init__(
        self, told: dict[str, Any], things: Things, parking: list[tuple[float, float]], battery: Battery
    ) -> None:
        self._things, self._parking, self._battery = things, parking, battery
        name, item = next(iter(things.items.items()))
        arguments = argparse.Namespace(
            namespace=told["namespace"],
            body=told["name"],
            urdf=told["urdf"],
            pose=told["pose"],
            item=name,
            item_radius=item["radius_m"],
            item_half_height=item["half_height_m"],
        )
        bridge = told["bridge"]
        super().__init__(arguments, Network(0) if bridge is None else StockDds(bridge, PARTS))
        self.name, self.capacity_ah = told["name"], told["battery"]["capacity_ah"]
        self.is_on = True
        """Whether its computer is on."""
        self.others: list[LabRobot] = []
        self._hand = told["hand"]
        self.base.fastest_m_s, self.base.fastest_rad_s = FASTEST_M_S, FASTEST_RAD_S
        self._drawn_s = time.monotonic()
        self._place()

    def _join_lab(self) -> None:
        """There is nobody who would have to be told."""

    def turn(self, now_s: float) -> None:
        while not self._inbox.empty():
            kind, goal = self._inbox.get()
            if kind != "drive":
                self._begin(kind, goal)
            elif self._is_free(goal.request.pose.pose.position):
                self._prepare(goal.request.pose.pose.position)
                self._begin(kind, goal)
            else:
                goal.end(ABORTED, error_code=GOAL_OCCUPIED)
        self.live_until(now_s)

    def _is_free(self, goal: Any) -> bool:
        """Whether no other robot stands there."""
        return all(math.dist((one.base.x_m, one.base.y_m), (goal.x, goal.y)) > APART_M for one in self.others)

    def _prepare(self, goal: Any) -> None:
        """Drive straight into and out of bin and dock alone: elsewhere something may be behind it."""
        self.base.parked = self._parks(self.base.x_m, self.base.y_m)
        self.base.straight_m = IN_AND_OUT_M if self._parks(goal.x, goal.y) else 0.0

    def _parks(self, x_m: float, y_m: float) -> bool:
        return any(math.dist((x_m, y_m), place) < NEAR_M for place in self._parking)

    def _tell_the_lab(self) -> None:
        if self._let_go is not None:
            self._things.let_go(self._item_name, *self._let_go)
            self._let_go = None
        elif self._in_hand is not None:
            self._things.carry(self._item_name, *self._carried())

    def look(self) -> None:
        """See what lies before it, once the things are where they are now."""
        if self._in_hand is not None:
            return
        things, (grasp, _) = self._things, self._in_map("grasp")
        name = things.nearest_item(float(grasp[0]), float(grasp[1]))
        item = things.items[name]
        self._item_name, self._item = name, things.pose(name)
        self._radius_m, self._half_height_m = item["radius_m"], item["half_height_m"]

    def draw(self) -> None:
        """Take from the battery what this turn takes, and read its gauge."""
        base, battery = self.base, self._battery
        works = bool(base.legs) or self._trajectory is not None or self._grip is not None
        now_s = time.monotonic()
        battery.flow(now_s - self._drawn_s, (base.x_m, base.y_m, base.yaw_rad), works)
        self._drawn_s = now_s
        self.voltage_v, self.current_a, self.soc = battery.voltage_v, battery.current_a, battery.soc

    def poses(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Where the markers on its base and on its gripper are."""
        half = self.base.yaw_rad / 2
        base = (
            np.array([self.base.x_m, self.base.y_m, 0.0]),
            np.array([math.cos(half), 0.0, 0.0, math.sin(half)]),
        )
        place_m, turn = self._in_map(self._hand["link"])
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(turn).ravel())
        return {self.name: base, self._hand["body"]: (place_m, quaternion)}


class World:
    """All devices, and what a person does with them: see `orders`."""

    def __init__(self, told: dict[str, Any]) -> None:
        self._told = told
        self.orders: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        """`device`, and `what` of it to set to which `value`; or an item that is to be laid back."""
        self.things = Things(told)
        outside, inside = told["ports"], told["inside"]
        for name in inside:
            setattr(self, f"{name}_cable", Cable(outside[name], inside[name]))
        self.panel = Panel(inside["meter"])
        batteries = [one["battery"] for one in told["robots"]]
        self.power = Power(batteries[0], told["dock"], self.panel)
        powered = [self.power, *map(Battery, batteries[1:])]
        self._robots = [
            LabRobot(one, self.things, told["parking"], battery)
            for one, battery in zip(told["robots"], powered, strict=True)
        ]
        for robot in self._robots:
            robot.others = [one for one in self._robots if one is not robot]
        self.robot, self.second = self._robots
        self._poses: dict[str, Any] = {}
        self._weights_n: list[float] = []
        self._range_m = math.inf
        self._shown: str | None = None
        self._look()
        self.motive = Motive(outside["natnet"], list(self._poses), lambda: self._poses)
        self.cells = Cells(inside["cells"], lambda: [self._range_m, *self._weights_n])
        self.video = Video(inside["camera"], self._picture)

    def _turn(self) -> None:
        for robot in self._robots:
            if robot.is_on:
                robot.turn(time.time())
        self.things.pass_until(time.time())
        while not self.orders.empty():
            self._obey(self.orders.get())
        self._look()

    def _look(self) -> None:
        """What the sensors see: replaced as a whole, for the threads that serve it."""
        things = self.things
        poses = {name: things.pose(name) for name in things.items}
        for robot in self._robots:
            robot.look()
            robot.draw()
            poses |= robot.poses()
        self._poses = poses
        self._weights_n = list(things.weights_n().values())
        self._range_m, self._shown = things.nearest_m(), things.shown()

    def _picture(self) -> bytes:
        shown = self._shown
        told = self._told["nothing"] if shown is None else self._told["items"][shown]["picture"]
        return Path(told).read_bytes()

    def _obey(self, order: dict[str, Any]) -> None:
        if (item := order["device"]) in self.things.items:
            self.things.lay(item)
        else:
            device = getattr(self, order["device"])
            assert hasattr(device, order["what"]), order
            setattr(device, order["what"], order["value"])
        # Other threads print, too: the end of a line may come after theirs.
        print(f"done: {order['number']};", flush=True)

    def listen(self) -> None:
        for line in sys.stdin:
            self.orders.put(json.loads(line))
        # Nobody is there any more.
        os.kill(os.getpid(), signal.SIGTERM)

    def run(self) -> None:
        threading.Thread(target=self.listen, daemon=True).start()
        with self.panel:
            print("the lab is there", flush=True)
            pause = threading.Event()
            while not pause.wait(TURN_S):
                self._turn()


if __name__ == "__main__":
    World(json.loads(Path(sys.argv[1]).read_text())).run()
