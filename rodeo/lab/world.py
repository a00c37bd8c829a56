"""The lab in MuJoCo: one world for the simulator that moves it and for the oracle that replays it.

`build_world(site)` puts the room, the furniture, the docks, the bins, the items and the robots together;
`robot_model()` is the robot alone with its base fixed at the origin, for kinematics.

Names: `<robot>/<part>` for what belongs to a robot (`panther1/waist`), the item's id for an item's body,
`<bin>/<compartment>` for a compartment's scale, `<bin>/camera`, `<bin>/presence`.
"""

import math
from functools import cache
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from rodeo.errors import ConfigError
from rodeo.lab import items as trash
from rodeo.lab.arm import GRASP_SITE, ArmModel
from rodeo.lab.config import (
    BinConfig,
    DockConfig,
    FurnitureConfig,
    ItemConfig,
    LabConfig,
    Pose2,
    Rgb,
    RobotConfig,
)
from rodeo.lab.geometry import quaternion_of
from rodeo.lab.layout import BinLayout, Vec3

TIMESTEP_S = 0.002
CONTROL_STEPS = 10
CONTROL_PERIOD_S = TIMESTEP_S * CONTROL_STEPS

WHEEL_JOINTS = ("fl_wheel_joint", "fr_wheel_joint", "rl_wheel_joint", "rr_wheel_joint")
ROLLING_RADIUS_M = 0.1852
"""Between the loaded and the free radius of the tyre: way per radian."""
TRACK_M = 0.697
PAD_THICKNESS_M = 0.008
"""The rubber on each finger: an item of width w is held at gripper position w / 2 + this."""
GRIPPER_OPEN_M = 0.057
GRIPPER_CLOSED_M = 0.021

CAMERA_SITE = "wrist_camera_optical_frame"
"""Frame of the wrist's depth and colour camera (REP 103: z ahead, x right, y down)."""
LIDAR_SITE = "lidar_link"

ROBOT_XML = Path(__file__).with_name("panther_viperx.xml")

FLOOR = "floor"
# Collision bits; the robot's own are in its model.
FIXED, ROBOT, ROLLING, ITEM = 1, 2, 4, 8

_BUCKET_MASS_KG = 0.8
_SCALE_STIFFNESS_N_M = 4000.0
_SCALE_DAMPING = 60.0
_BUCKET_FLOOR_M = 0.05
"""Height of the upper side of a bucket's floor."""
_BUCKET_FLOOR_THICKNESS_M = 0.02
"""More than what falls into it moves in two time steps."""

_COLOURS = {
    "blue": (0.16, 0.38, 0.76),
    "yellow": (0.93, 0.76, 0.18),
    "green": (0.20, 0.58, 0.31),
    "grey": (0.45, 0.47, 0.50),
}
_WALL = (0.86, 0.87, 0.88)
_WOOD = (0.72, 0.56, 0.40)
_STEEL = (0.32, 0.34, 0.37)


class LabSite(Protocol):
    """The part of a site that the world is made of."""

    lab: LabConfig
    bins: list[BinConfig]
    docks: list[DockConfig]
    items: list[ItemConfig]
    robots: list[RobotConfig]


def build_world(site: LabSite) -> mujoco.MjModel:
    """Compile the site's lab."""
    return world_spec(site).compile()


def world_spec(site: LabSite) -> mujoco.MjSpec:
    """The site's lab, still open to changes."""
    spec = mujoco.MjSpec()
    spec.modelname = "lab"
    _set_physics(spec)
    _add_room(spec, site.lab)
    for furniture in site.lab.furniture:
        _add_furniture(spec, furniture)
    for dock in site.docks:
        _add_dock(spec, dock)
    for bin_ in site.bins:
        _add_bin(spec, bin_)
    for item in site.items:
        _add_item(spec, item)
    for robot in site.robots:
        _add_robot(spec, robot)
    return spec


