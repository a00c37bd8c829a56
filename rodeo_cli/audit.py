"""`rodeo audit`: an organization's verdicts, judged again from chain, store and lab."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rodeo.display.formatting import count
from rodeo.errors import ConfigError
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    errors,
    make_folder,
    print_json,
    print_table,
    reports_errors,
    say,
    write_file,
)
from rodeo_cli.layout import Row
from rodeo_cli.pooling import TLS, PoolOption, TlsOption, TrustOption, engine
from rodeo_cli.site import stop_on_signals

if TYPE_CHECKING:
    from rodeo.chain.deployment import Deployment
    from rodeo.jobs.job import Engine, Work
    from rodeo_cli.auditing.judging import Verdict
    from rodeo_cli.auditing.reading import Attempt, History
    from rodeo_cli.auditing.summary import Summary

FOLDER = Path("out/audit")
_SHOWN = 100
"""Findings that are listed; the JSON has all."""


@reports_errors
def audit(
    site: SiteOption = DEFAULT_SITE,
    first: Annotated[int, typer.Option("--from", min=0, help="First block.", metavar="BLOCK")] = 0,
    last: Annotated[
        int | None,
        typer.Option("--to", min=0, help="Last block; by default the newest.", metavar="BLOCK"),
    ] = None,
    sample: Annotated[
        int | None,
        typer.Option(min=1, help="Judge so many verdicts again, chosen by the last block's hash."),
    ] = None,
    deployment: Annotated[
        Path | None,
        typer.Option(
            help="Where the contracts are (JSON); by default the record in the site's data folder.",
            metavar="FILE",
            exists=True,
        ),
    ] = None,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder of the chain's index and of answers, to continue from.")
    ] = FOLDER,
    report: Annotated[
        Path | None, typer.Option(help="Write a page (HTML) that needs nothing else.", metavar="FILE")
    ] = None,
    pool: PoolOption = None,
    tls: TlsOption = TLS,
    trust_pool: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Judge an organization's verdicts again, as an outsider could: from chain, store and lab alone.

    An attempt is of the block in which it ended. Exit status 1 when a verdict would be another one today, or
    a file, a root or a sum is wrong; 3 when none is, but some could not be judged again. Repeat the command
    to continue.
    """
    from rodeo_cli.auditing.page import conclusions, page

    stop_on_signals()
    loaded = Site.load(site)
    contracts = _deployment(loaded, deployment)
    make_folder(folder)
    elsewhere = partial(engine, pool, loaded, tls=tls, trust=trust_pool)
    summary = examine(loaded, contracts, folder, first, last, sample, elsewhere)
    if as_json:
        print_json(summary.to_json())
    else:
        _print(summary)
        for sentence in conclusions(summary):
            say(sentence)
    if report is not None:  # last: where it cannot be written, what was found is not lost
        write_file(report, page(summary))
    if not summary.is_clean:
        raise typer.Exit(1)
    if summary.failed or summary.failed_roots:
        raise typer.Exit(3)


def _deployment(site: Site, file: Path | None) -> Deployment:
    """Raises ConfigError, ChainError."""
    from pydantic import ValidationError

    from rodeo.chain.deployment import Deployment
    from rodeo.errors import unreadable

    if file is None:
        return Deployment.load(site.data_dir, site.chain.id)
    try:
        return Deployment.model_validate_json(file.read_bytes())
    except (OSError, ValidationError) as error:
        raise ConfigError("this is no deployment record", path=str(file), reason=unreadable(error)) from error


