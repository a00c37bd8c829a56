"""What the bin says, and where motion capture saw the item end: neither is the robot's word."""

from __future__ import annotations

from bisect import bisect_left
from itertools import pairwise

import numpy as np

from rodeo.checks.case import Case, CaseError, OthersFailed
from rodeo.checks.motion.kinematics import kinematics_of
from rodeo.checks.motion.phases import REST_M, phases_of
from rodeo.checks.motion.poses import Pose, base_of, motion_of, moving_s, pose_of
from rodeo.checks.motion.replay import replay_of
from rodeo.checks.motion.sources import (
    THE_SITE,
    doubtful,
    revoked_meanwhile,
    revoked_while_recorded,
    silent_s,
    unheard,
    whose,
)
from rodeo.checks.motion.witnesses import UNLISTED_S
from rodeo.checks.report import Finding, at_least, at_most, equal, skipped, standing, undecided
from rodeo.checks.results import once_per_case
from rodeo.checks.signed.heads import LISTED_S, fork, in_file, listed
from rodeo.checks.signed.statements import Said
from rodeo.checks.signed.testimony import bin_said, bin_testimony, by_signer, own_said
from rodeo.checks.tables import gaps_of
from rodeo.evidence.errors import EvidenceError
from rodeo.kinds import kinds_of
from rodeo.lab.drop import JUDGED_AFTER_DROP_S, WEIGHS_THE_SAME_N
from rodeo.lab.layout import BinLayout
from rodeo.site.topics import SEAL_CHANNEL
from rodeo.text.foreign_text import quoted
from rodeo.witness.heads import TOLD
from rodeo.witness.statement import Classification, Drop, Motion, Presentation, Removal
from rodeo_kinds.waste_disposal.checks import picture

DROP_SLACK_S = 10.0
"""Between the release and the change of weight in the compartment: the fall, and what slips late."""
FELL_SLACK_S = 2.0
"""The same where nobody saw it fall."""
FELT_SHARE = 0.3
"""By which share the weight that a robot felt in its gripper may be off."""
EARLY_SLACK_S = 1.0
"""Clocks of bin and robot, and pads that touch the item a little longer than they hold it."""
AWAY_M = 0.15
"""Distance of the hand from the item in the end: farther than its fingers reach."""
OPEN_M = 0.003
"""Each finger that lets go of an item opens by at least this distance."""
NEAR_BIN_M = 1.2
"""A base whose arm drops something into the bin is no farther from its middle: an arm reaches 0.75 m."""
BELOW_RIM_M = 0.1
"""An item that falls behind the walls may last be seen this deep below the rim."""
LOST_IN_A_ROW = TOLD - 2
"""Statements of motion capture that may be lost together."""
CLOCKS_S = 0.5
"""Clocks of bin and motion capture."""


def _drops(case: Case) -> list[Drop]:
    return [one.statement for one in bin_said(case) if isinstance(one.statement, Drop)]


def _classification(case: Case) -> Classification:
    """The one that the drop refers to, or the last. Raises CaseError."""
    found = [one.statement for one in bin_said(case) if isinstance(one.statement, Classification)]
    if not found:
        raise _unsaid(case, "no classification signed by the bin is in the recording")
    claim = claim_of(case)
    return next((one for one in found if claim and one.number == claim.classification), found[-1])


@once_per_case
def drop_of(case: Case) -> Drop | None:
    """The item's: others may use the bin meanwhile. Of those that the release can explain, the first that
    weighs what the item may weigh, rather in the compartment that the bin asked for; else the first that is
    heavier, which may be the item and something else; else the first at all, else the last."""
    drops = _drops(case)
    if len(drops) < 2:
        return drops[0] if drops else None  # whenever the item was let go of
    release_s = replay_of(case).release_s
    found = [drop for drop in drops if drop.settled_s >= release_s - EARLY_SLACK_S]
    if case.tracked:
        # Junk may weigh as much as the item: rather where motion capture sees that since.
        found = [
            one for one in found if _left(case, one.compartment, one.settled_s + CLOCKS_S) == one.compartment
        ] or found
    fitting = [drop for drop in found if _fits(case, drop)]
    fitting = fitting or [drop for drop in found if _holds(case, drop)] or found

    def unlikely(drop: Drop) -> tuple[bool, bool]:
        early = drop.settled_s < release_s and not _fits(case, drop)
        return drop.compartment != _asked_before(case, drop), early

    return min(fitting, key=unlikely, default=drops[-1])