def begin(model: mujoco.MjModel, site: LabSite) -> mujoco.MjData:
    """The world as it is when new: things where the site file puts them, arms stowed, grippers open.

    Raises ConfigError for a posture that is none of the arm's.
    """
    data = mujoco.MjData(model)
    for robot in site.robots:
        arm = ArmModel.of(model, f"{robot.name}/")
        stowed_rad = arm.posture("stowed_rad", robot.postures.stowed_rad)
        for joint, position in zip(arm.joints, stowed_rad, strict=True):
            data.joint(f"{robot.name}/{joint}").qpos[0] = position
            data.act[model.actuator(f"{robot.name}/{joint}").actadr[0]] = position
        for joint, side in zip(arm.fingers, (1, -1), strict=True):
            data.joint(f"{robot.name}/{joint}").qpos[0] = side * GRIPPER_OPEN_M
        data.act[model.actuator(f"{robot.name}/gripper").actadr[0]] = GRIPPER_OPEN_M
    mujoco.mj_forward(model, data)
    return data


def robot_model(kinematics: Path | None = None) -> mujoco.MjModel:
    """The robot with base_link fixed at the origin, joints and sites without prefix.

    From an MJCF or a URDF file, by default the Panther with a ViperX 300S. A URDF says by links of their
    names where GRASP_SITE and CAMERA_SITE are. Raises ConfigError when the file does not describe a robot
    with them.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(kinematics or ROBOT_XML))
        spec.compiler.fusestatic = False
        for name in (GRASP_SITE, CAMERA_SITE):
            if spec.site(name) is None and (link := spec.body(name)) is not None:
                link.add_site(name=name)
        model = spec.compile()
        for name in (GRASP_SITE, CAMERA_SITE):
            model.site(name)
    except (ValueError, KeyError) as error:
        raise ConfigError(f"not a usable robot: {error}", kinematics=str(kinematics)) from error
    return model


@cache
def arm_model(kinematics: Path | None = None) -> ArmModel:
    """The arm of `robot_model(kinematics)`, which says what it raises."""
    return ArmModel.of(robot_model(kinematics))


def _set_physics(spec: mujoco.MjSpec) -> None:
    option = spec.option
    option.timestep = TIMESTEP_S
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # Friction much stiffer than the normal direction: what is held does not creep out of the gripper.
    option.impratio = 100
    # MuJoCo 4.0.0 factors the sparse Hessian wrongly (google-deepmind/mujoco#3767, fixed in 4.0.1).
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    option.sleep_tolerance = 1e-4
    spec.compiler.degree = False


def _box(body: mujoco.MjsBody, size: Vec3, pos: Vec3, rgb: Rgb = _WALL, solid: bool = True) -> None:
    """Add a box of this extent; if it is not solid it is only seen."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[extent / 2 for extent in size],
        pos=list(pos),
        rgba=[*rgb, 1],
        contype=FIXED if solid else 0,
        conaffinity=0,
    )


def _place(spec: mujoco.MjSpec, name: str, pose: Pose2) -> mujoco.MjsBody:
    return spec.worldbody.add_body(name=name, pos=[pose.x_m, pose.y_m, 0], quat=quaternion_of(pose.yaw_rad))


def _add_room(spec: mujoco.MjSpec, lab: LabConfig) -> None:
    _add_textures(spec)
    length_m, width_m = lab.size_m
    world = spec.worldbody
    world.add_geom(
        name=FLOOR,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[length_m * 2, width_m * 2, 1],
        pos=[length_m / 2, width_m / 2, 0],
        contype=FIXED,
        conaffinity=0,
        material="floor",
        friction=[0.8, 0.005, 0.0001],
    )
    half = lab.wall_thickness_m / 2
    height_m, full = lab.wall_height_m, lab.wall_thickness_m
    for x, y, size in (
        (length_m / 2, -half, (length_m + 2 * full, full)),
        (length_m / 2, width_m + half, (length_m + 2 * full, full)),
        (-half, width_m / 2, (full, width_m)),
        (length_m + half, width_m / 2, (full, width_m)),
    ):
        _box(world, (*size, height_m), (x, y, height_m / 2))
    _add_lights(spec, lab)


