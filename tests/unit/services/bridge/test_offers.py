"""The bridge puts services into line again that stood back, and fetches bonds that were locked."""

from __future__ import annotations

from typing import Any

from services.bridge.offers import Update, due_updates

HERE = {"0x01": "alice"}


class FakeIndex:
    """What the index says of alice's two services, and of one of somebody else."""

    def __init__(self, *, engaged: bool = False, locked: bool = False, **provider: Any) -> None:
        known = {"earned": False, "vouched": False, "rests_until": None, "bond_locked_until": None}
        self._engaged, self._locked, self._provider = engaged, locked, known | provider

    def providers(self) -> dict[str, Any]:
        return {"0x01": self._provider, "0x02": self._provider}

    def engaged(self) -> set[str]:
        return {"0x01"} if self._engaged else set()

    def stood_back(self) -> list[dict[str, Any]]:
        return [self._service(1), self._service(2), self._service(3, "0x02")]

    def locked_bonds(self) -> list[dict[str, Any]]:
        return [self._service(4), self._service(5, "0x02")] if self._locked else []

    def _service(self, number: int, provider: str = "0x01") -> dict[str, Any]:
        return {"id": number, "provider": provider, "kind": "waste_disposal"}


def due(now_s: float, able: bool = True, **said: Any) -> tuple[list[Update], float | None]:
    index: Any = FakeIndex(**said)
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
