"""Results, table and report of a run that is known by heart: two cleanings and a charge on two days."""

from __future__ import annotations

import csv
import json
import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import Task
from rodeo.bus.queries import Person, Transaction, Transfer
from rodeo.site.config import Site
from rodeo_cli.experiment import PAPER
from rodeo_experiments import paper
from rodeo_experiments.arrivals import day_begins_s
from rodeo_experiments.record import Arrival, Fallen, Flow, Heard, Reading, Run, Sent
from rodeo_experiments.report import markdown, write_report, write_tables
from rodeo_experiments.results import Figures
from tests.support.tasks import task

SITE = Site.load(PAPER)
BEGIN_S = day_begins_s(SITE, 0)
HOUR_S, DAY_S = 3600.0, 86_400.0
ADDRESSES = {"organization": "0x" + "11" * 20, "panther1": "0x" + "22" * 20, "escrow": "0x" + "33" * 20}
KEYS = [
    "tasks_total",
    "tasks_settled",
    "tasks_rejected",
    "tasks_expired",
    "cleaning_settled",
    "charging_settled",
    "cleaning_execution_min_median",
    "cleaning_execution_min_range",
    "cleaning_oracle_s_median",
    "charging_min_median",
    "charging_oracle_s_median",
    "charging_interval_h_median",
    "balance_start_iec",
    "balance_end_iec",
    "organization_end_iec",
    "supply_conserved",
    "funded_charges_per_day",
    "funded_hours_total",
    "energy_kwh_total",
    "eur_per_cleaning",
    "gas_per_task_median",
    "site_realtime_factor",
    "wall_s",
    "seed",
]


def done(number: int, kind: str, begin_h: float, minutes: float, reward: int) -> Task:
    at_s = BEGIN_S + HOUR_S * begin_h
    creator = "panther1" if kind == "battery_charging" else "organization"
    return task("settled").model_copy(
        update={
            "id": number,
            "kind": kind,
            "verdict": "accepted",
            "creator": ADDRESSES[creator],
            "creator_name": creator,
            "reward_iec": Decimal(reward),
            "paid_iec": Decimal(reward),
            "registered": at_s,
            "assigned": at_s,
            "proof_submitted": at_s + 60 * minutes,
            "settled": at_s + 60 * minutes + 6,
        }
    )


TASKS = [
    done(1, "waste_disposal", 9, 1.0, 100),
    done(2, "waste_disposal", 33, 2.0, 100),
    done(3, "battery_charging", 34, 60.0, 200),
]


def moved(number: int, sender: str, to: str, amount: int, hours: float, reason: str = "transfer") -> Transfer:
    return Transfer(
        seq=number,
        block=number,
        time_s=BEGIN_S + HOUR_S * hours,
        tx_hash=f"0x{number:064x}",
        sender=ADDRESSES.get(sender, "0x" + "00" * 20),
        sender_name=sender,
        to=ADDRESSES[to],
        to_name=to,
        amount_iec=Decimal(amount),
        task_id=None,
        reason=reason,
    )


def a_run(**changes: Any) -> Run:
    transfers = [
        moved(1, "nobody", "organization", 2000, 7, "mint"),
        moved(2, "nobody", "panther1", 2000, 7, "mint"),
        moved(3, "organization", "panther1", 100, 9.1, "payment"),
        moved(4, "organization", "panther1", 100, 33.1, "payment"),
        moved(5, "panther1", "organization", 200, 35.1, "payment"),
    ]
    events = [
        Heard(
            name=name,
            task_id=one.id,
            tx_hash=f"0x{one.id}{step}",
            verdict="accepted" if name == "Ruled" else "",
            block_s=one.registered,
            wall_s=10.0 * one.id + step,
        )
        for one in TASKS
        for step, name in enumerate(("TaskRegistered", "ProofSubmitted", "Ruled"))
    ]
    transactions = [
        Transaction(
            tx_hash=event.tx_hash,
            block=3,
            time_s=event.block_s,
            events=[event.name],
            task_ids=[event.task_id or 0],
            sender=ADDRESSES["organization"],
            sender_name="organization",
            gas_used=100_000,
            gas_price_wei="1",
            fee_wei="1",
        )
        for event in events
    ]
    fields: dict[str, Any] = {
        "seed": 1,
        "days": 2,
        "begin_s": BEGIN_S,
        "timezone": "Europe/Madrid",
        "robots": ["panther1"],
        "work": "waste_disposal",
        "energy": "battery_charging",
        "emptying": "bin_emptying",
        "machine": {"cores": "2"},
        "parameters": {"agent.charge_below": "0.5"},
        "wall_s": 100.0,
        "site_s": 2 * DAY_S,
        "waited_s": 10.0,
        "supply_start_iec": "4000",
        "supply_end_iec": "4000",
        "started_s": BEGIN_S + 8 * HOUR_S,
        "tasks": TASKS,
        "transfers": transfers,
        "transactions": transactions,
        "participants": [
            Person(
                name=name,
                address=ADDRESSES[name],
                role=None,
                roles_on_chain=[],
                balance_iec=Decimal(2000),
                created={},
                executed={},
                member=True,
            )
            for name in ("organization", "panther1")
        ],
        "events": events,
        "sent": [Sent(command="register_task", task_id=1, sent_s=9.0, replied_s=9.5)],
        "battery": [
            Reading(robot="panther1", time_s=BEGIN_S + 9 * HOUR_S, soc=0.9, power_w=-50.0),
            Reading(robot="panther1", time_s=BEGIN_S + 20 * HOUR_S, soc=0.8, power_w=-5.0),
        ],
        "flows": [Flow(dock="dock1", begin_s=BEGIN_S, end_s=BEGIN_S + HOUR_S, energy_wh=400.0, cost_eur=0.1)],
        "arrivals": [
            Arrival(number=n, time_s=BEGIN_S, item=f"item{n + 1}", x_m=2.0, y_m=2.0, task_id=n + 1)
            for n in range(2)
        ],
        "notes": [],
    }
    return Run(**fields | changes)


