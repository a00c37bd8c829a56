"""The bridge puts services into line again that stood back, fetches bonds that were locked, and gives its
participants' services what the contracts overlooked."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.messages import PATIENCE_S
from rodeo.judging.rulings import GRACE_S
from services.bridge.offers import Match, Update, due_matches, due_updates

HERE = {"0x01": "alice"}


class FakeServices:
    """What the index says of alice's two services, and of one of somebody else."""

    def __init__(self, *, engaged: bool = False, locked: bool = False, **provider: Any) -> None:
        known = {"earned": False, "vouched": False, "rests_until": None, "bond_locked_until": None}
        self._engaged, self._locked, self._provider = engaged, locked, known | provider

    def providers(self) -> dict[str, Any]:
        return {"0x01": self._provider, "0x02": self._provider}

    def engaged(self) -> set[str]:
        return {"0x01"} if self._engaged else set()

    def idle(self) -> list[dict[str, Any]]:
        waits = self._service(6) | {"place": 1}
        return [waits, self._service(1), self._service(2), self._service(3, "0x02")]

    def locked_bonds(self) -> list[dict[str, Any]]:
        return [self._service(4), self._service(5, "0x02")] if self._locked else []

    def _service(self, number: int, provider: str = "0x01") -> dict[str, Any]:
        return {"id": number, "provider": provider, "kind": "waste_disposal", "place": 0}


def due(now_s: float, able: bool = True, **said: Any) -> tuple[list[Update], float | None]:
    index: Any = SimpleNamespace(services=FakeServices(**said))
    return due_updates(index, HERE, lambda _name, _kind: able, now_s)


def test_a_newcomer_offers_one_service_after_its_rest() -> None:
    assert due(1_000.0, rests_until=1_000) == ([], 1_000)
    assert due(1_001.0, rests_until=1_000) == ([Update("alice", 1, "active")], None)


def test_a_newcomer_that_works_or_waits_offers_nothing_else() -> None:
    assert due(1_001.0, engaged=True) == ([], None)


def test_a_proven_provider_offers_all_of_its_services() -> None:
    both = [Update("alice", 1, "active"), Update("alice", 2, "active")]
    assert due(1_000.0, engaged=True, earned=True) == (both, None)


def test_what_a_participant_cannot_do_is_not_offered() -> None:
    assert due(1_000.0, able=False) == ([], None)


def test_a_locked_bond_is_fetched_when_it_is_free() -> None:
    assert due(500.0, engaged=True, locked=True, bond_locked_until=500) == ([], 500)
    found, next_s = due(501.0, engaged=True, locked=True, bond_locked_until=500)
    assert (found, next_s) == ([Update("alice", 4, "retired")], None)
    assert found[0].command == "update_service" and found[0].data == {"service_id": 4, "state": "retired"}


OTHERS = [{"provider": f"0x1{number}", "gave_up": False} for number in range(4)]


class Market:
    """A task for 40 that waits since 1,000, and alice's service at 30, unless a test says otherwise.
    Tasks that name somebody wait, too, and another's service."""

    def __init__(self, *, passed: int = 0, earned: bool = False, tasks: int = 1, **service: Any) -> None:
        self._passed, self._earned, self._tasks, self._service = passed, earned, tasks, service

    def in_state(self, state: str) -> list[dict[str, Any]]:
        assert state == "open"
        common = {"number": 1, "reward": 40, "opened": 1_000.0, "passed": OTHERS[: self._passed]}
        common |= {"requested_service_id": None, "requested_provider": None}
        naming = [
            common | {"id": 98, "requested_service_id": 7},
            common | {"id": 99, "requested_provider": "0x01"},
        ]
        return naming + [common | {"id": number} for number in range(1, self._tasks + 1)]

    def idle(self) -> list[dict[str, Any]]:
        mine = {"id": 7, "provider": "0x01", "kind": "waste_disposal", "number": 1, "price": 30, "place": 1}
        strangers = [
            mine | {"id": 100 + place, "provider": "0x02", "place": place} for place in range(1, 100)
        ]
        line = strangers if self._service.get("place", 0) > 100 else [mine | {"id": 6, "provider": "0x02"}]
        return [mine | {"id": 5, "place": 0}, *line, mine | self._service]

    def providers(self) -> dict[str, Any]:
        return {name: {"earned": self._earned, "vouched": False} for name in ("0x01", "0x02", "0x10")}


def matches(now_s: float, able: bool = True, **said: Any) -> tuple[list[Match], float | None]:
    market: Any = Market(**said)
    index: Any = SimpleNamespace(tasks=market, services=market)
    return due_matches(index, HERE | {"0x10": "bob"}, lambda _name, _kind: able, now_s)


def test_a_service_that_waits_is_given_what_the_contracts_overlooked() -> None:
    first_s = 1_000 + GRACE_S
    assert matches(first_s) == ([], first_s)
    found, next_s = matches(first_s + 1, tasks=2)
    assert (found, next_s) == ([Match("alice", 1, 7)], None)
    assert found[0].command == "match_task" and found[0].data == {"task_id": 1, "service_id": 7}


def test_who_is_not_proven_takes_after_an_hour_what_no_proven_provider_took() -> None:
    """The contract says how long that is."""
    source = Path(__file__).parents[4] / "contracts/src/TaskManager.sol"
    assert " constant PATIENCE = 1 hours;" in source.read_text() and PATIENCE_S == 3600
    first_s = 1_000 + PATIENCE_S
    assert matches(first_s, passed=4) == ([], first_s)
    assert matches(first_s + 1, passed=4) == ([Match("alice", 1, 7)], None)
    assert matches(1_001 + GRACE_S, passed=4, earned=True) == ([Match("alice", 1, 7)], None)


def test_services_of_several_bridges_have_their_turns_in_line() -> None:
    second_s = 1_000 + 2 * GRACE_S
    assert matches(second_s, place=2) == ([], second_s)
    assert matches(second_s + 1, place=2) == ([Match("alice", 1, 7)], None)


def test_many_services_of_a_stranger_hold_up_nobody_for_long() -> None:
    assert matches(1_000 + 9 * GRACE_S + 1, place=101) == ([Match("alice", 1, 7)], None)


@pytest.mark.parametrize(
    "unfit",
    [{"price": 41}, {"number": 2}, {"provider": "0x02"}, {"place": 0}, {"provider": "0x10", "passed": 1}],
)
def test_what_does_not_fit_is_not_sent(unfit: dict[str, Any]) -> None:
    """A service that is too dear, of another judge, somebody else's, in no line, or had the task before."""
    assert matches(100_000, **unfit) == ([], None)
    assert matches(100_000, able=False) == ([], None)
