"""The money: balance over time with every transfer explained, deposits, withdrawals, tariffs."""

from __future__ import annotations

from decimal import Decimal
from functools import partial
from typing import Any

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.charging.tariff import prices
from rodeo.display.earnings import Line
from rodeo.display.formatting import iec, party, short, worth
from rodeo.text.strict_json import Json
from services.console.actions import ORGANIZATION
from services.console.money import change, reason
from services.console.pages import frame, widgets
from services.console.pages.forms import buttons
from services.console.pages.frame import Console

CHARTED = 500
"""Transfers in the chart: as many as the bridge gives at once."""
PRICED_S = 14 * 86_400
"""Prices that change twice a day cover a chart that spans more."""
PAGE_ROWS = 20
EARNINGS_ROWS, EARNINGS_TASKS = 40, 2_000
_GREEN, _RED, _TEAL, _AMBER = "#2f9d58", "#d9453d", "#139a85", "#c98a12"
_GREY = "#7b8896"
"""Can be read on a light and on a dark card."""
_AXIS = {
    "nameTextStyle": {"color": _GREY},
    "axisLabel": {"color": _GREY, "hideOverlap": True},
    "axisLine": {"lineStyle": {"color": _GREY}},
}
_GRID = {"lineStyle": {"color": _GREY, "opacity": 0.2}}
"""Fainter than what is charted on it, whatever is behind it."""
_CHART: Json = {
    "animation": False,
    "textStyle": {"fontFamily": "inherit"},
    "grid": {"left": 8, "right": 8, "top": 56, "bottom": 8, "containLabel": True},
    "legend": {"top": 0, "type": "scroll", "textStyle": {"color": _GREY}, "inactiveColor": _GREY},
    "tooltip": {"trigger": "item", "confine": True},
}
_PALETTE = (_TEAL, _AMBER, "#5b7fd0", "#a25fb0", _GREEN, _RED)


class Earnings:
    """Earned and spent by week."""

    def __init__(self, console: Console) -> None:
        self._console = console
        with widgets.card("Earned and spent, by week") as head:
            with head:
                ui.button("Earnings as CSV", icon="download").props("flat dense href=/files/earnings.csv")
            frame.follow_async(console, "events", self._load)
            self._weeks = ui.echart(_week_options([])).style("height: 280px; width: 100%")
            self._weeks.props(
                'role="img" aria-label="Earned and spent by week; the table below has the numbers"'
            )
            self._lines = widgets.Section(_draw_earnings).waiting()

    async def _load(self) -> None:
        lines = await frame.ask(self._console.queries.earnings, EARNINGS_TASKS)
        self._weeks.options.clear()
        self._weeks.options.update(_week_options(lines))
        self._weeks.update()
        self._weeks.visible = bool(lines)
        self._lines.show(lines)


