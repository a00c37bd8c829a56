"""Frames of a source: when they were taken, which are old, and where their bodies are in the map."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from rodeo.lab.config import MocapConfig, Pose2
from services.mocap.frames import Inbox, in_map, table
from services.mocap.sources import Frame, Opening, Pose, Source, SourceKind
from services.mocap.times import SiteTime, SystemTime

S = 1_000_000_000
START = 1_800_000_000 * S
UPRIGHT = Pose((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))


class Now:
    """A clock that stands where a test sets it."""

    def __init__(self) -> None:
        self.time_ns = START

    def now_ns(self) -> int:
        return self.time_ns

    def now_s(self) -> float:
        return self.time_ns * 1e-9


def never(_opening: Opening) -> Source:
    raise AssertionError("no source is opened here")


Deliver = Callable[..., list[tuple[int, dict[str, Pose | None]]]]


@pytest.fixture
def now() -> Now:
    return Now()


def inbox(now: Now, kind: SourceKind, **config: object) -> Inbox:
    bodies = {"Can 1": "item1", "panther1": "panther1"}
    return Inbox(MocapConfig.model_validate(config), kind, bodies, now)


SYSTEM, SITE = SourceKind(never), SourceKind(never, stamps="site")


@pytest.mark.parametrize("epoch_ns", [0, 7 * S, START + 3 * S])
def test_a_systems_own_clock_may_start_anywhere_and_late_frames_keep_their_time(epoch_ns: int) -> None:
    times = SystemTime(latency_ns=8_000_000)
    delays_ns = [3_000_000, 40_000_000, 0, 200_000_000, 12_000_000]
    found = [
        times.taken_ns(epoch_ns + at * S // 100, START + at * S // 100 + delay_ns + 8_000_000)
        for at, delay_ns in enumerate(delays_ns)
    ]
    # From the fastest one on nothing is off; before it by no more than the fastest until then was late.
    assert found[2:] == [START + at * S // 100 for at in (2, 3, 4)]
    assert [one - START - at * S // 100 for at, one in enumerate(found[:2])] == [3_000_000, 3_000_000]


def test_a_system_that_starts_anew_is_followed_from_its_next_frame_on() -> None:
    times = SystemTime(latency_ns=0)
    assert times.taken_ns(90 * S, START) == START
    assert times.taken_ns(1 * S, START + S) == START + S
    assert times.taken_ns(2 * S, START + 2 * S) == START + 2 * S


@pytest.mark.parametrize("off_s", [1.5, -1.5])
def test_stamps_that_cannot_be_the_sites_time_are_refused_with_the_number(off_s: float) -> None:
    times = SiteTime(0)
    assert times.taken_ns(START - 20_000_000, START) == START - 20_000_000 and times.off_s is None
    assert times.taken_ns(START + round(off_s * S), START) is None
    assert times.off_s == pytest.approx(off_s)
    assert times.taken_ns(START, START) == START and times.off_s is None


def test_a_frame_is_kept_with_the_sites_names_and_without_strangers(now: Now) -> None:
    box = inbox(now, SITE)
    box.deliver(Frame(START - 5_000_000, {"Can 1": UPRIGHT, "panther1": None, "a chair": UPRIGHT}))
    (frame,) = box.take(0)
    assert frame.time_ns == START - 5_000_000 and frame.delay_s == pytest.approx(0.005)
    assert frame.bodies == {"item1": UPRIGHT, "panther1": None}
    assert box.known == {"item1", "panther1"}


def test_a_stamp_that_stands_still_is_no_new_frame(now: Now) -> None:
    box = inbox(now, SYSTEM)
    for at in range(300):
        now.time_ns = START + at * S // 100
        moved = Pose((at * 0.01, 0.0, 0.0), UPRIGHT.quaternion)
        box.deliver(Frame(5 * S, {"panther1": moved}))
    assert len(box.take(0)) == 1


def test_bodies_that_come_in_messages_of_their_own_do_not_keep_each_other_out(now: Now) -> None:
    box = inbox(now, SITE)
    for body in ("panther1", "Can 1"):
        box.deliver(Frame(START, {body: UPRIGHT}))
    assert [set(one.bodies) for one in box.take(0)] == [{"panther1"}, {"item1"}]


@pytest.mark.parametrize(("rate_hz", "kept_hz"), [(50, 50), (100, 50), (120, 60), (240, 60)])
def test_a_fast_system_is_thinned_evenly(now: Now, rate_hz: int, kept_hz: int) -> None:
    box = inbox(now, SITE)
    for at in range(rate_hz):
        now.time_ns = START + at * S // rate_hz
        box.deliver(Frame(now.time_ns, {"panther1": UPRIGHT}))
    times_ns = [one.time_ns for one in box.take(0)]
    assert len(times_ns) == kept_hz
    assert np.ptp(np.diff(times_ns)) < 1_000_000


@pytest.mark.parametrize(
    "pose",
    [
        Pose((math.nan, 0.0, 0.0), UPRIGHT.quaternion),
        Pose((1e9, 0.0, 0.0), UPRIGHT.quaternion),
        Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_what_is_no_pose_counts_as_not_in_view(now: Now, pose: Pose) -> None:
    box = inbox(now, SITE)
    box.deliver(Frame(START, {"panther1": pose}))
    (frame,) = box.take(0)
    assert frame.bodies == {"panther1": None}


def test_frames_that_nobody_takes_are_counted_and_lost(now: Now) -> None:
    box = inbox(now, SITE)
    for at in range(2100):
        now.time_ns = START + at * S // 50
        box.deliver(Frame(now.time_ns, {"panther1": UPRIGHT}))
    assert len(box.take(0)) + box.lost == 2100 and box.lost > 0


def test_a_frame_without_a_stamp_was_taken_as_long_before_as_the_site_file_says(now: Now) -> None:
    box = inbox(now, SYSTEM, latency_s=0.02)
    box.deliver(Frame(None, {"panther1": UPRIGHT}))
    assert box.take(0)[0].time_ns == START - 20_000_000


def test_the_origin_of_the_system_has_a_place_in_the_map() -> None:
    origin = Pose2(x_m=3.0, y_m=1.0, yaw_rad=math.pi / 2)
    position_m, quaternion = in_map(UPRIGHT, origin)
    assert position_m == pytest.approx((1.0, 2.0, 0.5))
    assert quaternion == pytest.approx((math.cos(math.pi / 4), 0, 0, math.sin(math.pi / 4)))
    tilted = Pose((0.0, 0.0, 0.0), (math.cos(0.2), math.sin(0.2), 0.0, 0.0))
    assert math.hypot(*in_map(tilted, origin).quaternion) == pytest.approx(1)


def test_the_table_for_signing_has_nothing_where_nothing_was_seen(now: Now) -> None:
    box = inbox(now, SITE)
    box.deliver(Frame(START, {"panther1": UPRIGHT}))
    now.time_ns += S // 50
    box.deliver(Frame(now.time_ns, {"panther1": None, "Can 1": UPRIGHT}))
    poses, seen, time_ns = table(box.take(0), ["item1", "panther1"])
    assert seen.tolist() == [[False, True], [True, False]]
    assert poses[0, 1].tolist() == [1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 1.0] and np.isnan(poses[0, 0]).all()
    assert time_ns.tolist() == [START, START + S // 50]
