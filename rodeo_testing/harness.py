"""A kind's honest runs and its forgeries: who makes them, and which check has to refuse them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, TypedDict, TypeVar, Unpack, get_args

from rodeo.bus.messages import Ruling
from rodeo.checks.report import Report
from rodeo.site.config import Site
from rodeo_testing.ends import ENDS, Judging, doubted, ended
from rodeo_testing.workshop import Submission, Workshop

W = TypeVar("W", bound=Workshop)
Role = Literal["executor", "seller", "buyer", "creator", "bystander", "judge", "holder of two keys"]

ROLES: dict[Role, str] = {
    "executor": "records, seals and submits with its own robot's key, and may move things in the lab",
    "seller": "records, seals and submits with the key of its dock's meter",
    "buyer": "orders a charge, and signs its receipts with the robot's key",
    "creator": "posts the task, and chooses its content, time, price and number of attempts",
    "bystander": "is a member with its own key, and publishes on the bus and submits anything",
    "judge": "has the key of the oracle or of an auditor, and signs as somebody else",
    "holder of two keys": "has the key of its own device and that of motion capture, bin, meter or robot, but"
    " makes mistakes",
}
assert tuple(ROLES) == get_args(Role)


def _words(make: Callable[[W], Submission]) -> str:
    return " ".join((make.__doc__ or "").split())


class Ending(TypedDict, total=False):
    """The end of a case, where it is not rejected."""

    doubts: str
    """The party that failed: the case is void."""
    given_up: bool
    """Whether the executor itself gave up."""
    judging: Judging
    """The fate of the oracle's word."""


@dataclass(frozen=True)
class Forgery(Generic[W]):
    make: Callable[[W], Submission]
    role: Role
    check: str | None
    """The check that the verdict names; None where somebody spoils an honest proof, which is paid in full."""
    says: str = ""
    """Part of the verdict's reason."""
    ruins: bool = False
    """Whether somebody else keeps an honest executor from its work by it: then nobody is paid or fined."""
    doubts: str | None = None
    given_up: bool = False
    judging: Judging = "ruled"

    @property
    def words(self) -> str:
        return _words(self.make)

    @property
    def ruling(self) -> Ruling:
        """The ruling with which the case ends."""
        if self.check is None:
            return "accepted"
        if self.doubts is not None:
            return "void"
        return "given_up" if self.given_up else "rejected"

    @property
    def unworked(self) -> bool:
        """Whether the work was not done."""
        return self.check is not None and not self.ruins

    def worked(self, report: Report) -> bool:
        """Whether the forger got what it wanted, or a part of the price."""
        end = ENDS[ended(report, self.judging)]
        if self.check is None:
            return not (end.paid == "the amount" and report.amount_iec is None)
        return end.pays or (self.ruins and end.is_fine)

    def named(self, report: Report) -> bool:
        """Whether the verdict's reason is this forgery's own, and the case ends as it says, for the failure
        of whom it says."""
        end = ended(report, self.judging), doubted(report, self.judging)
        return self.check is None or (
            end == (self.ruling, self.doubts)
            and report.reason.split(":")[0] == self.check
            and self.says in report.reason
        )


class Harness(Generic[W]):
    """Forgeries and honest runs of one kind, by name. Each is one function, whose docstring describes what it
    does."""

    def __init__(self, workshop: Callable[[Site, Path], W]) -> None:
        self.workshop = workshop
        self.honest_runs: dict[str, Callable[[W], Submission]] = {}
        self.forgeries: dict[str, Forgery[W]] = {}

    def honest(self, make: Callable[[W], Submission]) -> Callable[[W], Submission]:
        """A proof that is accepted and paid in full."""
        assert make.__name__ not in self.honest_runs
        self.honest_runs[make.__name__] = make
        return make

    def forgery(
        self, check: str, says: str = "", *, role: Role, **ending: Unpack[Ending]
    ) -> Callable[[Callable[[W], Submission]], Callable[[W], Submission]]:
        """A proof that is refused by this check, with these words in the reason."""
        return lambda make: self._register(Forgery(make, role, check, says, **ending))

    def ruining(
        self, check: str, says: str = "", *, role: Role, **ending: Unpack[Ending]
    ) -> Callable[[Callable[[W], Submission]], Callable[[W], Submission]]:
        """Honest work that somebody prevents, or hides. This check reports it, with these
        words, and nobody is fined."""
        return lambda make: self._register(Forgery(make, role, check, says, ruins=True, **ending))

    def spoiling(
        self, *, role: Role, judging: Judging = "ruled"
    ) -> Callable[[Callable[[W], Submission]], Callable[[W], Submission]]:
        """An honest proof that somebody tries to spoil, which is paid in full all the same."""
        return lambda make: self._register(Forgery(make, role, None, judging=judging))

    def _register(self, forgery: Forgery[W]) -> Callable[[W], Submission]:
        name = forgery.make.__name__
        assert name not in self.forgeries
        self.forgeries[name] = forgery
        return forgery.make
