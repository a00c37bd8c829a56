"""The signed poses of a proof, in files for other people's tools: a derived MCAP with `/tf`, and CSV.

A robot's odometry drifts by metres over hours. Motion capture's signed poses do not drift, but only RODEO
reads the statements that hold them. The files written here are not sealed, and say so.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO, StringIO

import numpy as np
from mcap.writer import Writer

from rodeo.checks.case import Case, CaseError
from rodeo.checks.motion.poses import Pose, base_of, motions_of, pose_of
from rodeo.checks.signed.testimony import motion_capture_of
from rodeo.evidence.container import limit
from rodeo.evidence.errors import LayoutChanged
from rodeo.evidence.series import Array
from rodeo.ros2.definitions import schema_text
from rodeo.ros2.types import new, serialize, time_message

MAP = "map"
DERIVED = "rodeo:derived"
"""Name of the metadata record of a derived file."""
_HELD_S = 1.0
"""A body at rest has a pose at either end of the rest. Between them the pose is written once per this time,
because tf2 forgets poses after 10 s."""
_LONGEST_S = 24 * 3600.0
"""A recording of a day is the longest that readers of proofs admit."""
_FARTHEST_M = 300.0
_MOST_BODIES = 100
COLUMNS = ("time_s", "body", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "statement")
_TF, _TRANSFORM = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"
_PATH, _POSE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"


@dataclass(frozen=True)
class Bodies:
    """The poses of a proof's bodies, by the names that motion capture gives them."""

    poses: dict[str, Pose]
    source: str
    signer: str
    """Address of the device that signed them, empty where nobody did."""


def bodies_of(case: Case) -> Bodies:
    """What motion capture signed; on a site without, where the robot's own localisation saw the base.

    Raises CaseError where the recording has no pose at all, OthersFailed where they are nonsense, and
    ProofTooLarge.
    """
    found: dict[str, Pose] = {}
    try:
        if case.mocap:
            names = sorted({name for one in motions_of(case) for name in (*one.tracks, *one.resting)})
            limit("bodies", len(names), _MOST_BODIES)
            for body in names:
                # One that was seen once only has no motion.
                if (pose := _seen(case, body)) is not None:
                    found[body] = bounded(pose)
        else:
            found[case.robot.name] = bounded(base_of(case))
    except (CaseError, LayoutChanged) as error:
        raise CaseError("nobody signed poses in this recording", problem=error.message) from error
    if not found:
        raise CaseError("nobody signed poses in this recording")
    return Bodies(found, case.base_source, motion_capture_of(case).address if case.mocap else "")


def bounded(pose: Pose) -> Pose:
    """The pose, if a picture or a file of it has a size that anybody wants. Raises ProofTooLarge."""
    limit("seconds of poses", math.ceil(pose.time_s[-1] - pose.time_s[0]), int(_LONGEST_S))
    limit("metres from the room's corner", math.ceil(np.abs(pose.position_m).max()), int(_FARTHEST_M))
    return pose


def _seen(case: Case, body: str) -> Pose | None:
    try:
        return pose_of(case, body)
    except CaseError:
        return None


