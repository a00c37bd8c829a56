"""What electricity costs, by the site file's tariffs and the site's time."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal

from rodeo.config import TariffConfig

_HOUR_S = 3600
_DAY_S = 24 * _HOUR_S


def price_at(tariffs: Iterable[TariffConfig], time_s: float) -> Decimal:
    """EUR/kWh at this site time."""
    ordered = sorted(tariffs, key=lambda tariff: tariff.from_hour)
    hour = int(time_s % _DAY_S // _HOUR_S)
    begun = [tariff for tariff in ordered if tariff.from_hour <= hour]
    return (begun or ordered)[-1].eur_kwh


def prices(tariffs: list[TariffConfig], first_s: float, last_s: float) -> list[tuple[float, float]]:
    """(site time, EUR/kWh) at both ends and at each change in between; at most 200 days of changes."""
    times = {first_s, last_s}
    start_s = first_s - first_s % _DAY_S
    for day in range(min(200, int((last_s - start_s) // _DAY_S) + 1)):
        times |= {start_s + day * _DAY_S + tariff.from_hour * _HOUR_S for tariff in tariffs}
    return [
        (time_s, float(price_at(tariffs, time_s))) for time_s in sorted(times) if first_s <= time_s <= last_s
    ]
