"""What an oracle says about one proof: a verdict with one entry per check, recomputable by anyone.

A verdict has one of five outcomes. *Rejected*: a check failed for a reason that the executor answers for.
*Undecided*: a check failed for a reason that neither party owns (`Finding.fault`), so people decide.
*Given up*: the executor could not do it and did no harm, or the checks themselves failed at the proof.
*Impossible*: the executor gave up, and a check found that nobody could have done the task. *Accepted*: none
failed.

A rejection goes before everything else: what the executor did wrong is as wrong when a witness failed beside
it. So stages run in order and end at the first with a rejection. Of other failures the first names the
verdict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from rodeo.bus.messages import Fault
from rodeo.text.foreign_text import printable, quoted, shortened
from rodeo.text.strict_json import plain, write_json

Outcome = Literal["accepted", "rejected", "undecided", "given_up", "impossible"]
_PARTIES: dict[str, Fault] = {"the task's creator": "creator", "the oracle": "oracle", "the store": "oracle"}
"""The party that failed -> as the contracts name it. A site without its store has no judge."""

NOBODY = "nobody"
"""Is at fault where nothing failed, and a machine alone does not decide."""
REASON_CHARACTERS = 500
_DETAIL_CHARACTERS = 1000


def _as_shown(value: float | int | str | None) -> float | int | str | None:
    if isinstance(value, str):
        return printable(value)
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


Text = Annotated[str, AfterValidator(printable)]
"""Text that holds of others' words what `quoted` makes of them."""
Measured = Annotated[float | int | str | None, AfterValidator(_as_shown)]
"""What JSON has no number for is text: "nan", "inf"."""


class Finding(BaseModel):
    """What one check found. `passed` is None when it could not be asked (no chain to compare with)."""

    model_config = ConfigDict(frozen=True)

    passed: bool | None
    measured: Measured = None
    limit: Measured = None
    unit: Text = ""
    source: Text = ""
    """Where the limit comes from."""
    detail: Annotated[Text, AfterValidator(lambda text: shortened(text, _DETAIL_CHARACTERS))] = ""
    fault: Text | None = None
    """The party that failed, where a check did not pass and that is neither party's failure: "the oracle",
    "the site's motion capture". The check is then undecided, unless it is something `instead`."""
    instead: Literal["given_up", "impossible"] | None = None
    """Outcome of a check that did not pass. Given up: the executor could not do it. Impossible: nobody
    could, by who is at `fault`, and the executor is paid for its trouble."""
    stands: bool = Field(default=False, exclude=True)
    """Whether a failure stands whatever a witness had said while it was silent: it was found without that."""

    last: bool = Field(default=False, exclude=True)
    """Whether nothing more is asked where it did not pass."""

    @property
    def undecided(self) -> bool:
        return self.outcome == "undecided"

    @property
    def outcome(self) -> Outcome | None:
        """What a check that did not pass makes of the verdict; None of another one."""
        if self.passed is not False:
            return None
        return self.instead or ("rejected" if self.fault is None else "undecided")


class Check(Finding):
    """A finding under the name of its check."""

    name: str

    @classmethod
    def of(cls, name: str, found: Finding) -> Self:
        return cls(name=name, **dict(found))


