"""A robot's MuJoCo model as URDF, which is what `robot_description` holds and ROS tools read.

Links, joints, inertias and drawn primitives; sites become links without mass. Actuators and contact
parameters have no place in a URDF and are left out.
"""

from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

_UNLIMITED_EFFORT = 1000.0
_SPEED_RAD_S = 3.1416


def to_urdf(model: mujoco.MjModel, name: str) -> str:
    """The URDF of a model whose bodies all descend from the first one, which is the root link."""
    robot = Xml.Element("robot", name=name)
    mimics = _mimics(model)
    for body in range(1, model.nbody):
        _add_link(robot, model, body)
        parent = int(model.body_parentid[body])
        if parent != 0:
            _add_joint(robot, model, body, parent, mimics)
    for site in range(model.nsite):
        link = model.site(site).name
        Xml.SubElement(robot, "link", name=link)
        joint = Xml.SubElement(robot, "joint", name=f"{link}_joint", type="fixed")
        Xml.SubElement(joint, "parent", link=model.body(model.site_bodyid[site]).name)
        Xml.SubElement(joint, "child", link=link)
        _add_origin(joint, model.site_pos[site], model.site_quat[site])
    Xml.indent(robot)
    return Xml.tostring(robot, encoding="unicode")


def _add_link(robot: Xml.Element, model: mujoco.MjModel, body: int) -> None:
    link = Xml.SubElement(robot, "link", name=model.body(body).name)
    if model.body_mass[body] > 0:
        inertial = Xml.SubElement(link, "inertial")
        _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
        Xml.SubElement(inertial, "mass", value=_text(model.body_mass[body]))
        ixx, iyy, izz = map(_text, model.body_inertia[body])
        Xml.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
    for geom in np.flatnonzero(model.geom_bodyid == body):
        shape = _shape(model, int(geom))
        if model.geom_group[geom] <= 2 and shape is not None:
            visual = Xml.SubElement(link, "visual")
            _add_origin(visual, model.geom_pos[geom], model.geom_quat[geom])
            Xml.SubElement(visual, "geometry").append(shape)
            material = Xml.SubElement(visual, "material", name=f"geom{geom}")
            Xml.SubElement(material, "color", rgba=_text(_colour(model, int(geom))))


def _add_joint(
    robot: Xml.Element, model: mujoco.MjModel, body: int, parent: int, mimics: dict[int, tuple[str, float]]
) -> None:
    child = model.body(body).name
    if model.body_jntnum[body] == 0:
        joint = Xml.SubElement(robot, "joint", name=f"{child}_joint", type="fixed")
    else:
        index = int(model.body_jntadr[body])
        slides = model.jnt_type[index] == mujoco.mjtJoint.mjJNT_SLIDE
        limited = bool(model.jnt_limited[index])
        kind = "prismatic" if slides else "revolute" if limited else "continuous"
        joint = Xml.SubElement(robot, "joint", name=model.joint(index).name, type=kind)
        Xml.SubElement(joint, "axis", xyz=_text(model.jnt_axis[index]))
        effort = (
            float(model.jnt_actfrcrange[index, 1]) if model.jnt_actfrclimited[index] else _UNLIMITED_EFFORT
        )
        limit = Xml.SubElement(joint, "limit", effort=_text(effort), velocity=_text(_SPEED_RAD_S))
        if limited:
            lower, upper = model.jnt_range[index]
            limit.set("lower", _text(lower))
            limit.set("upper", _text(upper))
        if index in mimics:
            leader, factor = mimics[index]
            Xml.SubElement(joint, "mimic", joint=leader, multiplier=_text(factor))
    Xml.SubElement(joint, "parent", link=model.body(parent).name)
    Xml.SubElement(joint, "child", link=child)
    _add_origin(joint, model.body_pos[body], model.body_quat[body])


def _mimics(model: mujoco.MjModel) -> dict[int, tuple[str, float]]:
    """Joint -> (name of the joint it follows, factor), from the model's joint equalities."""
    joints = np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT)
    return {
        int(model.eq_obj1id[eq]): (model.joint(model.eq_obj2id[eq]).name, float(model.eq_data[eq, 1]))
        for eq in joints
    }


def _shape(model: mujoco.MjModel, geom: int) -> Xml.Element | None:
    size = model.geom_size[geom]
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_BOX:
            return Xml.Element("box", size=_text(2 * size))
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return Xml.Element("sphere", radius=_text(size[0]))
        case mujoco.mjtGeom.mjGEOM_CYLINDER | mujoco.mjtGeom.mjGEOM_CAPSULE:
            return Xml.Element("cylinder", radius=_text(size[0]), length=_text(2 * size[1]))
        case _:
            return None


def _colour(model: mujoco.MjModel, geom: int) -> np.ndarray:
    material = int(model.geom_matid[geom])
    return model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]


def _add_origin(element: Xml.Element, position_m: np.ndarray, quat_wxyz: np.ndarray) -> None:
    rpy = Rotation.from_quat(np.roll(quat_wxyz, -1)).as_euler("xyz", suppress_warnings=True)
    Xml.SubElement(element, "origin", xyz=_text(position_m), rpy=_text(rpy))


def _text(numbers: object) -> str:
    # Adding zero turns -0.0 into 0.
    return " ".join(f"{float(number) + 0.0:.9g}" for number in np.atleast_1d(np.asarray(numbers)))
