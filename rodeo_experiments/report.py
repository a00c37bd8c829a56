"""`report.md`, a self-contained `report.html`, and the tables as CSV."""

from __future__ import annotations

import csv
import html
import json
import math
import re
import statistics
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

from rodeo.display.earnings import COLUMNS, cells, earnings
from rodeo.lab.schedule import zone
from rodeo.site.config import Site
from rodeo.site.sections import ExperimentConfig
from rodeo_experiments import paper
from rodeo_experiments.record import Run
from rodeo_experiments.results import Figures, median, step_of
from rodeo_experiments.unlisted import COLUMNS as OF_THINGS

_LIMITS = (
    "The robot, its arm, the bin, the dock and the lab are simulated in MuJoCo. Contacts, motors and "
    "sensors are "
    "models with noise. A real lab has people in it, and other light, floors and radio.",
    "The simulated clock waits for bridge, oracle and chain. On the site's clock a verdict therefore takes "
    "no time, "
    "and the wall time of a verdict depends on this machine.",
    "Exploring while idle is limited to a few seconds an hour, because that time cannot be skipped. A "
    "robot that "
    "explores all day uses more energy and charges more often.",
    "The battery's capacity and resistance are the manufacturer's. Its base load is a parameter of the "
    "site file.",
    "Gas is measured on an embedded chain. The prices of gas and ETH are parameters. What a rollup charges "
    "for its "
    "data is not counted.",
)
_ARRIVING = (
    "Somebody leaves an item on free floor at a random place and time. The organization hears of it at once "
    "where it is."
)
_UNLISTED = (
    "People left these on the floor, and no process but the simulator knew of them. The bin named the class "
    "of what it was shown, and weighed what fell. Each is in `things.csv`."
)


def _arriving(experiment: ExperimentConfig) -> str:
    return (
        "Somebody leaves a thing on free floor at a random place and time. If no robot has found it "
        f"{experiment.unnoticed_min:g} minutes later, a person posts its place, which is "
        f"{experiment.pointing_error_m:g} m off (standard deviation, east and north)."
    )


_Local = Callable[[float | None], str]
"""Time (s) -> how a table shows it."""


def write_tables(figures: Figures, experiment: ExperimentConfig, folder: Path) -> None:
    """tasks.csv, transfers.csv, battery.csv, charges.csv, transactions.csv."""
    run = figures.run
    zone_ = zone(run.timezone)

    def local(time_s: float | None) -> str:
        return "" if time_s is None else f"{datetime.fromtimestamp(time_s, zone_):%Y-%m-%dT%H:%M:%S%z}"

    _write_tasks(run, folder, local)
    _csv(
        folder / "transfers.csv",
        "time from to amount_iec reason task tx_hash",
        (
            [
                local(one.time_s),
                one.sender_name or one.sender,
                one.to_name or one.to,
                one.amount_iec,
                one.reason,
                "" if one.task_id is None else one.task_id,
                one.tx_hash,
            ]
            for one in run.transfers
        ),
    )
    _csv(
        folder / "battery.csv",
        "time robot soc power_w",
        ([local(one.time_s), one.robot, one.soc, one.power_w] for one in run.battery),
    )
    _csv(
        folder / "charges.csv",
        "dock begin end minutes energy_wh eur",
        (
            [
                one.dock,
                local(one.begin_s),
                local(one.end_s),
                f"{(one.end_s - one.begin_s) / 60:.2f}",
                f"{one.energy_wh:.2f}",
                f"{one.cost_eur:.5f}",
            ]
            for one in figures.flows
        ),
    )
    _write_transactions(run, experiment, folder, local)
    if run.things:
        _write_things(figures, folder, local)


def _write_things(figures: Figures, folder: Path, local: _Local) -> None:
    _csv(
        folder / "things.csv",
        "number thing class mass_g x_m y_m left found_by task end in_bin bins_class scale_g",
        (
            [
                one.arrival.number,
                one.thing.id,
                one.thing.item_class,
                f"{one.thing.mass_kg * 1000:g}",
                one.arrival.x_m,
                one.arrival.y_m,
                local(one.arrival.time_s),
                one.arrival.found_by or "",
                one.arrival.task_id or "",
                one.end,
                *(
                    ["", "", ""]
                    if (fallen := one.arrival.fallen) is None
                    else [local(fallen.time_s), fallen.item_class, f"{one.scale_g:.1f}"]
                ),
            ]
            for one in figures.unlisted.left
        ),
    )


