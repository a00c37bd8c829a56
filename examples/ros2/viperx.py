"""What a mind has to know of its arm: joint angles for a gripper that points down, and smooth motions.

A robot with MoveIt asks that instead. The arm is a ViperX 300 S on a wedge that leans it 20 degrees forward.
Points are in the robot's `base_link` (m, x ahead, y left, z up), angles in rad.
"""

import math

import numpy as np
from builtin_interfaces.msg import Duration
from scipy.spatial.transform import Rotation
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

JOINTS = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"]
FOLDED = np.array([0.0, -0.6, 0.9, 0.0, 1.1, 0.0])
"""To drive with nothing between the fingers."""
ASIDE = np.array([1.2, -0.86, 0.45, 0.0, 1.63, 0.0])
"""To drive with something between them."""
REACH = 0.67
"""From the robot's centre to what it takes from the floor."""
ACROSS = math.pi / 2
"""The fingers close from left and right."""
CAMERA_AHEAD, CAMERA_ABOVE = 0.065, 0.077
"""From where the pads meet to the camera on the wrist, while they point down and close ACROSS."""
NEAREST, LOWEST, WITHIN = 0.13, 0.02, 0.2
"""What is nearer to the camera is a finger, what is lower is the floor, what is further off is not meant."""

_MOUNT = Rotation.from_euler("y", math.radians(20.05))
_SHOULDER = np.array([0.2936, 0.0, 0.4894])
_UPPER, _FORE, _HAND = math.hypot(0.0595, 0.3), 0.3, 0.1769
_BEND = math.atan2(0.0595, 0.3)
_SPEED, _ACCELERATION = 1.2, 2.5


def above(x, y, z, closing=ACROSS):
    """Joint angles that hold the pads at a point, straight down, closing along the heading `closing`.

    Raises ValueError where the arm does not reach.
    """
    c, s = math.cos(closing % math.pi), math.sin(closing % math.pi)
    hand = np.array([[0.0, c, s], [0.0, s, -c], [-1.0, 0.0, 0.0]])
    right, left, up = _MOUNT.inv().apply(np.array([x, y, z + _HAND]) - _SHOULDER)
    waist, reach = math.atan2(left, right), math.hypot(right, left)
    inner = (reach**2 + up**2 - _UPPER**2 - _FORE**2) / (2 * _UPPER * _FORE)
    if abs(inner) > 1:
        raise ValueError(f"the arm does not reach {x:.2f} {y:.2f} {z:.2f}")
    fold = math.acos(inner)
    upper = math.atan2(reach, up) - math.atan2(_FORE * math.sin(fold), _UPPER + _FORE * inner)
    shoulder, elbow = upper - _BEND, fold - math.pi / 2 + _BEND
    forearm = _MOUNT * Rotation.from_euler("ZY", [waist, shoulder + elbow])
    roll, wrist, turn = (forearm.inv() * Rotation.from_matrix(hand)).as_euler("XYX")
    return np.array([waist, shoulder, elbow, roll, wrist, turn])


def grasp_height(top):
    """Where the pads take what stands on the floor and is `top` high: not by its foot, nor with the palm."""
    return max(top - 0.035, 0.028)


def raised(point, by):
    return np.add(point, [0.0, 0.0, by])


def line(start, end, closing=ACROSS):
    """Angles along a straight line, slow at both of its ends."""
    shares = np.linspace(0.0, 1.0, 12)
    return [above(*point, closing) for point in start + np.outer(shares**2 * (3 - 2 * shares), end - start)]


def motion(knots):
    """A trajectory through joint angles, from rest to rest."""
    knots = np.array(knots)
    change = np.abs(knots[-1] - knots[0]).max()
    seconds = max(0.6, 1.5 * change / _SPEED, math.sqrt(6 * change / _ACCELERATION))
    times = np.linspace(0.0, seconds, len(knots))
    speeds = np.gradient(knots, times, axis=0)
    speeds[0] = speeds[-1] = 0.0
    points = [
        JointTrajectoryPoint(
            positions=list(angles),
            velocities=list(speed),
            time_from_start=Duration(sec=int(time), nanosec=int(time % 1 * 1e9)),
        )
        for time, angles, speed in zip(times, knots, speeds, strict=True)
    ]
    return JointTrajectory(joint_names=JOINTS, points=points)


def thing_below(image, info, pads):
    """What stands below the camera, with the pads at a height, down and ACROSS: how far it is ahead and left
    of the camera, how high it is, and the heading in which the fingers close on it. None if nothing does."""
    depth = np.frombuffer(image.data, np.float32).reshape(image.height, image.width)
    rows, columns = np.indices(depth.shape)
    ahead, left = (info.k[5] - rows) * depth / info.k[4], (info.k[2] - columns) * depth / info.k[0]
    height = pads + CAMERA_ABOVE - depth
    thing = (depth > NEAREST) & (height > LOWEST) & (np.hypot(ahead, left) < WITHIN)
    if thing.sum() < 10:
        return None
    points = np.stack([ahead[thing], left[thing]])
    spread, axes = np.linalg.eigh(np.cov(points))
    closing = math.atan2(axes[1, 0], axes[0, 0]) if spread[1] > 2 * spread[0] else ACROSS
    middle = np.quantile(points, [0.02, 0.98], axis=1).mean(axis=0)
    return middle, float(np.quantile(height[thing], 0.9)), closing
