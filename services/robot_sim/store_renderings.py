"""Make `renderings/`, what the bin's camera shows where there is no OpenGL driver.

python -m services.robot_sim.store_renderings --site deploy/sites/lab.toml
"""

import argparse
from pathlib import Path

# The lab chooses MuJoCo's OpenGL back end, which counts only before the first import of mujoco.
from rodeo.site.config import Site

# isort: split
import mujoco

from rodeo.lab.config import ItemConfig
from rodeo.lab.items import PALM_CLEARANCE_M, SHAPES, Shape, shape_of
from rodeo.lab.layout import BinLayout
from rodeo.lab.render import Camera, encode
from rodeo.lab.world import PAD_THICKNESS_M, arm_model, begin, build_world
from services.robot_sim.camera import RENDERINGS

SHOWING_RAD = (0.0, -0.5045, -0.246, 0.0, 1.9713, 0.0)
"""The arm with the gripper pointing down at the show point, from where the robot parks at the bin."""

_QUALITY = 85


def held(site: Site, item: ItemConfig | None) -> bytes:
    """The bin's camera picture of an item in the gripper of the parked robot, as a JPEG."""
    robot = site.robots[0].model_copy(update={"pose": BinLayout(site.bins[0]).parking})
    site = site.model_copy(update={"robots": [robot], "items": [item] if item else []})
    model = build_world(site)
    data = begin(model, site)
    for name, position in zip(arm_model().joints, SHOWING_RAD, strict=True):
        data.joint(f"{robot.name}/{name}").qpos[0] = position
    if item is not None:
        shape = shape_of(item)
        for finger, side in zip(arm_model().fingers, (1, -1), strict=True):
            data.joint(f"{robot.name}/{finger}").qpos[0] = side * (shape.half_m[1] + PAD_THICKNESS_M)
        mujoco.mj_forward(model, data)
        _put_between_pads(data, robot.name, item, shape)
    mujoco.mj_forward(model, data)
    camera = Camera(model, f"{site.bins[0].name}/camera")
    picture = encode(camera.image(data), quality=_QUALITY)
    camera.close()
    return picture


def _put_between_pads(data: mujoco.MjData, robot: str, item: ItemConfig, shape: Shape) -> None:
    x, y, z = data.site(f"{robot}/grasp").xpos
    below_m = 0.0 if shape.lies else max(0.0, shape.half_m[2] - PALM_CLEARANCE_M)
    qpos = data.joint(item.id).qpos
    qpos[:3] = x, y, z - below_m


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", type=Path, required=True)
    site = Site.load(parser.parse_args().site)
    RENDERINGS.mkdir(exist_ok=True)
    (RENDERINGS / "empty.jpg").write_bytes(held(site, None))
    for item_class, shapes in SHAPES.items():
        for shape in shapes:
            # Lying things are carried along the robot's x axis, which is the bin's.
            pose = site.bins[0].pose
            item = ItemConfig(id="shown", item_class=item_class, shape=shape, pose=pose)
            (RENDERINGS / f"{item_class}_{shape}.jpg").write_bytes(held(site, item))


if __name__ == "__main__":
    main()
