"""The published experiment in numbers: what the paper reports, what follows from its own counts, and ours.

The paper is "RODEO: RObotic DEcentralized Organization" by M. Groshev and E. Castello Ferrer. Only its
numbers are here, and in our words where two of them do not fit.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rodeo.bus.messages import Task
from rodeo_experiments.results import Figures, median

CLEANINGS, CHARGES, DAYS = 51, 8, 3
REWARD_IEC, CHARGE_IEC = 100, 200
START_IEC, END_IEC = 2000, 4100
CLEANING_MIN, CLEANING_RANGE_MIN = 3.2, (2.4, 3.7)
CLEANING_ORACLE_MIN, CLEANING_ORACLE_RANGE_MIN = 1.1, (0.9, 1.2)
CLEANING_TOTAL_MIN = 4.1
CHARGING_MIN = (53.6, 73.0, 65.5)
CHARGING_ORACLE_MIN = (0.8, 1.0, 0.3)
FUNDED = (1, 3, 7)
HOURS_PER_CHARGE = 8
REPLAY_SPEED = 3
REPORTED: dict[str, float] = {
    "cleaning_settled": CLEANINGS,
    "charging_settled": CHARGES,
    "cleaning_execution_min_median": CLEANING_MIN,
    "charging_min_median": statistics.median(CHARGING_MIN),
    "balance_end_iec": END_IEC,
}
"""Name in `results.json` -> what the paper reports of it."""
_TOTALS = frozenset({"cleaning_settled", "charging_settled", "balance_end_iec"})


def reported(days: int) -> dict[str, float]:
    """What a run of so many days is held against: the paper's totals are those of its own three."""
    return {name: value for name, value in REPORTED.items() if days == DAYS or name not in _TOTALS}


@dataclass(frozen=True)
class Row:
    quantity: str
    ours: str
    paper: str = "not told"
    recomputed: str = "–"
    """From the paper's own counts."""
    calibrated: str = ""
    """Value of the calibrated run, where there is one."""


def contradictions() -> list[str]:
    """Where the paper's numbers do not fit each other, each recomputed here."""
    gain = CLEANINGS * REWARD_IEC - CHARGES * CHARGE_IEC
    told = END_IEC - START_IEC
    fits_cleanings = (told + CHARGES * CHARGE_IEC) / REWARD_IEC
    fits_charges = (CLEANINGS * REWARD_IEC - told) / CHARGE_IEC
    organization = START_IEC - gain
    sums = [a + b for a, b in zip(CHARGING_MIN, CHARGING_ORACLE_MIN, strict=True)]
    of_medians = statistics.median(CHARGING_MIN) + statistics.median(CHARGING_ORACLE_MIN)
    busy_h = CHARGES * (HOURS_PER_CHARGE + statistics.median(CHARGING_MIN) / 60)
    return [
        f"{CLEANINGS} × {REWARD_IEC} − {CHARGES} × {CHARGE_IEC} = {gain:+,} IEC. The paper reports "
        f"{told:+,} IEC. That needs {fits_cleanings:.0f} paid cleanings, or {fits_charges:.0f} charges.",
        f"The organization began with {START_IEC:,} IEC, too. After all payments it would have "
        f"{organization:+,} IEC, which no token allows: it could never have paid for {CLEANINGS} cleanings.",
        f"Funded charges of {', '.join(map(str, FUNDED))} ({sum(FUNDED)} in all) fit no reading. Daily gains "
        f"sum to {told:,} IEC at most as reported, which buys {told // CHARGE_IEC} charges. Balances at the "
        f"end of a day are never below {START_IEC:,} IEC, which buys {START_IEC // CHARGE_IEC} on the first "
        "day already.",
        f"{CHARGES} charges of {HOURS_PER_CHARGE} h, and the charging itself, fill {busy_h:.0f} h of "
        f"{24 * DAYS} h. The balance is flat in the nights, so nobody charged then.",
        "The caption of the figure with completion times calls the light bars proof creation. The text calls "
        "them the oracle's decision.",
        "In one place a rejection returns the reward to the creator. In another the task is queued again.",
        f"The median of the charges' sums is {statistics.median(sums):.1f} min, as reported. The sum of both "
        f"medians is {of_medians:.1f} min. For cleanings the reported total is {CLEANING_TOTAL_MIN} min, and "
        f"the sum of the reported medians {CLEANING_MIN + CLEANING_ORACLE_MIN:.1f} min.",
    ]