@once_per_case
def claim_of(case: Case) -> Drop | None:
    """The drop that names who showed the item. It is not the item's where something else fell in before it:
    the bin takes that for what it was shown."""
    drop = drop_of(case)
    if drop is None or drop.classification is not None:
        return drop
    before = [one for one in _drops(case) if one.seq < drop.seq and one.classification is not None]
    return before[-1] if before else drop


def _fits(case: Case, drop: Drop) -> bool:
    """Whether what fell may weigh what the site says that the item weighs; False where it does not say."""
    off = _off_weight(case, drop)
    return off is not None and abs(off[0]) <= off[1]


def _holds(case: Case, drop: Drop) -> bool:
    """Whether the item may be a part of what fell."""
    off = _off_weight(case, drop)
    return off is not None and off[0] >= -off[1]


def _off_weight(case: Case, drop: Drop) -> tuple[float, float] | None:
    """By which share what fell is heavier than the item (less than 0: lighter), and by which it may be off;
    None where the site does not say what the item weighs."""
    item, tolerance = case.item, case.site.lab.mass_tolerance
    if case.unmarked:
        tolerance = FELT_SHARE
    if tolerance is None or "mass_kg" not in item.model_fields_set:
        return None
    return drop.weight_n / (item.mass_kg * 9.81) - 1, tolerance


def _asked_before(case: Case, drop: Drop) -> str | None:
    """The compartment that the bin had asked for last before something fell."""
    said = [one.statement for one in bin_said(case) if one.statement.seq < drop.seq]
    return next((one.compartment for one in reversed(said) if isinstance(one, Classification)), None)


def _drop(case: Case) -> Drop:
    drop = drop_of(case)
    if drop is None:
        raise _unsaid(case, "no drop signed by the bin is in the recording")
    return drop


def _unsaid(case: Case, what: str) -> EvidenceError:
    """The party at fault that the bin signed no such statement: the bin where its key was revoked
    meanwhile, or where motion capture, of which nothing is missing, heard nothing more of it."""
    name = case.bin.name
    if (key := revoked_while_recorded(case, "bin", name)) is not None:
        return OthersFailed(revoked_meanwhile(key), whose("bin", name))
    if bin_said(case) and heard_all(case):
        return OthersFailed(f"{what}, and motion capture heard none either", whose("bin", name))
    if (silence := unheard(case)) is not None:
        return OthersFailed(f"{what}, and {silence}", THE_SITE)
    return CaseError(what, bin=name)


def heard_all(case: Case) -> bool:
    """Whether motion capture listened to the end, nothing of that is missing, and it lists no statement of
    the bin that is not here."""
    said = [one.statement for one in motion_of(case)] if case.mocap else []
    if not said or said[-1].time_s < case.proof.end_ns * 1e-9 - LISTED_S * case.speed:
        return False
    if lost_in_a_row(motion_of(case)) > LOST_IN_A_ROW:
        return False
    known = {(one.statement.seq, one.digest) for one in bin_said(case)}
    return all(
        (head.index, head.digest) in known
        for one in said
        for head in one.heads
        if head.device == case.bin.name and head.chain is None and one.time_s > case.proof.start_ns * 1e-9
    )


def asked_compartment(case: Case) -> str:
    """Where the bin asked for it: the robot can only follow. Raises CaseError."""
    return _classification(case).compartment


