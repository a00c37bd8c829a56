"""One cleaning as a moving picture, rebuilt from its sealed recording: `rodeo_cli.lab_picture` writes it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import cv2
import mujoco
import numpy as np

from rodeo.checks.case import Case, CaseError
from rodeo.checks.motion.phases import phases_of
from rodeo.checks.motion.poses import Pose, base_of, pose_of
from rodeo.checks.signed.testimony import bin_said
from rodeo.checks.tables import increasing, joints_of
from rodeo.checks.verify import case_of, verify_file
from rodeo.errors import RodeoError
from rodeo.evidence.proof import open_proof
from rodeo.evidence.series import Array
from rodeo.kinds import kinds_of
from rodeo.lab.body import joint_names
from rodeo.lab.layout import Vec3
from rodeo.lab.render import Camera
from rodeo.lab.world import WHEEL_JOINTS, arm_model, begin, build_world
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.statement import Classification, Drop

FRAMES_PER_S = 12
_LEAST_PACE = 0.12
"""A robot that stands still passes this fast, as a share of its usual pace in the same scene."""
_END_S = 1.5
"""For which the last frame stays."""
_BEFORE_GRASP_S, _AFTER_LIFT_S, _BEFORE_SHOWN_S, _AFTER_DROP_S = 6.0, 2.0, 4.0, 1.5
_FONT = cv2.FontFace("sans")
_WHITE, _DARK = (245, 245, 245), (28, 30, 34)


@dataclass(frozen=True)
class View:
    """The camera's target (m), distance (m) and direction (degrees)."""

    lookat_m: Vec3
    distance_m: float
    azimuth_deg: float
    elevation_deg: float

    @property
    def row(self) -> tuple[float, ...]:
        return (*self.lookat_m, self.distance_m, self.azimuth_deg, self.elevation_deg)


@dataclass(frozen=True)
class Scene:
    """A part of the film: a stretch of the recording, how many seconds it lasts, and one caption. The camera
    moves from the view of the scene before to `view`."""

    until_s: float
    lasts_s: float
    caption: str
    view: View
    shows_picture: bool = False
    """Whether the bin's picture is shown in a corner."""


