"""What motion capture signs of moving and resting bodies, read back also where statements are missing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from rodeo.evidence.errors import BadStatement
from rodeo.witness.motion import MotionLog, Sample, track
from rodeo.witness.statement import Motion

START_US = 1_900_000_000_000_000
STEP_US = 20_000
HEADER: dict[str, Any] = {
    "chain_id": 1,
    "task_manager": "0x" + "12" * 20,
    "organization": "0x" + "34" * 20,
    "device": "mocap",
    "previous": None,
    "time_s": 0.0,
    "inputs": "sensor",
}


def at(time_us: int, x_m: float, yaw_rad: float = 0.0) -> Sample:
    return Sample(time_us, (x_m, 1.0, 0.1), (math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)))


def filmed(x_m, seconds: float, heads: bool = False, unseen=lambda _t: False) -> list[Motion]:  # type: ignore[no-untyped-def]
    """Statements about `item1`, whose x is `x_m(t)`, and about `panther1`, which rests."""
    log = MotionLog(["item1", "panther1"], START_US)
    statements = []
    for tick in range(1, round(seconds * 50) + 1):
        now_us = START_US + tick * STEP_US
        if not unseen(tick / 50):
            log.add("item1", at(now_us, x_m(tick / 50)))
        log.add("panther1", at(now_us, 3.0))
        if log.due(now_us, heads):
            seq = len(statements) + 1
            statements.append(Motion(**HEADER, seq=seq, **log.take(now_us, seq)._asdict()))
    return statements


def moving(t: float) -> float:
    return 0.3 * min(max(t - 4.0, 0.0), 6.0)


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize(
    "bad",
    [
        *(((x_m, 1.0, 0.1), (1.0, 0.0, 0.0, 0.0)) for x_m in (math.nan, math.inf, -math.inf)),
        *(((0.0, 1.0, math.nan), (w, 0.0, 0.0, 0.0)) for w in (1.0, math.nan)),
        *(((1.0, 1.0, 0.1), (w, 0.0, 0.0, 0.0)) for w in (0.0, 0.5, 2.0, math.nan, math.inf)),
    ],
)
def test_what_is_no_pose_is_not_signed_and_the_next_pose_is(bad: Any, together: bool) -> None:
    log = MotionLog(["item1"], START_US)
    samples = [Sample(START_US + STEP_US * number, *bad) for number in range(1, 4)]
    good = at(START_US + 4 * STEP_US, 1.0)
    if together:
        log.add_all("item1", [*samples, good])
    else:
        for sample in (*samples, good):
            log.add("item1", sample)
    statement = Motion(**HEADER, seq=1, **log.take(good.time_us, 1)._asdict())
    seen = track([statement], "item1")
    assert seen is not None and seen.time_us.tolist() == [good.time_us]
    assert seen.position_m == pytest.approx(np.array([good.position_m]), abs=1e-4)
    only_bad = MotionLog(["item1"], START_US)
    only_bad.add_all("item1", samples)
    assert only_bad.take(good.time_us, 1).tracks == {}


def test_everything_at_rest_is_signed_once_in_ten_seconds() -> None:
    statements = filmed(lambda _t: 0.5, 40.0)
    assert len(statements) == 5, "one for the first poses, then one at each ten seconds"
    assert all(set(s.tracks) | set(s.resting) == {"item1", "panther1"} for s in statements)


def test_a_moving_body_is_signed_every_second_at_every_pose() -> None:
    statements = filmed(moving, 15.0)
    seen = track(statements, "item1")
    assert seen is not None
    assert seen.unseen_us == ()
    travel = (seen.time_us > START_US + 4_100_000) & (seen.time_us < START_US + 9_900_000)
    assert np.diff(seen.time_us[travel]).max() == STEP_US
    wanted = np.array([moving((t - START_US) / 1e6) for t in seen.time_us])
    assert np.abs(seen.position_m[:, 0] - wanted).max() < 1.1e-3
    spans = [(s.end_us - s.start_us) / 1e6 for s in statements if "item1" in s.tracks][1:-1]
    assert max(spans[1:]) <= 1.02


def test_a_body_that_creeps_is_never_said_to_rest() -> None:
    seen = track(filmed(lambda t: 0.0005 * t, 30.0), "item1")
    assert seen is not None
    wanted = np.array([0.0005 * (t - START_US) / 1e6 for t in seen.time_us])
    assert np.abs(seen.position_m[:, 0] - wanted).max() < 1.2e-3


def test_what_stays_to_the_bit_is_signed_as_if_each_pose_had_been_added() -> None:
    def x_m(t: float) -> float:
        return min(max(t - 4.0, 0.0), 1.0)

    def filmed_by(short: bool) -> list[Any]:
        log, taken, before, stayed = MotionLog(["item1"], START_US), [], None, 0
        for tick in range(1, 50 * 30):
            now_us, place_m = START_US + tick * STEP_US, x_m(tick / 50)
            if 12 < tick / 50 < 15:
                continue  # out of view
            if short and place_m == before and log.stays("item1", now_us):
                stayed += 1
            else:
                log.add("item1", at(now_us, place_m))
            before = place_m
            if log.due(now_us, heads=tick % 3 == 0):
                taken.append(log.take(now_us, len(taken) + 1))
        assert (stayed > 1000) is short
        return taken

    assert filmed_by(short=True) == filmed_by(short=False)


def test_a_pose_that_was_not_taken_does_not_stay() -> None:
    log = MotionLog(["item1"], START_US)
    log.add("item1", at(START_US + STEP_US, 1.0))
    log.take(START_US + STEP_US, 1)
    log.add("item1", at(START_US + 2 * STEP_US, 1.0))
    log.add("item1", at(START_US + 3 * STEP_US, 1e6))
    assert not log.stays("item1", START_US + 4 * STEP_US), "it is beyond what can be signed"
    log.add("item1", at(START_US + 3 * STEP_US, 1.0))
    assert log.stays("item1", START_US + 4 * STEP_US)


def test_who_turns_on_the_spot_moves() -> None:
    log = MotionLog(["panther1"], START_US)
    log.add("panther1", at(START_US + STEP_US, 1.0))
    log.take(START_US + STEP_US, 1)
    log.add("panther1", at(START_US + 2 * STEP_US, 1.0, yaw_rad=0.0015))
    assert not log.due(START_US + 1_200_000, heads=False)
    log.add("panther1", at(START_US + 3 * STEP_US, 1.0, yaw_rad=0.0045))
    assert log.due(START_US + 1_200_000, heads=False)


def test_heads_are_listed_within_two_seconds_while_nothing_moves() -> None:
    statements = filmed(lambda _t: 0.5, 20.0, heads=True)
    assert max(s.end_us - s.start_us for s in statements) <= 2_020_000


def test_a_missing_statement_hides_what_moved_and_nothing_of_what_rested() -> None:
    statements = filmed(moving, 15.0)
    lost = next(i for i, s in enumerate(statements) if s.start_us > START_US + 6_000_000)
    left = statements[:lost] + statements[lost + 1 :]
    item, base = track(left, "item1"), track(left, "panther1")
    assert item is not None and base is not None
    assert len(item.unseen_us) == 1
    (gap,) = item.unseen_us
    assert gap[0] == statements[lost - 1].end_us
    assert 0.9e6 <= gap[1] - gap[0] <= 1.1e6
    assert base.unseen_us == ()


def test_a_pose_signed_again_at_rest_may_be_missing() -> None:
    statements = filmed(moving, 45.0)
    again = next(i for i, s in enumerate(statements) if s.start_us > START_US + 15_000_000 and s.tracks)
    assert "item1" in statements[again].tracks
    left = statements[:again] + statements[again + 1 :]
    for body in ("item1", "panther1"):
        seen = track(left, body)
        assert seen is not None
        assert seen.unseen_us == ()
        assert seen.time_us[-1] == statements[-1].end_us


def test_what_rested_before_the_first_statement_that_is_here_is_known_from_its_next_pose_on() -> None:
    statements = filmed(lambda _t: 0.5, 45.0, heads=True)
    seen = track(statements[6:], "item1")
    assert seen is not None
    assert seen.unseen_us == ()
    assert seen.time_us[-1] == statements[-1].end_us


def test_what_came_to_rest_in_a_missing_statement_lies_where_it_is_signed_next_ever_since() -> None:
    statements = filmed(moving, 25.0, heads=True)
    came = [i for i, s in enumerate(statements) if "item1" in s.tracks and "item1" not in s.resting][-1]
    left, after = statements[:came] + statements[came + 1 :], statements[came + 1]
    assert after.resting["item1"] == statements[came].seq and "item1" not in after.tracks
    seen = track(left, "item1")
    assert seen is not None
    assert seen.unseen_us == ((left[came - 1].end_us, after.start_us),)
    assert seen.position_m[seen.time_us >= after.start_us, 0] == pytest.approx(moving(25.0), abs=1e-3)
    unknown = track(left[: came + 2], "item1")
    assert unknown is not None
    assert unknown.unseen_us == ((left[came - 1].end_us, left[came + 1].end_us),), "it is not signed again"


def test_a_body_that_nobody_saw_is_not_at_rest() -> None:
    statements = filmed(moving, 15.0, unseen=lambda t: 6.0 <= t < 9.0)
    seen = track(statements, "item1")
    assert seen is not None
    assert sum(b - a for a, b in seen.unseen_us) >= 1.9e6


def test_what_a_moving_body_did_after_its_last_pose_is_not_known() -> None:
    """Its way up to the end of that statement was taken for straight, 7 cm beside the real one."""
    statements = filmed(moving, 15.0, unseen=lambda t: 5.5 <= t < 9.0)
    seen = track(statements, "item1")
    assert seen is not None
    (gap,) = seen.unseen_us
    last = START_US + 5_500_000 - STEP_US
    assert gap[0] == last
    assert min(s.end_us for s in statements if s.end_us >= last) > last + 200_000


def test_a_track_whose_times_go_back_is_refused() -> None:
    statement = filmed(moving, 6.0)[-1]
    other = statement.model_copy(update={"end_us": statement.start_us})
    with pytest.raises(BadStatement):
        track([other], "item1")


def test_a_body_that_is_in_no_statement_has_no_track() -> None:
    assert track(filmed(moving, 3.0), "item9") is None


def stamped(off_us) -> list[Motion]:  # type: ignore[no-untyped-def]
    """Statements about `item1` in motion, whose pose of each tick is stamped `off_us(tick)` beside it."""
    log = MotionLog(["item1"], START_US)
    statements = []
    for tick in range(1, 501):
        now_us = START_US + tick * STEP_US
        log.add("item1", at(now_us + off_us(tick), 0.01 * tick))
        if log.due(now_us, heads=True):
            seq = len(statements) + 1
            statements.append(Motion(**HEADER, seq=seq, **log.take(now_us, seq)._asdict()))
    return statements


@pytest.mark.parametrize("off_us", [4_000, 200_000, -200_000], ids=["ahead", "far ahead", "behind"])
def test_stamps_beside_the_clock_of_the_statements_hide_no_motion(off_us: int) -> None:
    seen = track(stamped(lambda _tick: off_us), "item1")
    assert seen is not None
    assert seen.unseen_us == ()
    assert np.diff(seen.time_us).max() == STEP_US
    assert len(seen.time_us) >= 480


def test_stamps_that_jitter_make_no_statement_that_nobody_can_read() -> None:
    chance = np.random.default_rng(1)
    seen = track(stamped(lambda _tick: round(chance.normal(0, 12_000))), "item1")
    assert seen is not None
    assert len(seen.time_us) > 350, "what came out of order was left out, the rest is signed"
    assert seen.unseen_us == ()


def test_a_resting_body_whose_stamps_are_ahead_rests() -> None:
    log = MotionLog(["item1"], START_US)
    statements = []
    for tick in range(1, 1001):
        now_us = START_US + tick * STEP_US
        log.add("item1", at(now_us + 4_000, 0.5))
        if log.due(now_us, heads=True):
            seq = len(statements) + 1
            statements.append(Motion(**HEADER, seq=seq, **log.take(now_us, seq)._asdict()))
    seen = track(statements, "item1")
    assert seen is not None
    assert seen.unseen_us == ()
    assert sum("item1" in one.tracks for one in statements) <= 3


def test_poses_lost_where_two_statements_meet_are_not_made_up() -> None:
    statements = filmed(moving, 15.0, unseen=lambda t: 5.8 <= t < 6.2)
    seen = track(statements, "item1")
    assert seen is not None
    wanted = np.array([moving((one - START_US) / 1e6) for one in seen.time_us])
    assert np.abs(seen.position_m[:, 0] - wanted).max() < 1.1e-3
    assert len(seen.unseen_us) == 1


def test_a_body_that_is_seen_again_is_signed_from_then_on() -> None:
    """It was lost until the end of the statement in which it came back."""
    seen = track(filmed(moving, 15.0, unseen=lambda t: 5.1 <= t < 7.4), "item1")
    assert seen is not None
    assert seen.unseen_us == ((START_US + 5_080_000, START_US + 7_400_000),)


def test_a_body_that_was_lost_for_long_is_not_said_to_have_rested_meanwhile() -> None:
    """Though it is where it was."""
    seen = track(filmed(lambda _t: 0.5, 25.0, unseen=lambda t: 13.0 <= t < 17.0), "item1")
    assert seen is not None
    (gap,) = seen.unseen_us
    assert gap[0] <= START_US + 13_000_000
    assert gap[1] >= START_US + 17_000_000


@pytest.mark.parametrize("since_s", [13.0, 13.3, 13.9, 14.5, 19.9, 20.1])
def test_who_waits_until_nobody_looks_is_unseen_for_as_long_as_nobody_does(since_s: float) -> None:
    """Whatever the statements say meanwhile of a body that rested when it was seen last."""

    def tossed(t: float) -> float:
        return 0.5 if t < since_s + 1.0 else 3.5

    seen = track(filmed(tossed, 30.0, heads=True, unseen=lambda t: since_s <= t < since_s + 1.9), "item1")
    assert seen is not None
    (gap,) = seen.unseen_us
    assert gap[0] <= START_US + since_s * 1e6 and gap[1] >= START_US + (since_s + 1.9) * 1e6


def test_what_stood_still_is_told_and_never_lost() -> None:
    log = MotionLog(["item1"], START_US)
    log.add("item1", at(START_US + STEP_US, 1.0))
    stall = START_US + STEP_US, START_US + STEP_US + 7_000_000
    log.stall(*stall)
    log.add("item1", at(stall[1] + STEP_US, 1.01))
    told = Motion(**HEADER, seq=1, **log.take(stall[1] + STEP_US, 1)._asdict())
    assert told.stalls_us == (stall,)
    seen = track([told], "item1")
    assert seen is not None
    assert list(seen.time_us) == [START_US + STEP_US, stall[1] + STEP_US]
    log.add("item1", at(stall[1] + 2 * STEP_US, 1.02))
    assert log.take(stall[1] + 2 * STEP_US, 2).stalls_us == (), "each is reported once"