def bin_witnessed(case: Case) -> Finding:
    """This site's bin signed what it felt by its own sensors, in one chain."""
    name = case.bin.name
    if (failed := doubtful(case, "bin", name)) is not None:
        return failed
    testimony = bin_testimony(case)
    return Finding(
        passed=True,
        measured=len(testimony.said),
        limit=1,
        source="device registry on chain",
        detail=f"statements signed by {testimony.address}",
    )


def classified(case: Case) -> Finding:
    """The item was shown to the bin between grasp and release."""
    statement = _classification(case)
    phases, release_s = replay_of(case).phases, replay_of(case).release_s
    if (failed := _combined(case, statement)) is not None:
        return failed
    return Finding(
        passed=phases.closing_s <= statement.shown_s <= release_s,
        measured=statement.shown_s - phases.closing_s,
        limit=release_s - phases.closing_s,
        unit="s",
        source="statement of the bin",
        detail=f"shown as {quoted(statement.item_class)} after the grasp, before the release",
    )


def _combined(case: Case, statement: Classification) -> Finding | None:
    """An undecided finding if the bin combined pictures of something else: the executor did not choose."""
    if all(look.taken_s >= phases_of(case).closing_s for look in statement.earlier):
        return None
    return undecided(
        "it combined pictures that it took before the grasp: they show something else",
        f"the bin {case.bin.name}",
        source="statement of the bin",
    )


def dropped(case: Case) -> Finding:
    """The bin felt it fall into the compartment that it asked for, when the replay lets go of it."""
    drop, claim = _drop(case), claim_of(case)
    number = _classification(case).number
    assert claim is not None
    if claim.classification != number:
        return equal(
            str(claim.classification),
            str(number),
            source="statement of the bin",
            detail="classification that the drop refers to",
        )
    release_s = replay_of(case).release_s
    delay_s, late_s = moving_s(case, release_s, drop.after_s), drop.settled_s - release_s
    early = not late_s >= -EARLY_SLACK_S
    slack_s = FELL_SLACK_S if case.unmarked else DROP_SLACK_S
    if early or not delay_s <= slack_s:
        return Finding(
            passed=False,
            measured=late_s if early else delay_s,
            limit=-EARLY_SLACK_S if early else slack_s,
            unit="s",
            source="statement of the bin",
            detail="from the release in the replay to the stated drop",
        )
    asked = asked_compartment(case)
    source, detail = "statement of the bin", f"fell with {drop.weight_n} N into"
    found = equal(drop.compartment, asked, source=source, detail=detail)
    # Whichever of them was the item.
    return found if any(one.compartment == asked for one in _drops(case)) else standing(found)


def presented(case: Case) -> Finding:
    """The robot told the bin, before it showed the item, for which recording; of several that did, motion
    capture tells who stood there."""
    binding = case.proof.binding
    if binding is None:
        return skipped("a bag has no recording ID that the bin could state")
    claim = claim_of(case) or _drop(case)
    own = [
        one
        for one in claim.claimants
        if one.address.lower() == (case.proof.signer or "").lower()
        and (one.recording, one.task_id, one.attempt)
        == (case.proof.recording, binding.task_id, binding.attempt)
    ]
    said = any(
        isinstance(one.statement, Presentation) and one.statement.recording == case.proof.recording
        for one in own_said(case)
    )
    if own and claim != drop_of(case) and len(claim.claimants) > 1:
        # It may be the item of another robot, whose claim this one would take.
        return undecided(
            f"something else of {claim.weight_n} N fell in before the item, and several robots had presented "
            "themselves",
            "whoever dropped it",
            source="claimants in the bin's statement",
        )
    first = claim.claimants[:1]
    if own and own[0] not in first and not case.mocap:
        # Anybody may have said so while this robot showed its item.
        return undecided(
            f"{quoted(first[0].device)} presented itself after this robot did, and nobody saw who stood at "
            "the bin",
            THE_SITE,
            source="claimants in the bin's statement",
        )
    if not own or (own[0] not in first and not (case.mocap and said)):
        found = [
            f"{quoted(one.device)} for task {one.task_id}, recording {one.recording[:18]}" for one in first
        ]
        return Finding(
            passed=False,
            measured=found[0] if found else "nobody",
            limit=f"{quoted(binding.device)} for task {binding.task_id}, "
            f"recording {str(case.proof.recording)[:18]}",
            source="claimants in the bin's statement",
            detail="robot that presented itself before the item was shown",
        )
    return _at_bin(case)