class Film:
    """Renders the work of one recording. Use it from the thread that made it.

    Raises EvidenceError where the recording is not sealed or shows no cleaning, RendererUnavailable.
    """

    def __init__(
        self, recording: Path, site: Site, size_px: tuple[int, int], frames_per_s: int = FRAMES_PER_S
    ) -> None:
        self._case = case = case_of(open_proof(recording), site, None)
        report = verify_file(recording, site)
        if not report.accepted:
            raise CaseError("the checks do not accept this recording", reason=report.reason)
        self.frames_per_s = frames_per_s
        self._model = build_world(site)
        self._data = begin(self._model, site)
        self._view = mujoco.MjvCamera()
        self._camera = Camera(self._model, self._view, *size_px)
        self._base, self._item = base_of(case), pose_of(case, case.item.id)
        joints, prefix = joints_of(case), f"{case.robot.name}/"
        names = list(joint_names(arm_model(case.robot.kinematics)))
        self._joints = increasing(joints), joints.named("position", names)
        self._joints_at = [self._model.joint(prefix + name).qposadr[0] for name in names]
        self._picture, self.scenes = _script(case)

    @property
    def item_m(self) -> Vec3:
        """Position of the item in the last frame."""
        x_m, y_m, z_m = self._data.body(self._case.item.id).xpos
        return float(x_m), float(y_m), float(z_m)

    def frames(self) -> Iterator[Array]:
        """(height, width, 3) uint8, RGB, `frames_per_s` of them for each second of the scenes."""
        times_s = self._base.time_s
        from_s, view = float(times_s[0]), self.scenes[0].view
        for scene in self.scenes:
            count = max(1, round(scene.lasts_s * self.frames_per_s))
            shares = np.arange(1, count + 1) / count
            for time_s, share in zip(self._paced(from_s, scene.until_s, shares), shares, strict=True):
                self._look(view, scene.view, share)
                yield self._frame(float(time_s), scene)
            from_s, view = scene.until_s, scene.view

    def _paced(self, from_s: float, until_s: float, shares: Array) -> Array:
        """The times (s) at which these shares of the scene's motion have passed."""
        at_s = np.linspace(from_s, until_s, 400)
        rows = self._rows(at_s)
        way = np.abs(np.diff(rows, axis=0)).sum(axis=1)
        usual = float(way.mean()) or 1.0
        passed = np.concatenate([[0.0], np.cumsum(np.maximum(way / usual, _LEAST_PACE))])
        return np.interp(shares * passed[-1], passed, at_s)

    def _rows(self, at_s: Array) -> Array:
        """(n, 7 + joints) base and joints at these moments, without the wheels."""
        time_s, positions = self._joints
        base = np.hstack([self._base.position_m, self._base.quaternion])
        return np.hstack(
            [
                _between(self._base.time_s, base, at_s),
                _between(time_s, positions[:, : -len(WHEEL_JOINTS)], at_s),
            ]
        )

    def _look(self, before: View, after: View, share: float) -> None:
        """From one view to the next, slowly at either end."""
        eased = share * share * (3 - 2 * share)
        *lookat, distance, azimuth, elevation = (1 - eased) * np.array(before.row) + eased * np.array(
            after.row
        )
        self._view.lookat[:] = lookat
        self._view.distance, self._view.azimuth, self._view.elevation = distance, azimuth, elevation

    def _frame(self, time_s: float, scene: Scene) -> Array:
        data, case = self._data, self._case
        self._put(f"{case.robot.name}/base_link", self._base, time_s)
        self._put(case.item.id, self._item, time_s)
        times_s, positions = self._joints
        data.qpos[self._joints_at] = _between(times_s, positions, np.array([time_s]))[0]
        mujoco.mj_forward(self._model, data)
        image = self._camera.image(data).copy()
        if scene.shows_picture:
            _inset(image, self._picture)
        _caption(image, scene.caption)
        return image

    def _put(self, body: str, pose: Pose, time_s: float) -> None:
        at = self._model.jnt_qposadr[self._model.body_jntadr[self._model.body(body).id]]
        row = _between(pose.time_s, np.hstack([pose.position_m, pose.quaternion]), np.array([time_s]))[0]
        self._data.qpos[at : at + 7] = row

    def close(self) -> None:
        self._camera.close()


def write(film: Film, path: Path, quality: int) -> int:
    """Writes the animation (.webp, .gif, .png), whose last frame stays for a moment. How many frames it has.

    Raises RodeoError where OpenCV cannot encode it.
    """
    animation = cv2.Animation()
    animation.frames = [cv2.cvtColor(frame, cv2.COLOR_RGB2BGR) for frame in film.frames()]
    animation.durations = [round(1000 / film.frames_per_s)] * (len(animation.frames) - 1) + [
        round(1000 * _END_S)
    ]
    options = [cv2.IMWRITE_WEBP_QUALITY, quality] if path.suffix == ".webp" else []
    ok, encoded = cv2.imencodeanimation(path.suffix, animation, options)
    if not ok:
        raise RodeoError("cannot encode the animation", path=str(path), frames=len(animation.frames))
    path.write_bytes(encoded.tobytes())
    return len(animation.frames)


