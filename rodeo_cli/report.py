"""`rodeo report`: what participants earned and spent."""

from __future__ import annotations

import math
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.bus.queries import Transaction
from rodeo.display.earnings import COLUMNS, cells, earnings
from rodeo.display.earnings import as_csv as to_csv
from rodeo.errors import BusUnavailable, InvalidRequest, NoResponder
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    SiteOption,
    connected,
    errors,
    print_json,
    print_listing,
    reports_errors,
)
from rodeo_cli.earnings_page import page
from rodeo_cli.layout import Row


@reports_errors
def report(
    site: SiteOption = DEFAULT_SITE,
    first: Annotated[
        datetime | None, typer.Option("--from", formats=["%Y-%m-%d"], help="First day (UTC).")
    ] = None,
    last: Annotated[
        datetime | None, typer.Option("--to", formats=["%Y-%m-%d"], help="Day before which it ends (UTC).")
    ] = None,
    participant: Annotated[list[str] | None, typer.Option(help="Only this one; repeatable.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only this kind of work; repeatable.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for programs.")] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV for spreadsheets.")] = False,
    as_html: Annotated[bool, typer.Option("--html", help="Print a page that needs nothing else.")] = False,
) -> None:
    """Show what each participant earned and spent, by kind of work and week.

    If the site does not run, this reads the index that its bridge left.
    """
    if first is not None and last is not None and last <= first:
        raise InvalidRequest(
            "--to has to be after --from", first=f"{first:%Y-%m-%d}", last=f"{last:%Y-%m-%d}"
        )
    if as_json + as_csv + as_html > 1:
        raise InvalidRequest("name one of --json, --csv and --html")
    tasks, transactions, loaded = _known(site)
    tariffs, org = loaded.economy.electricity, loaded.org
    if participant or kind:
        from rodeo.signing.keystores import wallet_names  # takes its time to import

        seen = earnings(tasks, transactions, tariffs)
        require("participant", participant, {*wallet_names(loaded), *(line.participant for line in seen)})
        require("kind", kind, {*(one.name for one in loaded.kinds), *(line.kind for line in seen)})
    lines = earnings(
        tasks,
        transactions,
        tariffs,
        first_s=_time_s(first, 0.0),
        last_s=_time_s(last, math.inf),
        participants=participant or (),
        kinds=kind or (),
    )
    if as_csv:
        sys.stdout.write(to_csv(lines))
    elif as_json:
        print_json(lines)
    elif as_html:
        sys.stdout.write(page(lines, org))
    else:
        print_listing(lines, False, COLUMNS, (Row(cells(line)) for line in lines), folds=(1, 2))


def require(what: str, given: list[str] | None, known: set[str]) -> None:
    """Raises InvalidRequest for a name that nobody has: the report would say that it earned nothing."""
    if unknown := [one for one in given or () if one not in known]:
        raise InvalidRequest(f"nobody knows this {what}", **{what: unknown, "known": sorted(known)})


def _known(path: Path) -> tuple[list[Task], list[Transaction], Site]:
    """Tasks and transactions, from the bridge or the index that it left, and the site."""
    site = Site.load(path)
    try:
        with connected(path) as (_site, bus):

            def ask(query: queries.Query[Any], limit: int, offset: int) -> Any:
                return queries.ask(bus, site.org, query, timeout_s=30.0, limit=limit, offset=offset)

            tasks = queries.entries(lambda offset: ask(queries.TASKS, queries.MAX_PAGE, offset).tasks)
            transactions = queries.entries(lambda offset: ask(queries.TRANSACTIONS, 100, offset).transactions)
    except (BusUnavailable, NoResponder):
        from services.bridge.offline import read  # takes its time to import

        tasks, transactions = read(site)
        errors.print("The bridge does not run: this is what it had indexed when it stopped.", style="dim")
    return tasks, transactions, site


def _time_s(day: datetime | None, otherwise: float) -> float:
    return otherwise if day is None else day.replace(tzinfo=UTC).timestamp()
