"""What the treasury says of money: why it moved, and what electricity cost meanwhile."""

from __future__ import annotations

import csv
from decimal import Decimal

from rodeo.bus.queries import Transfer
from rodeo.charging.tariff import price_at, prices
from rodeo.site.sections import TariffConfig
from services.console.money import transfers_csv

DAY_S = 86_400
TARIFFS = [
    TariffConfig(from_hour=6, eur_kwh=Decimal("0.34")),
    TariffConfig(from_hour=22, eur_kwh=Decimal("0.24")),
]


def test_before_the_first_hour_of_a_day_the_last_price_holds() -> None:
    at = {hour: price_at(TARIFFS, 10 * DAY_S + hour * 3600) for hour in (0, 5, 6, 21, 22, 23)}
    assert [str(at[hour]) for hour in at] == ["0.24", "0.24", "0.34", "0.34", "0.24", "0.24"]


def test_a_chart_gets_the_price_at_both_ends_and_at_each_change_in_between() -> None:
    start_s = 10 * DAY_S + 5 * 3600
    assert prices(TARIFFS, start_s, start_s + DAY_S) == [
        (start_s, 0.24),
        (10 * DAY_S + 6 * 3600, 0.34),
        (10 * DAY_S + 22 * 3600, 0.24),
        (start_s + DAY_S, 0.24),
    ]


def test_the_file_explains_each_transfer_and_no_name_in_it_is_a_formula() -> None:
    transfer = Transfer(
        seq=1,
        block=1,
        time_s=0,
        tx_hash="0x12",
        sender="0xabc",
        sender_name="=HYPERLINK(1)",
        to="0xdef",
        to_name=None,
        amount_iec=Decimal(5),
        task_id=3,
        reason="escrow",
        change_iec=Decimal(-5),
        balance_iec=Decimal(10),
    )
    (line,) = csv.DictReader(transfers_csv([transfer]).splitlines())
    assert line["from"] == "'=HYPERLINK(1)" and line["to"] == "0xdef"
    assert (line["why"], line["change_iec"], line["task"]) == ("Reward of task 3 into escrow", "-5", "3")
    assert line["balance_iec"] == "10"
    unknown = transfer.model_copy(update={"balance_iec": None})
    (line,) = csv.DictReader(transfers_csv([unknown]).splitlines())
    assert line["balance_iec"] == "", "not known, and not nothing"