def _script(case: Case) -> tuple[Array, list[Scene]]:
    """The bin's picture of the item and the scenes, by the times in the recording."""
    phases, said = phases_of(case), [one.statement for one in bin_said(case)]
    shown = next((one for one in said if isinstance(one, Classification)), None)
    drop = next((one for one in said if isinstance(one, Drop)), None)
    if shown is None or drop is None:
        raise CaseError("the bin's classification or drop is not in the recording", bin=case.bin.name)
    item, robot = pose_of(case, case.item.id), base_of(case)
    thing, paid_iec = case.item.shape, f"{kinds_of(case.site)[str(case.kind)].price_iec:g} IEC"
    begin_s, end_s = float(robot.time_s[0]), float(robot.time_s[-1])
    arrives_s = phases.closing_s - _BEFORE_GRASP_S
    grasp_deg = np.degrees(np.interp(phases.closing_s, robot.time_s, robot.yaw_rad)) + 100
    bin_deg = np.degrees(case.bin.pose.yaw_rad) + 230
    x_m, y_m, _ = item.position_m[0]
    (length_m, width_m), bin_m = case.site.lab.size_m, (case.bin.pose.x_m, case.bin.pose.y_m - 0.3)
    wide = View((0.485 * length_m, 0.46 * width_m, 0.1), 0.8 * length_m, 70, -36)
    near_item = View((x_m - 0.15, y_m + 0.05, 0.2), 2.2, grasp_deg, -27)
    at_bin, near_bin = View((*bin_m, 0.4), 3.2, bin_deg - 20, -34), View((*bin_m, 0.42), 2.1, bin_deg, -36)
    return _picture(case, shown.image_sha256), [
        Scene(begin_s + 0.25 * (arrives_s - begin_s), 1.4, f"A task is posted, for {paid_iec}", wide),
        Scene(arrives_s, 2.2, f"The robot drives to the {thing}", near_item),
        Scene(phases.lifted_s + _AFTER_LIFT_S, 2.2, f"It grasps the {thing}", near_item),
        Scene(shown.shown_s - _BEFORE_SHOWN_S, 2.4, "It drives to the bin", at_bin),
        Scene(shown.shown_s, 1.4, f"It shows the {thing} to the bin's camera", near_bin),
        Scene(
            shown.time_s + 0.2,
            1.3,
            f"The bin says: {shown.item_class}, into the {shown.compartment} compartment",
            near_bin,
            shows_picture=True,
        ),
        Scene(drop.settled_s + _AFTER_DROP_S, 1.6, f"It drops the {thing}, and the bin weighs it", near_bin),
        Scene(end_s, 2.0, f"An oracle replays the recording and accepts it: {paid_iec} are paid", wide),
    ]


def _picture(case: Case, wanted: str) -> Array:
    """The picture with this hash, RGB. Raises CaseError where it is not in the recording."""
    column = case.proof.topics.get("/" + topics.BIN_IMAGE.name(bin=case.bin.name))
    for message in column.data if column else []:
        data = types.deserialize(message, topics.BIN_IMAGE.type).data
        if "0x" + sha256(data).hexdigest() == wanted:
            image = cv2.imdecode(data, cv2.IMREAD_COLOR)
            if image is not None:
                return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    raise CaseError(
        "the recording has no picture with the hash that the bin signed, or it cannot be decoded",
        image_sha256=wanted,
    )


def _between(time_s: Array, rows: Array, at_s: Array) -> Array:
    """(n, columns) of `rows`, in between by their neighbours."""
    return np.stack([np.interp(at_s, time_s, column) for column in rows.T], axis=1)


def _caption(image: Array, text: str) -> None:
    """On a dark strip along the lower edge."""
    height = image.shape[0]
    size = round(height / 21)
    strip = image[height - 2 * size :]
    strip[:] = (0.35 * strip + 0.65 * np.array(_DARK)).astype(np.uint8)
    cv2.putText(image, text, (size, height - round(0.68 * size)), _WHITE, _FONT, size, 500)


def _inset(image: Array, picture: Array) -> None:
    """The bin's picture, in the upper left corner."""
    height = image.shape[0]
    tall, edge = round(height * 0.36), max(2, height // 200)
    wide = round(tall * picture.shape[1] / picture.shape[0])
    small = cv2.resize(picture, (wide, tall), interpolation=cv2.INTER_AREA)
    framed = cv2.copyMakeBorder(small, edge, edge, edge, edge, cv2.BORDER_CONSTANT, value=_WHITE)
    top = height // 30
    image[top : top + framed.shape[0], top : top + framed.shape[1]] = framed
