"""Did the base move as a Panther can, where a Panther can?"""

import numpy as np

from rodeo.checks.case import NO_MOCAP, Case
from rodeo.checks.motion.completeness import holes
from rodeo.checks.motion.poses import base_of, moved_s
from rodeo.checks.motion.smoothing import HALF_WINDOW_S, smoothed
from rodeo.checks.motion.sources import blind
from rodeo.checks.report import Finding, at_most, skipped, standing
from rodeo.checks.tables import increasing, table_of
from rodeo.evidence.series import Array
from rodeo.lab.geometry import seen_from
from rodeo.lab.layout import BUMPER_M, HALF_WIDTH_M
from rodeo.site.topics import ODOM, Topic

TOLERANCE = 1.05
"""On published limits, for numerical differentiation of poses."""
WINDOW_S = 0.2
"""Speeds are means over this time, so that a tenth of a millimetre of noise does not count as motion."""
TYRE_GRIP_M_S2 = 0.8 * 9.81
"""Whatever the motors do, tyres with a friction of 0.8 cannot push harder."""
ODOMETRY_WINDOW_S = 2.0
ODOMETRY_LIMIT_M = 0.25
"""Wheels of a skid-steered base slip: 12 % of what it can drive in one window."""
CLEARANCE_M = 0.03
"""How deep an outline may reach into a wall or furniture: bumpers touch, poses have errors."""


def base_speed(case: Case) -> Finding:
    """Fastest motion of the base by motion capture. Where it was not seen it went no slower than straight."""
    pose = base_of(case)
    return standing(
        at_most(
            float(
                np.linalg.norm(_rate(moved_s(case, pose.time_s), pose.position_m), axis=1).max(initial=0.0)
            ),
            case.robot.limits.linear_m_s * TOLERANCE,
            "m/s",
            source="Husarion Panther: 2 m/s",
            detail=f"highest speed by {case.base_source}",
        )
    )


def base_acceleration(case: Case) -> Finding:
    """Hardest change of the base's speed by motion capture."""
    pose = base_of(case)
    begins_s, (before, middle, after) = _windows(moved_s(case, pose.time_s), pose.position_m, 2)
    change = np.linalg.norm(after - 2 * middle + before, axis=1) / WINDOW_S**2
    seen = ~blind(case, begins_s, begins_s + 2 * WINDOW_S)
    return standing(
        at_most(
            float(change[seen].max(initial=0.0)),
            TYRE_GRIP_M_S2,
            "m/s2",
            source="friction of the tyres on the lab's floor",
            detail=f"highest acceleration by {case.base_source}",
        )
    )


def turning_speed(case: Case) -> Finding:
    """Fastest turn of the base by motion capture."""
    pose = base_of(case)
    return standing(
        at_most(
            float(np.abs(_rate(moved_s(case, pose.time_s), pose.yaw_rad)).max(initial=0.0)),
            case.robot.limits.angular_rad_s * TOLERANCE,
            "rad/s",
            source="the site's limits of the robot",
            detail=f"highest turn rate by {case.base_source}",
        )
    )


