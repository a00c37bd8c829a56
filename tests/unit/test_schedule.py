"""Schedule: working hours as people write them, against the site's time."""

from __future__ import annotations

import math
import zoneinfo
from datetime import UTC, datetime
from zoneinfo import ZoneInfo

import pytest

from rodeo.lab.schedule import Schedule, parse_hours, require_apart, zone

BERLIN = ZoneInfo("Europe/Berlin")


def utc(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


def berlin(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=BERLIN).timestamp()


@pytest.mark.parametrize(
    ("text", "hours"),
    [
        ("08:00-18:00", (480, 1080)),
        ("8:05 - 9:10", (485, 550)),
        ("00:00-24:00", (0, 1440)),
        ("22:00-06:00", (1320, 1800)),
        ("22:00-00:00", (1320, 1440)),
        ("22:00-24:00", (1320, 1440)),
    ],
)
def test_hours_are_read_as_people_write_them(text: str, hours: tuple[int, int]) -> None:
    assert parse_hours(text) == hours


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("8-18", 'write hours like "08:00-18:00"'),
        ("from 8 to 18", 'write hours like "08:00-18:00"'),
        ("08:00-18:00 UTC", 'write hours like "08:00-18:00"'),
        ("", 'write hours like "08:00-18:00"'),
        ("08:60-18:00", "is not a range of times"),
        ("08:00-24:01", "is not a range of times"),
        ("24:00-08:00", "is not a range of times"),
        ("08:00-08:00", "ends when it begins"),
    ],
)
def test_what_are_no_hours_is_refused_with_what_is_meant(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        parse_hours(text)


@pytest.mark.parametrize(
    "hours",
    [
        ("08:00-12:00", "11:59-18:00"),
        ("22:00-06:00", "05:00-07:00"),
        ("05:00-07:00", "22:00-06:00"),
        ("08:00-12:00", "08:00-12:00"),
        ("00:00-24:00", "03:00-04:00"),
    ],
)
def test_hours_that_overlap_are_refused(hours: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="overlap"):
        require_apart(hours)


def test_hours_that_touch_are_apart() -> None:
    require_apart(("08:00-12:00", "12:00-18:00", "22:00-08:00"))


def test_an_unknown_time_zone_is_refused_with_the_one_that_is_meant() -> None:
    with pytest.raises(ValueError, match='"Europe/Berlin" meant'):
        zone("Europe/Berlim")


@pytest.mark.parametrize("name", ["", "Europe", "../etc/passwd", "/etc/localtime", "a\0b"])
def test_what_names_no_time_zone_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="no time zone"):
        zone(name)


def test_a_machine_without_time_zones_knows_utc_and_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    zoneinfo.reset_tzpath(to=())
    ZoneInfo.clear_cache()
    try:
        assert zone("UTC") is UTC
        with pytest.raises(ValueError, match="pip install tzdata"):
            zone("Europe/Berlin")
    finally:
        zoneinfo.reset_tzpath()


def test_a_robot_without_hours_works_always_and_nothing_is_ever_due() -> None:
    always = Schedule(None)
    assert always.is_open(utc("2026-11-22T03:00"))
    assert always.next_change_s(utc("2026-11-22T03:00")) == math.inf


@pytest.mark.parametrize(
    ("now", "is_open", "change"),
    [
        ("2026-11-22T07:59:59", False, "2026-11-22T08:00"),
        ("2026-11-22T08:00", True, "2026-11-22T18:00"),
        ("2026-11-22T17:59:59", True, "2026-11-22T18:00"),
        ("2026-11-22T18:00", False, "2026-11-23T08:00"),
        ("2026-12-31T23:00", False, "2027-01-01T08:00"),
    ],
)
def test_the_day_is_parted_by_begin_and_end(now: str, is_open: bool, change: str) -> None:
    day = Schedule(["08:00-18:00"])
    assert (day.is_open(utc(now)), day.next_change_s(utc(now))) == (is_open, utc(change))


@pytest.mark.parametrize(
    ("now", "is_open", "change"),
    [
        ("2026-11-22T21:00", False, "2026-11-22T22:00"),
        ("2026-11-22T23:00", True, "2026-11-23T06:00"),
        ("2026-11-23T00:00", True, "2026-11-23T06:00"),
        ("2026-11-23T05:59", True, "2026-11-23T06:00"),
        ("2026-11-23T06:00", False, "2026-11-23T22:00"),
    ],
)
def test_a_night_shift_goes_over_midnight(now: str, is_open: bool, change: str) -> None:
    night = Schedule(["22:00-06:00"])
    assert (night.is_open(utc(now)), night.next_change_s(utc(now))) == (is_open, utc(change))


def test_hours_that_touch_are_one_stretch() -> None:
    day = Schedule(["22:00-24:00", "00:00-06:00", "12:00-13:00"])
    assert day.next_change_s(utc("2026-11-22T23:00")) == utc("2026-11-23T06:00")
    assert day.next_change_s(utc("2026-11-23T06:00")) == utc("2026-11-23T12:00")


def test_the_whole_day_never_changes() -> None:
    assert Schedule(["00:00-24:00"]).next_change_s(utc("2026-11-22T12:00")) == math.inf
    assert Schedule(["12:00-00:00", "00:00-12:00"]).next_change_s(utc("2026-11-22T12:00")) == math.inf


def test_hours_are_those_of_their_time_zone_in_summer_and_winter() -> None:
    day = Schedule(["08:00-18:00"], "Europe/Berlin")
    assert day.next_change_s(utc("2026-01-15T00:00")) == utc("2026-01-15T07:00")
    assert day.next_change_s(utc("2026-07-15T00:00")) == utc("2026-07-15T06:00")
    assert day.time_of_day(utc("2026-07-15T06:00")) == "08:00"


def test_over_a_change_to_summer_time_the_night_is_an_hour_shorter() -> None:
    night = Schedule(["22:00-06:00"], "Europe/Berlin")
    begin_s = berlin("2026-03-28T22:00")
    assert night.next_change_s(begin_s) - begin_s == 7 * 3600
    begin_s = berlin("2026-10-24T22:00")
    assert night.next_change_s(begin_s) - begin_s == 9 * 3600


def test_what_begins_in_an_hour_that_is_left_out_begins_an_hour_later() -> None:
    early = Schedule(["02:30-05:00"], "Europe/Berlin")
    assert early.next_change_s(berlin("2026-03-29T00:00")) == berlin("2026-03-29T03:30")


def test_each_minute_of_a_week_agrees_with_the_next_change() -> None:
    """What waits for `next_change_s` misses nothing: between two changes nothing changes."""
    schedule = Schedule(["06:00-09:30", "21:15-02:00"], "America/New_York")
    at_s, end_s = utc("2026-03-06T00:00"), utc("2026-03-10T00:00")  # clocks change on the 8th
    while at_s < end_s:
        change_s = schedule.next_change_s(at_s)
        steps = [at_s + 60 * n for n in range(math.ceil((change_s - at_s) / 60))]
        assert {schedule.is_open(one) for one in steps} == {schedule.is_open(at_s)}
        assert schedule.is_open(change_s) != schedule.is_open(at_s)
        at_s = change_s