def _add_textures(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.70, 0.80],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.62, 0.65, 0.68],
        rgb2=[0.62, 0.65, 0.68],
        markrgb=[0.53, 0.56, 0.59],
        width=256,
        height=256,
    )
    floor = spec.add_material(
        name="floor", texrepeat=[2, 2], texuniform=True, reflectance=0.03, specular=0.05
    )
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"


def _add_lights(spec: mujoco.MjSpec, lab: LabConfig) -> None:
    """Lights, and the camera that shows the whole room."""
    (length_m, width_m), world = lab.size_m, spec.worldbody
    world.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[length_m / 2, width_m / 2, 4],
        dir=[0.25, 0.35, -1],
        diffuse=[0.55, 0.54, 0.52],
        specular=[0.25, 0.25, 0.25],
        castshadow=True,
    )
    for x in (0.25, 0.75):
        world.add_light(
            pos=[length_m * x, width_m / 2, 3.5],
            dir=[0, 0, -1],
            diffuse=[0.22, 0.22, 0.23],
            specular=[0.1, 0.1, 0.1],
            attenuation=[1, 0, 0],
            castshadow=False,
        )
    eye = np.array([length_m * 0.27, width_m * -0.46, width_m * 0.70])
    target = np.array([length_m * 0.51, width_m * 0.48, 0.1])
    world.add_camera(name="overview", pos=list(eye), quat=_look(eye, target), fovy=47)

    spec.visual.global_.offwidth = 1920
    spec.visual.global_.offheight = 1080
    spec.visual.headlight.ambient = [0.36, 0.36, 0.38]
    spec.visual.headlight.diffuse = [0.18, 0.18, 0.18]
    spec.visual.headlight.specular = [0.05, 0.05, 0.05]
    spec.visual.quality.shadowsize = 4096
    spec.visual.quality.offsamples = 8
    spec.visual.map.znear = 0.005
    spec.visual.map.zfar = 30
    spec.stat.extent = max(lab.size_m)
    spec.stat.center = [length_m / 2, width_m / 2, 0.3]