def test_a_void_attempt_and_one_that_was_given_up_are_no_rejections() -> None:
    run = a_run()
    ends = ("rejected", "given_up", "void")
    more = [run.events[-1].model_copy(update={"verdict": end}) for end in ends]
    tasks = [TASKS[0].model_copy(update={"state": "failed", "verdict": "void"}), *TASKS[1:]]
    results = Figures(a_run(events=[*run.events, *more], tasks=tasks)).results()
    assert (results["tasks_rejected"], results["tasks_void"]) == (1, 1)


def test_every_key_is_there_and_the_numbers_follow_from_the_record() -> None:
    results = Figures(a_run()).results()
    assert set(KEYS) <= set(results)
    assert results["cleaning_execution_min_median"] == 1.5
    assert results["cleaning_execution_min_range"] == [1.0, 2.0]
    assert results["cleaning_oracle_s_median"] == 1.0  # of wall time
    assert results["charging_min_median"] == 60.0
    assert (results["balance_start_iec"], results["balance_end_iec"]) == (2000, 2000)
    assert results["funded_charges_per_day"] == [0, 0]
    assert results["funded_charges_per_day_by_balance"] == [10, 10]
    assert results["hours_per_charge"] == 8.0  # 400 Wh at 50 W; what it draws while it is off does not count
    assert results["eur_per_cleaning"] == 0.05
    assert results["gas_per_task_median"] == 300_000
    assert results["event_s_median"] == 1.0
    assert Figures(a_run()).problems(2) == []


def test_what_is_missing_live_or_not_conserved_is_a_problem() -> None:
    live = TASKS[0].model_copy(update={"state": "assigned"})
    run = a_run(tasks=[live, *TASKS[1:]], supply_end_iec="3999")
    assert Figures(run).problems(3) == [
        "2 of 3 arrivals were posted",
        "tasks [1] are not over",
        "the supply of IEC changed",
    ]


def test_a_balance_that_the_transfers_do_not_give_is_not_conserved() -> None:
    run = a_run(transfers=a_run().transfers[:-1])
    assert not Figures(run).is_conserved


def test_a_run_without_any_work_has_no_medians() -> None:
    results = Figures(a_run(tasks=[], events=[], flows=[], battery=[])).results()
    assert (results["cleaning_execution_min_median"], results["charging_interval_h_median"]) == (None, None)


def test_the_papers_numbers_are_recomputed() -> None:
    text = " ".join(paper.contradictions())
    for number in ("+3,500", "+2,100", "37 paid cleanings", "15 charges", "65.8", "66.3", "-1,500"):
        assert number in text


def test_the_table_has_three_columns() -> None:
    rows = {row.quantity: row for row in paper.table(Figures(a_run()))}
    gain = rows["Robot's gain (IEC)"]
    assert (gain.paper, gain.recomputed, gain.ours) == ("+2,100", "+3,500", "+0")
    assert rows["Cleanings by day"].ours == "1, 1"