def odometry(case: Case) -> Finding:
    """The robot's own odometry covers the ground that motion capture saw it cover."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    pose = base_of(case)
    table = table_of(case, ODOM, ns=case.robot.namespace)
    time_s = increasing(table)
    start_s, end_s = max(time_s[0], pose.time_s[0]), min(time_s[-1], pose.time_s[-1])
    edges = _between_holes(np.arange(start_s, end_s, ODOMETRY_WINDOW_S), time_s, ODOM)
    own = _travelled(edges, time_s, table.vector("pose.pose.position"))
    seen = _travelled(edges, pose.time_s, pose.position_m)
    on = ~blind(case, moved_s(case, edges[:-1]), moved_s(case, edges[1:]))
    return standing(
        at_most(
            float(np.abs(own - seen)[on].max(initial=0.0)),
            ODOMETRY_LIMIT_M,
            "m",
            source="slip of a skid-steered base",
            detail=f"largest disagreement with motion capture in {ODOMETRY_WINDOW_S:g} s",
        )
    )


def stays_in_room(case: Case) -> Finding:
    """How deep the base's outline ever was in a wall or in furniture."""
    pose = base_of(case)
    seen = np.column_stack([pose.position_m[:, :2], pose.yaw_rad])
    # The deepest of thousands of noisy poses is deeper than the base ever was.
    at = smoothed(pose.time_s, seen, pose.time_s)
    moved = moved_s(case, pose.time_s)
    # Beside a silence it is a guess.
    known = ~blind(case, moved - HALF_WINDOW_S, moved + HALF_WINDOW_S)
    at = at[known] if known.any() else seen
    outline = _outline()
    c, s = np.cos(at[:, 2:]), np.sin(at[:, 2:])
    x = at[:, :1] + c * outline[:, 0] - s * outline[:, 1]
    y = at[:, 1:2] + s * outline[:, 0] + c * outline[:, 1]
    length_m, width_m = case.site.lab.size_m
    depth = {"the walls": float(max(-x.min(), -y.min(), x.max() - length_m, y.max() - width_m))}
    for furniture in case.site.lab.furniture:
        along, across = np.abs(seen_from(furniture.pose, x, y))
        inside = np.minimum(furniture.size_m[0] / 2 - along, furniture.size_m[1] / 2 - across)
        depth[furniture.name] = float(inside.max())
    deepest = max(depth, key=lambda name: depth[name])
    return standing(
        at_most(
            max(depth[deepest], 0.0),
            CLEARANCE_M,
            "m",
            source="the site's walls and furniture",
            detail=f"into {deepest}",
        )
    )


def _rate(time_s: Array, values: Array) -> Array:
    """Change of `values` (n, m) or (n,) per second, over WINDOW_S from and to each sample."""
    _, (first, last) = _windows(time_s, values, 1)
    return np.asarray((last - first) / WINDOW_S)


def _windows(time_s: Array, values: Array, count: int) -> tuple[Array, list[Array]]:
    """When the windows begin, and `values` at the edges of `count` windows in a row that begin or end at each
    sample. Values between two samples are interpolated: a body without signed poses rests."""
    length_s = count * WINDOW_S
    begins_s = np.concatenate([time_s, time_s - length_s])
    begins_s = begins_s[(begins_s >= time_s[0]) & (begins_s <= time_s[-1] - length_s)]
    columns = values.reshape(len(values), -1).T
    edges = []
    for number in range(count + 1):
        at_s = begins_s + number * WINDOW_S
        found = np.stack([np.interp(at_s, time_s, column) for column in columns], axis=1)
        edges.append(found if values.ndim == 2 else found[:, 0])
    return begins_s, edges


def _between_holes(edges_s: Array, time_s: Array, topic: Topic) -> Array:
    """Those of `edges_s` that lie in no hole of the samples at `time_s`. Where a body was in a hole is not
    known, and it may have moved in a part of it only: one long window compares what it covered in all."""
    behind = np.clip(np.searchsorted(time_s, edges_s, side="right"), 1, len(time_s) - 1)
    return edges_s[~holes(time_s, topic)[behind - 1]]


def _travelled(edges_s: Array, time_s: Array, position_m: Array) -> Array:
    """Distance between the positions at successive `edges_s`, in the plane."""
    at = np.stack([np.interp(edges_s, time_s, position_m[:, i]) for i in (0, 1)], axis=1)
    return np.linalg.norm(np.diff(at, axis=0), axis=1)


def _outline() -> Array:
    """(m, 2) points on the edge of the base's footprint, about 10 cm apart."""
    along = np.linspace(-1, 1, 9)
    front = [(sign * BUMPER_M, t * HALF_WIDTH_M) for sign in (-1, 1) for t in along]
    side = [(t * BUMPER_M, sign * HALF_WIDTH_M) for sign in (-1, 1) for t in along]
    return np.array(front + side)
