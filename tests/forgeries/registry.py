"""What is forged by hand, by the role that does it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from services.oracle.report import Report
from tests.forgeries.workshop import Submission, Workshop

Make = Callable[[Workshop], Submission]
Role = Literal["executor", "seller", "buyer", "creator", "bystander", "judge", "holder of two keys"]

ROLES: dict[Role, str] = {
    "executor": "records, seals and submits with its own robot's key, and may move things in the lab",
    "seller": "records, seals and submits with the key of its dock's meter",
    "buyer": "orders a charge, and signs its receipts with the robot's key",
    "creator": "posts the task: which, where, when, at which price, how often",
    "bystander": "is a member with a key of its own, and says on the bus and submits what it likes",
    "judge": "has the key of the oracle or of an auditor, and signs as somebody else",
    "holder of two keys": "has its own device's key and that of motion capture, bin, meter or robot, and is"
    " careless",
}
assert tuple(ROLES) == get_args(Role)


@dataclass(frozen=True)
class Forgery:
    make: Make
    role: Role
    check: str | None
    """The check that the verdict names; None where somebody spoils an honest proof, which is paid in full."""
    says: str = ""
    """Part of the verdict's reason."""

    @property
    def words(self) -> str:
        return " ".join((self.make.__doc__ or "").split())

    def worked(self, report: Report) -> bool:
        """Whether the forger got what it wanted."""
        if self.check is None:
            return not (report.accepted and report.amount_iec is None)
        return report.accepted

    def named(self, report: Report) -> bool:
        """Whether the verdict's reason is this forgery's own."""
        return self.check is None or (
            report.reason.split(":")[0] == self.check and self.says in report.reason
        )


CATALOGUE: dict[str, Forgery] = {}


def forgery(check: str, says: str = "", *, role: Role) -> Callable[[Make], Make]:
    """A proof that is refused by this check, with these words in the reason."""
    return _registered(lambda make: Forgery(make, role, check, says))


def spoiling(*, role: Role) -> Callable[[Make], Make]:
    """An honest proof that somebody tries to spoil, which is paid in full all the same."""
    return _registered(lambda make: Forgery(make, role, None))


def _registered(forgery_of: Callable[[Make], Forgery]) -> Callable[[Make], Make]:
    def register(make: Make) -> Make:
        assert make.__name__ not in CATALOGUE
        CATALOGUE[make.__name__] = forgery_of(make)
        return make

    return register


def kinds(role: Role | None = None) -> int:
    """How many kinds of proofs are refused, of a role or of all."""
    return sum(one.check is not None and role in (None, one.role) for one in CATALOGUE.values())


def listed() -> str:
    """docs/forgeries.md"""
    spoiled = len(CATALOGUE) - kinds()
    parts = [_HEAD.format(kinds=kinds(), spoiled=spoiled)]
    for role, has in ROLES.items():
        parts.append(f"## {role[0].upper()}{role[1:]}\n\nThe {role} {has}.\n\n{_COLUMNS}")
        for name, one in CATALOGUE.items():
            if one.role == role:
                parts.append(f"| {name.replace('_', ' ')} | {one.words} | {_outcome(one)} |")
        parts.append("")
    return "\n".join(parts)


def _outcome(one: Forgery) -> str:
    if one.check is None:
        return "paid in full"
    return f"`{one.check}`{f': {one.says}' if one.says else ''}"


_COLUMNS = "| forgery | what it is | outcome |\n|---|---|---|"
_HEAD = """\
# What was forged, and what refused it

{kinds} forgeries, made from honest recordings by `tests/forgeries`, by the role that makes them, and
{spoiled} ways to spoil an honest proof. Each forgery is refused by the check named, with these words in the
reason; a proof that somebody tries to spoil is paid in full all the same. "For the motion capture, too" is a
lab whose motion capture helps the forger. `make bench ONLY=forgeries` counts.
"""