def test_a_calibrated_run_stands_beside_the_others_with_what_was_fitted() -> None:
    calibrated = Figures(a_run(tasks=[*TASKS, done(4, "battery_charging", 38, 80.0, 200)]))
    rows = {row.quantity: row for row in paper.table(Figures(a_run()), calibrated)}
    charges, reward = rows["Charges paid"], rows["Reward of a cleaning (IEC)"]
    assert (charges.paper, charges.ours, charges.calibrated) == ("8", "1", "2")
    assert reward.calibrated == reward.ours == "100"
    text = markdown(Figures(a_run()), SITE, {}, [], calibrated=calibrated)
    assert "| Charges paid | 8 | 8 | 1 | 2 |" in text
    assert "a base load of 115 W instead of 45 W" in text
    assert "paid 2 charges (paper: 8) and 2 cleanings (51)" in text
    assert "A charge took 70.0 min (65.5; this run 60.0)" in text


def an_unlisted_run() -> Run:
    """A robot found the first thing after a minute, a person pointed at the second, and the third lies there
    still."""
    tasks = [
        one.model_copy(update={"registered": BEGIN_S + 60 * after_min})
        for one, after_min in zip(TASKS[:2], (1, 30), strict=True)
    ]
    ends: list[dict[str, Any]] = [
        {"task_id": 1, "found_by": "panther1"},
        {"task_id": 2},
        {"task_id": None},
    ]
    fallen = Fallen(item_class="metal", weight_n=0.31, time_s=BEGIN_S + 120)
    arrivals = [
        Arrival(
            number=n, time_s=BEGIN_S, item=f"item{n + 1}", x_m=2, y_m=2, fallen=fallen if n == 0 else None
        )
        for n in range(3)
    ]
    arrivals = [one.model_copy(update=end) for one, end in zip(arrivals, ends, strict=True)]
    return a_run(tasks=tasks, arrivals=arrivals, things=SITE.items[:3])


def test_what_became_of_things_that_nobody_listed_stands_beside_the_paper() -> None:
    figures = Figures(an_unlisted_run())
    results = figures.results()
    assert (results["things_found_by_robots"], results["things_pointed_at"]) == (1, 1)
    assert (results["things_in_bin"], results["things_class_known"]) == (1, 1)
    assert (results["things_posted_min_median"], results["things_in_bin_min_median"]) == (15.5, 2.0)
    assert results["things_scale_off_g_median"] == pytest.approx(1000 * 0.31 / 9.81 - 30, abs=1e-3)
    assert "2 of 3 arrivals were posted" in figures.problems(3)
    text = markdown(figures, SITE, {}, [])
    assert "| Posted by a person | 51, on a web page | – | 1 |" in text
    assert "| item1, metal can | 30 | 1 | 1 | 0 | 0 | 1 | metal 1 | 32 to 32 |" in text
    assert "| item3, paper crumpled | 30 | 1 | 0 | 0 | 1 | 0 |  |  |" in text
    assert "a person posts its place" in text


def test_a_report_of_listed_items_says_nothing_of_things() -> None:
    assert not [name for name in Figures(a_run()).results() if name.startswith("things")]
    text = markdown(Figures(a_run()), SITE, {}, [])
    assert "nobody listed" not in text
    assert "hears of it at once" in text


def test_a_report_without_a_calibrated_run_says_nothing_of_one() -> None:
    text = markdown(Figures(a_run()), SITE, {}, [])
    assert "| Charges paid | 8 | 8 | 1 |\n" in text
    assert "calibrated" not in text.partition("## Parameters")[0]


def test_each_thing_is_a_row_of_a_table(tmp_path: Path) -> None:
    figures = Figures(an_unlisted_run())
    assert SITE.experiment is not None
    write_tables(figures, SITE.experiment, tmp_path)
    with (tmp_path / "things.csv").open() as file:
        rows = [(one["found_by"], one["end"], one["bins_class"]) for one in csv.DictReader(file)]
    assert rows == [("panther1", "accepted", "metal"), ("", "accepted", ""), ("", "never posted", "")]


def test_the_report_holds_everything_that_it_shows(tmp_path: Path) -> None:
    write_report(a_run(), SITE, tmp_path, ["nothing"])
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == len(list((tmp_path / "figures").glob("*.svg"))) == 8
    assert not re.search(r'(src|href)="(?!#)', page.replace("http://www.w3.org", ""))
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert json.loads((tmp_path / "results.json").read_text())["tasks_settled"] == 3
    for name in ("tasks", "transfers", "battery", "charges", "transactions"):
        assert len((tmp_path / f"{name}.csv").read_text().splitlines()) > 1


def test_a_deployment_whose_blocks_are_ahead_of_the_clock_is_before_the_start() -> None:
    run = a_run(started_s=BEGIN_S + 6.9 * HOUR_S)  # the mints are at 7
    assert Figures(run).results()["balance_start_iec"] == 2000
    early = [one.model_copy(update={"block": 2}) for one in run.transactions]
    assert Figures(a_run(transactions=early)).steps == {}
