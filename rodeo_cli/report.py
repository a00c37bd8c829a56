"""`rodeo report`: what participants earned and spent."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Annotated, Any

import typer

from rodeo import queries
from rodeo.earnings import Line, earnings
from rodeo_cli.common import DEFAULT_SITE, SiteOption, connected, print_json, print_listing, reports_errors
from rodeo_cli.layout import Row

_COLUMNS = (
    "week",
    "participant",
    "kind",
    "done",
    "earned",
    "bought",
    "spent",
    "kWh",
    "EUR",
    "transactions",
    "gas",
)


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
) -> None:
    """Show what each participant earned and spent, by kind of work and week."""
    with connected(site) as (loaded, bus):

        def ask(query: queries.Query[Any], limit: int, offset: int) -> Any:
            return queries.ask(bus, loaded.org, query, timeout_s=30.0, limit=limit, offset=offset)

        tasks = _all(lambda offset: ask(queries.TASKS, queries.MAX_PAGE, offset).tasks)
        transactions = _all(lambda offset: ask(queries.TRANSACTIONS, 100, offset).transactions)
    lines = earnings(
        tasks,
        transactions,
        loaded.economy.electricity,
        first_s=_time_s(first, 0.0),
        last_s=_time_s(last, math.inf),
        participants=participant or (),
        kinds=kind or (),
    )
    if as_csv:
        writer = csv.DictWriter(sys.stdout, list(Line.model_fields), lineterminator="\n")
        writer.writeheader()
        writer.writerows(line.model_dump(mode="json") for line in lines)
    elif as_json:
        print_json(lines)
    else:
        print_listing(lines, False, _COLUMNS, map(_row, lines), folds=(1, 2))


def _all(page: Callable[[int], list[Any]]) -> list[Any]:
    found: list[Any] = []
    while some := page(len(found)):
        found += some
    return found


def _row(line: Line) -> Row:
    return Row(
        (
            line.week,
            line.participant,
            line.kind,
            str(line.done),
            f"{line.earned_iec:f}",
            str(line.bought),
            f"{line.spent_iec:f}",
            f"{line.energy_kwh:.3f}",
            f"{line.electricity_eur:.3f}",
            str(line.transactions),
            str(line.gas),
        )
    )


def _time_s(day: datetime | None, otherwise: float) -> float:
    return otherwise if day is None else day.replace(tzinfo=UTC).timestamp()