class TreasuryPage:
    def __init__(self, console: Console) -> None:
        self._console = console
        self._account = ORGANIZATION
        self._page = 1
        with frame.page_head("Treasury"):
            if frame.user().has(Role.TREASURER):
                buttons(console, Role.TREASURER, lambda: self._refresh())
        self._refresh = frame.follow_async(console, "events", self._load)
        with ui.element("div").classes("grid tiles"):
            self._balance, self._escrow, self._earned, self._spent = (
                widgets.tile(name, "–")
                for name in ("balance", "in escrow", "received, as charted", "paid, as charted")
            )
        with widgets.card("Balance and electricity price") as head:
            with head:
                self._select = ui.select([ORGANIZATION], value=ORGANIZATION, label="Account")
                self._select.props("outlined dense").style("min-width: 180px")
                self._select.on_value_change(self._choose)
            self._none = widgets.Section(lambda text: widgets.empty(text) if text else None)
            self._chart = ui.echart(_options([], [], 0.0)).style("height: 320px; width: 100%")
            self._chart.props('role="img" aria-label="Balance over time; the table below has every transfer"')
        with ui.element("div").classes("grid"):
            with ui.element("div").classes("stack span-8"), widgets.card("Transfers") as head:
                with head:
                    self._csv = ui.button("CSV", icon="download").props("flat dense")
                self._rows = widgets.Section(self._draw_rows).waiting()
            with ui.element("div").classes("stack span-4"), widgets.card("Tariffs"):
                _draw_tariffs(console)
        Earnings(console)

    def _choose(self, event: Any) -> None:
        self._account, self._page = str(event.value), 1
        self._refresh()

    async def _load(self) -> None:
        asked = partial(self._console.queries.ask, account=self._account)
        charted = (await frame.ask(asked, queries.TRANSFERS, limit=CHARTED)).transfers
        offset = (self._page - 1) * PAGE_ROWS
        page = await frame.ask(asked, queries.TRANSFERS, limit=PAGE_ROWS, offset=offset)
        wallet = await frame.ask(asked, queries.WALLET)
        names = [wallet.name for wallet in self._console.live.summary.wallets] or [ORGANIZATION]
        if names != self._select.options:
            self._select.set_options(names)
        self._csv.props(f'href="/files/transfers.csv?account={self._account}"')
        self._balance.set_text(worth(wallet.balance_iec, self._console.site))
        self._escrow.set_text(worth(wallet.in_escrow_iec, self._console.site))
        changes = [change(one) for one in charted]
        self._earned.set_text(iec(sum((one for one in changes if one > 0), Decimal(0))))
        self._spent.set_text(iec(-sum((one for one in changes if one < 0), Decimal(0))))
        self._none.show(_why_empty(charted))
        self._rows.show(page.transfers, page.total, self._page)
        self._draw_chart(charted)

    def _draw_chart(self, transfers: list[queries.Transfer]) -> None:
        ordered = sorted(transfers, key=lambda one: one.seq)
        costs: list[tuple[float, float]] = []
        last_s = max((one.time_s for one in ordered), default=0.0)
        if ordered:
            first_s, last_s = ordered[0].time_s, max(last_s, ordered[0].time_s + 60)
            if last_s - first_s <= PRICED_S:
                costs = prices(self._console.site.economy.electricity, first_s, last_s)
        self._chart.options.clear()
        self._chart.options.update(_options(ordered, costs, last_s))
        self._chart.update()

    def _draw_rows(self, transfers: list[queries.Transfer], total: int, page: int) -> None:
        columns: widgets.Columns[queries.Transfer] = (
            widgets.Column("When", lambda one: frame.when(one.time_s), "plain-wide"),
            widgets.Column("Why", _why, "wrap"),
            widgets.Column("With", lambda one: _other(one, self._account), "wide-only"),
            widgets.Column("Change", lambda one: f"{change(one):+,.2f}".rstrip("0").rstrip("."), "number"),
            widgets.Column("Balance", lambda one: iec(one.balance_iec), "number wide-only"),
        )
        widgets.table("Transfers, newest first", columns, transfers, "No transfers.")
        if transfers:
            widgets.pager(page, PAGE_ROWS, total, "transfer", self._turn)

    def _turn(self, page: int) -> None:
        self._page = page
        self._refresh()


def _why(transfer: queries.Transfer) -> None:
    if transfer.task_id is None:
        widgets.Text("span", reason(transfer))
    else:
        widgets.Link(reason(transfer), f"/tasks/{transfer.task_id}")


def _other(transfer: queries.Transfer, account: str) -> str:
    if transfer.reason in ("mint", "burn"):
        return "–"
    if transfer.reason == "deposit":
        return "the organization's key"
    if transfer.reason in ("escrow", "payment", "surplus", "refund", "bond", "bond_returned"):
        return "escrow"
    if transfer.sender_name == account:
        return party(transfer.to_name, transfer.to)
    return party(transfer.sender_name, transfer.sender)


def _draw_tariffs(console: Console) -> None:
    economy = console.site.economy
    with widgets.facts():
        for tariff in sorted(economy.electricity, key=lambda tariff: tariff.from_hour):
            widgets.fact(f"Electricity from {tariff.from_hour}:00", f"{tariff.eur_kwh:.2f} EUR/kWh", "plain")
        for one in console.kinds.values():
            if one.price_iec:
                widgets.fact(f"Usual price, {one.title.lower()}", worth(one.price_iec, console.site), "plain")
    widgets.Text("p", "Tariffs are set under [economy] in the site file; hours are UTC.", "soft")


_EARNINGS: widgets.Columns[Line] = (
    widgets.Column("Week from", lambda one: one.week, "wide-only"),
    widgets.Column("Who", lambda one: party(one.participant, one.participant)),
    widgets.Column("Kind of work", lambda one: one.kind.replace("_", " "), "wrap wide-only"),
    widgets.Column("Done", lambda one: str(one.done), "number wide-only"),
    widgets.Column("Earned", lambda one: iec(one.earned_iec), "number"),
    widgets.Column("Bought", lambda one: str(one.bought), "number wide-only"),
    widgets.Column("Spent", lambda one: iec(one.spent_iec), "number"),
    widgets.Column("kWh", lambda one: f"{one.energy_kwh:.3f}", "number wide-only"),
    widgets.Column("EUR", lambda one: f"{one.electricity_eur:.2f}", "number wide-only"),
    widgets.Column("Gas", lambda one: f"{one.gas:,}", "number wide-only"),
)


