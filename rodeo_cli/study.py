"""Studies: many runs of an experiment, done as jobs on this machine or by a pool."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rodeo.display.formatting import count
from rodeo.host.files import writing
from rodeo.jobs.job import Engine, Work
from rodeo.jobs.local import Local
from rodeo.jobs.runner import Done, Runner
from rodeo.site.config import Site
from rodeo_cli.common import say, write_file
from rodeo_experiments.errors import ExperimentFailed
from rodeo_experiments.results import Figures
from rodeo_experiments.site import Variation
from rodeo_experiments.study import Asked, Runs, record_of, settings
from rodeo_experiments.study_report import Found, write_study

CORES_PER_SITE = 2
"""A site at full speed keeps so many busy."""


@dataclass(frozen=True)
class Study:
    """Runs of the site file `base` by `seeds` seeds and by what `changes` set, and their report in `out`."""

    base: Path
    out: Path
    vary: Variation
    source: str
    """The source of arrivals, see `rodeo_experiments.arrivals.plan`."""
    seeds: int
    changes: Sequence[str]
    """Texts `name=value,value`."""
    calibrated: bool
    """Whether each setting runs calibrated, too."""

    def run(self, elsewhere: Callable[[Sequence[Work]], Engine | None]) -> list[str]:
        """Do what is not kept yet, and write the report; returns what is wrong with the runs.

        `elsewhere` makes the engine to use before that of this machine. Raises ExperimentFailed.
        """
        works: list[Work] = [Runs(self.out / "running")]
        planned = {asked.job.key: (setting, asked) for setting, asked in self._planned()}
        local = Local(works, max(1, len(os.sched_getaffinity(0)) // CORES_PER_SITE))
        found, failed, kept, begun_s = [], [], 0, time.monotonic()
        with Runner(local, elsewhere(works), folder=self.out / "runs") as runner:
            for done in runner.run(asked.job for _, asked in planned.values()):
                setting, asked = planned[done.job.key]
                if done.answer is None:
                    failed.append(self._failure(done, setting))
                else:
                    run = record_of(done.answer)
                    found.append(Found(setting, run, Figures(run).problems(len(asked.times_s))))
                over, kept = len(found) + len(failed), kept + (done.by == "kept")
                said = f"{over} of {count(len(planned), 'run')}"
                if over > kept:
                    left_s = (time.monotonic() - begun_s) / (over - kept) * (len(planned) - over)
                    said = f"{said}, about {left_s / 60:.0f} min left"
                say(f"{said} ({done.by})")
        if not found:
            raise ExperimentFailed("no run reached its end", problems=failed)
        names = list(dict.fromkeys(setting for setting, _ in planned.values()))
        found.sort(key=lambda one: (names.index(one.setting), one.run.seed))
        with writing(self.out):
            write_study(found, self.out)
        return failed + [f"seed {one.run.seed}: {text}" for one in found for text in one.problems]

    def _planned(self) -> Iterator[tuple[str, Asked]]:
        """The name of each run's setting, and what the run is given."""
        first = self.vary.seed if self.vary.seed is not None else Site.load(self.base).clock.seed or 0
        variations = {"": self.vary}
        if self.calibrated:
            variations["calibrated"] = replace(self.vary, slow=True, calibrated=True)
        for changed in settings(self.changes):
            for calibrated, vary in variations.items():
                words = [f"{name} = {value}" for name, value in changed.items()]
                setting = ", ".join([*words, *filter(None, [calibrated])])
                for seed in range(first, first + self.seeds):
                    yield setting, Asked.of(self.base, replace(vary, seed=seed), changed, self.source)

    def _failure(self, done: Done, setting: str) -> str:
        """A sentence about a run without an end, whose log is written."""
        assert done.error is not None
        log = self.out / f"failed-{done.job.key[:8]}.log"
        write_file(log, done.error.log)
        seed = done.job.given["tables"]["clock"]["seed"]
        return f"seed {seed}, {setting or 'as in the site file'}: {done.error}, see {log}"
