"""The bridge with its index in PostgreSQL, a real one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import Cause, Fault, Ruling
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import Event
from services.bridge.database import open_database
from services.bridge.index import NOWHERE, UNDONE, Index, Position, TimedLog, sqlite_url
from services.bridge.reading import Page
from tests.integration.test_bridge import assert_index_equals_contracts
from tests.support.dao import founded
from tests.support.postgresql import postgresql
from tests.support.site import write_site

pytestmark = pytest.mark.long

GENESIS = "0x" + "01" * 32
CREATOR, ROBOT, TASKS = ("0x" + digit * 40 for digit in "123")
HOSTILE = 'a NUL \0, a quote \', 100 %, {"a": "\ud800"}'


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with postgresql() as address:
        yield address


def opened(url: str, schema_name: str = "") -> Index:
    return Index(url, 31_337, GENESIS, {"TaskManager": TASKS}, schema_name)


def history() -> list[list[Event]]:
    """Blocks with everything that the index keeps."""
    iec = 10**18
    return [
        [
            events.Transfer("0x" + "0" * 40, CREATOR, 2**256 - 1),
            events.KindAllowed("waste", 1, CREATOR, b"\1" * 32, 60, 3600),
        ],
        [
            events.ServiceRegistered(1, ROBOT, "waste", 100 * iec, True, HOSTILE),
            events.TermsAgreed(1, 50 * iec, 20 * iec, 2),
        ],
        [
            events.Transfer(CREATOR, TASKS, 120 * iec),
            events.TaskRegistered(1, CREATOR, "waste", 120 * iec, 3600, 600, 3, b"\1" * 32, HOSTILE),
            events.TaskAssigned(1, 1, ROBOT, 1, 100 * iec, b"\x07" * 32, 4600),
        ],
        [events.ProofSubmitted(1, 1, ROBOT, b"\x0a" * 32, HOSTILE)],
        [
            events.InstanceRuled(1, 1, 0, Ruling.REJECTED, b"\1" * 32, 1, 1_800),
            events.Reported(1, HOSTILE, HOSTILE),
            events.Ruled(1, 1, b"\x0a" * 32, Ruling.REJECTED, Fault.NOBODY, 0, 1_800, b"\x0b" * 32),
            events.PenaltySetAside(1, 1, 20 * iec),
            events.Challenged(1, 0, CREATOR, iec, 1_900, HOSTILE),
        ],
        [
            events.BondPenalized(1, 1, 20 * iec),
            events.TaskRequeued(1, 1, Cause.REJECTED),
        ],
        [
            events.RoleGranted("0x" + "99" * 32, CREATOR, CREATOR),
            events.DeviceRegistered(ROBOT, "bin", CREATOR, "itrash", CREATOR),
        ],
    ]


def fill(index: Index, blocks: list[list[Event]], fork: str = "a") -> None:
    for happened in blocks:
        number = index.position.block + 1
        block_hash = f"0x{fork}{number:063x}"
        logs = [
            TimedLog(Log(event, TASKS, number, block_hash, i, f"0x{number:064x}"), 1000 + number)
            for i, event in enumerate(happened)
        ]
        index.apply(logs, Position(number, block_hash, 1000 + number))


def everything(index: Index) -> dict[str, Any]:
    return {
        "events": [event.model_dump() for event in index.events_after(0, 1000)],
        "tasks": index.tasks.find(
            {"creator": CREATOR}, Page(10), states=("open", "assigned", "submitted", "ruled"), text="100 %"
        ),
        "services": index.services.find({"kind": "waste"}, Page(10)),
        "transfers": index.money.transfers(CREATOR, None, 0, 2**48, Page(10)),
        "transactions": index.money.transactions(1, Page(2, 1)),
        "counts": index.tasks.counts("creator"),
        "times": index.tasks.times(0, 2**48),
        "roles": index.rules.roles(),
        "devices": index.rules.devices(),
        "kinds": index.rules.all_kinds(),
        "balances": index.money.balances(),
        "position": index.position,
        "overdue": index.tasks.overdue(10**9),
        "concludable": index.tasks.concludable(10**9),
        "settleable": index.tasks.settleable(10**9),
        "next_end": index.tasks.next_end_s(1_000),
        "voids": index.tasks.voids(),
    }


def without(answers: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: answer for name, answer in answers.items() if name not in names}


def test_it_answers_as_sqlite_does_through_a_reorganization_and_a_restart(url: str, tmp_path: Path) -> None:
    both = [opened(url, "answers"), opened(sqlite_url(tmp_path / "index.sqlite"))]
    for index in both:
        fill(index, history()[:3])
    at_fork = [everything(index) for index in both]
    assert at_fork[0] == at_fork[1]
    assert at_fork[0]["tasks"][1] == 1
    fork = both[0].position
    for index in both:
        fill(index, history()[3:])
    assert everything(both[0]) == everything(both[1])
    for index in both:
        assert fork in index.recent_blocks()
        notices = index.roll_back(fork)
        assert [notice.name for notice in notices] == [UNDONE] * sum(map(len, history()[3:]))
    # Everything is as it was, but that what happened since is remembered.
    for index, before in zip(both, at_fork, strict=True):
        assert without(everything(index), "events") == without(before, "events")
        fill(index, history()[3:], fork="b")
    assert everything(both[0]) == everything(both[1])
    again = opened(url, "answers")
    assert everything(again) == everything(both[0])
    for index in both:
        index.roll_back(NOWHERE)
        assert index.tasks.find({}, Page(10)) == ([], 0) and index.money.balances() == {}
        fill(index, history(), fork="c")
    assert everything(both[0]) == everything(both[1])
    for index in (*both, again):
        index.close()


def test_two_bridges_share_a_database_without_seeing_each_other(url: str) -> None:
    one, other = opened(url, "one"), opened(url, "other")
    fill(one, history()[:3])
    assert other.last_seq() == 0 and other.position == NOWHERE
    one.close()
    other.close()


@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_an_index_of_another_version_is_rebuilt_and_answers_the_same(
    url: str, tmp_path: Path, database: str, caplog: pytest.LogCaptureFixture
) -> None:
    here = url if database == "postgresql" else sqlite_url(tmp_path / "index.sqlite")
    index = opened(here, "versions")
    fill(index, history())
    before = everything(index)
    index.close()
    engine = open_database(here, "versions")
    with engine.begin() as connection:
        for statement in (
            "update cursor set version = '6-before'",
            "alter table tasks drop column reason",
            "alter table services add column colour text",
            "drop table roots",
        ):
            connection.exec_driver_sql(statement)
    engine.dispose()
    index = opened(here, "versions")
    assert index.position == NOWHERE and index.last_seq() == 0
    assert "has schema version 6-before" in caplog.text
    fill(index, history())
    assert everything(index) == before
    index.close()
    kept = opened(here, "versions")
    assert everything(kept) == before
    kept.close()


def test_the_money_path_with_the_index_in_postgresql(url: str, tmp_path: Path) -> None:
    with founded(write_site(tmp_path, extra=f'bridge.database = "{url}"')) as dao:
        dao.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        first = dao.post("120", description="nul: \0")
        dao.prove(first)
        dao.running.kill("bridge")
        dao.running.start("bridge")
        dao.judge(first, accepted=True)
        dao.wait_for(lambda: "TaskSettled" in dao.names_of(first), "TaskSettled")
        assert [event.seq for event in dao.events] == list(range(1, len(dao.events) + 1))
        assert_index_equals_contracts(dao)
        assert not list((dao.running.site.data_dir / "bridge").rglob("index.sqlite"))
