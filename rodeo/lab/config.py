"""The site file's description of the physical lab: what stands where, what lies where, what the robot may do.

Frame `map`: origin in the lab's south-west corner on the floor, x east, y north, z up; yaw counter-clockwise
from x. Lengths in m, angles in rad, masses in kg, energies in Wh. Reading this module needs no MuJoCo.
"""

import difflib
import re
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from rodeo.lab.rates import RatesConfig
from rodeo.lab.schedule import Schedule, parse_hours, require_apart, zone
from rodeo.money.pricing import PricingConfig
from rodeo.text import redaction
from rodeo.text.addresses import typed_address
from rodeo.text.pydantic_words import close

Positive = Annotated[float, Field(gt=0)]
Point2 = tuple[float, float]
Rgb = tuple[float, float, float]


class ItemClass(StrEnum):
    """The six waste classes of the TrashNet data set (Thung and Yang, 2016)."""

    CARDBOARD = "cardboard"
    GLASS = "glass"
    METAL = "metal"
    PAPER = "paper"
    PLASTIC = "plastic"
    TRASH = "trash"


SHAPE_NAMES: dict[ItemClass, tuple[str, ...]] = {
    ItemClass.METAL: ("can", "tin"),
    ItemClass.PLASTIC: ("bottle", "cup"),
    ItemClass.CARDBOARD: ("box", "tube"),
    ItemClass.PAPER: ("crumpled", "ball"),
    ItemClass.GLASS: ("jar", "bottle"),
    ItemClass.TRASH: ("carton", "wrapper"),
}
"""Names of the shapes in `rodeo.lab.items.SHAPES`, whose geometry takes long to read."""


_DEVICE_NAME = r"^[a-z][a-z0-9_]*$"
"""A part of ROS names, of Zenoh keys, and of the name of a process."""


class Section(BaseModel):
    """A section of the site file: unknown keys are mistakes, values do not change while running."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Pose2(Section):
    """A pose on the floor in frame `map`."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


class FurnitureConfig(Section):
    """An obstacle on the floor; `pose` is the centre of its footprint, `size_m` its extent."""

    name: str
    kind: Literal["desk", "shelf", "crate", "wall"]
    pose: Pose2
    size_m: tuple[Positive, Positive, Positive]


class LabConfig(Section):
    """A rectangular room from (0, 0) to `size_m` with furniture in it."""

    size_m: tuple[Positive, Positive] = (7.0, 5.0)
    wall_height_m: Positive = 0.5
    wall_thickness_m: Positive = 0.1
    furniture: tuple[FurnitureConfig, ...] = ()
    mocap: bool = Field(True, description="whether motion capture tracks robots and items")
    mass_tolerance: float | None = Field(
        None,
        gt=0,
        description="share by which the weight that the bin feels may be off an item's `mass_kg`; left out, "
        "the weight is only reported",
    )
    mocap_gripper: bool = Field(False, description="whether it tracks the robots' grippers, too")


def gripper_body(robot: str) -> str:
    """Name of the body that motion capture tracks on the gripper of `robot`: what carries the fingers."""
    return f"{robot}/gripper"


class MocapConfig(Section):
    """The source of motion capture's poses, on a site with `lab.mocap`."""

    source: str | None = Field(None, pattern=_DEVICE_NAME)
    """`sim`, or a system of cameras: one of `services.mocap.sources`, or an installed package's. Left out:
    `sim` where the clock is simulated, else nobody."""
    address: str = ""
    """Where the system is; what this says depends on the source."""
    settings: dict[str, Any] = {}
    """Other settings of the source."""
    bodies: dict[str, str] = {}
    """Robot or item -> its name in the system; by default the same."""
    origin: Pose2 = Pose2(x_m=0.0, y_m=0.0)
    """Where the system's origin is in the map, and how its x axis is turned there."""
    latency_s: float = Field(0.0, ge=0, le=1)
    """Time from the exposure to the system's stamp, or to the frame's arrival where it stamps none or by a
    clock of its own. It is subtracted; `rodeo mocap latency` measures it."""


