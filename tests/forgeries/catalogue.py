"""The forgeries of all kinds that are shipped, and the document that lists them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rodeo.checks.report import Report
from rodeo.site.config import Site
from rodeo_kinds.battery_charging import harness as charging
from rodeo_kinds.battery_charging.harness.film import KIND as BATTERY_CHARGING
from rodeo_kinds.waste_disposal import harness as cleaning
from rodeo_kinds.waste_disposal.harness.film import KIND as WASTE_DISPOSAL
from rodeo_testing.harness import ROLES, Forgery, Harness, Role
from rodeo_testing.workshop import Workshop

HARNESSES: dict[str, Harness[Any]] = {WASTE_DISPOSAL: cleaning.HARNESS, BATTERY_CHARGING: charging.HARNESS}
KIND_OF = {name: kind for kind, harness in HARNESSES.items() for name in harness.forgeries}
CATALOGUE: dict[str, Forgery[Any]] = {
    name: one for harness in HARNESSES.values() for name, one in harness.forgeries.items()
}
assert len(CATALOGUE) == sum(len(harness.forgeries) for harness in HARNESSES.values())


class Shops:
    """A workshop for each kind."""

    def __init__(self, site: Site, folder: Path) -> None:
        self._shops: dict[str, Workshop] = {}
        for kind, harness in HARNESSES.items():
            own = folder / kind
            own.mkdir(parents=True)
            self._shops[kind] = harness.workshop(site, own)

    def __getitem__(self, kind: str) -> Workshop:
        return self._shops[kind]

    def judged(self, name: str, noise_seed: int | None = None) -> Report:
        """What the oracle says of the forgery of this name."""
        shop = self[KIND_OF[name]]
        return shop.judged(CATALOGUE[name].make(shop if noise_seed is None else shop.under_noise(noise_seed)))

    def empty(self) -> None:
        for shop in self._shops.values():
            shop.empty()


def kinds(role: Role | None = None) -> int:
    """How many kinds of proofs are refused, of a role or of all."""
    return sum(one.check is not None and role in (None, one.role) for one in CATALOGUE.values())


def listed() -> str:
    """docs/reference/forgeries.md"""
    spoiled = len(CATALOGUE) - kinds()
    parts = [_HEAD.format(kinds=kinds(), spoiled=spoiled)]
    for role, has in ROLES.items():
        parts.append(f"## {role[0].upper()}{role[1:]}\n\nThe {role} {has}.\n\n{_COLUMNS}")
        for name, one in CATALOGUE.items():
            if one.role == role:
                parts.append(f"| {name.replace('_', ' ')} | {one.words} | {_outcome(one)} |")
        parts.append("")
    return "\n".join(parts)


def _outcome(one: Forgery[Any]) -> str:
    if one.check is None:
        return "paid in full"
    failed = f": {one.doubts} failed" if one.doubts else ""
    end = f"; {one.ruling.replace('_', ' ')}{failed}{', and nobody is fined' if one.ruins else ''}"
    check = "no check" if one.check == "accepted" else f"`{one.check}`"
    return f"{check}{f': {one.says}' if one.says else ''}{'' if one.ruling == 'rejected' else end}"


_COLUMNS = "| forgery | what it is | outcome |\n|---|---|---|"
_HEAD = """\
# Forgeries, and the checks that refuse them

This page lists {kinds} forgeries, made from honest recordings by `rodeo_kinds/*/harness`, and
{spoiled} ways to spoil an honest proof. They are sorted by the role that makes them. The last column names
the check that refuses the forgery, with a part of the verdict's reason. The case ends with a rejection unless
the column says how else, and whose failure that is, as far as everybody else says nothing. "Paid in full"
means that the attempt to spoil the proof failed. "Nobody is fined" means that somebody kept an honest robot
from its work, or from being seen at it, and that it is not fined for that. In a forgery with "for the motion
capture, too", the lab's motion capture helps the forger. `make bench ONLY=forgeries` counts.
"""
