"""The figures of an audit, and what a program reads of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from rodeo_cli.auditing.bounds import upper_bound
from rodeo_cli.auditing.judging import RootFinding, Verdict


@dataclass(frozen=True)
class Summary:
    """What an audit found."""

    org: str
    block: int
    """The newest that was read."""
    known: int
    """Verdicts in the blocks that were asked for; of a sample, those of an oracle."""
    sampled: bool
    verdicts: Sequence[Verdict]
    roots: int
    odd_roots: Sequence[RootFinding]
    contradiction: str | None
    """What contracts and events disagree about."""

    @property
    def wrong(self) -> list[Verdict]:
        return [one for one in self.verdicts if one.wrong]

    @property
    def worth_a_look(self) -> list[Verdict]:
        """Wrong verdicts, then failed ones, then notes: a list that is cut leaves out the last."""
        found = (one for one in self.verdicts if one.findings or one.failed)
        return sorted(found, key=lambda one: (not one.wrong, not one.failed))

    @property
    def failed(self) -> list[Verdict]:
        """Verdicts that could not be judged again, though they should have been."""
        return [one for one in self.verdicts if one.failed]

    @property
    def wrong_roots(self) -> list[RootFinding]:
        return [one for one in self.odd_roots if not one.failed]

    @property
    def failed_roots(self) -> list[RootFinding]:
        """Roots whose log could not be looked at."""
        return [one for one in self.odd_roots if one.failed]

    @property
    def judged(self) -> int:
        return sum(bool(one.today) for one in self.verdicts)

    @property
    def paid_iec(self) -> Decimal:
        return sum((one.attempt.paid_iec for one in self.verdicts), Decimal(0))

    @property
    def most_wrong(self) -> float | None:
        """With 95 % confidence no larger share of all verdicts is wrong; None where all were looked at. What
        could not be judged again counts as wrong."""
        if not self.sampled or not self.verdicts:
            return None
        return upper_bound(sum(one.wrong or one.failed for one in self.verdicts), len(self.verdicts))

    @property
    def is_clean(self) -> bool:
        return not (self.wrong or self.wrong_roots or self.contradiction)

    def to_json(self) -> dict[str, Any]:
        return {
            "organization": self.org,
            "block": self.block,
            "verdicts_known": self.known,
            "verdicts": [_to_json(one) for one in self.verdicts],
            "judged_again": self.judged,
            "wrong": len(self.wrong),
            "failed": len(self.failed),
            "findings": dict(Counter(f.what for one in self.verdicts for f in one.findings if f.wrong)),
            "upper_bound_95": self.most_wrong,
            "paid_iec": f"{self.paid_iec:f}",
            "roots": self.roots,
            "wrong_roots": [
                {"device": one.root.device, "day": one.root.day, "detail": one.detail}
                for one in self.wrong_roots
            ],
            "failed_roots": len(self.failed_roots),
            "contradiction": self.contradiction,
        }


def _to_json(verdict: Verdict) -> dict[str, Any]:
    attempt = verdict.attempt
    return {
        "task_id": attempt.task_id,
        "attempt": attempt.number,
        "kind": verdict.kind,
        "block": attempt.block,
        "time_s": attempt.time_s,
        "proof_sha256": attempt.proof_sha256,
        "ruling": attempt.ruling,
        "paid_iec": f"{attempt.paid_iec:f}",
        "report_sha256": attempt.report_sha256,
        "report_uri": attempt.report_uri,
        "rules_sha256": verdict.rules_sha256,
        "today": verdict.today or None,
        "by": verdict.by or None,
        "reason": verdict.reason,
        "same_report": verdict.same_report,
        "unjudged": verdict.unjudged or None,
        "log": verdict.log or None,
        "wrong": verdict.wrong,
        "findings": [one._asdict() for one in verdict.findings],
    }