def _write_tasks(run: Run, folder: Path, local: _Local) -> None:
    arrivals = {one.task_id: one for one in run.arrivals}
    _csv(
        folder / "tasks.csv",
        "id kind state verdict attempts creator executor reward_iec paid_iec arrived registered assigned "
        "proof_submitted settled execution_min reason",
        (
            [
                task.id,
                task.kind,
                task.state,
                task.verdict or "",
                task.attempt,
                task.creator_name or task.creator,
                task.executor_name or task.executor or "",
                task.reward_iec,
                task.paid_iec,
                local(arrivals[task.id].time_s) if task.id in arrivals else "",
                *map(local, (task.registered, task.assigned, task.proof_submitted, task.settled)),
                "" if task.proof_submitted is None or task.assigned is None
                else f"{(task.proof_submitted - task.assigned) / 60:.3f}",
                task.reason or "",
            ]
            for task in run.tasks
        ),
    )  # fmt: skip


def _write_transactions(run: Run, experiment: ExperimentConfig, folder: Path, local: _Local) -> None:
    prices = experiment.gas_prices
    named = [re.sub(r"\W+", "_", one.name.lower()) for one in prices]
    _csv(
        folder / "transactions.csv",
        " ".join(["time step sender gas", *(f"{name}_eth {name}_eur" for name in named), "tasks tx_hash"]),
        (
            [
                local(one.time_s),
                step_of(one),
                one.sender_name or one.sender or "",
                one.gas_used or "",
                *(
                    text
                    for price in prices
                    for text in _fee(one.gas_used or 0, price.gas_gwei, experiment.eth_eur)
                ),
                " ".join(map(str, one.task_ids)),
                one.tx_hash,
            ]
            for one in run.transactions
        ),
    )


def _fee(gas: int, gwei: Decimal, eth_eur: Decimal) -> tuple[str, str]:
    eth = gas * gwei / Decimal(10) ** 9
    return f"{eth:.9f}", f"{eth * eth_eur:.6f}"


def _csv(path: Path, columns: str, rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns.split())
        writer.writerows(rows)


# -- the report ------------------------------------------------------------------------------------------


def markdown(
    figures: Figures,
    site: Site,
    captions: dict[str, str],
    problems: Sequence[str],
    calibrated: Figures | None = None,
) -> str:
    """The report."""
    run, experiment = figures.run, site.experiment
    assert experiment is not None
    lines = [
        "# Three days of one robot, again" if run.days == 3 and len(run.robots) == 1 else "# Days of a site"
    ]
    lines += ["", _summary(figures), ""]
    if problems:
        lines += ["**This run is not complete:** " + "; ".join(problems) + ".", ""]
    heads = ("quantity", "paper", "recomputed from the paper's counts", "this run", "calibrated run")
    rows = [
        (row.quantity, row.paper, row.recomputed, row.ours, row.calibrated)
        for row in paper.table(figures, calibrated)
    ]
    columns = len(heads) if calibrated else len(heads) - 1
    lines += ["## Beside the paper", ""]
    if calibrated:
        from_w = site.robots[0].battery.idle_power_w
        to_w = experiment.calibrated_idle_power_w or from_w
        lines += [paper.fitted(figures, calibrated, from_w, to_w), ""]
    lines += table_lines(heads[:columns], [row[:columns] for row in rows])
    if run.things:
        lines += [
            "",
            "## What nobody listed",
            "",
            _UNLISTED,
            "",
            *table_lines(OF_THINGS, figures.unlisted.rows()),
        ]
    lines += ["", "## Where the paper's numbers contradict each other", ""]
    lines += [f"- {one}" for one in paper.contradictions()]
    lines += ["", "## What differs between its robot and ours", "", _differences(figures, site), ""]
    if explained := [*figures.explained, *run.notes]:
        lines += ["## Tasks that were not paid", "", *(f"- {one}" for one in explained), ""]
    lines += ["## Figures", ""]
    for name, caption in captions.items():
        lines += [f"![{name}](figures/{name}.svg)", "", caption, ""]
    lines += ["## What everybody earned and spent, by week", "", *_earnings(run, site), ""]
    lines += ["## What the steps cost", "", *_fees(figures, experiment), ""]
    lines += ["## Method", "", *_method(figures), ""]
    lines += ["## Parameters", "", *table_lines(("parameter", "value"), sorted(run.parameters.items())), ""]
    lines += ["## Machine and versions", "", *table_lines(("what", "which"), sorted(run.machine.items())), ""]
    limits = [_arriving(experiment) if run.things else _ARRIVING, *_LIMITS]
    lines += ["## Limits of the simulation", "", *(f"- {one}" for one in limits), ""]
    lines += [
        "## All results",
        "",
        *table_lines(("name", "value"), [(k, json.dumps(v)) for k, v in figures.results().items()]),
    ]
    return "\n".join(lines) + "\n"