class CameraConfig(Section):
    """Where a bin's pictures come from."""

    source: Literal["bus", "video", "folder"] = "bus"
    """`bus`: whoever publishes what the bin's other sensors measure."""
    address: str = ""
    """`video`: what OpenCV opens, a device number or path ("0", "/dev/video0") or a stream ("rtsp://...");
    `folder`: its path, which starts at the site file that says it; the bus needs none."""

    @model_validator(mode="after")
    def _has_an_address(self) -> "CameraConfig":
        redaction.learn(self.address)
        if (self.source == "bus") != (not self.address):
            raise ValueError(
                "the camera sources video and folder need an address, such as "
                '"/dev/video0" or a folder, and the other sources take none'
            )
        return self


class BinConfig(Section):
    """A smart bin: a row of open-top compartments and a camera on a post behind them.

    `pose` is the centre of the footprint with x pointing from the back (the post) to the front, where the
    robot parks. Compartments stand side by side along the bin's y axis, the first at the largest y.
    """

    name: str = Field("itrash", pattern=_DEVICE_NAME)
    """Name of the bin in the organization, in its topics, and of its keystore with `-device` behind it."""
    pose: Pose2
    http_host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    http_port: int = Field(0, ge=0, le=65535)
    """Port of the bin's page; 0 takes a free port, which the status of its process shows."""
    source: Literal["sim", "ros2"] | None = None
    """Publisher of what its sensors measure: `robot_sim`, or a driver with the certificate `driver.<bin>`.
    Left out: `sim` where the clock is simulated, else nobody."""
    camera: CameraConfig = CameraConfig()
    rim_height_m: Positive = 0.42
    compartment_size_m: tuple[Positive, Positive] = (0.22, 0.20)
    wall_thickness_m: Positive = 0.01
    compartments: dict[str, tuple[ItemClass, ...]] = {
        "blue": (ItemClass.PAPER, ItemClass.CARDBOARD),
        "yellow": (ItemClass.PLASTIC, ItemClass.METAL),
        "green": (ItemClass.GLASS,),
        "grey": (ItemClass.TRASH,),
    }
    camera_height_m: Positive = 0.72
    camera_fovy_rad: Positive = 0.8
    show_distance_m: Positive = Field(0.34, description="from the camera to the point where an item is shown")
    presence_range_m: Positive = Field(0.55, description="longest range at which something counts as present")
    full_at_n: Positive = Field(200.0, description="weight of what is in a compartment that takes no more")

    costs: dict[ItemClass, dict[str, Annotated[float, Field(ge=0)]]] = {}
    """What an item of the class costs in a compartment of others: 1 where nothing is named; in its own, 0.
    Where all mistakes cost the same, the class that is said decides; else the least expected cost does."""

    @field_validator("costs")
    @classmethod
    def _costs_name_compartments(
        cls, costs: dict[ItemClass, dict[str, float]], info: ValidationInfo
    ) -> dict[ItemClass, dict[str, float]]:
        known = list(info.data.get("compartments", ()))
        for item_class, named in costs.items():
            for name in named:
                if known and name not in known:
                    raise ValueError(
                        f"costs of {item_class} name {name}; compartments are {', '.join(known)}"
                        f"{close(name, known)}"
                    )
        return costs

    def compartment_of(self, item_class: ItemClass) -> str:
        """The compartment that takes this class."""
        return next(name for name, classes in self.compartments.items() if item_class in classes)

    def compartment_for(self, label: str, probabilities: Mapping[str, float]) -> str:
        """Where what the bin says goes: its label, and its classes' probabilities as it signs them.

        What is unknown goes where trash goes. Bin and oracle both ask here, so that they cannot disagree.
        """
        known = label in set(ItemClass)
        own = self.compartment_of(ItemClass(label) if known else ItemClass.TRASH)
        mistakes = {self._cost(one, name) for one in ItemClass for name in self._others(one)}
        if len(mistakes) < 2 or not known:
            return own

        def expected(compartment: str) -> float:
            return sum(probabilities.get(one, 0.0) * self._cost(one, compartment) for one in ItemClass)

        return min(self.compartments, key=lambda name: (expected(name), name != own))

    def _others(self, item_class: ItemClass) -> list[str]:
        return [name for name in self.compartments if name != self.compartment_of(item_class)]

    def _cost(self, item_class: ItemClass, compartment: str) -> float:
        wrong = compartment != self.compartment_of(item_class)
        return self.costs.get(item_class, {}).get(compartment, float(wrong))

    @model_validator(mode="after")
    def _every_class_has_one_compartment(self) -> "BinConfig":
        taken = [item_class for classes in self.compartments.values() for item_class in classes]
        if sorted(taken) != sorted(ItemClass):
            raise ValueError(f"each class needs exactly one compartment, got {sorted(taken)}")
        for item_class, costs in self.costs.items():
            if (own := self.compartment_of(item_class)) in costs:
                raise ValueError(f"{item_class} belongs in {own}: it has no cost there")
        return self


