"""What a proof pays its executor by the contracts' rules, if only its judge acts on it.

What the oracle finds and what becomes of its word -> the ruling with which the case ends -> what that pays.
docs/reference/contracts.md has the same two tables, which `contracts/test/Ends.t.sol` and `Silence.t.sol`
compute.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from rodeo.bus.messages import Ruling
from rodeo.checks.report import Report

Judging = Literal["ruled", "silent", "split", "removed", "unanswered"]
"""What becomes of the oracle's word. Silent: it is down for its whole window. Split: too few oracles vote for
the same. Removed: its judge is, before the case ends. Unanswered: who decides about a challenge is down."""
DOUBTED: dict[Judging, str] = {
    "silent": "the oracle",
    "split": "the quorum",
    "removed": "the judge",
}
"""Judge without a word -> the party that counts as failed."""


class End(NamedTuple):
    """Cells of the row in the contracts' table."""

    paid: str
    penalty: str

    @property
    def pays(self) -> bool:
        return self.paid != "nothing"

    @property
    def is_fine(self) -> bool:
        """Whether a proven executor pays it."""
        return self.penalty.partition(";")[0] != "none"


ENDS: dict[Ruling, End] = {
    "accepted": End("the amount", "none"),
    "impossible": End("a tenth of the price", "none"),
    "rejected": End("nothing", "to the treasury"),
    "given_up": End("nothing", "none; to the treasury if not proven"),
    "void": End("nothing", "none"),
}


def ended(report: Report, judging: Judging = "ruled") -> Ruling:
    """The ruling with which the case ends."""
    if judging in DOUBTED or report.outcome == "undecided":  # passed on to auditors that say nothing
        return "void"
    return report.outcome


def doubted(report: Report, judging: Judging = "ruled") -> str | None:
    """The party that failed, where that decides; None where the executor's own word does."""
    return DOUBTED.get(judging, report.fault)