def _at_bin(case: Case) -> Finding:
    return at_most(
        from_bin_m(case, base_of(case), replay_of(case).release_s),
        NEAR_BIN_M,
        "m",
        source=case.base_source,
        detail="distance of the robot from the bin at the release",
    )


def from_bin_m(case: Case, pose: Pose, time_s: float) -> float:
    """How far a body was from the middle of the bin."""
    x_m, y_m, _ = pose.at(np.array([time_s]))[0]
    return float(np.hypot(x_m - case.bin.pose.x_m, y_m - case.bin.pose.y_m))


def heard(case: Case) -> Finding:
    """The bin heard this recording go on just before it was shown the item: its own chain says so, also where
    there is no motion capture."""
    if not case.proof.sealed:
        return skipped("a bag has no seals that witnesses could list")
    if (forked := fork(case, bin_said(case))) is not None:
        return forked
    shown = _classification(case)
    indexes = [
        head.index
        for one, head in listed(case, bin_said(case))
        if one.statement.seq <= shown.seq and in_file(case, head)
    ]
    if not indexes:
        raise CaseError("the bin does not list this recording before it saw the item", seq=shown.seq)
    sealed_s = case.proof.topics[SEAL_CHANNEL].log_ns[max(indexes)] * 1e-9
    return at_most(
        abs(moving_s(case, sealed_s, shown.time_s)) / case.speed,
        UNLISTED_S,
        "s",
        source="chain of the bin",
        detail="from the newest seal of this recording that it lists to its statement about the item",
    )


def pictured(case: Case) -> Finding:
    """The picture that the bin classified is in the proof, as its camera encoded it, and a network that the
    kind's rules list said what it shows."""
    assert case.kind is not None
    if (failed := _combined(case, _classification(case))) is not None:
        return failed
    listed = kinds_of(case.site)[case.kind].models()
    return picture.shown(case.proof, case.bin.name, _classification(case), listed)


def asked_rightly(case: Case) -> Finding:
    """The bin asked for the compartment that follows from what it said, by the site's compartments and costs.

    Undecided where it did not: the robot could only follow.
    """
    said = _classification(case)
    right = case.bin.compartment_for(said.item_class, said.probabilities)
    if said.compartment != right:
        return undecided(
            f"it asked for {quoted(said.compartment)}, and by the site's compartments and costs it is "
            f"{right}",
            f"the bin {case.bin.name}",
            source="statement of the bin",
        )
    return equal(said.compartment, right, source="statement of the bin", detail="asked for")


def nothing_left_out(case: Case) -> Finding:
    """From the release on, the recording holds what the bin said, and what motion capture said without a gap
    in which it could have told of the bin: it lists each head of the bin `TOLD` times.
    """
    missing = {case.bin.name: _missing_of_bin(case)}
    if case.mocap:
        ends_s = [one.statement.end_us * 1e-6 for one in motion_of(case) if isinstance(one.statement, Motion)]
        # The one before the release, too: the gap may begin there.
        before = max(bisect_left(ends_s, replay_of(case).release_s) - 1, 0)
        lost = lost_in_a_row(motion_of(case)[before:])
        missing["motion capture"] = lost if lost > LOST_IN_A_ROW else 0
    return equal(
        sum(missing.values()),
        0,
        source="numbers in the witnesses' chains, and the bin's heads that motion capture lists",
        detail="missing statements: " + ", ".join(f"{count} of {who}" for who, count in missing.items()),
    )


def lost_in_a_row(said: list[Said]) -> int:
    """How many statements of this chain are missing in a row."""
    return max((later.statement.seq - one.statement.seq - 1 for one, later in pairwise(said)), default=0)


