"""What the overview says waits for a person, and where robots are."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.access.accounts import User
from rodeo.access.roles import Role
from services.console import scene
from services.console.attention import Seen, needs, place, robots
from services.console.glance import Summary
from services.console.heartbeats import ProcessState
from tests.support.site import RunningSite, write_site

READY = ProcessState("robot_agent", "the robot's mind", "ready", "driving", soc=0.5, task_id=7)
ADA = User("ada", frozenset({Role.AUDITOR}), "alice")


def task(**more: Any) -> Any:
    usual = {"id": 7, "kind": "waste_disposal", "state": "submitted", "judge": "oracle", "passed_on": False}
    rest = {"judge_removed": False, "dispute": None, "standing": None, "verdict_deadline": 9.0}
    return SimpleNamespace(**usual | rest | more)


def proposal(state: str, voters: list[str]) -> Any:
    ballots = [SimpleNamespace(voter_name=one) for one in voters]
    return SimpleNamespace(number=3, description="a bond", state=state, vote_end_s=8.0, ballots=ballots)


def money(name: str, balance_iec: int, offered: str) -> Any:
    """A wallet, and a service of this kind for 5 IEC."""
    offer = SimpleNamespace(kind=offered, price_iec=Decimal(5), state="active")
    return {"wallets": [SimpleNamespace(name=name, balance_iec=Decimal(balance_iec))], "services": [offer]}


def bench(stake_iec: int) -> Any:
    judge = SimpleNamespace(name="emil", seat=0, stake_iec=Decimal(stake_iec))
    return SimpleNamespace(judges=[judge], committees=[], stake_needed=lambda _one: Decimal(10))


CHALLENGED = SimpleNamespace(challenger="0x1", settled=False, until=8.0)


@pytest.mark.parametrize(
    ("summary", "processes", "told", "href"),
    [
        ({}, [READY], None, ""),
        ({}, [ProcessState("robot_agent", "", "lost", "gone")], "panther1 is lost", "/operator"),
        ({}, [ProcessState("robot_agent", "", "silent")], "panther1 was never heard", "/operator"),
        ({}, [READY, ProcessState("oracle", "", "silent")], "Never heard: oracle", "#processes"),
        ({}, [READY, ProcessState("bridge", "", "ready", warnings=("gas",))], "warns: gas", "#processes"),
        ({"cases": [task()]}, [READY], None, ""),
        ({"cases": [task(passed_on=True)]}, [READY], "an auditor rules until 9", "/work"),
        ({"cases": [task(state="ruled", dispute=CHALLENGED)]}, [READY], "decide until 8", "/tasks/7"),
        ({"proposals": [proposal("active", ["bob"])]}, [READY], "members vote until 8", "/proposals"),
        ({"proposals": [proposal("active", ["alice"])]}, [READY], None, ""),
        ({"proposals": [proposal("executed", [])]}, [READY], None, ""),
        (money("panther1", 4, "charge"), [READY], "too little for a charge (5 IEC)", "/treasury"),
        (money("panther1", 5, "charge"), [READY], None, ""),
        (money("organization", 4, "cleaning"), [READY], "too little for a task (5 IEC)", "/treasury"),
        ({"organization": bench(9)}, [READY], "too low to judge: emil", "/services"),
        ({"organization": bench(10)}, [READY], None, ""),
    ],
)  # fmt: skip
def test_it_is_told_with_a_way_to_do_something_about_it(
    tmp_path: Path, summary: dict[str, Any], processes: list[ProcessState], told: str | None, href: str
) -> None:
    site = RunningSite(write_site(tmp_path), wallets=False).site
    seen = Seen(site, Summary(**summary), processes, ADA, "charge", lambda time_s: f"{time_s:g}")
    found = needs(seen)
    assert [one.href for one in found] == ([href] if told else [])
    assert all(str(told) in one.text for one in found)


def test_alarms_come_first(tmp_path: Path) -> None:
    site = RunningSite(write_site(tmp_path), wallets=False).site
    lost = ProcessState("bridge", "", "lost", "its heartbeat stopped")
    summary = Summary(cases=[task(passed_on=True)])
    found = needs(Seen(site, summary, [READY, lost], ADA, None, str))
    assert [one.alarm for one in found] == [True, False]


def test_a_robot_is_told_where_it_is_and_what_it_said_last(tmp_path: Path) -> None:
    site = RunningSite(write_site(tmp_path), wallets=False).site
    lab = scene.lab(site)
    dock = lab["docks"][0]
    (one,) = robots(site, lab, [READY], {"panther1": {"x": dock["x"] + 0.1, "y": dock["y"]}})
    assert (one.name, one.mind, one.soc) == ("panther1", READY, 0.5)
    assert one.place == f"near {dock['name']}"
    (unseen,) = robots(site, lab, [], {})
    assert (unseen.mind.state, unseen.place) == ("silent", "not seen")


def test_far_from_everything_a_place_is_its_coordinates() -> None:
    lab: Any = {"docks": [{"name": "dock1", "x": 0, "y": 0}], "bins": [], "places": [], "furniture": []}
    assert place(lab, 4.2, 2.6) == "4 m east, 3 m north"