class PlaceConfig(Section):
    """A pose with a name, for tasks to speak of."""

    name: str = Field(pattern=_DEVICE_NAME)
    pose: Pose2


_MODBUS = re.compile(r"(tcp|rtu\+tcp)://[^/\s:]+(:\d{1,5})?|rtu:///\S+")


def _is_modbus(text: str) -> str:
    if text and not _MODBUS.fullmatch(text):
        raise ValueError(
            f'{text!r} is no address of Modbus: "tcp://192.168.1.20:502", "rtu:///dev/ttyUSB0", or '
            '"rtu+tcp://192.168.1.20:4196" for a converter that passes bytes on'
        )
    return text


ModbusAddress = Annotated[str, AfterValidator(_is_modbus)]
ModbusUnit = Annotated[int, Field(ge=1, le=247)]
ModbusBit = Annotated[int, Field(ge=0, le=65535)]


class MeterConfig(Section):
    """A dock's meter and contactor."""

    source: Literal["sim", "ros2", "modbus"] | None = None
    """With `sim` and `ros2`, `robot_sim` or a driver with the certificate `driver.<dock>` publishes what the
    meter reads, and switches the contactor. With `modbus` the dock's own process reads the meter, and
    publishes what it reads. Left out: `sim` where the clock is simulated, else nobody."""
    address: ModbusAddress = ""
    """Where the meter answers: "tcp://host:502", "rtu:///dev/ttyUSB0", or "rtu+tcp://host:4196" for a
    converter that passes the bytes of RTU on."""
    baud: int = Field(9600, ge=1200, le=115200)
    """Speed of a serial line. Its `parity` follows, and it has 8 data bits."""
    parity: Literal["N", "E", "O"] = "N"
    model: str = "sdm120"
    """Its registers: `sdm120`, `sdm630`, or the path of a file like those in `services/charger/meters`,
    resolved against the site file."""
    unit: ModbusUnit = 1
    serial: int | None = Field(None, ge=1, lt=2**32)
    """The meter's serial number. Another meter that answers in its place is then noticed."""
    efficiency: float = Field(1.0, gt=0, le=1)
    """Share of what the meter counts that reaches the contacts: the supply's efficiency, where the meter is
    on its mains side."""
    contactor_address: ModbusAddress = ""
    """Where the contactor's module answers; by default on the meter's line."""
    contactor_unit: ModbusUnit = 2
    coil: ModbusBit = 0
    """Coil of the module that closes the contactor, counted from 0."""
    present: ModbusBit = 0
    """Discrete input of the module that is set while a robot is on the contacts, counted from 0."""

    @model_validator(mode="after")
    def _has_an_address(self) -> "MeterConfig":
        if (self.source == "modbus") != bool(self.address):
            raise ValueError(
                'a meter with source = "modbus" needs an address, such as "tcp://192.168.1.20:502", and '
                "others take none"
            )
        line = self.contactor_address or self.address
        if line == self.address and self.address and self.contactor_unit == self.unit:
            raise ValueError(f"meter and contactor are both unit {self.unit} of {line}")
        return self


class DockConfig(Section):
    """A charging station; its contacts face along its x axis towards the parked robot.

    The supply holds `current_a` until the terminals reach `voltage_v`, then holds the voltage until the
    current has fallen to `cutoff_a`.
    """

    name: str = Field("dock1", pattern=_DEVICE_NAME)
    """Name of the dock and its meter in the organization, in its topics, and of its keystore with
    `-device` behind it."""
    pose: Pose2
    meter: MeterConfig = MeterConfig()
    contact_tolerance_m: Positive = 0.06
    contact_tolerance_rad: Positive = 0.15
    voltage_v: Positive = 42.0
    current_a: Positive = 10.5
    cutoff_a: Positive = 1.6


