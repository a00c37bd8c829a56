"""Does the recorded motion, replayed in physics, carry the item?"""

import math

import numpy as np

from rodeo.checks.case import NO_MARKERS, NO_MOCAP, Case, CaseError
from rodeo.checks.counts import COUNTS
from rodeo.checks.motion.grip import EVERY
from rodeo.checks.motion.gripper import most_of
from rodeo.checks.motion.phases import LIFTED_M, phases_of
from rodeo.checks.motion.poses import base_of, moved_s, pose_of
from rodeo.checks.motion.replay import replay_of, vote_of
from rodeo.checks.motion.sources import silent_s
from rodeo.checks.report import Finding, at_least, at_most, skipped, standing
from rodeo.checks.signed.testimony import bin_said
from rodeo.checks.tables import joints_of
from rodeo.lab.world import TIMESTEP_S
from rodeo.text.foreign_text import in_words
from rodeo.witness.statement import Drop

HELD_SHARE = 0.95
"""Share of the time between lift and release; a contact may flicker while the item settles between the
pads."""
SLIP_LIMIT_M = 0.04
"""Within the pads' own 4 cm, so the item is still between them."""
MOTION_CAPTURE_SHARE = 0.98
"""Share of the carry: where poses of a fast arm are missing, its way is only guessed."""
MOTION_CAPTURE_OFF_S = 3.0
"""And off for no more than this in all, however long it takes."""
GUESSED_S = 0.2
"""Between two messages or poses: what a fast arm did in more than this is not known."""
KNOWN_SHARE = 0.65
"""Share of the carry: with 5 % of all messages lost, and 2 % in runs, item, base and joints together are
known for nine tenths of it on average, and now and then for three quarters."""
MOTION_CAPTURE_LIMIT_M = 0.05
"""Replays of honest recordings stay within a centimetre until the release."""


MAJORITY = 0.5
"""Share of the replays: one lucky grasp is not what happened, one unlucky one neither."""


def carried(case: Case) -> Finding:
    """The gripper closed, and the item left the floor. If it did not before the bin felt a drop, that
    stands whatever motion capture had said after."""
    try:
        phases = phases_of(case)
    except CaseError as error:
        failed = Finding(passed=False, detail=in_words(error))
        felt = (one.statement for one in bin_said(case) if isinstance(one.statement, Drop))
        own = case.proof.recording
        fell_s = min(
            (one.settled_s for one in felt for by in one.claimants if by.recording == own), default=math.inf
        )
        return failed if any(from_s < fell_s for from_s, _ in silent_s(case)) else standing(failed)
    return Finding(
        passed=True,
        measured=phases.rest_s - phases.closing_s,
        unit="s",
        source=case.item_pose_source,
        detail="from the grasp to the item's rest",
    )


def replayed(case: Case) -> Finding:
    """The recording shows a carry that can be moved again."""
    time_s = replay_of(case).time_s
    return at_most(
        float(time_s[-1] - time_s[0]),
        COUNTS.carried_s,
        "s",
        source="longest plausible carry across a room",
        detail="replayed in physics from the grasp to the item's rest",
    )


def grasp(case: Case) -> Finding:
    """The fingers close on the item and lift it off the floor."""
    replay = replay_of(case)
    rise = replay.item_m[:, 2] - replay.placed_m[2]
    before_release = replay.time_s <= replay.release_s
    return at_least(
        float(rise[before_release].max(initial=0.0)),
        2 * LIFTED_M,
        "m",
        source="replay in physics",
        detail="the item rises in the gripper by",
    )


def transport(case: Case) -> Finding:
    """From lift to release the item stays between the pads."""
    replay = replay_of(case)
    carried = _carried(case)
    held = float(replay.held[carried].mean())
    grip = replay.item_in_gripper_m[carried]
    slip = float(np.linalg.norm(grip - grip[0], axis=1).max())
    if held < HELD_SHARE:
        return at_least(
            held,
            HELD_SHARE,
            "",
            source="replay in physics",
            detail="share of the path on which the gripper holds it",
        )
    return at_most(
        slip, SLIP_LIMIT_M, "m", source="length of the pads", detail="the item slips in the gripper by"
    )


def motion_capture(case: Case) -> Finding:
    """The replayed item is where motion capture saw the real one."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    if not case.tracked:
        return skipped(NO_MARKERS)
    replay = replay_of(case)
    carried = _carried(case) & _known(case)
    if carried.sum() < KNOWN_SHARE * _carried(case).sum():
        raise CaseError("too little of the carry was both seen and recorded", share=KNOWN_SHARE)
    pose = pose_of(case, case.item.id)
    return at_most(
        most_of(
            np.linalg.norm(replay.item_m[carried] - pose.at(replay.time_s[carried]), axis=1),
            EVERY * TIMESTEP_S,
            MOTION_CAPTURE_SHARE,
            MOTION_CAPTURE_OFF_S,
        ),
        MOTION_CAPTURE_LIMIT_M,
        "m",
        source="motion capture of the item",
        detail="distance between the replayed item and the recorded one",
    )


def ensemble(case: Case) -> Finding:
    """Most of several replays with small errors do the work, too."""
    vote = vote_of(case)
    return at_least(
        vote.succeeded / vote.run,
        MAJORITY,
        "",
        source=f"replays with errors of measurement; {_TRUST[case.item_pose_source]}",
        detail=f"{vote.succeeded} of the {vote.run} replays that decided it lift, carry and drop the item",
    )


_TRUST = {
    "motion capture": "the item lay where motion capture signed it",
    "perception": "weaker: the item lay where the robot reported it",
}


def _known(case: Case) -> np.ndarray:
    """(n,) when item and base were seen and the joints recorded, rather than guessed from before and after.

    How much may be missing is for `seen_throughout` and `cleaning_gaps` to say.
    """
    time_s, joint_s = replay_of(case).time_s, joints_of(case).stamp_s
    gaps = np.flatnonzero(np.diff(moved_s(case, joint_s)) > GUESSED_S)
    spans = [(joint_s[gap], joint_s[gap + 1]) for gap in gaps]
    known = np.ones(len(time_s), bool)
    for start_s, end_s in [*spans, *pose_of(case, case.item.id).unseen_s, *base_of(case).unseen_s]:
        known &= (time_s < start_s) | (time_s > end_s)
    return known


def _carried(case: Case) -> np.ndarray:
    """(n,) between lift and release. Raises CaseError when the replay lets go before the recording lifts."""
    replay = replay_of(case)
    carried = (replay.time_s >= replay.phases.lifted_s) & (replay.time_s <= replay.release_s)
    if carried.sum() < 2:
        raise CaseError(
            "the item falls out of the gripper in the replay",
            release_s=round(replay.release_s - replay.phases.closing_s, 2),
        )
    return carried