def _look(eye: np.ndarray, target: np.ndarray) -> list[float]:
    """Quaternion of a camera (looks along -z, y up) at `eye` that looks at `target`."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0, 0, 1), back)
    right /= np.linalg.norm(right)
    x, y, z, w = Rotation.from_matrix(np.column_stack((right, np.cross(back, right), back))).as_quat()
    return [w, x, y, z]


def _add_furniture(spec: mujoco.MjSpec, furniture: FurnitureConfig) -> None:
    body = _place(spec, furniture.name, furniture.pose)
    x, y, z = furniture.size_m
    if furniture.kind == "desk":
        _box(body, (x, y, 0.03), (0, 0, z - 0.015), rgb=_WOOD)
        for sx in (-1, 1):
            for sy in (-1, 1):
                foot = (sx * (x / 2 - 0.05), sy * (y / 2 - 0.05), (z - 0.03) / 2)
                _box(body, (0.05, 0.05, z - 0.03), foot, rgb=_STEEL)
        _box(body, (0.36, 0.03, 0.24), (0, y * 0.2, z + 0.17), rgb=(0.08, 0.08, 0.09), solid=False)
        _box(body, (0.05, 0.05, 0.06), (0, y * 0.2, z + 0.03), rgb=_STEEL, solid=False)
        _box(body, (0.34, 0.12, 0.015), (0, -y * 0.15, z + 0.008), rgb=(0.2, 0.2, 0.22), solid=False)
    elif furniture.kind == "shelf":
        for side in (-1, 1):
            _box(body, (x, 0.03, z), (0, side * (y / 2 - 0.015), z / 2), rgb=_WOOD)
        for level in (0.06, 0.40, 0.74, 1.0):
            _box(body, (x, y - 0.06, 0.025), (0, 0, level * (z - 0.0125)), rgb=_WOOD)
        for place, colour in ((-0.3, "blue"), (0.0, "grey"), (0.25, "green")):
            _box(
                body, (x * 0.6, 0.2, 0.16), (0, place * y, 0.40 * z + 0.09), rgb=_COLOURS[colour], solid=False
            )
    else:
        _box(body, (x, y, z), (0, 0, z / 2), rgb=_WALL if furniture.kind == "wall" else _WOOD)


def _add_dock(spec: mujoco.MjSpec, dock: DockConfig) -> None:
    """A charging box whose face, at the origin of its pose, carries two contact rails."""
    body = _place(spec, dock.name, dock.pose)
    _box(body, (0.16, 0.5, 0.36), (-0.085, 0, 0.18), rgb=(0.90, 0.91, 0.93))
    _box(body, (0.165, 0.44, 0.02), (-0.085, 0, 0.365), rgb=_COLOURS["green"], solid=False)
    for z in (0.185, 0.215):
        _box(body, (0.012, 0.30, 0.012), (-0.003, 0, z), rgb=(0.85, 0.65, 0.25), solid=False)
    _box(body, (0.8, 0.9, 0.002), (0.42, 0, 0.001), rgb=(0.30, 0.55, 0.40), solid=False)
    body.add_site(name=f"{dock.name}/contact", pos=[0, 0, 0.2], size=[0.02, 0.02, 0.02], group=4)


def _add_bin(spec: mujoco.MjSpec, config: BinConfig) -> None:
    """Four open buckets in a row, each with its own walls and standing on its own scale."""
    layout = BinLayout(config)
    body = _place(spec, config.name, config.pose)
    for name in config.compartments:
        _add_bucket(body, config, name, layout.offset_m(name))

    post_x, camera_z = -config.show_distance_m - 0.05, config.camera_height_m
    _box(body, (0.04, 0.04, camera_z), (post_x, 0, camera_z / 2), rgb=_STEEL)
    _box(body, (0.16, 0.16, 0.02), (post_x, 0, 0.01), rgb=_STEEL)
    _box(body, (0.06, 0.09, 0.06), (post_x + 0.01, 0, camera_z), rgb=(0.1, 0.1, 0.11))
    camera = [-config.show_distance_m, 0, camera_z]
    # A camera looks along its own -z with y up: x of the bin is ahead of it.
    body.add_camera(
        name=f"{config.name}/camera",
        pos=camera,
        quat=[0.5, 0.5, -0.5, -0.5],
        fovy=math.degrees(config.camera_fovy_rad),
    )
    body.add_site(
        name=f"{config.name}/presence", pos=camera, quat=[math.sqrt(0.5), 0, math.sqrt(0.5), 0], group=4
    )


def _add_bucket(bin_body: mujoco.MjsBody, config: BinConfig, name: str, offset_m: float) -> None:
    """A bucket on a stiff spring: what it holds weighs the same on its floor or wedged between its walls."""
    wall_m, rim_m, rgb = config.wall_thickness_m, config.rim_height_m, _COLOURS.get(name, _STEEL)
    inner_x, inner_y = config.compartment_size_m
    outer_x, outer_y = inner_x + 2 * wall_m, inner_y + 2 * wall_m
    bottom_m = _BUCKET_FLOOR_M - _BUCKET_FLOOR_THICKNESS_M
    _box(bin_body, (outer_x, outer_y, bottom_m / 2), (0, offset_m, bottom_m / 4), rgb=_STEEL)
    bucket = bin_body.add_body(name=f"{config.name}/{name}", pos=[0, offset_m, 0])
    bucket.add_joint(
        name=f"{config.name}/{name}",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, 0, 1],
        stiffness=[_SCALE_STIFFNESS_N_M, 0, 0],
        damping=[_SCALE_DAMPING, 0, 0],
    )
    bucket.mass, bucket.inertia, bucket.explicitinertial = _BUCKET_MASS_KG, [0.01, 0.01, 0.01], True
    bucket.gravcomp = 1  # tared
    floor_z = (_BUCKET_FLOOR_M + bottom_m) / 2
    dark = (rgb[0] / 2, rgb[1] / 2, rgb[2] / 2)
    _box(bucket, (inner_x, inner_y, _BUCKET_FLOOR_THICKNESS_M), (0, 0, floor_z), dark)
    middle_z, height_m = (rim_m + bottom_m) / 2, rim_m - bottom_m
    for side in (-1, 1):
        x, y = side * (inner_x + wall_m) / 2, side * (inner_y + wall_m) / 2
        _box(bucket, (wall_m, outer_y, height_m), (x, 0, middle_z), rgb)
        _box(bucket, (inner_x, wall_m, height_m), (0, y, middle_z), (0.93, 0.93, 0.94))


def scale_weight_n(model: mujoco.MjModel, data: mujoco.MjData, bin_name: str, compartment: str) -> float:
    """What the compartment's scale reads, in N: all that its bucket carries, its own weight taken off."""
    joint = model.joint(f"{bin_name}/{compartment}")
    return float(-data.qpos[joint.qposadr[0]] * _SCALE_STIFFNESS_N_M)


