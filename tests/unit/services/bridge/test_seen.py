"""What robots see on the floor is proposed once, whatever they say, and kept with what people said."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.bus.queries import SeenThing
from rodeo.bus.session import Request
from rodeo.errors import InvalidRequest
from rodeo.kinds import kinds_of
from rodeo.site.config import Site
from services.bridge import seen
from services.bridge.reading import Page
from services.bridge.seen import (
    DAY_S,
    MAX_OPEN,
    NotARobot,
    NotForPeople,
    SeenThings,
    TooManySeen,
    UnknownSeen,
)
from tests.support.site import LAB

KIND = "waste_disposal"
PHOTO = "4c" * 32 + ".jpg"


class Clock:
    """The site's time, as the test sets it."""

    now = 1_000_000.0

    def now_s(self) -> float:
        return self.now

    def now_ns(self) -> int:
        return int(self.now * 1e9)


class Tasks:
    """The index's tasks, as the keeper reads them."""

    def __init__(self) -> None:
        self.rows: dict[int, dict[str, Any]] = {}

    def get(self, task_id: int, /) -> Mapping[str, Any] | None:
        return self.rows.get(task_id)

    def find(
        self, filters: Mapping[str, Any], page: Page, /, *, states: tuple[str, ...]
    ) -> tuple[list[Mapping[str, Any]], int]:
        found = [row for row in self.rows.values() if row["state"] in states]
        return found[page.offset : page.offset + page.limit], len(found)


class Lab:
    """A keeper with one robot's reports, its clock and its index."""

    def __init__(self, folder: Path) -> None:
        self.site = Site.load(LAB)
        self.folder, self.clock, self.tasks = folder, Clock(), Tasks()
        self.told: list[SeenThing] = []
        self.kinds = [one.name for one in self.site.kinds]
        self.start()

    def start(self, **kind: Any) -> None:
        """Begin again, as after a restart; `kind` are options of the kind of work."""
        listed = [one.model_copy(update=kind) if one.name == KIND else one for one in self.site.kinds]
        self.site = self.site.model_copy(update={"kinds": listed})
        args = self.folder, self.site, kinds_of(self.site), self.tasks, self.clock
        self.keeper = SeenThings(*args, self.told.append)

    def report(self, x_m: float = 2.0, y_m: float = 2.0, robot: str = "panther1", **other: Any) -> SeenThing:
        sighting = {"kind": KIND, "x_m": x_m, "y_m": y_m, "size_m": [0.12, 0.07, 0.07], "photo": PHOTO}
        return self.keeper.act(robot, "report", sighting | other)

    def say(self, thing: SeenThing, what: str, who: str = "olivia") -> SeenThing:
        return self.keeper.act(who, "say", {"id": thing.id, "what": what})

    def gone(self, thing: SeenThing, robot: str = "panther1") -> SeenThing:
        return self.keeper.act(robot, "gone", {"id": thing.id})

    def things(self, state: str = "open,posted") -> list[int]:
        answer = self.keeper.answer(Request("", {"state": state}, b""))
        return [one["id"] for one in answer["things"]]

    def task(self, number: int, state: str, verdict: str | None = None, x_m: float = 2.1) -> None:
        """The index has this task now, and the bridge says so."""
        params = {"x_m": x_m, "y_m": 2.0}
        row = {"id": number, "kind": KIND, "state": state, "verdict": verdict, "params": params}
        self.tasks.rows[number] = row
        self.event(number)

    def event(self, number: int, name: str = "TaskRegistered") -> None:
        where = {"block": 1, "log_index": 0, "tx_hash": "0x", "time_s": 0.0}
        self.keeper.heard(DaoEvent(seq=1, name=name, task_id=number, args={}, **where))


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path / "seen")


def test_a_thing_that_is_seen_again_is_the_same_one(lab: Lab) -> None:
    first = lab.report()
    lab.clock.now += 100.0
    again = lab.report(x_m=2.2, size_m=[0.2, 0.1, 0.1])
    assert (again.id, again.x_m) == (first.id, 2.0)
    assert again.last_s == first.first_s + 100.0
    assert lab.report(x_m=2.3).id != first.id


def test_many_small_steps_do_not_drag_a_thing_along(lab: Lab) -> None:
    assert [lab.report(x_m=2.0 + 0.1 * step).id for step in range(5)] == [1, 1, 1, 2, 2]


def test_what_is_kept_outlives_the_process(lab: Lab) -> None:
    thing = lab.say(lab.report(), "metal")
    lab.start()
    assert lab.report().id == thing.id
    assert lab.things() == [thing.id]
    assert lab.say(thing, "dismissed").said[0].what == "dismissed"


def test_a_damaged_file_costs_one_thing(lab: Lab) -> None:
    lab.report(), lab.report(x_m=3.0)
    (lab.folder / "1.json").write_text('{"id": 1')
    lab.start()
    assert lab.things() == [2]


def test_what_was_dismissed_is_not_proposed_again(lab: Lab) -> None:
    thing = lab.say(lab.report(), "dismissed")
    assert lab.gone(thing).state == "dismissed"
    assert lab.report().id == thing.id
    assert lab.things() == []


def test_another_thing_where_one_was_dismissed_is_proposed(lab: Lab) -> None:
    thing = lab.say(lab.report(), "dismissed")
    assert lab.report(size_m=[0.3, 0.3, 0.2]).id != thing.id
    assert lab.things("dismissed") == []


