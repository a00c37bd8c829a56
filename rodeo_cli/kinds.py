"""Kinds of work: which are installed, what one says, whether its checks hold, and how to begin a new one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from rodeo.bus import queries
from rodeo.display.formatting import span
from rodeo.errors import BusError, RemoteError
from rodeo.host.instance import lock_holder
from rodeo.kinds import Kind, KindError, installed, kinds_of, load
from rodeo.site.config import Site
from rodeo.site.endpoint import is_local
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    print_facts,
    print_json,
    print_listing,
    reports_errors,
    say,
)
from rodeo_cli.formatting import iec
from rodeo_cli.layout import Row

kinds = typer.Typer(help="List, show, check and create kinds of work.", no_args_is_help=True)
Name = Annotated[str, typer.Argument(help="Name of an installed kind.", metavar="NAME")]


@kinds.command(name="list")
@reports_errors
def list_kinds(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the kinds that are installed or declared in the site file, and whether the site uses them.

    Without a site file the last column is empty.
    """
    used = _used(site)
    found: dict[str, Kind | KindError] = {name: _loaded(name) for name in installed()}
    entries = [
        {
            "name": name,
            "title": kind.title if isinstance(kind, Kind) else "(cannot be imported)",
            "judged_by": kind.judge if isinstance(kind, Kind) else "",
            "installed": name in installed(),
            "used_by_site": None if used is None else name in used,
            "error": None if isinstance(kind, Kind) else str(kind),
        }
        for name, kind in sorted((found | (used or {})).items())
    ]
    words = {None: "", True: "yes", False: "no"}
    rows = (
        Row((str(one["name"]), str(one["title"]), str(one["judged_by"]), words[one["used_by_site"]]))  # type: ignore[index]
        for one in entries
    )
    print_listing({"kinds": entries}, as_json, ("kind", "title", "judged by", "used by this site"), rows, [1])


def _loaded(name: str) -> Kind | KindError:
    """A kind of somebody else's that cannot be imported hides no other."""
    try:
        return load(name)
    except KindError as error:
        return error


def _used(path: Path) -> dict[str, Kind] | None:
    """The kinds that the site file lists; None where there is no such file."""
    return dict(kinds_of(Site.load(path))) if path.exists() else None


