"""An honest cleaning, filmed in the lab's physics, and its task."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rodeo.checks.case import ChainRecord
from rodeo.lab.config import BinConfig, ItemConfig, Pose2
from rodeo.lab.drop import JUDGED_AFTER_DROP_S, RECORDED_AFTER_DROP_S, WATCHED_S
from rodeo.lab.layout import PICK_DISTANCE_M, BinLayout
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.vision.classification import model_sha256, thresholds_sha256
from rodeo_testing.assignments import chain_record
from rodeo_testing.recordings import RENDERINGS, Camera, FilmedOperator, Reality, Sample, Take, moved

KIND = "waste_disposal"


def cleaning_chain_record(take: Take, params: dict[str, Any] | None = None, **task: Any) -> ChainRecord:
    """The chain's view of a cleaning of `item1`, unless `params` say otherwise."""
    return chain_record(take, KIND, params or {"item_id": "item1", "x_m": 4.6, "y_m": 1.2}, **task)


def film_cleaning(
    site: Site,
    item_id: str,
    *,
    compartment: str | None = None,
    grip_n: float = 5.0,
    start: Pose2 | None = None,
    via: Sequence[tuple[float, float]] = ((4.7, 1.7), (5.2, 3.4)),
    linger_s: float = 0.0,
    sway_rad: float = 0.0,
    after_drop_s: float = JUDGED_AFTER_DROP_S + 1.0,
    reality: Reality = lambda _spec: None,
) -> Take:
    """Fetch `item_id` and drop it into its compartment, or into `compartment`, whatever the bin asks for.

    The robot starts half a metre west of the item (or at `start`) and carries it `via` these points.
    It stands about for `linger_s` before it picks and while it carries. While it drives with the item all
    joints of its arm sway by `sway_rad`. The film ends `after_drop_s` after the drop. `reality` changes what
    the world is like beside the site file.
    """
    camera = Camera(site, reality)
    operator = FilmedOperator(camera)
    item = next(item for item in site.items if item.id == item_id)
    layout = BinLayout(site.bins[0])
    place = camera.data.body(item_id)
    beside = Pose2(x_m=float(place.xpos[0]) - PICK_DISTANCE_M, y_m=float(place.xpos[1]))
    before = start or Pose2(x_m=beside.x_m - 0.5, y_m=beside.y_m)
    camera.put_robot(before)
    operator.wait(0.5)
    operator.move(operator.stowed_rad)
    operator.drive_to(beside)

    operator.wait(linger_s / 2)
    operator.pick(item, grip_n)
    operator.wait(linger_s / 2)
    if sway_rad:
        operator.sway(sway_rad)
    _carry(operator, camera, via, layout)

    camera.say("robot/presentation", bin=site.bins[0].name)
    operator.show(item, layout)
    wanted = _classified(camera, site.bins[0], item)
    released_s = camera.now_ns * 1e-9
    operator.drop(item, layout, compartment or wanted)
    inside = [n for n in site.bins[0].compartments if layout.contains(n, tuple(place.xpos))]
    if inside:
        camera.say(
            "bin/drop",
            number=1,
            classification=1,
            compartment=inside[0],
            expected_compartment=wanted,
            weight_n=round(item.mass_kg * 9.81, 3),
            after_s=released_s,
            settled_s=camera.now_ns * 1e-9,
            correct=inside[0] == wanted,
        )
    operator.wait(0.5)
    camera.still(after_drop_s)
    return Take(camera.samples)


def _carry(
    operator: FilmedOperator, camera: Camera, via: Sequence[tuple[float, float]], layout: BinLayout
) -> None:
    for x_m, y_m in via:
        here = camera.body.pose
        operator.drive_to(Pose2(x_m=x_m, y_m=y_m, yaw_rad=math.atan2(y_m - here.y_m, x_m - here.x_m)))
    operator.drive_to(layout.parking)
    operator.sway_no_more()


def _classified(camera: Camera, smart_bin: BinConfig, item: ItemConfig) -> str:
    """The compartment that the bin asks for: it takes a picture and says what it is."""
    wanted = smart_bin.compartment_of(item.item_class)
    picture = (RENDERINGS / f"{item.item_class.value}_1.jpg").read_bytes()
    camera.photograph(smart_bin.name, picture)
    camera.say(
        "bin/classification",
        number=1,
        item_class=item.item_class.value,
        probabilities={item.item_class.value: 1.0},
        compartment=wanted,
        full=False,
        image_sha256="0x" + hashlib.sha256(picture).hexdigest(),
        model_sha256=model_sha256(),
        thresholds_sha256=thresholds_sha256(),
        shown_s=camera.now_ns * 1e-9,
    )
    return wanted


def watched(take: Take, for_s: float = RECORDED_AFTER_DROP_S) -> Take:
    """`take` recorded for `for_s` after the drop, with the bin's statement at the end of its watch."""
    drop = take.of("bin/drop")[-1].message
    settled_s, until_s = drop["settled_s"], drop["settled_s"] + WATCHED_S
    longer = take.standing(settled_s + for_s + 1.0 - take.end_s)
    watch = {"drop": drop["number"], "compartment": drop["compartment"], "after_s": settled_s}
    said = Sample("bin/watch", "", watch | {"until_s": until_s}, round(until_s * 1e9))
    return Take(sorted([*longer.samples, said], key=lambda sample: sample.time_ns))


def without_mocap(take: Take, item_id: str, off_m: tuple[float, float] = (0.0, 0.0)) -> Take:
    """The same film at a site without motion capture, whose robot sees the item this far from where it is."""
    lies = take.of(topics.MOCAP_POSE.name(body=item_id))[0]
    at = lies.message.pose.position
    seen = moved(lies, x=at.x + off_m[0], y=at.y + off_m[1])
    robot = next(found["ns"] for s in take.samples if (found := topics.JOINT_STATES.parts(s.topic)))
    samples = []
    for sample in take.samples:
        if sample.topic == topics.MOCAP_POSE.name(body=robot):
            samples.append(replace(sample, topic=topics.POSE.name(ns=robot)))
        elif sample is lies:
            samples.append(replace(seen, topic=topics.ITEM_POSE.name(ns=robot)))
        elif not topics.MOCAP_POSE.parts(sample.topic):
            samples.append(sample)
    return Take(samples)