def _missing_of_bin(case: Case) -> int:
    """Statements of the bin since the classification that are not in the recording, though a later one is, or
    though motion capture heard of them."""
    keys, shown = bin_testimony(case).keys, _classification(case).seq
    # Also what it signed under a key that did not count any more: that was not left out.
    signed = (said for key in keys for said in by_signer(case)[key].said)
    own = [said.statement.seq for said in signed if said.statement.seq >= shown]
    heard = [
        head.index
        for said in (motion_of(case) if case.mocap else ())
        for head in said.statement.heads
        if head.address.lower() in keys and head.chain is None
    ]
    return _gaps(own) + max(max(heard, default=0) - max(own), 0)


def _gaps(numbers: list[int]) -> int:
    return max(numbers) + 1 - min(numbers) - len(set(numbers)) if numbers else 0


def stays_in_bin(case: Case) -> Finding:
    """Motion capture sees the item lie in the compartment, or last above its opening, and nowhere else after;
    the fingers are open, the hand is away, nobody takes anything out, and that for a while."""
    # Where the bin fell silent, `dropped` says so; motion capture saw where the item went all the same.
    drop = drop_of(case)
    fell_s = replay_of(case).release_s + DROP_SLACK_S
    settled_s, after_s = (fell_s, fell_s) if drop is None else (drop.settled_s, drop.after_s)
    compartment = asked_compartment(case) if drop is None else drop.compartment
    end_s = case.proof.end_ns * 1e-9
    source = f"recorded and signed for {JUDGED_AFTER_DROP_S:g} s after the bin's drop"
    if case.mocap:
        end_s = min(end_s, motion_of(case)[-1].statement.time_s)
    removed = [
        one.statement
        for one in bin_said(case)
        if isinstance(one.statement, Removal)
        and one.statement.compartment == compartment
        and one.statement.settled_s > after_s
    ]
    taken = _taken_out(case, removed, drop)
    if taken is not None and taken.outcome == "rejected":
        return taken
    if case.tracked and (left := _left(case, compartment, settled_s + CLOCKS_S)) != compartment:
        found = _elsewhere(case, left or "left it", compartment)
        # The bin says until when it fell; since when is the replay's word, which doubted poses move.
        strayed = drop is not None and _strayed(case, compartment, settled_s + CLOCKS_S) != compartment
        return standing(found) if strayed or _outside_at_last(case) else found
    if drop is not None and end_s - settled_s < JUDGED_AFTER_DROP_S - CLOCKS_S:
        return at_least(
            end_s - settled_s,
            JUDGED_AFTER_DROP_S,
            "s",
            source,
            "from the drop to the end of the recording",
        )
    if not case.tracked:
        return taken or Finding(passed=True, source=source, detail="nothing was taken out of the bin")
    found = _lies_in(case, compartment, settled_s)
    return taken if taken is not None and found.passed else found


def _taken_out(case: Case, removed: list[Removal], drop: Drop | None) -> Finding | None:
    """Whether it was the item that left the compartment after it had fallen in, by its weight and by where
    motion capture saw it after that. None if it was something else."""
    item_s = pose_of(case, case.item.id).time_s[-1] if case.tracked else -np.inf
    seen = [one for one in removed if item_s >= one.settled_s + CLOCKS_S]
    # What is heavier cannot be the item alone; nobody can tell what it was.
    heavier = [one for one in removed if drop and one.weight_n > drop.weight_n + WEIGHS_THE_SAME_N]
    unseen_n = sum(one.weight_n for one in removed if one not in seen and one not in heavier)
    words, source = "after the drop something was taken out of", "statement of the bin"
    if len(seen) < len(removed) and (drop is None or unseen_n >= drop.weight_n - WEIGHS_THE_SAME_N):
        where = quoted(removed[0].compartment)
        return equal(f"{unseen_n:.3g} N", None, source=source, detail=f"{words} {where}")
    for one in removed:
        detail = f"{words} {quoted(one.compartment)}: {one.weight_n} N"
        if one not in seen:
            than = "more" if one in heavier else "less"
            return undecided(f"{detail}, {than} than the item; nobody saw it since", _WHOEVER, source)
        if drop is None or abs(one.weight_n - drop.weight_n) <= WEIGHS_THE_SAME_N:
            return undecided(f"{detail}, as much as the item, which is seen there since", _WHOEVER, source)
    return None


