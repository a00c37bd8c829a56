"""Commands that run and measure whole days of a site."""

from __future__ import annotations

import logging
import time
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

import deploy
from rodeo.errors import InvalidRequest
from rodeo.site.config import Site
from rodeo_cli.common import console, reports_errors, say, usual_site
from rodeo_cli.pooling import TLS, PoolOption, TlsOption, TrustOption, engine
from rodeo_cli.site import stop_on_signals

if TYPE_CHECKING:
    from rodeo_experiments.record import Run
    from rodeo_experiments.site import Variation

PAPER = Path(deploy.__file__).parent / "sites" / "paper.toml"
FOLDER = Path("out/experiment")
_SAY_EVERY_S = 10.0

experiments = typer.Typer(help="Run and measure whole days of a site.", no_args_is_help=True)

OutOption = Annotated[
    Path | None,
    typer.Option(
        help="Folder for site, record and report.",
        show_default="out/experiment/paper; with --seeds or --set out/experiment/study",
    ),
]
TariffOption = Annotated[
    Path | None,
    typer.Option(exists=True, dir_okay=False, help="CSV file with columns `from_hour` (UTC), `eur_kwh`."),
]
CalibratedOption = Annotated[
    bool | None,
    typer.Option(
        "--calibrated/--no-calibrated",
        help="Run the days once more, with the base load and the pace that were fitted to the paper.",
        show_default="only where site, days, robots, arrivals and pace are the published ones",
    ),
]
ArrivalsOption = Annotated[
    str, typer.Option(help="poisson:RATE per hour, or a CSV file with a column `hours`.", metavar="SOURCE")
]
UnlistedOption = Annotated[
    bool,
    typer.Option(
        "--unlisted",
        help="List nothing: robots that explore find what people leave, or a person posts its place.",
    ),
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Continue an interrupted run; if it is complete, report again.")
]
PaceOption = Annotated[
    Literal["site", "paper"], typer.Option(help="Speed limits of the site file, or slower ones.")
]
ChangesOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Run each of these values of a setting, as agent.charge_below=0.3,0.5; several combine.",
        metavar="KEY=A,B,C",
    ),
]


@experiments.command()
@reports_errors
def paper(
    out: OutOption = None,
    site: Annotated[
        Path, typer.Option("--site", help="Site file.", show_default="deploy/sites/paper.toml")
    ] = PAPER,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of every random choice.")] = None,
    days: Annotated[int | None, typer.Option(min=1, max=14, help="Site days.")] = None,
    robots: Annotated[int | None, typer.Option(min=1, max=8, help="Number of robots.")] = None,
    arrivals: ArrivalsOption = "",
    tariff: TariffOption = None,
    chain: Annotated[Literal["eth-tester", "anvil"] | None, typer.Option(help="The local chain.")] = None,
    pace: PaceOption = "site",
    unlisted: UnlistedOption = False,
    resume: ResumeOption = False,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Number of seeds to run.")] = 1,
    changes: ChangesOption = None,
    calibrated: CalibratedOption = None,
    pool: PoolOption = None,
    tls: TlsOption = TLS,
    trust_pool: TrustOption = False,
) -> None:
    """Run the days of the published experiment, and report them beside its numbers.

    A second run of the same days is calibrated: its base load and pace were fitted to the paper. The report
    shows both beside the paper.

    With --seeds or --set, each run is a job: it is kept once it is done, and not run again. The report shows
    the medians of all seeds with their intervals, for each setting.

    Exit status 0 only if every arrival was posted, every task is over and the supply of IEC was conserved.
    """
    from rodeo_cli.study import Study
    from rodeo_experiments.site import Variation

    _need_matplotlib()
    stop_on_signals()
    vary = Variation(seed, days, robots, tariff, chain, slow=pace == "paper", unlisted=unlisted)
    studied = seeds > 1 or bool(changes)
    out = out or FOLDER / ("study" if studied else "paper")
    if pool and not studied:
        raise InvalidRequest("a pool does the runs of a study: use --seeds or --set", pool=pool)
    if calibrated is None:
        calibrated = site == PAPER and not (days or robots or arrivals or vary.slow or unlisted or studied)
    try:
        if studied:
            study = Study(site, out, vary, arrivals, seeds, changes or (), calibrated)
            # A study makes its own keys; those that a worker must not read are the lab's here.
            elsewhere = partial(engine, pool, Site.load(site), tls=tls, trust=trust_pool, beside=usual_site())
            problems = study.run(elsewhere)
        else:
            problems = _run(site, out, vary, arrivals, resume, calibrated)
    except KeyboardInterrupt:
        say(f"stopped; {'the same command runs what is missing' if studied else '--resume continues'}")
        raise typer.Exit(130) from None
    for problem in problems:
        console.print(f"[bold red]not as expected[/]: {escape(problem)}")
    say(f"The report is {out / 'report.html'}.")
    if problems:
        raise typer.Exit(1)


