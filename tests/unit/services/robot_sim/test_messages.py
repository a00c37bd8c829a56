"""Messages of the simulated robot: templates equal what the type store serialises, frames follow REP 105."""

import itertools
import math

import mujoco
import numpy as np
import pytest

from rodeo.lab.body import joint_names
from rodeo.lab.config import NoiseConfig
from rodeo.lab.sensors import WRIST_CAMERA, Lidar
from rodeo.lab.world import arm_model
from rodeo.ros2 import types
from rodeo.site.config import Site
from services.robot_sim import messages
from services.robot_sim.cdr import Rows
from services.robot_sim.frames import RobotFrames, Transform, odom_in_map, reckoned_poses
from services.robot_sim.simulation import Simulation
from tests.support.site import LAB

TIME_NS = 1_800_000_000_123_456_789


def compose(
    parent_m: np.ndarray, parent_quat: np.ndarray, child_m: np.ndarray, child_quat: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the child, which is given in the parent's frame, in the frame of the parent's pose."""
    position, quat = np.empty(3), np.empty(4)
    mujoco.mju_rotVecQuat(position, child_m, parent_quat)
    mujoco.mju_mulQuat(quat, parent_quat, child_quat)
    return parent_m + position, quat


def test_a_pose_written_into_its_template_is_the_serialised_pose() -> None:
    pose = messages.pose((1.0, 2.0, 3.0), (0.5, 0.1, 0.2, 0.3))
    expected = types.serialize(messages.pose_stamped(TIME_NS, pose))
    template = messages.pose_template()
    template.encode(np.array([1]), (0, np.full((1, 7), 9.0)))
    place_m, quat_xyzw = np.array([[1.0, 2.0, 3.0]]), np.array([[0.1, 0.2, 0.3, 0.5]])
    assert template.encode(np.array([TIME_NS]), (0, place_m), (3, quat_xyzw)) == [expected]


def test_poses_of_several_times_are_as_many_messages_one_after_the_other() -> None:
    times_ns, poses = TIME_NS + np.arange(40) * 20_000_000, np.random.default_rng(2).normal(size=(40, 7))
    template = messages.pose_template()
    alone = [template.encode(times_ns[k : k + 1], (0, poses[k : k + 1]))[0] for k in range(len(times_ns))]
    assert template.encode(times_ns, (0, poses)) == alone
    assert len(set(alone)) == len(alone)


def test_odometry_written_into_its_template_reads_back() -> None:
    template = messages.odometry_template("robots/one", NoiseConfig())
    (cdr,) = template.encode(
        np.array([TIME_NS]),
        (0, np.array([[1.0, 2.0, 0.0, 0.0, 0.0, 0.6, 0.8]])),
        (messages.ODOMETRY_TWIST, np.array([[0.3, 0.0, 0.0, 0.0, 0.0, -0.2]])),
    )
    message = types.deserialize(cdr, "nav_msgs/msg/Odometry")
    assert (message.header.frame_id, message.child_frame_id) == ("robots/one/odom", "robots/one/base_link")
    assert message.header.stamp.nanosec == 123_456_789
    pose, twist = message.pose.pose, message.twist.twist
    assert (pose.position.x, pose.position.y, pose.orientation.w) == (1.0, 2.0, 0.8)
    assert (twist.linear.x, twist.angular.z) == (0.3, -0.2)
    assert message.pose.covariance[0] > 0 and message.twist.covariance[35] > 0


def test_joint_states_written_into_their_template_read_back() -> None:
    joints = joint_names(arm_model())
    count = len(joints)
    position, velocity, effort = (np.arange(count) + offset for offset in (0.0, 100.0, 200.0))
    template = messages.joint_state_template(joints)
    (cdr,) = template.encode(np.array([TIME_NS]), position[None], velocity[None], effort[None])
    message = types.deserialize(cdr, "sensor_msgs/msg/JointState")
    assert message.name == list(joints)
    assert (message.position == position).all()
    assert (message.velocity == velocity).all()
    assert (message.effort == effort).all()


def test_a_clock_written_into_its_template_is_the_serialised_clock() -> None:
    template = messages.clock_template()
    template.encode(1)
    assert template.encode(TIME_NS) == types.serialize(messages.clock(TIME_NS))


@pytest.mark.parametrize("distance_m", [0.31, math.inf])
def test_a_distance_written_into_its_template_is_the_serialised_range(distance_m: float) -> None:
    template = messages.presence_template("bin")
    template.encode(1, 1.5)
    expected = types.serialize(messages.presence(TIME_NS, "bin", distance_m))
    assert template.encode(TIME_NS, distance_m) == expected


def test_ranges_written_into_their_template_are_the_serialised_scan() -> None:
    ranges_m = np.random.default_rng(4).uniform(0.3, 10.0, Lidar.BEAMS)
    ranges_m[::7] = math.inf
    template = messages.scan_template("robots/one")
    template.encode(1, np.ones(Lidar.BEAMS))
    expected = types.serialize(messages.scan(TIME_NS, "robots/one", ranges_m))
    assert template.encode(TIME_NS, ranges_m) == expected


def test_depths_written_into_their_template_are_the_serialised_picture_and_its_lens() -> None:
    lens = WRIST_CAMERA
    depth_m = np.random.default_rng(5).uniform(0.1, 1.5, (lens.height_px, lens.width_px)).astype(np.float32)
    depth_m[0, :3] = -math.inf, math.inf, 0.5
    template = messages.depth_image_template("robots/one", lens)
    template.encode(1, np.ones(depth_m.nbytes, np.uint8))
    expected = types.serialize(messages.depth_image(TIME_NS, "robots/one", depth_m))
    assert template.encode(TIME_NS, depth_m.view(np.uint8).ravel()) == expected
    info = messages.camera_info_template("robots/one", lens)
    info.encode(1)
    assert info.encode(TIME_NS) == types.serialize(messages.camera_info(TIME_NS, "robots/one", lens))


def test_the_frames_lead_from_the_base_to_where_the_hand_is() -> None:
    simulation = Simulation(Site.load(LAB), TIME_NS)
    for _ in range(5):
        simulation.step()
    model, data = simulation.model, simulation.data
    frames = RobotFrames(model, "panther1", "ns")
    poses = frames.poses(data.xpos[None], data.xquat[None], data.xmat[None])[0]
    moving = [
        Transform(*names, pose[:3], np.roll(pose[3:], 1))
        for names, pose in zip(frames.moving, poses, strict=True)
    ]
    tree = {t.child: t for t in (*frames.fixed(), *moving)}
    frame, position, quat = "ns/grasp", np.zeros(3), np.array([1.0, 0, 0, 0])
    while frame != "ns/base_link":
        step = tree[frame]
        position, quat = compose(step.position_m, step.quat_wxyz, position, quat)
        frame = step.parent
    base = data.body("panther1/base_link")
    there_m, _ = compose(base.xpos, base.xquat, position, quat)
    assert there_m == pytest.approx(data.site("panther1/grasp").xpos, abs=1e-4)


def test_transforms_written_into_their_template_are_the_serialised_transforms() -> None:
    chance = np.random.default_rng(3)
    names = [("map", "a/odom"), ("a/odom", "a/base_link"), ("a/base_link", "a/left_finger_link")]
    times_ns, poses = np.array([TIME_NS, TIME_NS + 20_000_000]), chance.normal(size=(2, 3, 7))
    expected = [
        messages.transforms(
            int(time_ns),
            [Transform(*name, pose[:3], np.roll(pose[3:], 1)) for name, pose in zip(names, row, strict=True)],
        )
        for time_ns, row in zip(times_ns, poses, strict=True)
    ]
    template = messages.transforms_template(names)
    template.encode(np.array([1]), np.ones((1, 3, 7)))
    assert template.encode(times_ns, poses) == [types.serialize(message) for message in expected]


def test_what_wheels_reckon_in_odom_is_where_the_base_is_in_the_map() -> None:
    base_m, base_quat = np.array([1.0, 2.0, 3.0]), np.array([0.4, 0.2, -0.4, 0.8])
    x_m, y_m, yaw_rad = 0.7, -0.3, 2.1
    reckoned = np.array([[x_m, y_m, yaw_rad, 0.3, -0.2]])
    (odom,) = odom_in_map(base_m[None], base_quat[None], reckoned)
    (in_odom,), (twist,) = reckoned_poses(reckoned)
    assert (in_odom[:3].tolist(), twist.tolist()) == ([x_m, y_m, 0.0], [0.3, 0, 0, 0, 0, -0.2])
    reckoned_quat = np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])
    assert np.roll(in_odom[3:], 1) == pytest.approx(reckoned_quat)
    there_m, there_quat = compose(odom[:3], np.roll(odom[3:], 1), in_odom[:3], reckoned_quat)
    assert there_m == pytest.approx(base_m)
    assert there_quat == pytest.approx(base_quat)


def test_frames_are_computed_to_the_last_bit_as_written_out_on_every_machine() -> None:
    chance = np.random.default_rng(5)
    model = Simulation(Site.load(LAB), TIME_NS).model
    frames = RobotFrames(model, "panther1", "ns")
    places_m, quaternions, turns = (chance.normal(size=(6, model.nbody, n)) for n in (3, 4, 9))
    poses = frames.poses(places_m, quaternions, turns)
    links = [model.body(f"panther1/{child.removeprefix('ns/')}") for _, child in frames.moving]
    for row, link in itertools.product(range(6), range(len(links))):
        body, parent = links[link].id, links[link].parentid[0]
        offset_m, turn = places_m[row, body] - places_m[row, parent], turns[row, parent].tolist()
        x_m, y_m, z_m = offset_m.tolist()
        p, q = quaternions[row, parent].tolist(), quaternions[row, body].tolist()
        assert poses[row, link].tolist() == [
            *(x_m * turn[k] + y_m * turn[3 + k] + z_m * turn[6 + k] for k in range(3)),
            p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2],
            p[0] * q[2] + p[1] * q[3] - p[2] * q[0] - p[3] * q[1],
            p[0] * q[3] - p[1] * q[2] + p[2] * q[1] - p[3] * q[0],
            p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3],
        ]
    base_m, base_quat, reckoned = (
        chance.normal(size=(50, 3)),
        chance.normal(size=(50, 4)),
        chance.normal(size=(50, 5)),
    )
    odom, (in_odom, _) = odom_in_map(base_m, base_quat, reckoned), reckoned_poses(reckoned)
    for row in range(50):
        x_m, y_m, yaw_rad, *_ = reckoned[row].tolist()
        c, s, (w, x, y, z) = math.cos(yaw_rad / 2), -math.sin(yaw_rad / 2), base_quat[row].tolist()
        w, x, y, z = w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s
        assert in_odom[row].tolist() == [x_m, y_m, 0, 0, 0, -s, c]
        assert odom[row].tolist() == [
            base_m[row, 0] - (1 - 2 * (y * y + z * z)) * x_m - 2 * (x * y - w * z) * y_m,
            base_m[row, 1] - 2 * (x * y + w * z) * x_m - (1 - 2 * (x * x + z * z)) * y_m,
            base_m[row, 2] - 2 * (x * z - w * y) * x_m - 2 * (y * z + w * x) * y_m,
            *(x, y, z, w),
        ]


@pytest.mark.parametrize("first, shape", [(-1, (2, 7)), (1, (2, 7)), (0, (2, 8)), (0, (3, 7))])
def test_numbers_that_do_not_fit_are_not_written(first: int, shape: tuple[int, int]) -> None:
    template = messages.pose_template()
    with pytest.raises(ValueError, match=f"{shape[1]} numbers from the {first}th on for {shape[0]} times"):
        template.encode(np.array([1, 2]), (first, np.zeros(shape)))


def test_a_template_has_all_the_numbers_that_are_written_into_it() -> None:
    with pytest.raises(ValueError, match="16 bytes has no number that ends at 20"):
        Rows(bytes(16), [4], [12])