def _summary(figures: Figures) -> str:
    run, results = figures.run, figures.results()
    robots = "One robot" if len(run.robots) == 1 else f"{len(run.robots)} robots"
    kept = "No IEC appeared or disappeared." if figures.is_conserved else "The supply of IEC changed."
    charges = count(len(figures.settled(figures.charges)), "charge")
    return (
        f"{robots} did {results['cleaning_settled']} of {count(len(run.arrivals), 'cleaning')} in "
        f"{count(run.days, 'site day')} and bought {charges}. The run took {run.wall_s:.0f} s of wall time "
        f"with seed {run.seed}. {kept}{_each(figures)}"
    )


def _each(figures: Figures) -> str:
    """What each robot of a run has in the end, if there are several."""
    robots = figures.run.robots
    if len(robots) == 1:
        return ""
    balances = ", ".join(f"{robot} {figures.balance(robot):,.0f} IEC" for robot in robots)
    return f" In the end: {balances}. Balances and what they fund are those of {robots[0]} below."


def count(number: int, one: str) -> str:
    return f"{number} {one}" if number == 1 else f"{number} {one}s"


def _differences(figures: Figures, site: Site) -> str:
    limits, (length_m, width_m) = site.robots[0].limits, site.lab.size_m
    minutes = median(figures.execution_min(figures.cleanings))
    ours = "" if math.isnan(minutes) else f" and ours {60 * minutes:.0f} s"
    return (
        f"The paper's robot takes {60 * paper.CLEANING_MIN:.0f} s for a cleaning{ours}. Ours drives at up to "
        f"{limits.cruise_m_s:g} m/s, turns its joints at up to {limits.joint_rad_s:g} rad/s, looks at the "
        "place "
        f"that the task names with a depth camera, and works in a room of {length_m:g} m by {width_m:g} m. "
        "The "
        "paper tells neither its speeds nor the size of its room. `--pace paper` uses the slower limits of "
        "the "
        "site file."
    )


def _method(figures: Figures) -> list[str]:
    run = figures.run
    return [
        "The real processes run: router, chain with the contracts, bridge, robot's mind, bin, dock, oracle "
        "and the "
        "simulated body with its physics. Nobody sets a battery level, a verdict or a balance. Each "
        "cleaning is "
        "recorded, sealed, replayed by the oracle and paid on chain. Each charge follows from the battery.",
        "",
        "A person empties the bin, is paid for it, and an auditor judges that. The simulated clock runs "
        "as fast as "
        "the machine computes, waits for who works, and jumps over what is empty. It stood still for "
        "somebody for "
        f"{100 * run.waited_s / run.wall_s:.0f} % of the wall time.",
        "",
        "Execution time is from assignment to proof on the site's clock. Names that end in `_min` are site "
        "time. "
        "Names with `oracle_s` are wall time from the proof's event to the verdict's event as heard on the "
        "bus.",
    ]