class ItemConfig(Section):
    """A piece of trash; see `SHAPE_NAMES` for the shapes of each class."""

    id: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    item_class: ItemClass = Field(alias="class")
    shape: str
    pose: Pose2
    mass_kg: float = Field(0.05, ge=0.02, le=0.2)
    rgb: Rgb | None = Field(None, description="colour; the shape's usual colour if left out")

    @field_validator("shape")
    @classmethod
    def _is_a_shape_of_its_class(cls, shape: str, info: ValidationInfo) -> str:
        item_class = info.data.get("item_class")
        names = SHAPE_NAMES.get(item_class, ()) if item_class is not None else (shape,)
        if shape not in names:
            close = difflib.get_close_matches(shape, names, n=1)
            meant = f'; is "{close[0]}" meant?' if close else ""
            raise ValueError(f"{item_class} has no shape {shape!r}, only {' and '.join(names)}{meant}")
        return shape

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


class BatteryConfig(Section):
    """The Panther's Li-ion pack, 10 cells in series.

    Capacity, resistance and voltage: Husarion's panther_description (battery plug-in: 20 Ah, 0.15 ohm, 42 V
    full) and data sheet (734 Wh). Idle and motion power give about 8 h of mixed operation per charge.
    """

    capacity_wh: Positive = 734.0
    capacity_ah: Positive = 20.0
    resistance_ohm: Positive = 0.15
    percentage_full: float = Field(1.0, ge=1, le=1e6, description="what its driver calls full")
    soc: float = Field(1.0, ge=0, le=1, description="state of charge when the world is new")
    idle_power_w: Positive = 45.0
    standby_power_w: float = Field(
        5.0, ge=0, description="while the motors are switched off, outside the robot's working hours"
    )
    arm_power_w: Positive = Field(35.0, description="added while the arm moves or holds torque")
    drive_efficiency: float = Field(
        0.6, gt=0, le=1, description="mechanical power at the wheels / electrical"
    )


class MotionLimits(Section):
    """Limits of the body. The drivers obey them, and the oracle checks recordings against them.

    Speed and wheel limits: Husarion (2 m/s; wheel joints 34.5 N m, 10.958 rad/s). Arm: Interbotix
    vx300s description (pi rad/s per joint; joint ranges and torques are in the robot model itself).
    """

    linear_m_s: Positive = 2.0
    angular_rad_s: Positive = 2.0
    joint_rad_s: Positive = 3.1416
    cruise_m_s: Positive = Field(0.7, description="speed the driver plans with indoors")
    cruise_rad_s: Positive = 0.9
    acceleration_m_s2: Positive = 0.8
    acceleration_rad_s2: Positive = 1.5
    gripper_force_n: Positive = Field(5.0, description="largest force of one finger")


Posture = Annotated[tuple[float, ...], Field(min_length=1)]


class PosturesConfig(Section):
    """Joint angles of the arm in rad, from the base to the hand; by default a ViperX 300S's."""

    stowed_rad: Posture = (0.0, -1.1, 0.55, 0.0, 1.77, 0.0)
    """In a new world: the gripper points down, 0.63 m above the floor and hardly beyond the bumper."""
    ready_rad: Posture = (0.0, -0.6, 0.9, 0.0, 1.1, 0.0)
    """Folded above the deck: for driving without anything in the gripper."""
    look_rad: Posture = (0.0, -1.1, 0.55, 0.0, 1.25, 0.0)
    """Camera 0.75 m above the front bumper, looking at the floor half a metre ahead of it. The first joint
    turns it."""
    aside_rad: Posture = (1.2, -0.86, 0.45, 0.0, 1.63, 0.0)
    """Fingers down over the deck's left side: for driving to and from the bin out of its sensor's sight. With
    the first joint's angle negated it is over the right side."""


