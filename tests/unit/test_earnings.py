"""What participants earned and spent, by kind and week."""

from __future__ import annotations

from datetime import UTC, datetime
from decimal import Decimal

from rodeo.bus.messages import Task
from rodeo.bus.queries import Transaction
from rodeo.display.earnings import COLUMNS, Line, as_csv, cells, earnings, sums
from rodeo.site.sections import TariffConfig
from rodeo_cli.earnings_page import page
from tests.support.tasks import task

TARIFFS = [TariffConfig(from_hour=0, eur_kwh=Decimal("0.30"))]
SUNDAY_S = datetime(2026, 5, 3, 12, tzinfo=UTC).timestamp()
MONDAY_S = datetime(2026, 5, 4, 12, tzinfo=UTC).timestamp()


def paid(number: int, kind: str, at_s: float, creator: str, executor: str, amount: int) -> Task:
    known = {"id": number, "kind": kind, "settled": at_s, "paid_iec": Decimal(amount)}
    known |= {"creator_name": creator, "executor_name": executor, "params": {"energy_wh": 500.0}}
    return task("settled").model_copy(update=known)


def sent(sender: str, tasks: list[int], gas: int | None) -> Transaction:
    return Transaction(
        tx_hash="0x1",
        block=1,
        time_s=MONDAY_S,
        events=["ProofSubmitted"],
        task_ids=tasks,
        sender="0x0",
        sender_name=sender,
        gas_used=gas,
        gas_price_wei="1",
        fee_wei="1",
    )


TASKS = [
    paid(1, "waste_disposal", SUNDAY_S, "organization", "panther1", 100),
    paid(2, "waste_disposal", MONDAY_S, "organization", "panther1", 90),
    paid(3, "battery_charging", MONDAY_S, "panther1", "organization", 200),
    task("open").model_copy(update={"id": 9}),
]
SENT = [
    sent("panther1", [2], 50),
    sent("panther1", [2, 3], 70),
    sent("panther1", [], 1000),
    sent("x", [3], None),
]


def of(lines: list[Line], week: str, participant: str, kind: str) -> Line:
    return next(one for one in lines if (one.week, one.participant, one.kind) == (week, participant, kind))


def test_a_week_begins_on_monday_and_both_sides_of_a_payment_have_a_line() -> None:
    lines = earnings(TASKS, SENT, TARIFFS)
    before = of(lines, "2026-04-27", "panther1", "waste_disposal")
    assert (before.done, before.earned_iec, before.gas) == (1, 100, 0)
    work = of(lines, "2026-05-04", "panther1", "waste_disposal")
    assert (work.done, work.earned_iec, work.spent_iec, work.transactions, work.gas) == (1, 90, 0, 2, 120)
    bought = of(lines, "2026-05-04", "panther1", "battery_charging")
    assert (bought.bought, bought.spent_iec, bought.energy_kwh) == (1, 200, 0.5)
    assert round(bought.electricity_eur, 6) == 0.15
    sold = of(lines, "2026-05-04", "organization", "battery_charging")
    assert (sold.done, sold.earned_iec, sold.electricity_eur) == (1, 200, 0)
    assert sum(one.earned_iec for one in lines) == sum(one.spent_iec for one in lines)


def test_lines_are_filtered_by_time_participant_and_kind() -> None:
    lines = earnings(
        TASKS, SENT, TARIFFS, first_s=MONDAY_S, participants=["panther1"], kinds=["waste_disposal"]
    )
    assert [(one.week, one.participant, one.done) for one in lines] == [("2026-05-04", "panther1", 1)]


def test_what_was_not_paid_earns_nothing() -> None:
    assert earnings([task("open"), task("settled")], [], TARIFFS) == []


def test_a_page_has_sums_bars_and_every_line_and_names_are_text() -> None:
    lines = earnings(TASKS, SENT, TARIFFS)
    (total,) = [one for one in sums(lines) if one.participant == "panther1"]
    assert (total.done, total.earned_iec, total.spent_iec, total.gas) == (2, 190, 200, 120)
    (odd,) = [one for one in lines if one.without_gas]
    assert cells(odd)[COLUMNS.index("gas")] == "0 + 1 unknown"
    shown = page([*lines, Line(week="2026-05-04", participant="<b>eve", kind="x")], "lab")
    assert shown.count("<tr>") == 2 + len(sums(lines)) + 1 + len(lines) + 1
    assert "&lt;b&gt;eve" in shown and "<b>" not in shown
    assert "src=" not in shown and "href=" not in shown
    assert "Nobody" in page([], "lab")


def test_a_file_has_a_line_for_each() -> None:
    head, first, *_ = as_csv(earnings(TASKS, SENT, TARIFFS)).splitlines()
    assert head.startswith("week,participant,kind,done,earned_iec")
    assert first == "2026-04-27,organization,waste_disposal,0,0,1,100,0.5,0.15,0,0,0,0"