def test_a_dismissal_is_forgotten_a_day_after_the_thing_was_seen_last(lab: Lab) -> None:
    thing = lab.say(lab.report(), "dismissed")
    lab.clock.now += DAY_S + 1
    assert lab.report().id != thing.id


def test_a_person_takes_a_dismissal_back(lab: Lab) -> None:
    thing = lab.say(lab.report(), "dismissed")
    assert lab.say(thing, "plastic").state == "open"
    assert [one.what for one in lab.say(thing, "paper", who="anna").said] == ["plastic", "paper"]


def test_any_robot_withdraws_what_is_gone(lab: Lab) -> None:
    thing = lab.report()
    assert lab.gone(thing).state == "gone"
    assert lab.things() == []
    assert lab.report().id != thing.id
    with pytest.raises(NotForPeople):
        lab.say(thing, "metal")


@pytest.mark.parametrize(("who", "act"), [("olivia", "report"), ("olivia", "gone"), ("panther1", "say")])
def test_nobody_speaks_out_of_turn(lab: Lab, who: str, act: str) -> None:
    with pytest.raises(NotARobot) as refused:
        lab.keeper.act(who, act, {})
    assert refused.value.details["who"] == who


def test_a_thing_that_there_is_not_is_named(lab: Lab) -> None:
    with pytest.raises(UnknownSeen) as refused:
        lab.keeper.act("panther1", "gone", {"id": 7})
    assert refused.value.details["id"] == 7


@pytest.mark.parametrize(
    "wrong",
    [
        {"x_m": -1.0},
        {"x_m": float("nan")},
        {"size_m": [0.1, 0.1]},
        {"size_m": [0.1, 0.1, 5.0]},
        {"photo": "../../etc/passwd"},
        {"kind": "battery_charging"},
        {"kind": "unheard_of"},
    ],
)
def test_what_no_task_could_be_about_is_refused(lab: Lab, wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest):
        lab.report(**wrong)
    assert lab.things() == []


def test_nothing_lies_inside_of_furniture(lab: Lab) -> None:
    bin_pose = lab.site.bins[0].pose
    with pytest.raises(InvalidRequest):
        lab.report(bin_pose.x_m, bin_pose.y_m)


def test_a_flood_ends_at_the_limit(lab: Lab) -> None:
    for number in range(MAX_OPEN):
        lab.report(x_m=1.0 + 0.3 * (number % 4), y_m=1.0 + 0.3 * (number // 4))
    with pytest.raises(TooManySeen) as refused:
        lab.report(x_m=3.0, y_m=1.0)
    assert refused.value.details["open"] == MAX_OPEN


def test_who_proposes_and_withdraws_all_day_comes_to_an_end(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(seen, "MAX_A_DAY", 5)
    for _ in range(5):
        lab.gone(lab.report())
    with pytest.raises(TooManySeen):
        lab.report()
    lab.clock.now += 2 * DAY_S
    assert lab.report().id == 6
    assert len(list(lab.folder.iterdir())) == 2  # and the last before it, whose number is the highest


def test_a_thing_ends_with_its_task(lab: Lab) -> None:
    thing = lab.report()
    lab.task(7, "open")
    assert (lab.told[-1].state, lab.told[-1].task_id) == ("posted", 7)
    assert lab.gone(thing).state == "posted"
    with pytest.raises(NotForPeople):
        lab.say(thing, "dismissed")
    lab.task(7, "settled", "accepted")
    assert lab.told[-1].state == "gone"


def test_a_task_elsewhere_is_about_something_else(lab: Lab) -> None:
    lab.report()
    lab.task(7, "open", x_m=2.3)
    assert lab.told[-1].state == "open"


def test_what_a_task_is_about_already_is_not_proposed(lab: Lab) -> None:
    lab.task(7, "assigned")
    assert (lab.report().state, lab.told[-1].task_id) == ("posted", 7)


def test_a_task_that_a_reorganization_took_leaves_the_thing_open(lab: Lab) -> None:
    lab.report()
    lab.task(7, "open")
    lab.tasks.rows.clear()
    lab.event(7)  # an index that is made anew lacks it for a while
    assert lab.told[-1].state == "posted"
    lab.event(7, "EventUndone")
    assert (lab.told[-1].state, lab.told[-1].task_id) == ("open", None)


def test_people_post_unless_the_site_says_otherwise(lab: Lab) -> None:
    assert lab.keeper.posting(lab.report()) is None


def test_the_site_posts_each_thing_once(lab: Lab) -> None:
    lab.start(post_seen_as="finder")
    name, command = lab.keeper.posting(lab.report()) or pytest.fail("nothing is posted")
    assert (name, command.params) == ("finder", {"x_m": 2.0, "y_m": 2.0, "photo": PHOTO})
    assert command.reward_iec > 0
    # The bridge takes the same request once, also after a restart.
    lab.start()
    assert lab.keeper.posting(lab.report()) == (name, command)


def test_what_people_spoke_of_is_theirs(lab: Lab) -> None:
    lab.start(post_seen_as="finder")
    assert lab.keeper.posting(lab.say(lab.report(), "confirmed")) is None


def test_what_one_task_left_there_is_left_to_people(lab: Lab) -> None:
    lab.start(post_seen_as="finder")
    lab.report()
    lab.task(7, "open")
    lab.task(7, "failed", "rejected")
    again = lab.report()
    assert again.state == "open" and lab.keeper.posting(again) is None
    lab.task(7, "settled", "accepted")
    assert lab.keeper.posting(again) is not None