def table(figures: Figures, calibrated: Figures | None = None) -> list[Row]:
    """The paper beside a run, and beside the calibrated run where there is one."""
    rows = _rows(figures)
    if calibrated is None:
        return rows
    return [replace(row, calibrated=other.ours) for row, other in zip(rows, _rows(calibrated), strict=True)]


def fitted(figures: Figures, calibrated: Figures, from_w: float, to_w: float) -> str:
    """What was fitted to the paper in the calibrated run, what was not, and what came of it."""
    cleanings, charges = calibrated.settled(calibrated.cleanings), calibrated.settled(calibrated.charges)
    cleaning, charging = (median(calibrated.execution_min(some)) for some in (cleanings, charges))
    ours = median(figures.execution_min(figures.charges))
    return (
        f"Two numbers of the calibrated run were fitted to the paper: a base load of {to_w:g} W instead of "
        f"{from_w:g} W, so that the robot charges {CHARGES} times, and the slower limits of `--pace paper`, "
        "so that a cleaning takes about as long. These two figures therefore prove nothing. Nothing else was "
        "fitted: seed, arrivals, room, working hours, battery, dock, prices and thresholds are those of this "
        f"run. The calibrated run paid {len(charges)} charges (paper: {CHARGES}) and {len(cleanings)} "
        f"cleanings ({CLEANINGS}). A cleaning took {_number(cleaning)} min ({CLEANING_MIN}). A charge took "
        f"{_number(charging)} min ({statistics.median(CHARGING_MIN)}; this run {_number(ours)}): the base "
        "load draws from the dock while the battery charges."
    )


def _rows(figures: Figures) -> list[Row]:
    parts = (_counts, _unlisted, _money, _times, _funded, _costs)
    return [row for part in parts for row in part(figures)]


def _counts(figures: Figures) -> list[Row]:
    results = figures.results()
    return [
        Row("Cleanings paid", f"{len(figures.settled(figures.cleanings))}", f"{CLEANINGS}", f"{CLEANINGS}"),
        Row("Charges paid", f"{len(figures.settled(figures.charges))}", f"{CHARGES}", f"{CHARGES}"),
        Row("Both", f"{len(figures.settled(figures.own_tasks))}", "59", f"{CLEANINGS + CHARGES}"),
        Row("Cleanings by day", _list(results["cleanings_per_day"]), "5 on the first", f"{CLEANINGS} in all"),
        Row("Charges by day", _list(results["charges_per_day"]), "1 on the first", f"{CHARGES} in all"),
        Row("Bin emptied by a person", str(results["emptying_settled"])),
        Row(
            "Rejected, void, expired",
            ", ".join(str(results[f"tasks_{end}"]) for end in ("rejected", "void", "expired")),
            "none told",
        ),
    ]


def _unlisted(figures: Figures) -> list[Row]:
    every = figures.unlisted
    if not every.left:
        return []
    return [
        Row("Things that people left", f"{len(every.left)}, none of them listed", f"{CLEANINGS}"),
        Row("Found by a robot", f"{len(every.found)}", "none told"),
        Row("Posted by a person", f"{len(every.pointed)}", f"{CLEANINGS}, on a web page"),
        Row("Tasks where nothing was left", f"{every.about_nothing}", "none told"),
        Row("In the bin", f"{len(every.fallen)}", f"{CLEANINGS}"),
        Row(
            "From being left to being found by a robot (min)",
            _spread([one.posted_min for one in every.found]),
            "none told",
        ),
        Row(
            "From being left to being posted by a person (min)",
            _spread([one.posted_min for one in every.pointed]),
            "at once",
        ),
        Row("From being left to lying in the bin (min)", _spread([one.in_bin_min for one in every.fallen])),
        Row(
            "Class as the bin named it",
            f"right for {sum(one.is_known for one in every.fallen)} of {len(every.fallen)}",
        ),
        Row("Bin's scale, off the mass (g)", _spread([one.off_g for one in every.fallen])),
    ]