@kinds.command()
@reports_errors
def show(name: Name, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show a kind's parameters, windows, price, rules, recorded topics and checks, in order.

    While the site runs, show also which rules are current on its chain.
    """
    kind = (_used(site) or {}).get(name) or load(name)
    document = _document(kind)
    installed_rules, current = document["rules_hash"], _current_rules(site, name)
    document |= {
        "current_rules": current,
        "installed_is_current": None if current is None else installed_rules in current,
    }
    if as_json:
        print_json(document)
        return
    print_facts(
        document,
        False,
        (
            ("kind", kind.name),
            ("title", kind.title),
            ("description", kind.description),
            ("judged by", "the oracle, by the checks below" if kind.judge == "oracle" else "auditors"),
            ("time to do it", span(kind.execution_window_s)),
            ("price", f"{'at most ' * bool(kind.rates)}{iec(kind.price_iec)} for a {kind.unit}"),
            ("rates", _rates_in_words(kind)),
            ("provides", kind.provides),
            ("rules", str(installed_rules or "")),
            ("networks that count", ", ".join(document["models_sha256"])),
            ("current on chain", _current_in_words(current, installed_rules)),
            ("done by", kind.behaviour or ("people, or a separate process")),
        ),
    )
    for number, (columns, rows, folds) in enumerate(_tables(document)):
        if number:
            say("")
        print_listing(None, False, columns, rows, folds)


def _tables(document: dict[str, Any]) -> Iterator[tuple[tuple[str, ...], list[Row], list[int]]]:
    """Columns, rows and the columns that fold of a kind's parameters, recorded topics and checks."""
    parameters, needed = (document["parameters"].get(one, ()) for one in ("properties", "required"))
    told = [
        Row((field, _type(one), "yes" if field in needed else "no", str(one.get("description", ""))))
        for field, one in dict(parameters).items()
    ]
    yield ("parameter", "type", "needed", "description"), told, [3]
    recorded = [
        Row((one["topic"], one["written_by"], str(one["rate_hz"] or ""), one["signed_by"]))
        for one in document["recorded"]
    ]
    yield ("recorded", "written by", "Hz", "signed by"), recorded, []
    checks = [Row((str(c["stage"]), c["name"], c["asks"], c["source"])) for c in document["checks"]]
    yield ("stage", "check", "what it checks", "source"), checks, [2, 3]


def _current_rules(path: Path, name: str) -> list[str] | None:
    """Hashes of the rules under which tasks of this kind may be posted at the site now, the newest last; None
    while nobody can be asked."""
    if not path.exists():
        return None
    site = Site.load(path)
    if is_local(site.bus.router) and lock_holder(site.data_dir / "router") is None:
        return None
    try:
        with connected(path) as (loaded, bus):
            kinds = queries.ask(bus, loaded.org, queries.ORGANIZATION).kinds
    except (BusError, RemoteError):
        return None
    return next((one.rules_sha256 for one in kinds if one.kind == name), [])


def _current_in_words(current: list[str] | None, installed_rules: str | None) -> str:
    if current is None:
        return "unknown: no site answers"
    if not current:
        return "none: no task of this kind can be posted" if installed_rules else "none"
    told = " or ".join(reversed(current))
    if installed_rules in current:
        return f"{told}; the installed rules are current"
    return f"{told}; the installed rules are not among them"


def _document(kind: Kind) -> dict[str, Any]:
    # Imported here: what the checks use takes its time, and a listing needs none of it.
    from rodeo.checks.rules import rules_hash

    checks = kind.load_checks()
    return {
        "name": kind.name,
        "title": kind.title,
        "description": kind.description,
        "judged_by": kind.judge,
        "execution_window_s": kind.execution_window_s,
        "price_iec": str(kind.price_iec),
        "unit": kind.unit,
        "measure": kind.measure,
        "rates": [{"from_hour": one.from_hour, "iec": str(one.iec)} for one in kind.rates],
        "provides": kind.provides,
        "behaviour": kind.behaviour,
        "rules_hash": rules_hash(kind),
        "models_sha256": kind.models(),
        "parameters": kind.schema,
        "recorded": [
            {
                "topic": one.topic.key,
                "written_by": one.topic.writer,
                "rate_hz": one.topic.rate_hz,
                "signed_by": one.signed_by or "the executor's seals",
            }
            for one in kind.recorded
        ],
        "checks": [
            {
                "stage": number,
                "name": check.__name__,
                "asks": " ".join((check.__doc__ or "").split()),
                "source": f"{check.__module__}.{check.__name__}",
            }
            for number, stage in enumerate(checks.stages if checks else (), start=1)
            for check in stage
        ],
    }


def _rates_in_words(kind: Kind) -> str:
    """Empty where there are none: it is left out then."""
    told = [f"{iec(one.iec)} for a {kind.measure} from {one.from_hour}:00 UTC" for one in kind.rates]
    return ", ".join(told)


def _type(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_type(one) for one in schema["anyOf"])
    return str(schema.get("type", schema.get("$ref", "any"))).rpartition("/")[2]


@kinds.command()
@reports_errors
def check(
    name: Name,
    only: Annotated[
        str, typer.Option("--only", help="Run only the cases whose name contains this text.")
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Record the kind's honest runs, generate its forgeries, and run its checks on each.

    Uses the lab that comes with RODEO. Exit status 0 if every honest run is accepted and every forgery is
    refused for its own reason, else 1.
    """
    # Imported here: filming needs MuJoCo, and the other commands do not.
    from rodeo_testing.check import lab, outcomes

    harness = load(name).load_harness()
    if harness is None:
        say(f"{name} has no harness: there is nothing to check")
        raise typer.Exit(1)
    with tempfile.TemporaryDirectory() as folder:
        found = list(outcomes(harness, lab(), Path(folder), only))
    rows = (
        Row(
            (
                one.what,
                one.name.replace("_", " "),
                "accepted" if one.accepted else "refused",
                "" if one.passed else f"WRONG: expected {one.expected}",
                one.reason,
            )
        )
        for one in found
    )
    wrong = sum(not one.passed for one in found)
    print_listing(
        {"kind": name, "passed": bool(found) and not wrong, "outcomes": [asdict(one) for one in found]},
        as_json,
        ("what", "name", "verdict", "", "reason"),
        rows,
        [1, 4],
        f"{len(found) - wrong} of {len(found)} as expected",
    )
    if wrong or not found:
        raise typer.Exit(1)


@kinds.command()
@reports_errors
def new(
    name: Annotated[str, typer.Argument(help="Name of the new kind: inspect_door.", metavar="NAME")],
    into: Annotated[Path, typer.Option("--into", help="Folder to create.", metavar="DIR")],
) -> None:
    """Write a package for a kind in which a robot drives to a place and stays there.

    It is complete: declaration, parameters, behaviour, checks, an honest run and three forgeries, and a test.
    """
    from rodeo_testing.template import write

    for path in write(name, into):
        say(str(path))
    say(f"install it with `pip install --no-deps --editable {into}`, then run `rodeo kind check {name}`")