_WHOEVER = "whoever took something out of the bin"


def _lies_in(case: Case, compartment: str, settled_s: float) -> Finding:
    found = _end(case, compartment, settled_s + CLOCKS_S)
    if found != compartment:
        elsewhere = _elsewhere(case, found, compartment)
        return standing(elsewhere) if _outside_at_last(case) else elsewhere
    gap_m, held_m = _gaps_m(case)
    if not gap_m >= held_m + OPEN_M:
        return at_least(
            gap_m, held_m + OPEN_M, "m", "the robot's joints", "half the gap between the fingers at the end"
        )
    return at_least(
        _hand_away_m(case, pose_of(case, case.item.id).position_m[-1]),
        AWAY_M,
        "m",
        source="motion capture of base and item, and the robot's joints",
        detail=f"the item lies in {found}; distance of the hand from it",
    )


def _elsewhere(case: Case, found: str, compartment: str) -> Finding:
    x_m, y_m, z_m = pose_of(case, case.item.id).position_m[-1]
    return equal(
        f"{found}, last at {x_m:.2f} {y_m:.2f} {z_m:.2f}",
        compartment,
        source="motion capture of the item",
        detail="where the item is from the drop on",
    )


def _mentioned(case: Case) -> bool:
    """Whether motion capture says after the last pose that is here where the item is, by a statement that is
    not here: then it saw it elsewhere, whether it sees it in the end or not."""
    statement = pose_of(case, case.item.id).statement
    assert statement is not None  # a site without motion capture has no such pose
    later = [one.statement for one in motion_of(case)[int(statement[-1]) + 1 :]]
    return any(
        isinstance(one, Motion) and case.item.id in one.tracks.keys() | one.resting.keys() for one in later
    )


def _end(case: Case, wanted: str, settled_s: float) -> str:
    """The compartment that the item is in from the drop on, or what keeps it from being in one."""
    item, layout = pose_of(case, case.item.id), BinLayout(case.bin)
    if (left := _left(case, wanted, settled_s)) != wanted:
        return left or "left it"
    last_s, last_m = float(item.time_s[-1]), item.position_m[-1]
    if _hidden(case):
        if _mentioned(case):
            return "elsewhere, according to a statement that was left out"
        if last_s < replay_of(case).release_s - EARLY_SLACK_S:
            return "out of sight before the release"
        x_m, y_m, z_m = last_m
        above = z_m >= case.bin.rim_height_m - BELOW_RIM_M
        return _compartment(layout, np.array([x_m, y_m, 0.0 if above else z_m])) or "out of sight elsewhere"
    lately_m = item.position_m[item.time_s >= last_s - JUDGED_AFTER_DROP_S / 2]
    # What stands on other things may tip over long after it was let go of; it does not rise by that.
    if (last_m[2] - lately_m[:, 2] > REST_M).any():
        return "being lifted"
    return _compartment(layout, last_m) or "elsewhere"


def _left(case: Case, wanted: str, settled_s: float) -> str | None:
    """Where the item was seen first that is not there from the drop on; None for nowhere in the bin."""
    layout, strayed = BinLayout(case.bin), _strayed(case, wanted, settled_s)
    names = [strayed, *(_fallen_into(case, layout, place) for place in _falling(case, settled_s))]
    return next((name for name in names if name not in (wanted, _ABOVE)), wanted)


def _strayed(case: Case, wanted: str, settled_s: float) -> str | None:
    """The same of what is in there, whenever it fell."""
    item, layout = pose_of(case, case.item.id), BinLayout(case.bin)
    names = (_compartment(layout, place) for place in item.position_m[item.time_s >= settled_s])
    return next((name for name in names if name != wanted), wanted)


