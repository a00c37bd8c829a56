"""What each check is good for: which forgeries pass, and which honest runs return, when it is off.

A proof is judged with all checks. Where the stage at which it ends has no failure but those of the part that
is turned off, it is judged again without that part. Elsewhere the verdict is the same with and without it.
"""

from __future__ import annotations

import csv
import inspect
import json
import logging
import re
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import wraps
from hashlib import file_digest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rodeo.checks.case import Case, CheckFunction, Checks
from rodeo.checks.report import Finding, Report
from rodeo.kinds import kinds_of
from rodeo.site.config import Site
from rodeo_experiments.results import median
from rodeo_testing.check import lab
from rodeo_testing.harness import Harness
from rodeo_testing.workshop import Submission, Workshop

log = logging.getLogger(__name__)

Say = Callable[[str, float], None]


@dataclass
class Part:
    """Something that is turned off: a witness, one check, or all checks of one module."""

    kind: str
    name: str
    checks: frozenset[str]
    decides: int = 0
    """Forgeries that this part alone refuses at the stage at which they end."""
    passing: list[str] = field(default_factory=list)
    """Forgeries that are accepted without it."""
    refused: list[str] = field(default_factory=list)
    """Noisy honest runs that it refuses."""
    returning: list[str] = field(default_factory=list)
    """Those of them that are accepted without it."""
    seconds: float = 0.0
    """Median wall time of it in an honest run."""


@dataclass
class Found:
    """What an ablation came to."""

    parts: list[Part]
    forgeries: int
    honest: int
    wall_s: float

    def results(self) -> dict[str, Any]:
        return {
            "forgeries": self.forgeries,
            "noisy_honest_runs": self.honest,
            "wall_s": round(self.wall_s, 1),
            "parts": [
                {
                    "kind": one.kind,
                    "part": one.name,
                    "checks": sorted(one.checks),
                    "decides": one.decides,
                    "forgeries_passing": sorted(one.passing),
                    "honest_refused": sorted(one.refused),
                    "honest_returning": sorted(one.returning),
                    "seconds": round(one.seconds, 4),
                }
                for one in self.parts
            ],
        }


def ablate(sample: int, seeds: int, seed: int, say: Say) -> Found:
    """Judge `sample` forgeries of each kind, drawn by `seed`, and each honest run under `seeds` noises."""
    site = lab()
    begun_s = time.monotonic()
    chance = np.random.default_rng(seed)
    parts: list[Part] = []
    forgeries = honest = 0
    kinds = {name: kind for name, kind in kinds_of(site).items() if kind.harness}
    with TemporaryDirectory() as folder:
        for number, (name, kind) in enumerate(kinds.items()):
            own = Path(folder, name)
            own.mkdir()
            found = KindAblation(name, kind.load_checks(), kind.load_harness(), site, own)

            def told(text: str, share: float, number: int = number, name: str = name) -> None:
                say(f"{name}: {text}", (number + share) / len(kinds))

            names = [one for one, forgery in found.harness.forgeries.items() if forgery.check]
            chosen = sorted(chance.permutation(names)[:sample].tolist())
            forgeries += found.forge(chosen, told)
            honest += found.be_honest(seeds, told)
            parts += found.parts()
    return Found(parts, forgeries, honest, time.monotonic() - begun_s)


class KindAblation:
    """The ablation of one kind's checks, on its harness. `folder` is the workshop's."""

    def __init__(self, name: str, checks: Checks, harness: Harness[Any], site: Site, folder: Path) -> None:
        self._name = name
        self.harness = harness
        self._shop: Workshop = harness.workshop(site, folder)
        self._seconds: dict[str, list[float]] = defaultdict(list)
        self._stages = [frozenset(one.__name__ for one in stage) for stage in checks.stages]
        modules: dict[str, set[str]] = defaultdict(set)
        for stage in checks.stages:
            for one in stage:
                modules[_subject(one)].add(one.__name__)
        each = [Part(name, one, frozenset([one])) for stage in self._stages for one in sorted(stage)]
        whole = [Part(name, f"all: {one}", frozenset(found)) for one, found in sorted(modules.items())]
        witnesses = [
            Part(name, f"witness: {witness}", frozenset(resting))
            for witness, words in WITNESSES.items()
            if (resting := {one.__name__ for stage in checks.stages for one in stage if rests_on(one, words)})
        ]
        self._parts = [*witnesses, *each, *(one for one in whole if len(one.checks) > 1)]

    def forge(self, names: Collection[str], say: Say) -> int:
        """Judge these forgeries; how many there were."""
        for number, name in enumerate(names):
            say(f"forgery {number + 1} of {len(names)}", 0.7 * number / len(names))
            kept = _kept(self._shop, self.harness.forgeries[name].make(self._shop))
            failed = self._failed(self._shop.judged(kept))
            for part in self._parts:
                if failed and failed <= part.checks:
                    part.decides += 1
                    if self._passes(self._shop, kept, part):
                        part.passing.append(name)
            self._shop.empty()
        return len(names)

    def be_honest(self, seeds: int, say: Say) -> int:
        """Judge each honest run under so many noises; how many there were."""
        runs = [(name, seed) for name in self.harness.honest_runs for seed in range(seeds)]
        for number, (name, seed) in enumerate(runs):
            say(f"honest run {number + 1} of {len(runs)}", 0.7 + 0.3 * number / len(runs))
            shop = self._shop.under_noise(seed)
            kept = _kept(shop, self.harness.honest_runs[name](shop))
            failed = self._failed(shop.judged(kept, self._timed))
            for part in self._parts:
                if failed & part.checks:
                    part.refused.append(f"{name} {seed}")
                    if failed <= part.checks and self._passes(shop, kept, part):
                        part.returning.append(f"{name} {seed}")
            self._shop.empty()
        return len(runs)

    def parts(self) -> list[Part]:
        for part in self._parts:
            part.seconds = sum(median(self._seconds[one]) for one in part.checks if self._seconds[one])
        return self._parts

    @staticmethod
    def _failed(report: Report) -> frozenset[str]:
        return frozenset(one.name for one in report.checks if one.passed is False)

    def _passes(self, shop: Workshop, kept: Submission, part: Part) -> bool:
        def without(checks: Checks) -> Checks:
            left = [tuple(one for one in stage if one.__name__ not in part.checks) for stage in checks.stages]
            return replace(checks, stages=tuple(left))

        try:
            return shop.judged(kept, without).accepted
        except AssertionError as error:
            # It relies on what a check that is off would have refused.
            log.info("a check cannot do without %s: %r", part.name, error)
            return False

    def _timed(self, checks: Checks) -> Checks:
        return replace(checks, stages=tuple(tuple(map(self._timing, stage)) for stage in checks.stages))

    def _timing(self, check: CheckFunction) -> CheckFunction:
        @wraps(check)
        def timed(case: Case) -> Finding:
            begun_s = time.perf_counter()
            try:
                return check(case)
            finally:
                self._seconds[check.__name__].append(time.perf_counter() - begun_s)

        return timed