_GAIN = CLEANINGS * REWARD_IEC - CHARGES * CHARGE_IEC
"""What the paper's robot earned, IEC."""


def _money(figures: Figures) -> list[Row]:
    robot, results = figures.run.robots[0], figures.results()
    balance_start, balance_end = figures.balance(robot, figures.started_s), figures.balance(robot)
    return [
        Row("Reward of a cleaning (IEC)", _price(figures.cleanings), f"{REWARD_IEC}", f"{REWARD_IEC}"),
        Row("Price of a charge (IEC)", _price(figures.charges), f"{CHARGE_IEC}", f"{CHARGE_IEC}"),
        Row(
            "Robot's balance at the start (IEC)", f"{balance_start:,.0f}", f"{START_IEC:,}", f"{START_IEC:,}"
        ),
        Row(
            "Robot's balance at the end (IEC)",
            f"{balance_end:,.0f}",
            f"{END_IEC:,}",
            f"{START_IEC + _GAIN:,}",
        ),
        Row(
            "Robot's gain (IEC)",
            f"{balance_end - balance_start:+,.0f}",
            f"{END_IEC - START_IEC:+,}",
            f"{_GAIN:+,}",
        ),
        Row(
            "Organization's balance (IEC)",
            f"{results['organization_start_iec']:,.0f} to {results['organization_end_iec']:,.0f}",
            f"{START_IEC:,} at the start",
            f"{START_IEC - _GAIN:+,} at the end",
        ),
    ]


def _times(figures: Figures) -> list[Row]:
    cleaning, charging = map(figures.execution_min, (figures.cleanings, figures.charges))
    total = [
        ((task.settled or 0.0) - (task.assigned or 0.0)) / 60 for task in figures.settled(figures.cleanings)
    ]
    days = (
        [one for one in figures.charges if _day(figures, one.settled) == n] for n in range(figures.run.days)
    )
    charging_per_day = [median(figures.execution_min(of_day)) for of_day in days]
    return [
        Row(
            "Cleaning, assignment to proof (min)",
            f"{_spread(cleaning)} of site time",
            _with_range(CLEANING_MIN, CLEANING_RANGE_MIN),
        ),
        Row(
            "Cleaning, oracle (min)",
            _oracle(figures, figures.cleanings),
            _with_range(CLEANING_ORACLE_MIN, CLEANING_ORACLE_RANGE_MIN),
            f"replayed at {REPLAY_SPEED} × real time: {CLEANING_MIN / REPLAY_SPEED:.1f}",
        ),
        Row(
            "Cleaning, both (min)",
            f"{_spread(total)} of site time",
            f"{CLEANING_TOTAL_MIN} (3.6 to 4.8)",
            f"{CLEANING_MIN + CLEANING_ORACLE_MIN:.1f}",
        ),
        Row(
            "Charging by day (min)",
            ", ".join(_number(one) for one in charging_per_day),
            ", ".join(f"{one:.1f}" for one in CHARGING_MIN),
        ),
        Row(
            "Charging, median (min)",
            _spread(charging),
            f"{statistics.median(CHARGING_MIN)}",
            f"{statistics.median(CHARGING_MIN)}",
        ),
        Row(
            "Charging, oracle (min)",
            _oracle(figures, figures.charges),
            ", ".join(f"{one:.1f}" for one in CHARGING_ORACLE_MIN),
            f"median {statistics.median(CHARGING_ORACLE_MIN):.1f}",
        ),
        Row(
            "Hours between two charges",
            _spread(figures.intervals_h),
            "shown in the figure only",
            f"{24 * DAYS / CHARGES:.1f} on average",
        ),
        Row(
            "Hours per charge",
            f"{_number(figures.hours_per_charge)}, measured",
            f"{HOURS_PER_CHARGE}, assumed",
        ),
    ]


