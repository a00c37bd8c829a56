"""`rodeo verify`: the oracle's checks on a proof, here and now."""

from __future__ import annotations

import tempfile
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.text import Text

from rodeo.bus import queries
from rodeo.display.formatting import (
    count,
)
from rodeo.errors import BusError, InvalidRequest, RemoteError
from rodeo.jobs.job import JobError
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    console,
    errors,
    print_json,
    reports_errors,
)
from rodeo_cli.layout import printable
from rodeo_cli.pooling import TLS, PoolOption, TlsOption, TrustOption, engine
from rodeo_cli.task_words import judged_by

if TYPE_CHECKING:
    from rodeo.bus.session import Bus
    from rodeo.checks.report import Report
    from rodeo.jobs.job import Engine, Work
    from services.oracle.chain_view import View

RESULT_STYLES = {"passed": "green", "FAILED": "bold red", "undecided": "bold yellow", "skipped": "dim"}


@reports_errors
def verify(
    files: Annotated[
        list[Path],
        typer.Argument(help="Proofs (MCAP), or ROS 1 or ROS 2 bags.", metavar="FILE...", exists=True),
    ],
    site: SiteOption = DEFAULT_SITE,
    offline: Annotated[
        bool, typer.Option("--offline", help="Do not ask the bridge. Skip the checks that need the chain.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Show each check's limit, the source of the limit, and more."),
    ] = False,
    pool: PoolOption = None,
    tls: TlsOption = TLS,
    trust_pool: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run the oracle's checks on proofs here and now, several side by side. Exit status 1 when one fails.

    What only the chain knows (who may sign, which days were posted) is taken as of the block of the verdict,
    if there is one; what came later is a warning. Without a running site that is skipped, with a warning.
    With --json several files give a list.
    """
    loaded, found, failed = Site.load(site), [], list[JobError]()
    elsewhere = partial(engine, pool, loaded, tls=tls, trust=trust_pool)
    for file, known, report in _verified(loaded, site, files, offline, elsewhere):
        name = printable(str(file))
        if len(files) > 1 and not as_json:
            console.print(f"[bold]{escape(name)}[/]", highlight=False, soft_wrap=True)
        if isinstance(report, JobError):
            failed.append(report)
            errors.print(f"{name}: {report}\n{report.log}", markup=False, highlight=False, soft_wrap=True)
            found.append({"file": name, "outcome": None, "error": str(report)})
            continue
        warnings = [*known.warnings, *_other_rules(known, report)]
        warn(warnings)
        found.append({"file": name} | report.model_dump(mode="json") | {"warnings": warnings})
        if as_json:
            continue
        for line in check_lines(report, console.width, verbose):
            console.print(line, soft_wrap=True)
        console.print(_conclusion(site, report, offline), highlight=False, soft_wrap=True)
    if as_json:
        print_json(found[0] if len(files) == 1 else found)
    if failed:
        raise failed[0]
    if any(one["outcome"] != "accepted" for one in found):
        raise typer.Exit(1)


def _other_rules(known: View, report: Report) -> Iterator[str]:
    task = known.chain_record and known.chain_record.task
    if task and task.rules_sha256 != report.rules_sha256:
        named = task.rules_sha256 or "none"
        yield f"the task is judged by the rules {named}; installed here are {report.rules_sha256}"


def _verified(
    site: Site,
    site_path: Path,
    files: Sequence[Path],
    offline: bool,
    elsewhere: Callable[[Sequence[Work]], Engine | None],
) -> Iterator[tuple[Path, View, Report | JobError]]:
    """Each file, what the chain knows of it, and the report on it or why there is none, in the order in which
    they are named.

    Raises InvalidRequest.
    """
    # Imported here: only this command needs the readers of recordings.
    from rodeo.checks.report import Report
    from rodeo.jobs.local import Local
    from rodeo.jobs.proofs import Verify
    from rodeo.jobs.runner import Runner
    from services.oracle.chain_view import View

    for file in files:
        if not (file.is_file() or file.is_dir()):
            raise InvalidRequest("this is neither a file nor a folder", path=str(file))
    known = {file: View(None, []) for file in files} if offline else chain_views(site_path, files)
    reports: dict[Path, Report | JobError] = {}
    with tempfile.TemporaryDirectory() as folder:
        verifying = Verify(site, Path(folder, "verifying"))
        with Runner(Local([verifying]), elsewhere([verifying]), folder=Path(folder, "answers")) as runner:
            for done in runner.run(verifying.file(file, known[file].chain_record) for file in known):
                assert done.job.file is not None
                reports[done.job.file] = done.error or Report.model_validate_json(done.answer or b"")
    for file in files:
        yield file, known[file], reports[file]


def check_lines(report: Report, width: int, verbose: bool) -> Iterator[Text]:
    """A line for each check; with `verbose` what it compared with follows in full."""
    names = max((len(check.name) for check in report.checks), default=0)
    for check, (name, result, measured, limit, source, about) in zip(
        report.checks, report.rows(), strict=True
    ):
        line = Text(f"{result:9}  ", style=RESULT_STYLES[result]) + Text(f"{name:{names}}  ", style="")
        if not verbose:
            told = printable("  ".join(text for text in (measured, about) if text))
            line.append(told, style="bold" if check.passed is False else "dim")
            line.truncate(width, overflow="ellipsis")
            line.rstrip()
            yield line
            continue
        line.append(printable(measured))
        yield line
        indent = " " * 11
        against = f"limit {limit}" if limit else ""
        whence = f"from: {source}" if source else ""
        for text in (about, "; ".join(one for one in (against, whence) if one)):
            for part in textwrap.wrap(
                printable(text), width, initial_indent=indent, subsequent_indent=indent
            ):
                yield Text(part, style="dim")


def outcome(report: Report) -> str:
    """The reason, or the number of checks where nothing failed."""
    if not report.accepted:
        return printable(report.reason)
    skipped = sum(check.passed is None for check in report.checks)
    passed = count(len(report.checks) - skipped, "check") + " passed"
    return passed + (f", {skipped} were skipped" if skipped else "")


def _conclusion(site_path: Path, report: Report, offline: bool) -> str:
    """The checks' outcome. A person's word is never the oracle's verdict: its judge is named."""
    from rodeo.kinds import kinds_of

    kinds = kinds_of(Site.load(site_path))
    if report.kind is None or not kinds.by_people(report.kind) or report.outcome == "rejected":
        return f"[bold]{report.outcome}[/]: {escape(outcome(report))}"
    told = "[bold]a person's statement[/] with a valid seal; software cannot check whether it is true"
    if offline or report.task_id is None:
        return f"{told}: an auditor judges it"
    try:
        with connected(site_path) as (site, bus):
            task = queries.ask(bus, site.org, queries.TASK, id=report.task_id)
            same = task.proof_sha256 == report.proof_sha256
            judged = judged_by(site, bus, task) if same else ""
    except (BusError, RemoteError) as error:
        judged = f"cannot find out who judged it: {error}"
    return f"{told}\n" + (escape(judged) or f"an auditor judges it: `rodeo task review {report.task_id}`")


def warn(warnings: list[str]) -> None:
    for warning in warnings:
        errors.print(f"[bold yellow]warning[/]: {escape(warning)}", highlight=False, soft_wrap=True)


def chain_views(site_path: Path, files: Sequence[Path]) -> dict[Path, View]:
    """The running site's view of each proof; if no bridge answers, a warning about that."""
    from rodeo.dao import ORGANIZATION, Participant
    from services.oracle.chain_view import View, view

    def unknown(error: BusError | RemoteError) -> View:
        return View(None, [f"skipping the checks that need the chain: {error}"])

    def known(file: Path, site: Site, bus: Bus) -> View:
        try:
            return view(file, site, Participant(bus, site.org, ORGANIZATION))
        except (BusError, RemoteError) as error:
            return unknown(error)

    try:
        with connected(site_path) as (site, bus):
            return {file: known(file, site, bus) for file in files}
    except (BusError, RemoteError) as error:
        return {file: unknown(error) for file in files}