WITNESSES = {
    "motion capture": re.compile(r"\bmotion_capture_of\b|\bmotions?_of\b|\bpose_of\b"),
    "bin": re.compile(r"\bdrop_of\b|\bbin_of\b|\"bin\""),
    "gripper": re.compile(r"\bgrip(?!per_body)|_grip|\bfinger"),
    "meter receipts": re.compile(r"\bcharge_of\b|\breceipt"),
}
"""A witness -> what a check calls or names in its code to read it."""


def rests_on(check: CheckFunction, words: re.Pattern[str]) -> bool:
    """Whether the check, or a function of its own module that it calls, reads what these words name."""
    seen: set[Any] = set()
    waiting: list[Any] = [inspect.unwrap(check)]
    while waiting:
        function = waiting.pop()
        if function in seen:
            continue
        seen.add(function)
        if words.search(_code(function)):
            return True
        for name in function.__code__.co_names:
            other = inspect.unwrap(function.__globals__.get(name, check))
            if inspect.isfunction(other) and other.__module__ == check.__module__:
                waiting.append(other)
    return False


def _code(function: Any) -> str:
    """Its source without its docstring."""
    text = inspect.getsource(function)
    return text.replace(inspect.getdoc(function) or "\0", "") if function.__doc__ else text


def _subject(check: CheckFunction) -> str:
    """The module that the check is in."""
    *_, above, name = check.__module__.split(".")
    return f"{above}'s own checks" if name == "checks" else name


def _kept(shop: Workshop, submission: Submission) -> Submission:
    """The same in the store, to be judged more than once."""
    if submission.path is None:
        return submission
    with submission.path.open("rb") as file:
        sha256 = submission.sha256 or "0x" + file_digest(file, "sha256").hexdigest()
    uri = submission.uri or shop.deposit(submission.path)
    return replace(submission, path=None, uri=uri, sha256=sha256)


# -- what is written -------------------------------------------------------------------------------------


def write(found: Found, folder: Path) -> None:
    """results.json, ablation.csv, figures/ablation.svg, report.md and report.html."""
    from rodeo_experiments.ablation_figure import draw  # needs the extra `experiment`
    from rodeo_experiments.report import as_html

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(found.results(), indent=2) + "\n")
    with (folder / "ablation.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(_COLUMNS)
        writer.writerows(_rows(found))
    rows = [(f"{one.name} ({one.kind})", one.decides, len(one.passing)) for one in found.parts]
    draw(rows, folder / "figures")
    text = "\n".join(_lines(found)) + "\n"
    (folder / "report.md").write_text(text)
    (folder / "report.html").write_text(as_html(text, folder))


_COLUMNS = (
    "kind",
    "turned off",
    "refuses alone",
    "forgeries that pass then",
    "honest runs that it refuses",
    "honest runs that return",
    "seconds saved",
)


def _rows(found: Found) -> Iterator[tuple[str, ...]]:
    for one in found.parts:
        yield (
            one.kind,
            one.name,
            str(one.decides),
            f"{len(one.passing)}{': ' if one.passing else ''}{', '.join(sorted(one.passing))}",
            str(len(one.refused)),
            str(len(one.returning)),
            f"{one.seconds:.3f}",
        )


def _lines(found: Found) -> Iterator[str]:
    yield "# What each check is good for"
    yield ""
    yield (
        f"{found.forgeries} forgeries and {found.honest} noisy honest runs were judged with all checks, and "
        f"again without the part that refused them. That took {found.wall_s:.0f} s."
    )
    yield ""
    yield "![ablation](figures/ablation.svg)"
    yield ""
    yield "Forgeries that only this part refuses, and which of them pass when it is off."
    yield ""
    yield "## Everything that was turned off"
    yield ""
    yield "| " + " | ".join(_COLUMNS) + " |"
    yield "|" + "---|" * len(_COLUMNS)
    for row in _rows(found):
        yield "| " + " | ".join(row) + " |"
    yield ""
    yield (
        "A forgery that no other check refuses passes. One that passes with no single check off is refused "
        "by "
        "several. Time is shared: what several checks need is computed once, and counts for the first of "
        "them."
    )
