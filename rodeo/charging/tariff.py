"""Prices by the hour of the site's time: electricity, and a kind's rates."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from typing import TypeVar

from rodeo.site.sections import FromHour, RateConfig, TariffConfig

_HOUR_S = 3600
_DAY_S = 24 * _HOUR_S


_Entry = TypeVar("_Entry", bound=FromHour)


def applying(entries: Iterable[_Entry], time_s: float) -> _Entry:
    """The entry that applies at this site time; there is at least one."""
    ordered = sorted(entries, key=lambda entry: entry.from_hour)
    hour = int(time_s % _DAY_S // _HOUR_S)
    begun = [entry for entry in ordered if entry.from_hour <= hour]
    return (begun or ordered)[-1]


def applying_between(entries: Iterable[_Entry], first_s: float, last_s: float) -> list[_Entry]:
    """Every entry that applies at some time from `first_s` to `last_s`."""
    entries = list(entries)
    hours = {int(first_s // _HOUR_S) + number for number in range(min(24, _hours(first_s, last_s)))}
    found = [applying(entries, hour * _HOUR_S) for hour in sorted(hours)]
    return list({entry.from_hour: entry for entry in found}.values())


def _hours(first_s: float, last_s: float) -> int:
    """Hours that begin up to `last_s`, and the one in which `first_s` lies."""
    return int(last_s // _HOUR_S) - int(first_s // _HOUR_S) + 1


def hourly_mean_iec(rates: Iterable[RateConfig]) -> Decimal:
    """Mean of the rates of a day's 24 hours."""
    rates = list(rates)
    return sum((applying(rates, hour * _HOUR_S).iec for hour in range(24)), Decimal(0)) / 24


def price_at(tariffs: Iterable[TariffConfig], time_s: float) -> Decimal:
    """EUR/kWh at this site time."""
    return applying(tariffs, time_s).eur_kwh


def prices(tariffs: list[TariffConfig], first_s: float, last_s: float) -> list[tuple[float, float]]:
    """(site time, EUR/kWh) at both ends and at each change in between; at most 200 days of changes."""
    times = {first_s, last_s}
    start_s = first_s - first_s % _DAY_S
    for day in range(min(200, int((last_s - start_s) // _DAY_S) + 1)):
        times |= {start_s + day * _DAY_S + tariff.from_hour * _HOUR_S for tariff in tariffs}
    return [
        (time_s, float(price_at(tariffs, time_s))) for time_s in sorted(times) if first_s <= time_s <= last_s
    ]