def _outside_at_last(case: Case) -> bool:
    """Whether motion capture, which was not off any more, last saw the item in no compartment, and above none
    before it was hidden."""
    item = pose_of(case, case.item.id)
    if any(until_s > item.time_s[-1] for _, until_s in silent_s(case)):
        return False
    x_m, y_m, z_m = item.position_m[-1]
    return _compartment(BinLayout(case.bin), np.array([x_m, y_m, 0.0 if _hidden(case) else z_m])) is None


_ABOVE = "above the bin"


def _falling(case: Case, settled_s: float) -> np.ndarray:
    """(n, 3) where the item was from its release until the bin was sure of the drop."""
    item = pose_of(case, case.item.id)
    between = (item.time_s > replay_of(case).release_s + EARLY_SLACK_S) & (item.time_s < settled_s)
    return item.position_m[between]


def _fallen_into(case: Case, layout: BinLayout, point_m: np.ndarray) -> str | None:
    """`_ABOVE` for what is not below the bin's rim yet, else whose walls are around it; None for nobody's: a
    person may put it in from there."""
    x_m, y_m, z_m = point_m
    above = z_m >= case.bin.rim_height_m - BELOW_RIM_M
    return _ABOVE if above else _compartment(layout, np.array([x_m, y_m, 0.0]))


def _compartment(layout: BinLayout, point_m: np.ndarray) -> str | None:
    x_m, y_m, z_m = map(float, point_m)
    return next((name for name in layout.config.compartments if layout.contains(name, (x_m, y_m, z_m))), None)


def _hidden(case: Case) -> bool:
    """Whether motion capture does not see the item at the end, though it sees."""
    unseen = pose_of(case, case.item.id).unseen_s
    return bool(unseen) and unseen[-1][0] >= pose_of(case, case.item.id).time_s[-1]


def _hand_away_m(case: Case, item_m: np.ndarray) -> float:
    last_s = kinematics_of(case).time_s[-1:]
    return float(np.linalg.norm(kinematics_of(case).hand(last_s).position_m[0] - item_m))


def _gaps_m(case: Case) -> tuple[float, float]:
    """Half the gap between the fingers at the end, and while they held the item, m."""
    time_s, gap_m = gaps_of(case)
    held = (time_s >= phases_of(case).lifted_s) & (time_s < replay_of(case).release_s)
    return float(gap_m[-1]), float(np.median(gap_m[held]))


def weight(case: Case) -> Finding:
    """The bin felt about the item's weight. More than that may be the item and something else, which the bin
    takes for one drop: undecided where the item came to lie in the compartment."""
    drop = _drop(case)
    if (off := _off_weight(case, drop)) is None:
        return Finding(
            passed=None,
            measured=drop.weight_n,
            unit="N",
            source="statement of the bin",
            detail="the site declares no mass and tolerance for this item; the bin measured",
        )
    weighs = f"the bin measured {drop.weight_n} N, the item weighs {case.item.mass_kg * 9.81:.3f} N"
    if off[0] > off[1] and (case.unmarked or _lies_there(case, drop)):
        seen = "nobody" if case.unmarked else "motion capture"
        more = f"{weighs}, and {seen} saw it fall in: something else may have fallen in with it"
        return undecided(more, "whoever dropped it", source="statement of the bin")
    found = at_most(
        abs(off[0]),
        off[1],
        "",
        source="the site's item.mass_kg and lab.mass_tolerance",
        detail=f"{weighs}; relative difference",
    )
    # Whenever it was let go of: nothing that fell in weighed as much.
    offs = [one for drop in _drops(case) if (one := _off_weight(case, drop)) is not None]
    return standing(found) if all(share < -limit for share, limit in offs) else found


def _lies_there(case: Case, drop: Drop) -> bool:
    """Whether motion capture saw the item fall into the compartment, and nowhere else after."""
    return case.tracked and _end(case, drop.compartment, drop.settled_s + CLOCKS_S) == drop.compartment
