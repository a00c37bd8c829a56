"""A robot's own tasks count against its daily cap until they are refunded."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from rodeo.bus import queries
from rodeo.bus.messages import Mined, Task
from rodeo.commands import Command
from rodeo.commands.services import Agree, SetPayout
from rodeo.commands.tasks import RegisterTask
from rodeo.robot.errors import CapReached
from rodeo_testing import answers
from services.robot_agent.participant import RobotParticipant
from tests.support.tasks import task

NOW_S = 1_000_000.0
CAP_IEC = Decimal(500)
CHARGE = RegisterTask(kind="battery_charging", reward_iec=Decimal(200))


class Bridge(RobotParticipant):
    """The account of a robot whose own tasks are `posted`."""

    def __init__(self, posted: list[Task]) -> None:
        self.name = "panther1"
        self.posted = posted
        self.sent: list[Command] = []

    def tasks(self, **filters: Any) -> list[Task]:
        assert filters["creator"] == "panther1"
        return self.posted

    def command(self, name: str, request: Command) -> Mined:
        self.sent.append(request)
        return Mined(tx_hash="0x", block=1, task_id=7)


ROBOT, SAFE, OTHER = (f"0x{number:040}" for number in (1, 2, 3))


class Paid(Bridge):
    """The account of a robot that has named `payout` before."""

    def __init__(self, payout: str | None) -> None:
        super().__init__([])
        self.payout = payout

    def ask(self, query: queries.Query[queries.A], **parameters: Any) -> queries.A:
        assert parameters == {"account": "panther1"}
        known = {"name": "panther1", "address": ROBOT, "payout": self.payout}
        return query.answer.model_validate(known | {"balance_iec": "0", "in_escrow_iec": "0"})


@pytest.mark.parametrize(
    ("before", "wanted", "after", "sends"),
    [
        (None, SAFE, SAFE, True),
        (SAFE, SAFE, SAFE, False),
        (OTHER, SAFE, OTHER, False),
        (None, ROBOT, ROBOT, False),
    ],
)
def test_a_robot_says_once_who_is_paid(before: str | None, wanted: str, after: str, sends: bool) -> None:
    account = Paid(before)
    assert account.name_payout(wanted) == after
    assert account.sent == ([SetPayout(payout=wanted)] if sends else [])


def own(state: str, reward_iec: int, age_s: float, refunded_iec: int = 0) -> Task:
    changes = {
        "reward_iec": Decimal(reward_iec),
        "refunded_iec": Decimal(refunded_iec),
        "registered": NOW_S - age_s,
        "creator_name": "panther1",
    }
    return task(state).model_copy(update=changes)


def test_a_robot_buys_up_to_its_cap() -> None:
    account = Bridge([own("settled", 300, age_s=3600)])
    assert account.post(CHARGE, NOW_S, CAP_IEC) == 7


def test_a_purchase_above_the_cap_is_refused_with_what_was_spent() -> None:
    account = Bridge([own("settled", 200, age_s=7200), own("assigned", 200, age_s=3600)])
    with pytest.raises(CapReached) as caught:
        account.post(CHARGE, NOW_S, CAP_IEC)
    assert caught.value.details == {"spent_iec": "400"}
    assert account.sent == []


@pytest.mark.parametrize(
    "harmless",
    [
        own("failed", 400, 60, refunded_iec=400),
        own("cancelled", 400, 60, refunded_iec=400),
        own("settled", 400, 60, refunded_iec=150),
        own("settled", 400, 25 * 3600),
    ],
)
def test_what_came_back_and_what_is_a_day_old_does_not_count(harmless: Task) -> None:
    assert Bridge([harmless]).post(CHARGE, NOW_S, CAP_IEC) == 7


@pytest.mark.parametrize(("state", "live"), [("submitted", True), ("ruled", False), ("settled", False)])
def test_a_charge_whose_ruling_stands_for_days_does_not_keep_from_the_next(state: str, live: bool) -> None:
    found = Bridge([own(state, 200, 60)]).own_live_task("battery_charging")
    assert (found is not None) == live


class Offering(Bridge):
    """Offers one service, which has not agreed to the judge that its kind has now."""

    def __init__(self, task_id: int | None = None) -> None:
        super().__init__([])
        zero = dict.fromkeys(("bond_iec", "penalty_iec", "completed", "rejected", "expired"), 0)
        zero |= dict.fromkeys(("max_failures", "failures", "place", "reputation"), 0)
        who = {"id": 3, "kind": "waste_disposal", "provider": ROBOT, "provider_name": "panther1"}
        offer = {"price_iec": "10", "state": "active", "description": "", "auto_accept": True}
        self.service: dict[str, Any] = {**zero, **who, **offer, "agrees": False, "task_id": task_id}

    def ask(self, query: queries.Query[queries.A], **_parameters: Any) -> queries.A:
        services = {"services": [self.service], "total": 1}
        known = {"services": services, "organization": answers.organization(measured=["waste_disposal"])}
        return answers.answered(query, known)


@pytest.mark.parametrize(
    ("judge", "task_id", "agrees"),
    [("oracle", None, True), ("auditor", None, False), (None, None, False), ("oracle", 7, False)],
)
def test_a_service_agrees_only_to_whom_its_provider_expects_to_judge(
    judge: str | None, task_id: int | None, agrees: bool
) -> None:
    account = Offering(task_id)
    account.offer_service("waste_disposal", Decimal(10), "cleaning", judge=judge)
    assert account.sent == ([Agree(service_id=account.service["id"])] if agrees else [])
