"""What the bin says: an attestation by a device that is not the robot's."""

from typing import Any

from rodeo.lab.config import ItemClass
from services.oracle.case import Case, CaseError
from services.oracle.report import Finding, equal

DROP_SLACK_S = 10.0
"""Between the release and the change of weight in the compartment: the fall, and what slips late."""
EARLY_SLACK_S = 1.0
"""Clocks of bin and robot, and pads that touch the item a little longer than they hold it."""


def _statements(case: Case, *keys: str) -> list[dict[str, Any]]:
    """Payloads signed by this site's bin that have `keys`, in order."""
    return [s.payload for s in case.stated("bin", "bin", *keys) if s.payload["bin"] == case.site.bin.name]


def _classification(case: Case) -> dict[str, Any]:
    """The one that the drop refers to, or the last. Raises CaseError."""
    statements = _statements(case, "class", "compartment", "image_sha256", "time_s")
    if not statements:
        raise CaseError("no classification signed by the bin is in the recording", bin=case.site.bin.name)
    drop = drop_of(case)
    wanted = drop["classification_seq"] if drop else None
    return next((s for s in statements if s.get("seq") == wanted), statements[-1])


def drop_of(case: Case) -> dict[str, Any] | None:
    """The first that the release can explain, else the last: others may use the bin meanwhile."""
    drops = _statements(case, "classification_seq", "compartment", "weight_n", "after_s", "time_s")
    if not drops:
        return None
    earliest_s = case.replay.release_s - EARLY_SLACK_S
    return next((drop for drop in drops if float(drop["time_s"]) >= earliest_s), drops[-1])


def expected_compartment(case: Case) -> str:
    """By the site's mapping of the attested class. Raises CaseError."""
    label = str(_classification(case)["class"])
    # What the bin does not recognize goes where trash goes.
    return case.site.bin.compartment_of(ItemClass(label) if label in set(ItemClass) else ItemClass.TRASH)


def classified(case: Case) -> Finding:
    """The item was shown to the bin between grasp and release."""
    statement = _classification(case)
    at_s = float(statement["time_s"])
    phases, release_s = case.replay.phases, case.replay.release_s
    return Finding(
        passed=phases.closing_s <= at_s <= release_s,
        measured=at_s - phases.closing_s,
        limit=release_s - phases.closing_s,
        unit="s",
        source="attestation of the bin",
        detail=f"shown as {statement['class']!s:.40} after the grasp, before the release",
    )


def dropped(case: Case) -> Finding:
    """The bin felt it fall into the compartment that it asked for, when the replay lets go of it."""
    drop = drop_of(case)
    if drop is None:
        raise CaseError("no drop signed by the bin is in the recording", bin=case.site.bin.name)
    if drop["classification_seq"] != _classification(case).get("seq"):
        return equal(
            str(drop["classification_seq"]),
            str(_classification(case).get("seq")),
            source="attestation of the bin",
            detail="the drop refers to another classification",
        )
    release_s = case.replay.release_s
    delay_s, late_s = float(drop["after_s"]) - release_s, float(drop["time_s"]) - release_s
    early = not late_s >= -EARLY_SLACK_S
    if early or not delay_s <= DROP_SLACK_S:
        return Finding(
            passed=False,
            measured=late_s if early else delay_s,
            limit=-EARLY_SLACK_S if early else DROP_SLACK_S,
            unit="s",
            source="attestation of the bin",
            detail="from the release in the replay to the attested drop",
        )
    return equal(
        str(drop["compartment"]),
        expected_compartment(case),
        source="attestation of the bin",
        detail=f"fell with {drop['weight_n']} N into",
    )
