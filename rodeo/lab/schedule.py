"""When a robot works: hours of the day in a time zone, against the site's time.

Hours are written like "08:00-18:00". "22:00-06:00" ends on the next day, and "24:00" is the end of a day.
Site time is Unix time (`rodeo.host.clock`), so the hours are those of the wall clock in the zone, summer time
included: what begins in an hour that the clocks leave out begins an hour later.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from rodeo.text.site_problems import close

Hours = tuple[int, int]
"""Minutes after midnight at which work begins (0 to 1439) and ends, the end 1 to 1440 minutes later."""

_DAY_MIN = 24 * 60
_WRITTEN = re.compile(r"(\d{1,2}):(\d{2})\s*-\s*(\d{1,2}):(\d{2})")


def parse_hours(text: str) -> Hours:
    """What "08:00-18:00" says. Raises ValueError with a sentence."""
    match = _WRITTEN.fullmatch(text.strip())
    if match is None:
        raise ValueError(f'write hours like "08:00-18:00", not {text!r}')
    begin_h, begin_min, end_h, end_min = map(int, match.groups())
    begin, end = 60 * begin_h + begin_min, 60 * end_h + end_min
    if begin_min > 59 or end_min > 59 or begin >= _DAY_MIN or end > _DAY_MIN:
        raise ValueError(f"{text!r} is not a range of times between 00:00 and 24:00")
    if begin == end:
        raise ValueError(f'{text!r} ends when it begins; "00:00-24:00" is the whole day')
    return begin, end if end > begin else end + _DAY_MIN


def require_apart(hours: Sequence[str]) -> None:
    """Raises ValueError when two of the hours overlap."""
    stretches = [(*parse_hours(text), text) for text in hours]
    for number, (begin, end, text) in enumerate(stretches):
        for other_begin, other_end, other in stretches[:number]:
            if any(begin + day < other_end and other_begin < end + day for day in (-_DAY_MIN, 0, _DAY_MIN)):
                raise ValueError(f'"{other}" and "{text}" overlap')


def zone(name: str) -> tzinfo:
    """The time zone of that name in the IANA database. Raises ValueError with a sentence."""
    if name == "UTC":
        return UTC  # needs no database
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        known = available_timezones()
    if not known:
        raise ValueError(f"this machine has no time zone database to look up {name!r}: pip install tzdata")
    raise ValueError(
        f'there is no time zone {name!r}; they are named like "Europe/Berlin"{close(name, known)}'
    )


class Schedule:
    """Args:
    hours: as the site file has them; None for always.
    timezone: in which they are meant.

    Raises ValueError.
    """

    def __init__(self, hours: Sequence[str] | None, timezone: str = "UTC") -> None:
        self._hours = None if hours is None else [parse_hours(text) for text in hours]
        self._zone = zone(timezone)

    def is_open(self, now_s: float) -> bool:
        """Whether `now_s` of site time is within the hours. They include their begin, not their end."""
        return self._hours is None or any(begin <= now_s < end for begin, end in self._around(now_s))

    def next_change_s(self, now_s: float) -> float:
        """The first site time after `now_s` at which the hours begin or end; infinite where that is never."""
        is_open = self.is_open(now_s)
        times = sorted({time_s for stretch in self._around(now_s) for time_s in stretch if time_s > now_s})
        return next((time_s for time_s in times if self.is_open(time_s) != is_open), math.inf)

    def time_of_day(self, time_s: float) -> str:
        """08:00, in the schedule's time zone."""
        return f"{datetime.fromtimestamp(time_s, self._zone):%H:%M}"

    def _around(self, now_s: float) -> Iterator[tuple[float, float]]:
        """Site times at which the hours of yesterday, today and the next two days begin and end."""
        today = datetime.fromtimestamp(now_s, self._zone).date()
        for day in range(-1, 3):
            for begin, end in self._hours or ():
                yield self._instant(today, day, begin), self._instant(today, day, end)

    def _instant(self, today: date, days: int, minutes: int) -> float:
        more, minutes = divmod(minutes, _DAY_MIN)
        at = datetime.combine(today + timedelta(days + more), time(minutes // 60, minutes % 60), self._zone)
        return at.timestamp()
