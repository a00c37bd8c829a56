"""Ask a kind's checks about its honest runs and its forgeries."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from rodeo.site.config import Site
from rodeo_testing.harness import Harness

What = Literal["honest run", "forgery", "honest run that is spoiled"]


@dataclass(frozen=True)
class Outcome:
    """The checks' findings on one proof."""

    name: str
    what: What
    expected: str
    """"accepted", or the check that has to refuse it."""
    accepted: bool
    reason: str
    passed: bool
    """Whether it is as expected: a forgery is refused for its own reason."""
    verify_s: float
    """Wall time of the verification."""


def lab() -> Site:
    """The site that comes with RODEO, in which the harnesses of all kinds work."""
    return Site.load(Path(str(files("deploy"))) / "sites" / "lab.toml")


def outcomes(harness: Harness[Any], site: Site, folder: Path, only: str = "") -> Iterator[Outcome]:
    """Each honest run and then each forgery, in files below `folder`; `only` is part of the names wanted."""
    shop = harness.workshop(site, folder)
    for name, make in harness.honest_runs.items():
        if only in name:
            submission, begun_s = make(shop), time.monotonic()
            report = shop.judged(submission)
            paid = report.accepted and report.amount_iec is None
            took_s = time.monotonic() - begun_s
            yield Outcome(name, "honest run", "accepted", report.accepted, report.reason, paid, took_s)
            shop.empty()
    for name, forgery in harness.forgeries.items():
        if only in name:
            submission, begun_s = forgery.make(shop), time.monotonic()
            report = shop.judged(submission)
            yield Outcome(
                name,
                "forgery" if forgery.check else "honest run that is spoiled",
                forgery.check or "accepted",
                report.accepted,
                report.reason,
                not forgery.worked(report) and forgery.named(report),
                time.monotonic() - begun_s,
            )
            shop.empty()
