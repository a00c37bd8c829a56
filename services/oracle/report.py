"""What an oracle says about one proof: a verdict with one entry per check, recomputable by anyone."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel, ConfigDict

Measured = float | int | str | None


class Finding(BaseModel):
    """What one check found. `passed` is None when it could not be asked (no chain to compare with)."""

    model_config = ConfigDict(frozen=True)

    passed: bool | None
    measured: Measured = None
    limit: Measured = None
    unit: str = ""
    source: str = ""
    """Where the limit comes from."""
    detail: str = ""


class Check(Finding):
    """A finding under the name of its check."""

    name: str


class Report(BaseModel):
    """`reason` is "accepted", or the name of the first check that failed and why."""

    model_config = ConfigDict(frozen=True)

    kind: str | None
    task_id: int | None
    attempt: int | None
    proof_sha256: str | None
    item_pose_source: str | None = None
    """Of a cleaning: who said where the item lay, "motion capture" or, weaker, the robot's "perception"."""
    accepted: bool
    reason: str
    checks: list[Check]

    @classmethod
    def of(
        cls,
        checks: list[Check],
        *,
        kind: str | None = None,
        task_id: int | None = None,
        attempt: int | None = None,
        proof_sha256: str | None = None,
        item_pose_source: str | None = None,
    ) -> Report:
        failed = next((check for check in checks if check.passed is False), None)
        return cls(
            kind=kind,
            task_id=task_id,
            attempt=attempt,
            proof_sha256=proof_sha256,
            item_pose_source=item_pose_source,
            accepted=failed is None and bool(checks),
            reason=describe(failed) if failed else "accepted" if checks else "nothing was checked",
            checks=checks,
        )

    def to_bytes(self) -> bytes:
        """The JSON that is stored by content."""
        return json.dumps(self.model_dump(), indent=1, ensure_ascii=False).encode()

    def rows(self) -> list[tuple[str, str, str, str, str, str]]:
        """(check, result, measured, limit, source of the limit, detail) as text, for a table."""
        words = {True: "passed", False: "FAILED", None: "skipped"}
        return [
            (c.name, words[c.passed], _text(c.measured, c.unit), _text(c.limit, c.unit), c.source, c.detail)
            for c in self.checks
        ]


def describe(check: Check) -> str:
    """One line for the verdict: which check failed, on what."""
    values = ""
    if check.measured is not None and check.limit is not None:
        values = f" ({_text(check.measured, check.unit)}, limit {_text(check.limit, check.unit)})"
    return f"{check.name}: {check.detail}{values}"[:500]


def _text(value: Any, unit: str) -> str:
    if value is None:
        return ""
    number = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f"{number} {unit}".strip()


def at_most(measured: float, limit: float, unit: str, source: str, detail: str = "") -> Finding:
    """Passes when `measured` <= `limit`; a NaN fails."""
    return Finding(
        passed=bool(measured <= limit),
        measured=float(measured),
        limit=float(limit),
        unit=unit,
        source=source,
        detail=detail,
    )


def at_least(measured: float, limit: float, unit: str, source: str, detail: str = "") -> Finding:
    """Passes when `measured` >= `limit`; a NaN fails."""
    return at_most(measured, limit, unit, source, detail).model_copy(
        update={"passed": bool(measured >= limit)}
    )


def equal(measured: Measured, expected: Measured, source: str, detail: str = "") -> Finding:
    """Passes when both are the same."""
    return Finding(
        passed=measured == expected, measured=measured, limit=expected, source=source, detail=detail
    )


def skipped(detail: str) -> Finding:
    """Neither passed nor failed."""
    return Finding(passed=None, detail=detail)