class Report(BaseModel):
    """`reason` is "accepted", or the name of the check that decided and why."""

    model_config = ConfigDict(frozen=True)

    kind: str | None
    task_id: int | None
    attempt: int | None
    proof_sha256: str | None
    item_pose_source: str | None = None
    """The source of where the item of a cleaning lay, "motion capture" or, weaker, the robot's
    "perception"."""
    outcome: Outcome
    reason: str
    fault: str | None = None
    """The party that failed, of an undecided verdict and of an impossible task."""
    party: Fault = "nobody"
    """The same as the contracts name it."""
    amount_iec: Decimal | None = None
    """What an accepted proof is paid; None is the task's full price."""
    acts: list[str] = []
    """What was done and can be paid for only once (`rodeo.checks.acts`). Of a proof that was not accepted as
    far as they are known: people may accept it yet."""
    rules_sha256: str | None = None
    """Hash of the rules that the checks are (`rodeo.checks.rules`); None where people judge the kind."""
    checks: list[Check]

    @property
    def accepted(self) -> bool:
        return self.outcome == "accepted"

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
        amount_iec: Decimal | None = None,
        acts: Sequence[str] = (),
        rules_sha256: str | None = None,
        parties: Mapping[str, Fault] | None = None,
    ) -> Report:
        """The report that these checks make; what is paid only where they allow it. `parties`: who is at
        fault -> as the contracts name it."""
        failed = [check for check in checks if check.passed is False]
        # The first failed check that is the executor's fault; else the first failed check.
        decisive = min(failed, key=lambda check: check.outcome != "rejected", default=None)
        outcome: Outcome = "accepted" if checks else "rejected"
        if decisive is not None:
            outcome = decisive.outcome or outcome
        fault = (decisive and decisive.fault) or ""
        return cls(
            kind=kind,
            task_id=task_id,
            attempt=attempt,
            proof_sha256=proof_sha256,
            item_pose_source=item_pose_source,
            outcome=outcome,
            reason=describe(decisive) if decisive else "accepted" if checks else "nothing was checked",
            fault=fault or None,
            party=(_PARTIES | dict(parties or {})).get(fault.partition(",")[0], "nobody"),
            amount_iec=amount_iec if outcome == "accepted" else None,
            acts=list(acts),
            rules_sha256=rules_sha256,
            checks=checks,
        )

    def with_checks(self, *more: Check, first: bool = False) -> Report:
        """The report that these checks make with the ones that there are, put before or behind them."""
        checks = [*more, *self.checks] if first else [*self.checks, *more]
        return Report.of(
            checks,
            kind=self.kind,
            task_id=self.task_id,
            attempt=self.attempt,
            proof_sha256=self.proof_sha256,
            item_pose_source=self.item_pose_source,
            amount_iec=self.amount_iec,
            acts=self.acts,
            rules_sha256=self.rules_sha256,
            parties={} if self.fault is None else {self.fault: self.party},
        )

    def to_bytes(self) -> bytes:
        """The JSON that is stored by content."""
        return write_json(plain(self.model_dump(mode="json")), indent=1)

    def rows(self) -> list[tuple[str, str, str, str, str, str]]:
        """(check, result, measured, limit, source of the limit, detail) as text, for a table."""
        words = {True: "passed", False: "FAILED", None: "skipped"}
        return [
            (
                c.name,
                words[c.passed] if c.outcome in (None, "rejected") else str(c.outcome).replace("_", " "),
                _text(c.measured, c.unit),
                _text(c.limit, c.unit),
                c.source,
                c.detail,
            )
            for c in self.checks
        ]


def describe(check: Check) -> str:
    """One line for the verdict: which check failed, on what, and whose failure it is if not a party's."""
    values = ""
    if check.measured is not None and check.limit is not None:
        values = f" ({_text(check.measured, check.unit)}, limit {_text(check.limit, check.unit)})"
    fault = ""
    if check.fault is not None:
        but = "people decide" if check.fault == NOBODY else "not the executor"
        fault = f"; {check.fault} is at fault, {but}"
    return shortened(f"{check.name}: {check.detail}{values}", REASON_CHARACTERS - len(fault)) + fault


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
    """Passes when both are the same. Text is quoted: either may be others' words."""
    shown, limit = (quoted(one) if isinstance(one, str) else one for one in (measured, expected))
    return Finding(passed=measured == expected, measured=shown, limit=limit, source=source, detail=detail)


def undecided(detail: str, fault: str, source: str = "") -> Finding:
    """Neither party failed but `fault` did: people decide."""
    return Finding(passed=False, source=source, detail=detail, fault=fault)


def impossible(detail: str, fault: str, source: str = "") -> Finding:
    """Nobody could do what `fault` asked for."""
    return Finding(passed=False, source=source, detail=detail, fault=fault, instead="impossible")


def given_up(detail: str, source: str = "", fault: str | None = None) -> Finding:
    """The executor could not do it, or `fault` could not judge it: nobody is paid, nobody pays."""
    return Finding(passed=False, source=source, detail=detail, fault=fault, instead="given_up")


def standing(found: Finding) -> Finding:
    """The same, found without what a witness could have said while it was silent."""
    return found.model_copy(update={"stands": True})


def skipped(detail: str) -> Finding:
    """Neither passed nor failed."""
    return Finding(passed=None, detail=detail)