def examine(
    site: Site,
    deployment: Deployment,
    folder: Path,
    first: int = 0,
    last: int | None = None,
    sample: int | None = None,
    elsewhere: Callable[[Sequence[Work]], Engine | None] = lambda _: None,
) -> Summary:
    """Read the chain, judge again and compare. `elsewhere` makes the engine to use before that of this
    machine.

    Raises RequestError, ChainError, IndexUnusable, StoreUnavailable, VerifierEnded.
    """
    from rodeo.jobs.local import Local
    from rodeo.jobs.proofs import Verify
    from rodeo.jobs.runner import Runner
    from rodeo_cli.auditing.judging import Audit, odd_roots
    from rodeo_cli.auditing.reading import History
    from rodeo_cli.auditing.summary import Summary

    verify = Verify(site, folder / "verifying")
    local = Local([verify])
    with Runner(local, elsewhere([verify]), folder=folder / "answers") as runner, _progress() as tell:
        reading = tell("reading the chain", None)
        history = History(site, deployment, folder, reading)
        try:
            newest = history.last_of(first, last)
            attempts, known = _chosen(history, first, newest, sample)
            judging = tell("judging again", min(known, sample or known))
            verdicts: list[Verdict] = []
            examined = Audit(site, history, verify, runner)
            for verdict in examined.judge(attempts):
                verdicts.append(verdict)
                judging(len(verdicts), 0)
            examined.compare_claims()
            roots = [root for root in history.roots if first <= root.block <= newest]
            looked = iter(range(1, len(roots) + 1))
            looking = tell("daily roots", len(roots))
            odd = list(odd_roots(site, roots, history.devices, lambda: looking(next(looked), 0)))
            return Summary(
                org=site.org,
                block=newest,
                known=known,
                sampled=sample is not None and sample < known,
                verdicts=sorted(verdicts, key=lambda one: one.attempt.place),
                roots=len(roots),
                odd_roots=odd,
                contradiction=history.contradiction(),
            )
        finally:
            history.close()


def _chosen(history: History, first: int, last: int, sample: int | None) -> tuple[Iterable[Attempt], int]:
    """The attempts to judge again, and among how many they were chosen."""
    from rodeo_cli.auditing.bounds import sampled

    if sample is None:
        return history.attempts(first, last), sum(1 for _ in history.attempts(first, last))
    oracles = (one for one in history.attempts(first, last) if not one.by_people)
    # Nobody knew the block's hash when the verdicts before it were given.
    return sampled(oracles, sample, history.block_hash(last))


Tell = Callable[[int, int], None]
"""Called with how much is done, and of how much where that was unknown before."""


@contextmanager
def _progress() -> Iterator[Callable[[str, int | None], Tell]]:
    """Bars with the time left, on stderr, where that is a terminal; Ctrl-C says how far they got."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(20), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bars:

        def begin(what: str, total: int | None) -> Tell:
            bar = bars.add_task(what, total=total)
            return lambda done, of: bars.update(bar, completed=done, total=total if total is not None else of)

        try:
            yield begin
        except KeyboardInterrupt:
            for bar in bars.tasks[-1:]:
                far = f"{bar.description}: {bar.completed:g} of {bar.total or 0:g}"
                errors.print(f"stopped; {far}. The same command continues.", highlight=False, soft_wrap=True)
            raise


def _print(summary: Summary) -> None:
    rows = []
    for one in summary.worth_a_look:
        for finding in one.findings:
            what = finding.what if finding.wrong else f"{finding.what} (noted)"
            rows.append(Row([*_named(one), what, finding.detail]))
        if one.failed:
            rows.append(Row([*_named(one), "failed", one.unjudged]))
    if rows:
        print_table(("Task", "Attempt", "Chain", "Today", "What", "Why"), rows[:_SHOWN], folds=(5,))
    if len(rows) > _SHOWN:
        say(f"and {count(len(rows) - _SHOWN, 'line')} more: --json has all")
    for root in summary.odd_roots[:_SHOWN]:
        say(f"root of day {root.root.day} of {root.root.device}: {root.detail}")
    if len(summary.odd_roots) > _SHOWN:
        say(f"and {count(len(summary.odd_roots) - _SHOWN, 'root')} more: --json has all")
    for log in filter(None, (one.log for one in summary.failed)):
        errors.print(log, markup=False, highlight=False, soft_wrap=True)


def _named(verdict: Verdict) -> list[str]:
    attempt = verdict.attempt
    return [str(attempt.task_id), str(attempt.number), attempt.ruling, verdict.today or "not judged"]
