"""Commands about a site before it runs: check its file, prepare it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from rodeo.cli.common import DEFAULT_SITE, SiteOption, console, reports_errors

sites = typer.Typer(
    help="Check a site's file, and make the site ready for its processes.", no_args_is_help=True
)


@sites.command()
@reports_errors
def check(
    file: Annotated[
        Path, typer.Argument(help="Site file.", envvar="RODEO_SITE", metavar="FILE")
    ] = DEFAULT_SITE,
) -> None:
    """Say what is wrong or doubtful in a site file, with the line. Exit status 1 if the site is refused."""
    # Imported here: what looks for ways in the room takes its time, and the other commands need none.
    from rodeo.cli.site_check import check as check_file

    findings = check_file(file)
    for finding in findings:
        _say(str(finding))
    if any(finding.severity == "error" for finding in findings):
        raise typer.Exit(1)
    if not findings:
        _say(f"{file}: nothing found")


@sites.command()
@reports_errors
def prepare(
    site: SiteOption = DEFAULT_SITE,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for gas money that is missing, on a chain elsewhere.")
    ] = False,
) -> None:
    """Make keys and certificates, look for gas money, and put the contracts on the site's chain.

    Says each step, does only what is missing, and may be repeated.
    """
    # Imported here: the chain's library takes a second, and the other commands need none.
    from deploy.prepare import prepare as prepare_site

    prepare_site(site, _say, threading.Event(), wait)


def _say(text: str) -> None:
    console.print(escape(text), highlight=False, soft_wrap=True)