def _draw_earnings(lines: list[Line]) -> None:
    none = "Nobody earned or spent anything yet."
    widgets.table("Earned and spent, the newest week first", _EARNINGS, newest_first(lines), none)
    if lines:
        told = f"The newest {EARNINGS_ROWS} of {len(lines)}" if len(lines) > EARNINGS_ROWS else "All"
        about = f"{told} lines of the newest {EARNINGS_TASKS:,} tasks; the CSV file has all."
        widgets.Text("p", about, "soft")


def newest_first(lines: list[Line]) -> list[Line]:
    """As many as the table shows."""
    ordered = sorted(lines, key=lambda one: (one.participant, one.kind))
    return sorted(ordered, key=lambda one: one.week, reverse=True)[:EARNINGS_ROWS]


def _week_options(lines: list[Line]) -> Json:
    """ECharts: for each week what each participant earned, upwards, and spent, downwards."""
    weeks = sorted({one.week for one in lines})
    totals = {
        name: dict.fromkeys(weeks, (Decimal(0), Decimal(0)))
        for name in sorted({one.participant for one in lines})
    }
    for one in lines:
        earned, spent = totals[one.participant][one.week]
        totals[one.participant][one.week] = earned + one.earned_iec, spent + one.spent_iec
    series = [
        {
            "name": short(name),
            "type": "bar",
            "stack": "both",
            "color": _PALETTE[number % len(_PALETTE)],
            "barMaxWidth": 48,
            "data": [float(totals[name][week][index]) * sign for week in weeks],
            "itemStyle": {"opacity": 1.0 if sign > 0 else 0.55},
        }
        for number, name in enumerate(totals)
        for index, sign in enumerate((1, -1))
    ]
    upwards: Json = {"type": "value", "name": "IEC earned (up), spent (down)", **_AXIS, "splitLine": _GRID}
    upwards["nameTextStyle"] = {"color": _GREY, "align": "left"}
    return _CHART | {
        "xAxis": {"type": "category", "data": weeks, **_AXIS},
        "yAxis": upwards,
        "series": series,
    }


def _why_empty(charted: list[queries.Transfer]) -> str:
    """The text in place of a balance over time; empty where there is one."""
    if not charted:
        return "No money moved on this account yet."
    if all(one.balance_iec is None for one in charted):
        return "The token is older than the organization: of earlier balances, only the changes are known."
    return ""


def _options(transfers: list[queries.Transfer], costs: list[tuple[float, float]], last_s: float) -> Json:
    """ECharts: balance until `last_s` as a step line with a mark for each transfer, electricity's price."""
    known = [
        (one, [round(one.time_s * 1000), float(one.balance_iec)])
        for one in transfers
        if one.balance_iec is not None
    ]

    def marks(received: bool) -> list[Json]:
        return [
            {"value": point, "name": f"{reason(one)}: {change(one):+,f} IEC"}
            for one, point in known
            if (change(one) > 0) == received
        ]

    balance = [point for _, point in known]
    balance += [[round(last_s * 1000), point[1]] for point in balance[-1:]]  # it stays so
    line = {"lineStyle": {"width": 2}, "showSymbol": False, "step": "end", "type": "line"}
    dots = {"type": "scatter", "symbolSize": 9, "tooltip": {"formatter": "{b}"}}
    return _CHART | {
        "useUTC": True,
        "xAxis": {"type": "time", **_AXIS},
        "yAxis": [
            {"type": "value", "name": "IEC", "scale": True, **_AXIS, "splitLine": _GRID},
            {"type": "value", "name": "EUR/kWh", "min": 0, **_AXIS, "splitLine": {"show": False}},
        ],
        "series": [
            {**line, "name": "Balance", "data": balance, "color": _TEAL},
            {**dots, "name": "Received", "data": marks(True), "color": _GREEN, "symbol": "triangle"},
            {**dots, "name": "Paid", "data": marks(False), "color": _RED, "symbol": "diamond"},
            {**line, "name": "Electricity", "yAxisIndex": 1, "color": _AMBER,
             "data": [[round(time_s * 1000), price] for time_s, price in costs],
             "lineStyle": {"width": 1.5, "type": "dashed"}},
        ],
    }  # fmt: skip
