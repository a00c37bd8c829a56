"""What people post: an item at once, and a thing that nobody listed when nobody else has found it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, cast

from rodeo.bus.messages import Task
from rodeo.bus.queries import SeenThing
from rodeo.commands.tasks import CancelTask, RegisterTask
from rodeo.site.config import Site
from rodeo_cli.experiment import PAPER
from rodeo_experiments.arrivals import day_begins_s
from rodeo_experiments.people import Agenda, People, Plan
from rodeo_experiments.progress import Journal
from rodeo_experiments.site import Variation, write_site
from tests.support.tasks import task

PLACE = (2.0, 1.5)


class Clock:
    def __init__(self, now_s: float) -> None:
        self.s = now_s

    def now_s(self) -> float:
        return self.s


class Organization:
    def __init__(self) -> None:
        self.passed: list[dict[str, Any]] = []
        self.cancelled: list[int] = []

    def task(self, task_id: int) -> Task:
        return task("open", id=task_id, passed=self.passed)

    def command(self, name: str, request: CancelTask) -> None:
        assert name == "cancel_task"
        self.cancelled.append(request.task_id)


class Board:
    """Numbers tasks from 1; an equal request is the same task."""

    def __init__(self) -> None:
        self.posted: dict[str | None, RegisterTask] = {}
        self.found: list[SeenThing] = []

        self.organization = Organization()

    def kind_of(self, _task_id: int) -> str:
        return "waste_disposal"

    def seen(self) -> list[SeenThing]:
        return self.found

    def post(self, request: RegisterTask) -> int:
        self.posted.setdefault(request.request_id, request)
        return list(self.posted).index(request.request_id) + 1

    def tasks(self) -> list[Any]:
        return []


class Floor:
    def put_down(self, _item: str, _lying: Any) -> tuple[float, float]:
        return PLACE


class Day:
    """One day's people, with their journal in `folder`: a second one continues the first."""

    def __init__(self, folder: Path, unlisted: bool) -> None:
        path = folder / "site.toml"
        site = Site.load(path if path.exists() else write_site(PAPER, folder, Variation(unlisted=unlisted)))
        self.agenda, self.board, self.clock = Agenda(), Board(), Clock(day_begins_s(site, 0))
        self.journal = Journal(folder / "progress.json", site)
        fakes: Any = (self.board, Floor(), self.clock)
        self.people = People(Plan.of(site, []), self.journal, self.agenda, *fakes)

    def pass_to(self, time_s: float) -> None:
        while self.agenda.is_due(time_s):
            self.clock.s = self.agenda.next_s(math.inf)
            self.agenda.act()
        self.clock.s = time_s


def params(board: Board) -> list[dict[str, Any]]:
    return [cast("dict[str, Any]", one.params) for one in board.posted.values()]


def test_an_item_is_posted_at_once_where_it_is(tmp_path: Path) -> None:
    day = Day(tmp_path, unlisted=False)
    day.people.leave(0, day.clock.s)
    assert params(day.board) == [{"item_id": "item1", "x_m": 2.0, "y_m": 1.5}]


def test_a_person_posts_about_where_a_thing_lies_once_nobody_has_found_it_for_so_long(tmp_path: Path) -> None:
    day = Day(tmp_path, unlisted=True)
    left_s = day.clock.s
    day.people.leave(0, left_s)
    day.pass_to(left_s + 29 * 60)
    assert day.board.posted == {}
    day.pass_to(left_s + 31 * 60)
    (told,) = params(day.board)
    assert "item_id" not in told
    assert 0 < math.dist((told["x_m"], told["y_m"]), PLACE) < 0.25
    assert [one.task_id for one in day.journal.progress.arrivals] == [1]


def test_nobody_points_at_what_a_robot_has_found(tmp_path: Path) -> None:
    day = Day(tmp_path, unlisted=True)
    left_s = day.clock.s
    day.people.leave(0, left_s)
    elsewhere, here = (
        SeenThing(
            id=number,
            kind="waste_disposal",
            x_m=PLACE[0] + away_m,
            y_m=PLACE[1],
            size_m=[0.1, 0.05, 0.05],
            photo="0" * 64 + ".jpg",
            robot="panther1",
            first_s=left_s,
            last_s=left_s,
            state="posted",
            task_id=number,
        )
        for number, away_m in ((7, 0.6), (8, 0.03))
    )
    day.board.found += [elsewhere, here]
    day.pass_to(left_s + 31 * 60)
    assert day.board.posted == {}
    (arrival,) = day.journal.progress.arrivals
    assert (arrival.task_id, arrival.found_by) == (8, "panther1")


def test_a_person_takes_back_what_every_robot_has_given_up(tmp_path: Path) -> None:
    day = Day(tmp_path, unlisted=True)
    organization = day.board.organization
    for gave_up, cancelled in ((False, []), (True, [3])):
        organization.passed = [{"provider": "0x1", "gave_up": gave_up}]
        day.people.look("TaskRequeued", 3)
        assert organization.cancelled == cancelled


def test_a_run_that_continues_points_to_the_same_place_once(tmp_path: Path) -> None:
    first = Day(tmp_path, unlisted=True)
    left_s = first.clock.s
    first.people.leave(0, left_s)
    again = Day(tmp_path, unlisted=True)
    again.people.catch_up()
    for day in (first, again):
        day.pass_to(left_s + 31 * 60)
    assert params(first.board) == params(again.board)
    (after,) = Day(tmp_path, unlisted=True).journal.progress.arrivals
    assert after.task_id == 1