def _fees(figures: Figures, experiment: ExperimentConfig) -> list[str]:
    rows = []
    for step, found in sorted(figures.steps.items()):
        gas = int(statistics.median(one.gas_used or 0 for one in found))
        fees = [
            f"{eth} ETH = {eur} EUR"
            for price in experiment.gas_prices
            for eth, eur in [_fee(gas, price.gas_gwei, experiment.eth_eur)]
        ]
        rows.append((step, str(len(found)), f"{gas:,}", *fees))
    heads = [f"{one.name}, {one.gas_gwei:g} gwei" for one in experiment.gas_prices]
    return [
        f"One ETH is {experiment.eth_eur} EUR here.",
        "",
        *table_lines(("step", "transactions", "median gas", *heads), rows),
    ]


def _earnings(run: Run, site: Site) -> list[str]:
    lines = earnings(run.tasks, run.transactions, site.economy.electricity)
    return table_lines(COLUMNS, map(cells, lines))


def table_lines(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table."""
    cells = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    return [
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(heads),
        *("| " + " | ".join(row) + " |" for row in cells),
    ]


# -- as HTML ---------------------------------------------------------------------------------------------

_CSS = Path(__file__).with_name("report.css")
_IMAGE = re.compile(r"!\[(\w+)\]\((.+)\)")
_STRONG, _CODE = re.compile(r"\*\*(.+?)\*\*"), re.compile(r"`(.+?)`")


def as_html(text: str, folder: Path) -> str:
    """The report with its figures in it. Understands the Markdown that `markdown` writes, and no more."""
    blocks, title = [], "Report"
    paragraphs = [block for block in re.split(r"\n{2,}", text.strip()) if block.strip()]
    for number, block in enumerate(paragraphs):
        lines = block.splitlines()
        first = lines[0]
        if first.startswith("# "):
            title = first[2:]
            blocks.append(f"<h1>{_inline(title)}</h1>")
        elif first.startswith("## "):
            blocks.append(f"<h2>{_inline(first[3:])}</h2>")
        elif first.startswith("| "):
            blocks.append(_htmltable_lines(lines))
        elif first.startswith("- "):
            blocks.append("<ul>" + "".join(f"<li>{_inline(line[2:])}</li>" for line in lines) + "</ul>")
        elif image := _IMAGE.fullmatch(first):
            caption = paragraphs[number + 1] if number + 1 < len(paragraphs) else ""
            svg = (folder / image[2]).read_text()
            # One document has one of each id: matplotlib names its own alike in every file.
            svg = re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{image[1]}-", svg[svg.index("<svg") :])
            blocks.append(f"<figure>{svg}<figcaption>{_inline(caption)}</figcaption></figure>")
        elif number == 0 or not _IMAGE.fullmatch(paragraphs[number - 1]):
            blocks.append(f"<p>{_inline(block)}</p>")
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_CSS.read_text()}</style></head>\n<body>\n" + "\n".join(blocks) + "\n</body></html>\n"
    )


def _htmltable_lines(lines: Sequence[str]) -> str:
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    head, *body = [rows[0], *rows[2:]]
    cells = "".join(f"<th>{_inline(cell)}</th>" for cell in head)
    filled = "".join("<tr>" + "".join(f"<td>{_inline(cell)}</td>" for cell in row) + "</tr>" for row in body)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>{filled}</tbody></table>"


def _inline(text: str) -> str:
    escaped = html.escape(text.replace("\\|", "|"), quote=False)
    return _CODE.sub(r"<code>\1</code>", _STRONG.sub(r"<strong>\1</strong>", escaped))


def write_report(
    run: Run,
    site: Site,
    folder: Path,
    problems: Sequence[str],
    calibrated: Run | None = None,
) -> None:
    """Everything that `rodeo experiment paper` leaves in its folder, from the run's record."""
    from rodeo_experiments.figures import draw  # needs the extra `experiment`

    assert site.experiment is not None
    figures = Figures(run)
    write_tables(figures, site.experiment, folder)
    captions = draw(figures, site.economy.electricity, folder / "figures")
    (folder / "results.json").write_text(json.dumps(figures.results(), indent=2) + "\n")
    text = markdown(figures, site, captions, problems, Figures(calibrated) if calibrated else None)
    (folder / "report.md").write_text(text)
    (folder / "report.html").write_text(as_html(text, folder))
