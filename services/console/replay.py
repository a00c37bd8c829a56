"""A recording as pages replay it: poses at a few hundred instants, statements in between, and pictures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from rodeo.display.checked import lines
from rodeo.display.formatting import phrase
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.errors import BadStatement, LayoutChanged
from rodeo.evidence.proof import Proof
from rodeo.evidence.series import Table
from rodeo.lab.config import RobotConfig
from rodeo.lab.headings import yaws_of
from rodeo.robot.recording import PICTURE, STALLED
from rodeo.ros2 import types
from rodeo.ros2.errors import MalformedMessage
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL
from rodeo.text.strict_json import Json
from rodeo.witness.motion import track as signed_track
from rodeo.witness.statement import Classification, Drop, Motion, Removal, Watch, parse
from services.console.curves import carried, checks_at, curves, gap_m, recorded, rows_at
from services.console.scene import arm_drawing
from services.console.solids import joint_names

Array = np.ndarray[Any, Any]

FRAMES = 600
"""Most instants; a browser gets them all at once."""
_MARKS = 60
_TEXT = 160
"""Characters of one mark."""
_PICTURES, _PICTURE_BYTES = 6, 200_000
"""Most pictures of one camera, and most bytes of one: they come in the page's own message."""
_WRIST = "wrist camera"
_KINDS = {b"\x89PNG": "png", b"\xff\xd8\xff": "jpeg"}


def track(proof: Proof, site: Site, report: Json | None = None) -> Json:
    """The recording as `LabReplay` shows it, with the checks of the `report`. Raises EvidenceError when a
    topic cannot be read."""
    start_ns, end_ns = proof.start_ns, proof.end_ns
    duration_s = (end_ns - start_ns) * 1e-9
    frames = int(min(FRAMES, max(2, duration_s * 2)))
    at_ns = np.linspace(start_ns, end_ns, frames)
    motion = _motion(proof)
    t = [round(float(one), 1) for one in (at_ns - start_ns) * 1e-9]
    robots = {one.name: _robot(proof, motion, one, at_ns) for one in site.robots}
    items = {one.id: _pose(motion, one.id, at_ns) for one in site.items}
    seen = {name: one for name, one in items.items() if one is not None}
    marks, moments = _marks(proof, start_ns)
    moments |= {"started": 0.0, "ended": t[-1]}
    checked = lines(report or {})
    drawn: list[Json] = []
    robot = next((one for one in site.robots if robots[one.name] is not None), None)
    if robot is not None:
        drawn = curves(proof, site, robot, at_ns, checked)
        for moment, (at_s, item) in carried(seen, gap_m(proof, robot, at_ns), t).items():
            marks.append({"t": at_s, "text": f"{moment.capitalize()} {item}"})
            moments[moment] = at_s
    return {
        "duration_s": round(duration_s, 1),
        "t": t,
        "robots": {name: one for name, one in robots.items() if one is not None},
        "items": seen,
        "marks": sorted(marks, key=lambda mark: mark["t"])[:_MARKS],
        "pictures": pictures(proof, site),
        "curves": drawn,
        "checks": checks_at(moments, drawn, t, checked),
    }


def _motion(proof: Proof) -> list[Motion]:
    """Statements of motion capture, in the order of its chain. The oracle decides whose signatures count."""
    said: dict[str, dict[int, Motion]] = {}
    for value in proof.json(ATTESTATION_CHANNEL):
        try:
            attestation = Attestation.model_validate(value)
            statement = parse(attestation.payload)
        except (ValidationError, BadStatement):
            continue  # anybody may have put it there
        if isinstance(statement, Motion):
            said.setdefault(attestation.signer, {}).setdefault(statement.seq, statement)
    chain = max(said.values(), key=len, default={})
    return [chain[seq] for seq in sorted(chain)]