_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}


def _add_item(spec: mujoco.MjSpec, item: ItemConfig) -> None:
    shape = trash.shape_of(item)
    position, quat = trash.rest_pose(item)
    body = spec.worldbody.add_body(name=item.id, pos=list(position), quat=list(quat))
    body.add_freejoint(name=item.id)
    colour = item.rgb or shape.rgb
    solid = [part for part in shape.parts if part.solid]
    for part in shape.parts:
        x, y, z, w = Rotation.from_euler("xyz", part.rpy).as_quat()
        body.add_geom(
            type=_KINDS[part.kind],
            size=[*part.size, *([0.0] * (3 - len(part.size)))],
            pos=list(part.pos),
            quat=[w, x, y, z],
            rgba=[*(min(1.0, c * part.tint) for c in colour), 1],
            mass=item.mass_kg / len(solid) if part.solid else 0.0,
            contype=ITEM if part.solid else 0,
            conaffinity=FIXED | ROBOT | ITEM if part.solid else 0,
            # Rolling friction, so that a round thing on the floor stays where it was left.
            condim=6,
            friction=[0.7, 0.005, 0.002],
        )


def robot_spec(robot: RobotConfig) -> mujoco.MjSpec:
    """The robot as the lab has it, its base fixed at the origin, names without prefix, open to changes.

    Raises ConfigError when its file describes no robot with a base_link.
    """
    # A URDF has no actuators and no contact parameters.
    mjcf = robot.kinematics if robot.kinematics and robot.kinematics.suffix == ".xml" else ROBOT_XML
    try:
        spec = mujoco.MjSpec.from_file(str(mjcf))
    except ValueError as error:
        raise ConfigError(f"not a usable robot: {error}", kinematics=str(mjcf)) from error
    if spec.body("base_link") is None:
        raise ConfigError("not a usable robot: it has no body base_link", kinematics=str(mjcf))
    return spec


def _add_robot(spec: mujoco.MjSpec, robot: RobotConfig) -> None:
    child = robot_spec(robot)
    frame = spec.worldbody.add_frame(
        pos=[robot.pose.x_m, robot.pose.y_m, 0], quat=quaternion_of(robot.pose.yaw_rad)
    )
    child.body("base_link").add_freejoint(name="base")
    tyres = [geom for geom in child.geoms if geom.contype == ROLLING]
    for number, tyre in enumerate(tyres, 1):
        tyre.name = tyre.name or f"tyre{number}"
        _roll(spec, robot.name, tyre)
    spec.attach(child, prefix=f"{robot.name}/", frame=frame)


def _roll(spec: mujoco.MjSpec, robot: str, tyre: mujoco.MjsGeom) -> None:
    """Let the tyre touch the floor as a pair of geoms: the same contact, but nobody has to look for it.

    The pair has the tyre's parameters, which is how MuJoCo mixes two geoms when one has the higher priority.
    """
    if tyre.priority <= spec.geom(FLOOR).priority:
        raise ConfigError("a tyre's priority must be higher than the floor's", robot=robot, tyre=tyre.name)
    slide, spin, roll = tyre.friction
    spec.add_pair(
        geomname1=FLOOR,
        geomname2=f"{robot}/{tyre.name}",
        condim=tyre.condim,
        friction=[slide, slide, spin, roll, roll],
        solref=tyre.solref,
        solimp=tyre.solimp,
    )
    tyre.contype = tyre.conaffinity = 0