def mcap(case: Case, bodies: Bodies) -> bytes:
    """An MCAP file with `/tf` in the map, and the whole way of each body as `/<body>/path`."""
    file = BytesIO()
    writer = Writer(file)
    writer.start(profile="ros2", library="rodeo, derived")
    writer.add_metadata(DERIVED, _origin(case, bodies))
    schemas = {
        name: writer.register_schema(name, "ros2msg", schema_text(name).encode()) for name in (_TF, _PATH)
    }
    tf = writer.register_channel("/tf", "cdr", schemas[_TF])
    first_ns = min(_nanoseconds(pose.time_s[0]) for pose in bodies.poses.values())
    for body, pose in bodies.poses.items():
        channel = writer.register_channel(f"/{body}/path", "cdr", schemas[_PATH])
        stamps = [
            new(_POSE, header=_header(at_ns), pose=_pose(position, quaternion))
            for at_ns, position, quaternion in rows_of(pose)
        ]
        path = serialize(new(_PATH, header=_header(first_ns), poses=stamps))
        writer.add_message(channel, first_ns, path, first_ns)
    for at_ns, body, position, quaternion in sorted(
        (
            (*row[:1], body, *row[1:])
            for body, pose in bodies.poses.items()
            for row in rows_of(pose, held=True)
        ),
        key=lambda row: row[:2],
    ):
        transform = new(_TRANSFORM, header=_header(at_ns), child_frame_id=body)
        at, turn = transform.transform.translation, transform.transform.rotation
        at.x, at.y, at.z = position
        turn.w, turn.x, turn.y, turn.z = quaternion
        writer.add_message(tf, at_ns, serialize(new(_TF, transforms=[transform])), at_ns)
    writer.finish()
    return file.getvalue()


def table(case: Case, bodies: Bodies) -> str:
    """The signed poses as CSV, a row for each; `statement` is the number of the one that says it."""
    file = StringIO()
    lines = csv.writer(file, lineterminator="\n")
    lines.writerow(COLUMNS)
    motions = motions_of(case) if case.mocap else []
    for body, pose in bodies.poses.items():
        for number, (time_s, position, quaternion) in enumerate(
            zip(pose.time_s, pose.position_m, pose.quaternion, strict=True)
        ):
            seq = "" if pose.statement is None else motions[int(pose.statement[number])].seq
            values = (*(f"{one:.4f}" for one in position), *(f"{one:.6f}" for one in quaternion))
            lines.writerow((f"{time_s:.6f}", body, *values, seq))
    return file.getvalue()


def _origin(case: Case, bodies: Bodies) -> dict[str, str]:
    proof = case.proof
    binding = proof.binding
    return {
        "derived": "true",
        "note": "computed from a sealed proof, signed by nobody, and no proof itself",
        "from_sha256": proof.sha256,
        "from_signer": proof.signer or "",
        "task_id": "" if binding is None else str(binding.task_id),
        "attempt": "" if binding is None else str(binding.attempt),
        "poses": bodies.source,
        "poses_signed_by": bodies.signer,
        "frame": MAP,
    }


def rows_of(pose: Pose, held: bool = False) -> Iterator[tuple[int, list[float], list[float]]]:
    """Time (ns), position and quaternion of each pose; with `held` also in the middle of rests."""
    time_s = _held(pose) if held else pose.time_s
    rows = np.clip(np.searchsorted(pose.time_s, time_s, side="right") - 1, 0, None)
    for at_s, row in zip(time_s, rows, strict=True):
        yield _nanoseconds(at_s), pose.position_m[row].tolist(), pose.quaternion[row].tolist()


def _held(pose: Pose) -> Array:
    """The times of the poses, and of those between the ends of each rest that was seen."""
    more = [pose.time_s]
    for start_s, end_s in zip(pose.time_s[:-1], pose.time_s[1:], strict=True):
        unseen = any(from_s < end_s and start_s < until_s for from_s, until_s in pose.unseen_s)
        if end_s - start_s > _HELD_S and not unseen:
            more.append(np.arange(start_s + _HELD_S, end_s, _HELD_S))
    return np.unique(np.concatenate(more))


def _nanoseconds(time_s: float) -> int:
    return round(float(time_s) * 1e6) * 1000


def _header(at_ns: int) -> object:
    return new("std_msgs/msg/Header", stamp=time_message(at_ns), frame_id=MAP)


def _pose(position: list[float], quaternion: list[float]) -> object:
    w, x, y, z = quaternion
    return new(
        "geometry_msgs/msg/Pose",
        position=new("geometry_msgs/msg/Point", x=position[0], y=position[1], z=position[2]),
        orientation=new("geometry_msgs/msg/Quaternion", w=w, x=x, y=y, z=z),
    )
