"""Where things of the site are in the map frame: pure geometry for agent, simulator and oracle."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from rodeo.lab.config import BinConfig, DockConfig, FurnitureConfig, Pose2
from rodeo.lab.geometry import Rectangle, ahead, facing, seen_from, wrap

BUMPER_M = 0.4025
"""From the robot's centre to its front: the front wheels reach as far as the bumper."""
HALF_WIDTH_M = 0.425
FOOTPRINT_RADIUS_M = math.hypot(BUMPER_M, HALF_WIDTH_M)
"""The robot can turn on the spot where nothing is closer than this."""
ITEM_RADIUS_M = 0.05
"""How far a piece of trash may reach from its centre."""
SHOULDER_M = 0.283
"""From the robot's centre forward to the arm's shoulder axis."""

PARKING_GAP_M = 0.06
"""Between the bumper and the bin while the arm works over it."""
CONTACT_GAP_M = 0.02
"""Between the bumper and the dock's face: its contacts are sprung."""
PICK_DISTANCE_M = 0.67
"""From the robot's centre forward to an item that it takes from the floor."""

BUCKET_GAP_M = 0.002
"""Between the walls of neighbouring compartments: each stands on a scale of its own."""

_DOCK_HALF_M = 0.085, 0.25
"""Half of the dock's box, which stands behind its pose (rodeo.lab.world)."""

Vec3 = tuple[float, float, float]


def footprint(robot: Pose2) -> Rectangle:
    """The floor that a robot at this pose covers."""
    return Rectangle(robot, BUMPER_M, HALF_WIDTH_M)


def furniture_floor(one: FurnitureConfig) -> Rectangle:
    """The floor that a piece of furniture covers."""
    return Rectangle(one.pose, one.size_m[0] / 2, one.size_m[1] / 2)


def dock_floor(dock: DockConfig) -> Rectangle:
    """The floor that a dock covers."""
    x_m, y_m = ahead(dock.pose, -_DOCK_HALF_M[0])
    return Rectangle(Pose2(x_m=x_m, y_m=y_m, yaw_rad=dock.pose.yaw_rad), *_DOCK_HALF_M)


@dataclass(frozen=True)
class BinLayout:
    """The bin's points in the map frame."""

    config: BinConfig

    @property
    def depth_m(self) -> float:
        return self.config.compartment_size_m[0] + 2 * self.config.wall_thickness_m

    @property
    def width_m(self) -> float:
        return len(self.config.compartments) * self._pitch_m - BUCKET_GAP_M

    @property
    def floor(self) -> Rectangle:
        """The floor that the compartments cover: all but the camera's post."""
        return Rectangle(self.config.pose, self.depth_m / 2, self.width_m / 2)

    @property
    def _pitch_m(self) -> float:
        return self.config.compartment_size_m[1] + 2 * self.config.wall_thickness_m + BUCKET_GAP_M

    def offset_m(self, compartment: str) -> float:
        """The compartment's centre on the bin's y axis."""
        names = list(self.config.compartments)
        return ((len(names) - 1) / 2 - names.index(compartment)) * self._pitch_m

    def compartment(self, name: str) -> Vec3:
        """Centre of the compartment's opening, at the height of the rim."""
        return (*ahead(self.config.pose, 0.0, self.offset_m(name)), self.config.rim_height_m)

    def contains(self, name: str, point_m: Vec3) -> bool:
        """Whether the point is inside the compartment, below the rim."""
        along, across = seen_from(self.config.pose, *point_m[:2])
        half_x, half_y = (size / 2 for size in self.config.compartment_size_m)
        return (
            abs(along) <= half_x
            and abs(across - self.offset_m(name)) <= half_y
            and 0 <= point_m[2] <= self.config.rim_height_m
        )

    def compartment_at(self, point_m: Iterable[float]) -> str | None:
        """The compartment that the point (3,) is in."""
        x_m, y_m, z_m = map(float, point_m)
        return next((name for name in self.config.compartments if self.contains(name, (x_m, y_m, z_m))), None)

    @property
    def camera(self) -> Vec3:
        return (*ahead(self.config.pose, -self.config.show_distance_m), self.config.camera_height_m)

    @property
    def show_point(self) -> Vec3:
        """Where an item is held to be seen by the camera, and the presence sensor's beam passes."""
        return (self.config.pose.x_m, self.config.pose.y_m, self.config.camera_height_m)

    @property
    def parking(self) -> Pose2:
        """Where the robot stands to reach every compartment and the show point."""
        return facing(self.config.pose, self.depth_m / 2 + PARKING_GAP_M + BUMPER_M)


def dock_parking(dock: DockConfig) -> Pose2:
    """Where the robot stands to charge."""
    return facing(dock.pose, CONTACT_GAP_M + BUMPER_M)


def on_contacts(dock: DockConfig, robot: Pose2) -> bool:
    """Whether a robot at this pose touches the dock's contacts."""
    turn = wrap(robot.yaw_rad - dock.pose.yaw_rad - math.pi)
    contacts = Rectangle(dock.pose, dock.contact_tolerance_m, dock.contact_tolerance_m)
    return contacts.contains(*ahead(robot, BUMPER_M)) and abs(turn) <= dock.contact_tolerance_rad