class NoiseConfig(Section):
    """Noise of a simulated robot's sensors: standard deviations of Gaussian noise; 0 is perfect.

    Scale and bias are drawn once per robot, from its name and the site's `clock.seed`, so that a run can be
    repeated.
    """

    wheel_scale: float = Field(0.01, ge=0, lt=0.2, description="relative error of the way per wheel turn")
    gyro_bias_rad_s: float = Field(0.0005, ge=0, description="BMI088 after calibration at rest")
    gyro_rad_s: float = Field(0.0017, ge=0, description="BMI088: 0.014 deg/s per root Hz, read at 50 Hz")
    lidar_m: float = Field(0.01, ge=0, description="Slamtec S-series: 10 to 30 mm")
    depth_share: float = Field(
        0.005, ge=0, lt=0.2, description="of the depth; RealSense D405: 2 % at 0.5 m is its limit"
    )


def _are_hours(text: str) -> str:
    parse_hours(text)
    return text


def _is_a_zone(name: str) -> str:
    zone(name)
    return name


class RobotConfig(Section):
    """One robot: by default a Husarion Panther with a ViperX 300S arm.

    `body` names what moves it: `robot_sim`, or a robot that runs ROS 2 on the same Zenoh network.
    """

    name: str = Field("panther1", pattern=r"^[a-z][a-z0-9_]*$")
    """Name of the robot in the organization, of its motion capture body, and of its keystore unless `wallet`
    is set."""
    namespace: str = Field("", pattern=r"^[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*$", validate_default=True)
    """ROS namespace of its topics and prefix of its frames; the name if left out."""
    body: Literal["sim", "ros2"] = "sim"
    kinematics: Path | None = None
    """MJCF or URDF of the robot, resolved against the site file; default `rodeo/lab/panther_viperx.xml`. It
    defines the arm's joints, their number, and the fingers (`rodeo.lab.arm`)."""
    postures: PosturesConfig = PosturesConfig()
    """Postures of the arm. An arm with other joints than a ViperX 300S's needs its own."""
    wallet: str = Field("", pattern=r"^[a-z][a-z0-9_-]*$", validate_default=True)
    """Keystore of its account; by default the name."""
    mind: str | None = Field(None, pattern=r"^node\.[a-z][a-z0-9_-]*$")
    """Certificate of the ROS 2 nodes that are its mind, `node.<participant>`: they move its body, and a
    process `robot_recorder` records their work. By default its mind is a process `robot_agent`."""
    payout: Annotated[str, AfterValidator(typed_address)] | None = None
    """Address that payments for its work go to, and its bonds and stakes; by default its own. The robot names
    it once. From then on only that address can change it, and neither the robot's key nor this file."""
    pose: Pose2
    """Where a simulated body stands in a new world."""
    working_hours: tuple[Annotated[str, AfterValidator(_are_hours)], ...] | None = Field(None, min_length=1)
    """Hours of the day in which the robot works, like "08:00-18:00" (rodeo.lab.schedule); by default always.
    At other times it is off: it takes no work and draws its battery's standby power."""
    timezone: Annotated[str, AfterValidator(_is_a_zone)] = "UTC"
    """Time zone of the working hours, by its IANA name, for instance "Europe/Berlin"."""
    battery: BatteryConfig = BatteryConfig()
    limits: MotionLimits = MotionLimits()
    rates: RatesConfig = RatesConfig()
    """How often its drivers publish, where that is more often than the table of keys says."""
    noise: NoiseConfig = NoiseConfig()
    pricing: PricingConfig = PricingConfig()
    """What it asks for its work (rodeo.money.pricing)."""

    @field_validator("working_hours")
    @classmethod
    def _hours_are_apart(cls, hours: tuple[str, ...] | None) -> tuple[str, ...] | None:
        require_apart(hours or ())
        return hours

    @property
    def schedule(self) -> Schedule:
        """When it works."""
        return Schedule(self.working_hours, self.timezone)

    @model_validator(mode="before")
    @classmethod
    def _named_after_the_robot(cls, fields: Any) -> Any:
        if not isinstance(fields, dict):
            return fields
        name = fields.get("name", cls.model_fields["name"].default)
        return {"namespace": name, "wallet": name, **fields}