@experiments.command()
@reports_errors
def ablation(
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = Path("out/experiment/ablation"),
    sample: Annotated[int, typer.Option(min=1, help="Forgeries of each kind.")] = 60,
    noises: Annotated[int, typer.Option(min=1, help="Noises under which each honest run is judged.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the sample.")] = 1,
) -> None:
    """Turn off each check: which forgeries pass then, which honest runs return, what time is saved."""
    from rodeo_experiments.ablation import ablate, write

    _need_matplotlib()
    # What a check makes of a forgery is the result here, also where it fails to compute anything.
    logging.getLogger("rodeo.checks").setLevel(logging.CRITICAL)
    with _Shown() as shown:
        found = ablate(sample, noises, seed, shown.say)
    write(found, out)
    say(f"{found.forgeries} forgeries and {found.honest} honest runs in {found.wall_s:.0f} s.")
    say(f"The report is {out / 'report.html'}.")


def _need_matplotlib() -> None:
    """Before the work begins. Raises ExperimentFailed."""
    from rodeo_experiments.errors import ExperimentFailed

    if find_spec("matplotlib") is None:
        raise ExperimentFailed('the figures need matplotlib: pip install "rodeo-dao[experiment]"')


def _run(
    base: Path, out: Path, vary: Variation, source: str, resume: bool, calibrated: bool = False
) -> list[str]:
    """One run, with the calibrated one after it if asked for, and the report; what is wrong with them."""
    from dataclasses import replace

    from rodeo_experiments.report import write_report

    run, site, problems = _days(base, out, vary, source, resume)
    fitted = None
    if calibrated:
        vary, folder = replace(vary, slow=True, calibrated=True), out / "calibrated"
        say("The same days again, with the base load and the pace that were fitted to the paper:")
        fitted, fitted_site, found = _days(base, folder, vary, source, resume)
        write_report(fitted, fitted_site, folder, found)
        problems += [f"calibrated run: {one}" for one in found]
    write_report(run, site, out, problems, calibrated=fitted)
    return problems


def _days(base: Path, out: Path, vary: Variation, source: str, resume: bool) -> tuple[Run, Site, list[str]]:
    """The record of one run, its site, and what is wrong with it."""
    # Physics and chain take seconds to import, and the other commands need none of it.
    from rodeo_experiments.arrivals import plan
    from rodeo_experiments.conduct import Conduct
    from rodeo_experiments.record import Run
    from rodeo_experiments.results import Figures
    from rodeo_experiments.site import Begun, site_again, write_site

    path, record, options = out / "site.toml", out / "run.json", _options(base, vary, source)
    if resume and path.exists():
        times = Begun.load(out, base, options, record.exists()).times_s
        site = site_again(path)
    else:
        site = Site.load(write_site(base, out, vary))
        assert site.experiment is not None
        times = plan(site, site.experiment, source)
        Begun.now(base, options, times).save(out)
    assert site.experiment is not None
    if not record.exists():
        say(f"{len(times)} arrivals in {site.experiment.days} site days, seed {site.clock.seed}. Logs: {out}")
        with _Shown() as shown:
            Conduct(path, times, out, shown.say).run().save(record)
    run = Run.load(record)
    results = Figures(run).results()
    say(
        f"{results['cleaning_settled']} cleanings and {results['charging_settled']} charges are paid; "
        f"{run.wall_s:.0f} s of wall time."
    )
    return run, site, Figures(run).problems(len(times))


def _options(base: Path, vary: Variation, source: str) -> dict[str, str | int | None]:
    """Options by their names on the command line; None for those not given."""
    return {
        "site": None if base == PAPER else str(base.resolve()),
        "seed": vary.seed,
        "days": vary.days,
        "robots": vary.robots,
        "arrivals": source or None,
        "tariff": None if vary.tariff is None else str(vary.tariff.resolve()),
        "chain": vary.chain,
        "pace": "paper" if vary.slow else None,
        "unlisted": 1 if vary.unlisted else None,
    }


class _Shown:
    """Progress: a bar on a terminal, a line now and then elsewhere."""

    def __init__(self) -> None:
        self._bar = Progress(
            BarColumn(20),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("starting", total=1.0)
        self._begun_s = time.monotonic()
        self._said_s = -_SAY_EVERY_S

    def __enter__(self) -> _Shown:
        self._bar.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._bar.stop()

    def say(self, text: str, share: float) -> None:
        self._bar.update(self._task, completed=share, description=escape(text))
        now_s = time.monotonic() - self._begun_s
        if not console.is_terminal and now_s - self._said_s >= _SAY_EVERY_S:
            self._said_s = now_s
            say(f"{now_s:6.0f} s  {text}")