def _pose(motion: list[Motion], body: str, at_ns: Array) -> Json | None:
    seen = signed_track(motion, body)
    if seen is None:
        return None
    rows = np.clip(np.searchsorted(seen.time_us, at_ns // 1000, side="right") - 1, 0, len(seen.time_us) - 1)
    x, y, z = seen.position_m[rows].T
    yaw = _rounded(yaws_of(seen.quaternion[rows]))
    quat = [_rounded(one) for one in seen.quaternion[rows]]
    return {"x": _rounded(x), "y": _rounded(y), "z": _rounded(z), "yaw": yaw, "quat": quat}


def _robot(proof: Proof, motion: list[Motion], robot: RobotConfig, at_ns: Array) -> Json | None:
    name, namespace = robot.name, robot.namespace
    columns = _pose(motion, name, at_ns)
    if columns is None:
        odom = recorded(proof, topics.ODOM, topics.ODOM.name(ns=namespace))
        if odom is None:
            return None
        rows = rows_at(odom, at_ns)
        columns = {axis: _rounded(odom[f"pose.pose.position.{axis}"][rows]) for axis in "xy"}
        columns["yaw"] = _rounded(_yaw(odom, "pose.pose.orientation", rows))
    columns.pop("z", None)
    joints = recorded(proof, topics.JOINT_STATES, topics.JOINT_STATES.name(ns=namespace))
    if joints is not None:
        arm = arm_drawing(robot.kinematics)
        try:
            angles = joints.named("position", arm.joints)[rows_at(joints, at_ns)]
        except LayoutChanged:
            angles = np.empty((0, len(arm.joints)))  # another robot's arm, which this map cannot draw
        columns["arm"] = [arm.points(row) for row in angles]
        columns["joints"] = _joints(joints, joint_names(robot.kinematics), at_ns)
    battery = recorded(proof, topics.BATTERY_STATE, topics.BATTERY_STATE.name(ns=namespace))
    if battery is not None:
        columns["soc"] = _rounded(battery["percentage"][rows_at(battery, at_ns)])
    return columns


def _joints(table: Table, names: list[str], at_ns: Array) -> list[list[float | None]]:
    """At each instant the positions of the drawing's joints; None of those that were not recorded."""
    known = set(table.names())
    rows = rows_at(table, at_ns)
    columns = [
        _rounded(table.named("position", [name])[rows, 0]) if name in known else [None] * len(rows)
        for name in names
    ]
    return [list(one) for one in zip(*columns, strict=True)]


def _yaw(table: Table, path: str, rows: Array) -> Array:
    return yaws_of(np.stack([table[f"{path}.{axis}"][rows] for axis in "wxyz"], axis=1))


def _rounded(values: Array, digits: int = 3) -> list[float | None]:
    """None for what is no number."""
    return [round(float(value), digits) if np.isfinite(value) else None for value in values]


def _marks(proof: Proof, start_ns: int) -> tuple[list[Json], dict[str, float]]:
    """Contract events, notes of the recorder, statements of devices; and when which of `MOMENTS` was."""
    marks: list[Json] = []
    moments: dict[str, float] = {}
    for channel in (EVENT_CHANNEL, ATTESTATION_CHANNEL):
        for log_ns, value in zip(_logged_ns(proof, channel), proof.json(channel), strict=True):
            text, moment = _sentence(value)
            at_s = round((log_ns - start_ns) * 1e-9, 1)
            marks += [{"t": at_s, "text": text[:_TEXT]}] if text else []
            moments |= {moment: at_s} if moment else {}
    return marks, moments


def pictures(proof: Proof, site: Site) -> list[Json]:
    """The last pictures of each camera of the recording, by time; `from` also says what the robot noted that
    its own are of."""
    noted = [
        (log_ns, str(event.get("of"))[:_TEXT])
        for log_ns, event in zip(_logged_ns(proof, EVENT_CHANNEL), proof.events(), strict=True)
        if event.get("event") == PICTURE
    ]
    cameras = {topics.BIN_IMAGE.name(bin=one.name): f"{one.name}'s camera" for one in site.bins}
    cameras |= {topics.WRIST_IMAGE.name(ns=one.namespace): f"{one.name}'s {_WRIST}" for one in site.robots}
    found = [
        {"t": round((log_ns - proof.start_ns) * 1e-9, 1), "from": _of(whose, log_ns, noted), "src": src}
        for topic, whose in cameras.items()
        if (column := proof.topics.get("/" + topic)) is not None
        for log_ns, data in [*zip(column.log_ns, column.data, strict=True)][-_PICTURES:]
        if (src := _picture(data))
    ]
    return sorted(found, key=lambda one: one["t"])


def _of(whose: str, log_ns: int, noted: list[tuple[int, str]]) -> str:
    of = [of for at_ns, of in noted if at_ns <= log_ns]
    return f"{whose}: {of[-1]}" if of and whose.endswith(_WRIST) else whose


def _logged_ns(proof: Proof, channel: str) -> Sequence[int]:
    return proof.topics[channel].log_ns if proof.count(channel) else []


def _picture(data: bytes) -> str:
    """The picture as the source of an image; empty for what is none, or too large."""
    try:
        picture = types.deserialize(data, topics.BIN_IMAGE.type).data.tobytes()
    except MalformedMessage:
        return ""
    kind = next((kind for start, kind in _KINDS.items() if picture.startswith(start)), "")
    if not kind or len(picture) > _PICTURE_BYTES:
        return ""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"


def _stated(payload: Json) -> tuple[str, str]:
    try:
        statement = parse(payload)
    except BadStatement:
        return "", ""
    match statement:
        case Classification():
            return f"Bin: this is {statement.item_class}", "shown to the bin"
        case Drop():
            return f"Bin: it fell into {statement.compartment}", "fell into the bin"
        case Removal():
            return f"Bin: something was taken out of {statement.compartment}", ""
        case Watch():
            return f"Bin: watched {statement.compartment} after the drop", ""
    return "", ""


def _sentence(value: Json) -> tuple[str, str]:
    """One recorded object in words, and its moment; empty for readings that come every second."""
    payload = value.get("payload")
    if isinstance(payload, dict):
        return _stated(payload)
    name = value.get("name") or value.get("event")
    if not isinstance(name, str):
        return "", ""
    if name == PICTURE:
        return "", ""
    if name == STALLED:
        return "The robot's odometry was silent", ""
    detail = value.get("message")
    told = f"{phrase(name)}: {detail}" if isinstance(detail, str) else phrase(name)
    return told, "gave up" if name == "execution_failed" else ""