def _funded(figures: Figures) -> list[Row]:
    robot, hours = figures.run.robots[0], figures.hours_per_charge
    by_gain, by_balance = figures.funded(figures.gains(robot)), figures.funded(figures.day_ends(robot))
    return [
        Row(
            "Funded charges by day, of the day's gain",
            _list(by_gain),
            ", ".join(map(str, FUNDED)),
            f"{_GAIN // CHARGE_IEC} in all",
        ),
        Row(
            "Funded charges by day, of the balance",
            _list(by_balance),
            ", ".join(map(str, FUNDED)),
            f"{(START_IEC + _GAIN) // CHARGE_IEC} on the last",
        ),
        Row(
            "Funded hours by day, of the day's gain",
            ", ".join(_number(one * hours) for one in by_gain),
            ", ".join(str(HOURS_PER_CHARGE * one) for one in FUNDED),
            f"{_GAIN // CHARGE_IEC * HOURS_PER_CHARGE} in all",
        ),
        Row("Change of the balance at night (IEC)", _nights(figures), "0"),
    ]


def _costs(figures: Figures) -> list[Row]:
    results = figures.results()
    gas = {step: median(one.gas_used or 0 for one in found) for step, found in figures.steps.items()}
    return [
        Row("Energy bought (kWh)", f"{figures.energy_kwh:.2f}"),
        Row("Electricity per charge (EUR)", _eur(results["eur_per_charge"])),
        Row("Electricity per cleaning (EUR)", _eur(results["eur_per_cleaning"])),
        Row(
            "Gas per step",
            "; ".join(f"{step} {used / 1000:.0f}k" for step, used in sorted(gas.items()) if step != "others"),
            recomputed="published code: 590k to 7.9M",
        ),
        Row(
            "Transaction, event (s of wall time)",
            f"{_number(results['transaction_s_median'], 2)}, {_number(results['event_s_median'], 2)}",
            recomputed="published code polls every 1 to 2 s",
        ),
    ]


def _day(figures: Figures, time_s: float | None) -> int | None:
    return None if time_s is None else figures.run.day_of(time_s)


def _nights(figures: Figures) -> str:
    """What the robot's balance changed by outside of the hours from 8 to 18, in all nights."""
    run, robot = figures.run, figures.run.robots[0]
    changes = []
    for day in range(run.days - 1):
        evening_s = run.begin_s + 86_400 * day + 19 * 3600
        changes.append(figures.balance(robot, evening_s + 13 * 3600) - figures.balance(robot, evening_s))
    return ", ".join(f"{one:.0f}" for one in changes) or "no whole night"


def _with_range(middle: float, ends: tuple[float, float]) -> str:
    return f"{middle} ({ends[0]} to {ends[1]})"


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "none"
    return f"{median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _oracle(figures: Figures, tasks: Sequence[Task]) -> str:
    wall_s = figures.oracle_s(tasks)
    site_s = figures.oracle_site_s(tasks)
    if not wall_s:
        return "none"
    wall, site = median(wall_s), median(site_s)
    return f"{wall / 60:.2f} of wall time ({wall:.1f} s), {site / 60:.2f} of site time"


def _price(tasks: Sequence[Task]) -> str:
    return ", ".join(sorted({f"{task.reward_iec:.0f}" for task in tasks})) or "none"


def _list(values: object) -> str:
    return ", ".join(map(str, values)) if isinstance(values, list) else str(values)


def _number(value: object, digits: int = 1) -> str:
    if not isinstance(value, int | float) or math.isnan(value):
        return "–"
    return f"{value:.{digits}f}"


def _eur(value: object) -> str:
    return _number(value, 3)
