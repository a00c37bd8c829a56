"""The index tells what the contracts' events say, and nothing else."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy

from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import (
    Cause,
    Fault,
    Instance,
    Namers,
    Revocation,
    Ruling,
    ServiceState,
    Windows,
)
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import ZERO_ADDRESS, Event
from services.bridge import schema
from services.bridge.errors import IndexUnusable
from services.bridge.index import NOWHERE, Index, Position, TimedLog, sqlite_url
from services.bridge.projection.tasks import parse_task_text
from services.bridge.reading import Page

GENESIS = "0x" + "01" * 32
CONTRACTS = {"TaskManager": "0x" + "aa" * 20}
CREATOR, ROBOT = "0x" + "11" * 20, "0x" + "22" * 20
ORACLE_JUDGE = "0x" + "01" * 20
IEC = 10**18
WINDOWS = Windows(600, 7200, 180, 900, 7200, 0)


class Chain:
    """Makes blocks of events and hands them to an index."""

    def __init__(self, index: Index) -> None:
        self.index = index

    def block(
        self, *happened: Event, time_s: int = 1_000, contract: str = CONTRACTS["TaskManager"]
    ) -> list[int]:
        """Sequence numbers of a new block's events, which `contract` has logged."""
        number = self.index.position.block + 1
        logs = [
            TimedLog(Log(event, contract, number, f"0x{number:064x}", i, f"0x{number:064x}"), time_s)
            for i, event in enumerate(happened)
        ]
        return [event.seq for event in self.index.apply(logs, Position(number, f"0x{number:064x}", time_s))]


def open_index(folder: Path, genesis: str = GENESIS, contracts: dict[str, str] = CONTRACTS) -> Index:
    return Index(sqlite_url(folder / "index.sqlite"), 31_337, genesis, contracts)


@pytest.fixture
def chain(tmp_path: Path) -> Chain:
    return Chain(open_index(tmp_path))


def registered(task_id: int = 1, params: str = '{"params":{"item_id":"i"},"description":"d"}') -> Event:
    return events.TaskRegistered(
        task_id, CREATOR, "waste_disposal", 120 * IEC, 3600, 600, 3, bytes(32), params
    )


def offered(auto_accept: bool = True) -> Event:
    return events.ServiceRegistered(1, ROBOT, "waste_disposal", 100 * IEC, auto_accept, "cleans")


def assigned(attempt: int = 1, deadline: int = 4_600) -> Event:
    return events.TaskAssigned(1, attempt, ROBOT, 1, 100 * IEC, b"\x07" * 32, deadline)


def proved(attempt: int = 1) -> Event:
    return events.ProofSubmitted(1, attempt, ROBOT, b"\x0a" * 32, "file:///p.mcap")


def ruled(ruling: Ruling, attempt: int = 1, until: int = 0) -> Event:
    return events.Ruled(1, attempt, b"\x0a" * 32, ruling, Fault.NOBODY, 0, until, b"\x0b" * 32)


def judged(accepted: bool, attempt: int = 1) -> list[Event]:
    """Finally."""
    report = events.Reported(1, "file:///r.json", "why")
    return [report, ruled(Ruling.ACCEPTED if accepted else Ruling.REJECTED, attempt)]


def settled(paid_iec: int) -> Event:
    return events.TaskSettled(1, ROBOT, paid_iec * IEC, (120 - paid_iec) * IEC)


def task(chain: Chain) -> dict[str, Any]:
    row = chain.index.tasks.get(1)
    assert row is not None
    return row


def test_sequence_numbers_count_on_over_blocks_and_restarts(chain: Chain, tmp_path: Path) -> None:
    assert chain.block(registered(), offered()) == [1, 2]
    assert chain.block() == []
    again = Chain(open_index(tmp_path))
    assert again.index.position.block == 1
    assert again.block(assigned()) == [3]
    assert [event.seq for event in again.index.events_after(1, 10)] == [2, 3]
    assert [event.seq for event in again.index.events_after(0, 1)] == [1]


@pytest.mark.parametrize("other", [{"genesis": "0x" + "02" * 32}, {"contracts": {"TaskManager": CREATOR}}])
def test_the_index_of_another_chain_or_deployment_is_emptied(
    chain: Chain, tmp_path: Path, other: dict[str, Any]
) -> None:
    chain.block(registered())
    emptied = open_index(tmp_path, **other)
    assert emptied.position.block == -1
    assert emptied.tasks.get(1) is None and emptied.last_seq() == 0


@pytest.mark.parametrize(
    "ddl",
    [
        "alter table tasks add column colour text",
        "drop index tasks_by_kind",
        "alter table services drop column penalty",
    ],
)
def test_an_index_that_names_another_version_gets_the_tables_of_this_one(
    chain: Chain, tmp_path: Path, ddl: str, caplog: pytest.LogCaptureFixture
) -> None:
    chain.block(registered(), offered())
    chain.index.close()
    with sqlite3.connect(tmp_path / "index.sqlite") as connection:
        made = connection.execute("select sql from sqlite_master order by name").fetchall()
        connection.execute(ddl)
        connection.execute("update cursor set version = '6-before'")
    again = Chain(open_index(tmp_path))
    assert (again.index.position, again.index.last_seq()) == (NOWHERE, 0)
    assert "has schema version 6-before" in caplog.text and "rebuilt from the chain's events" in caplog.text
    with sqlite3.connect(tmp_path / "index.sqlite") as connection:
        assert connection.execute("select sql from sqlite_master order by name").fetchall() == made
    again.block(registered(), offered())
    assert task(again)["execution_window_s"] == 3600


def test_an_index_of_an_older_version_is_dropped_and_what_is_not_the_indexs_stays(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with sqlite3.connect(tmp_path / "index.sqlite") as connection:
        connection.execute("create table cursor (id integer primary key, version integer not null)")
        connection.execute("insert into cursor values (1, 6)")
        connection.execute("create table kinds (kind text primary key, allowed boolean)")
        connection.execute("insert into kinds values ('waste_disposal', 1)")
        connection.execute("create table notes (text text)")
    chain = Chain(open_index(tmp_path))
    assert (chain.index.position, chain.index.rules.kinds()) == (NOWHERE, [])
    assert "has schema version 6," in caplog.text
    with sqlite3.connect(tmp_path / "index.sqlite") as connection:
        tables = {name for (name,) in connection.execute("select name from sqlite_master")}
    assert "notes" in tables


def test_an_index_of_this_version_is_kept_and_a_new_file_is_no_news(
    chain: Chain, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    chain.block(registered())
    assert open_index(tmp_path).tasks.get(1) is not None
    assert "version" not in caplog.text


def test_every_change_of_the_tables_makes_another_version(monkeypatch: pytest.MonkeyPatch) -> None:
    versions = {schema.version()}
    monkeypatch.setattr(schema.tasks.c.description, "nullable", True)
    versions.add(schema.version())
    monkeypatch.setattr(schema.tasks.c.state, "type", sqlalchemy.String(17))
    versions.add(schema.version())
    other = sqlalchemy.MetaData()
    for table in schema.metadata.sorted_tables:
        table.to_metadata(other)
    monkeypatch.setattr(schema, "metadata", other)
    assert schema.version() in versions
    sqlalchemy.Index(
        "tasks_by_creator_and_state", other.tables["tasks"].c.creator, other.tables["tasks"].c.state
    )
    versions.add(schema.version())
    other.tables["kinds"].append_column(sqlalchemy.Column("colour", sqlalchemy.Text))
    versions.add(schema.version())
    monkeypatch.setattr(schema, "_CONTENT", 1_000)
    versions.add(schema.version())
    assert len(versions) == 6


@pytest.mark.parametrize("spoil", [lambda data: b"not a database" * 100, lambda data: _flipped(data)])
def test_a_damaged_file_is_set_aside_and_the_index_made_anew(
    tmp_path: Path, spoil: Callable[[bytes], bytes]
) -> None:
    chain = Chain(open_index(tmp_path))
    chain.block(registered(), offered())
    chain.index.close()
    path = tmp_path / "index.sqlite"
    path.write_bytes(spoil(path.read_bytes()))
    anew = Chain(open_index(tmp_path))
    assert (anew.index.position, anew.index.last_seq()) == (NOWHERE, 0)
    anew.block(registered(), offered())
    assert path.with_name("index.sqlite.damaged").exists()


def _flipped(data: bytes) -> bytes:
    """With 40 bits changed in every page but the first."""
    spoilt = bytearray(data)
    for page in range(4096, len(data), 4096):
        for number in range(40):
            spoilt[page + 13 * number] ^= 1 << number % 8
    return bytes(spoilt)


def test_a_database_that_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    (tmp_path / "index.sqlite").mkdir()
    with pytest.raises(IndexUnusable) as refused:
        open_index(tmp_path)
    assert refused.value.details["url"].endswith("index.sqlite")


def test_a_block_is_taken_in_whole_or_not_at_all(chain: Chain) -> None:
    with pytest.raises(Exception, match="there is a row"):
        chain.block(registered(2), registered(1), registered(1))
    assert chain.index.last_seq() == 0 and chain.index.tasks.find({}, Page(10)) == ([], 0)
    assert chain.index.position.block == -1


def test_amounts_in_events_are_iec_and_names_are_text(chain: Chain) -> None:
    chain.block(registered(), offered(), assigned())
    first, _, second = chain.index.events_after(0, 10)
    assert first.args["reward_iec"] == "120" and first.args["kind"] == "waste_disposal"
    assert second.args["nonce"] == "0x" + "07" * 32 and second.task_id == 1


def test_what_is_in_escrow_is_the_sum_of_all_tasks_however_many(chain: Chain) -> None:
    chain.block(*(registered(task_id) for task_id in range(1, 602)), offered())
    assert chain.index.tasks.in_escrow(CREATOR) == 601 * 120 * IEC
    chain.block(events.TaskCancelled(2, 120 * IEC))
    assert chain.index.tasks.in_escrow(CREATOR) == 600 * 120 * IEC
    assert chain.index.tasks.in_escrow(ROBOT) == 0


def test_a_task_through_its_life(chain: Chain) -> None:
    chain.block(registered(), time_s=1_000)
    assert (task(chain)["state"], task(chain)["attempt"], task(chain)["executor"]) == ("open", 0, None)
    assert (task(chain)["params"], task(chain)["description"]) == ({"item_id": "i"}, "d")
    chain.block(offered(), assigned(), time_s=1_001)
    assert (task(chain)["state"], task(chain)["assigned"], task(chain)["price"]) == (
        "assigned",
        1_001,
        100 * IEC,
    )
    assert chain.index.services.find({}, Page(10))[0][0]["task_id"] == 1
    chain.block(proved(), time_s=1_100)
    assert (task(chain)["state"], task(chain)["verdict_deadline"]) == ("submitted", 1_700)
    chain.block(*judged(True), events.TaskSettled(1, ROBOT, 100 * IEC, 20 * IEC), time_s=1_200)
    assert (task(chain)["state"], task(chain)["settled"], task(chain)["paid"]) == (
        "settled",
        1_200,
        100 * IEC,
    )
    assert task(chain)["report_sha256"] == "0x" + "0b" * 32
    assert (
        chain.index.services.find({}, Page(10))[0][0]["task_id"],
        chain.index.services.find({}, Page(10))[0][0]["completed"],
    ) == (None, 1)


def test_a_requeued_task_says_why_until_it_is_tried_again(chain: Chain) -> None:
    chain.block(registered(), offered(), assigned(), proved(), *judged(False))
    chain.block(events.TaskRequeued(1, 1, Cause.REJECTED))
    assert (task(chain)["state"], task(chain)["verdict"], task(chain)["reason"]) == (
        "open",
        "rejected",
        "why",
    )
    assert (task(chain)["executor"], task(chain)["nonce"], task(chain)["execution_deadline"]) == (None,) * 3
    assert chain.index.services.find({}, Page(10))[0][0]["rejected"] == 1
    chain.block(assigned(2))
    assert (task(chain)["verdict"], task(chain)["proof_sha256"], task(chain)["attempt"]) == (None, None, 2)


def known_for(chain: Chain) -> tuple[int, int]:
    provider = chain.index.services.providers()[ROBOT]
    return provider["done"] // 10**9, provider["failed"] // 10**9


def test_what_others_paid_for_and_what_was_rejected_make_the_reputation(chain: Chain) -> None:
    chain.block(events.WindowsChanged("waste_disposal", WINDOWS, 90 * IEC))
    chain.block(registered(), offered(), assigned(), proved())
    chain.block(*judged(False), events.TaskRequeued(1, 1, Cause.REJECTED))
    assert known_for(chain) == (0, 90), "the reference price"
    chain.block(assigned(2), proved(2))
    chain.block(*judged(False, 2), events.TaskRequeued(1, 2, Cause.REJECTED))
    assert known_for(chain) == (0, 90), "the same creator on the same day"
    chain.block(assigned(3), proved(3))
    paid = events.TaskSettled(1, ROBOT, 80 * IEC, 40 * IEC)
    chain.block(*judged(True, 3), paid, time_s=2 * 86_400)
    assert known_for(chain) == (80, 88)


def test_what_an_owner_pays_its_robot_makes_no_reputation(chain: Chain) -> None:
    chain.block(events.DeviceRegistered(ROBOT, "robot", CREATOR, "panther1", CREATOR))
    chain.block(registered(), offered(), assigned(), proved())
    chain.block(*judged(True), events.TaskSettled(1, ROBOT, 80 * IEC, 40 * IEC))
    assert known_for(chain) == (0, 0)


def test_a_service_that_fell_asleep_is_paused_and_waits_nowhere(chain: Chain) -> None:
    chain.block(registered(), offered(), assigned())
    chain.block(
        events.TaskFailed(1, 120 * IEC, 1, Cause.EXECUTION_EXPIRED),
        events.ProviderFellAsleep(ROBOT, 5_000),
        events.ServiceFellAsleep(1),
    )
    assert chain.index.services.is_asleep(ROBOT) and not chain.index.services.is_asleep(CREATOR)
    service = chain.index.services.find({}, Page(10))[0][0]
    assert (service["state"], service["place"], service["task_id"]) == ("paused", 0, None)
    assert chain.index.services.providers()[ROBOT]["failures"] == 1
    chain.block(events.ProviderWokeUp(ROBOT))
    assert not chain.index.services.is_asleep(ROBOT)


@pytest.mark.parametrize(
    ("cause", "reason", "counted"),
    [
        (Cause.EXECUTION_EXPIRED, "no proof within the execution window", 1),
        (Cause.NOT_ACCEPTED, "the executor did not accept the task in time", 0),
    ],
)
def test_an_expired_attempt_counts_against_the_service_only_if_it_is_its_fault(
    chain: Chain, cause: Cause, reason: str, counted: int
) -> None:
    chain.block(registered(), offered(), assigned(), events.TaskFailed(1, 120 * IEC, 1, cause))
    assert (task(chain)["state"], task(chain)["verdict"], task(chain)["reason"]) == (
        "failed",
        "expired",
        reason,
    )
    assert chain.index.services.find({}, Page(10))[0][0]["expired"] == counted


@pytest.mark.parametrize("cause", [Cause.NOT_ACCEPTED, Cause.ABANDONED, Cause.ABANDONED_LATE])
def test_an_attempt_that_was_given_back_counts_against_the_service_only_if_it_was_accepted(
    chain: Chain, cause: Cause
) -> None:
    chain.block(registered(), offered(auto_accept=False), assigned())
    assert task(chain)["accepted"] is False
    chain.block(events.TaskAccepted(1, 1, ROBOT))
    assert task(chain)["accepted"] is True
    chain.block(events.TaskRequeued(1, 1, cause))
    row = task(chain)
    assert (row["state"], row["accepted"]) == ("open", None)
    assert row["verdict"] == ("expired" if cause is Cause.NOT_ACCEPTED else "abandoned")
    assert record(chain)[3] == (cause is Cause.ABANDONED_LATE)


def test_a_service_that_accepts_every_task_accepts_by_its_assignment(chain: Chain) -> None:
    chain.block(registered(), offered(), assigned())
    assert task(chain)["accepted"] is True


def test_an_impossible_task_pays_its_executor_and_is_no_completion(chain: Chain) -> None:
    chain.block(registered(), offered(), assigned(), proved())
    report = events.Reported(1, "", "no such item")
    chain.block(report, ruled(Ruling.IMPOSSIBLE), events.TaskSettled(1, ROBOT, 10 * IEC, 110 * IEC))
    row = task(chain)
    assert (row["state"], row["verdict"], row["reason"]) == ("settled", "impossible", "no such item")
    assert (row["paid"], row["refunded"]) == (10 * IEC, 110 * IEC)
    assert record(chain) == (None, 0, 0, 0, 0)


def test_a_task_is_late_for_its_verdict_after_half_of_the_window(chain: Chain) -> None:
    chain.block(registered(), offered(), assigned(), proved(), time_s=1_100)  # 600 s, until 1,700
    assert chain.index.tasks.late_verdicts(1_400) == [] and chain.index.tasks.late_verdicts(1_401) == [1]
    chain.block(*judged(True), events.TaskSettled(1, ROBOT, 100 * IEC, 20 * IEC))
    assert chain.index.tasks.late_verdicts(1_401) == []


def record(chain: Chain) -> tuple[Any, ...]:
    (service,), _ = chain.index.services.find({}, Page(10))
    failures = chain.index.services.providers()[ROBOT]["failures"]
    return (*(service[name] for name in ("task_id", "completed", "rejected", "expired")), failures)


def bonds(chain: Chain) -> tuple[int, int]:
    (service,), _ = chain.index.services.find({}, Page(10))
    return service["bond"], service["set_aside"]


CASE_END = 2_700
"""End of task 1's case: its verdict window ends at 1,700, and the audit window is 1,000 s."""


def submitted(chain: Chain) -> None:
    """Task 1 with a proof, of a service with a bond of 20, at an organization that lets auditors replace."""
    chain.block(
        events.KindAllowed("waste_disposal", 1, ORACLE_JUDGE, bytes(32), 60, 3600),
        events.WindowsChanged("waste_disposal", replace(WINDOWS, audit_window=1_000), IEC),
    )
    terms = events.TermsAgreed(1, 20, 5, 0)
    chain.block(offered(), terms, registered(), assigned(), proved(), time_s=1_100)


def passed_on(chain: Chain) -> None:
    """Task 1, whose proof the oracle could not decide."""
    submitted(chain)
    chain.block(
        events.Reported(1, "", "a hang"),
        events.PassedOn(1, 1, CREATOR),
        ruled(Ruling.VOID, until=CASE_END),
        events.PenaltySetAside(1, 1, 5),
    )


def test_a_case_that_the_oracle_passed_on_waits_for_the_auditors_and_frees_the_service(chain: Chain) -> None:
    passed_on(chain)
    row = task(chain)
    assert (row["state"], row["verdict"], row["reason"], row["passed_on"]) == ("ruled", None, "a hang", True)
    assert row["standing"] == {"ruling": "void", "fault": "nobody", "amount_iec": "0", "until": CASE_END}
    assert (row["case_end"], row["executor"], row["proof_sha256"]) == (CASE_END, ROBOT, "0x" + "0a" * 32)
    assert record(chain) == (None, 0, 0, 0, 0) and places(chain) == [2] and bonds(chain) == (15, 5)
    assert chain.index.tasks.in_escrow(CREATOR) == 120 * IEC
    assert chain.index.tasks.next_end_s(CASE_END) == CASE_END
    assert chain.index.tasks.concludable(CASE_END) == [] and chain.index.tasks.concludable(CASE_END + 1) == [
        1
    ]


def test_auditors_pay_for_a_part_and_the_record_counts_it_then(chain: Chain) -> None:
    passed_on(chain)
    chain.block(*judged(True), events.PenaltyReturned(1, 1, 5), settled(30), time_s=2_000)
    row = task(chain)
    assert (row["state"], row["verdict"], row["standing"]) == ("settled", "accepted", None)
    assert (row["paid"], row["refunded"], row["settled"]) == (30 * IEC, 90 * IEC, 2_000)
    assert record(chain) == (None, 1, 0, 0, 0) and bonds(chain) == (20, 0) and places(chain) == [2]
    assert chain.index.tasks.concludable(10**9) == []


def test_what_is_rejected_at_the_end_takes_what_was_set_aside(chain: Chain) -> None:
    passed_on(chain)
    chain.block(
        *judged(False),
        events.BondPenalized(1, 1, 5),
        events.TaskRequeued(1, 1, Cause.REJECTED),
        assigned(2),
    )
    row = task(chain)
    assert (row["state"], row["attempt"], row["case_end"], row["verdict"]) == ("assigned", 2, None, None)
    assert (row["standing"], row["passed_on"]) == (None, False)
    assert record(chain) == (1, 0, 1, 0, 1) and bonds(chain) == (15, 0)


def test_a_penalty_without_a_ruling_that_stood_is_taken_from_the_bond(chain: Chain) -> None:
    submitted(chain)
    end = events.TaskFailed(1, 120 * IEC, 1, Cause.REJECTED)
    chain.block(*judged(False), end, events.BondPenalized(1, 1, 5))
    assert record(chain) == (None, 0, 1, 0, 1) and bonds(chain) == (15, 0)


@pytest.mark.parametrize("next_task", [False, True])
def test_a_service_that_retires_has_its_bond_back_and_what_was_set_aside_when_the_case_ends(
    chain: Chain, next_task: bool
) -> None:
    passed_on(chain)
    if next_task:  # its bond waits for that one, too
        again = events.TaskAssigned(2, 1, ROBOT, 1, 100 * IEC, b"\x07" * 32, 9_000)
        chain.block(registered(2), again, events.ServiceUpdated(1, 100 * IEC, ServiceState.RETIRED))
    else:
        chain.block(
            events.ServiceUpdated(1, 100 * IEC, ServiceState.RETIRED), events.BondReturned(1, ROBOT, 15)
        )
    chain.block(events.BondReturned(1, ROBOT, 5), events.TaskFailed(1, 120 * IEC, 1, Cause.VOID))
    assert bonds(chain) == (15 if next_task else 0, 0)
    row = task(chain)
    assert (row["verdict"], row["fault"], row["state"]) == ("void", "nobody", "failed")


def test_a_service_whose_bond_ran_short_waits_again_when_a_case_ends(chain: Chain) -> None:
    submitted(chain)
    chain.block(
        ruled(Ruling.ACCEPTED, until=CASE_END), events.PenaltySetAside(1, 1, 5), events.BondRanShort(1)
    )
    (service,), _ = chain.index.services.find({}, Page(10))
    assert (service["state"], service["place"]) == ("short", 0)
    chain.block(*judged(True), events.PenaltyReturned(1, 1, 17), settled(30))
    (service,), _ = chain.index.services.find({}, Page(10))
    assert (service["state"], service["place"]) == ("active", 2)


def test_a_service_waits_again_before_the_task_that_it_gave_up_is_offered(chain: Chain) -> None:
    submitted(chain)
    chain.block(
        ruled(Ruling.GIVEN_UP, until=CASE_END), events.PenaltySetAside(1, 1, 5), events.BondRanShort(1)
    )
    chain.block(events.PenaltyReturned(1, 1, 17), events.TaskRequeued(1, 1, Cause.GIVEN_UP), assigned(2))
    assert places(chain) == [0] and chain.index.rules.setting("places") == 2


def test_where_nobody_ruled_the_attempt_is_void_and_has_no_report(chain: Chain) -> None:
    submitted(chain)
    assert chain.index.tasks.concludable(1_700) == [] and chain.index.tasks.concludable(1_701) == [1]
    chain.block(
        events.Ruled(1, 1, b"\x0a" * 32, Ruling.VOID, Fault.ORACLE, 0, CASE_END, bytes(32)), time_s=1_701
    )
    row = task(chain)
    assert (row["standing"]["fault"], row["reason"], row["report_sha256"]) == ("oracle", None, None)
    assert chain.index.tasks.concludable(CASE_END) == []
    chain.block(events.TaskFailed(1, 120 * IEC, 1, Cause.VOID))
    row = task(chain)
    assert (row["state"], row["verdict"], row["fault"]) == ("failed", "void", "oracle")
    assert record(chain) == (None, 0, 0, 0, 0)
    assert chain.index.tasks.voids() == {CREATOR: {"oracle": 1}}
    assert chain.index.tasks.recent_voids(100) == {CREATOR: (1, {"oracle": 1}), None: (1, {"oracle": 1})}
    assert chain.index.tasks.recent_voids(0) == {}


def test_a_report_of_another_transaction_is_not_that_of_a_ruling(chain: Chain) -> None:
    submitted(chain)
    chain.block(events.Reported(1, "file:///other", "of another"))
    chain.block(ruled(Ruling.ACCEPTED, until=CASE_END))
    row = task(chain)
    assert (row["reason"], row["report_uri"], row["report_sha256"]) == (None, None, "0x" + "0b" * 32)


def test_what_a_judge_said_that_was_removed_can_be_concluded_at_once(chain: Chain) -> None:
    submitted(chain)
    chain.block(ruled(Ruling.ACCEPTED, until=CASE_END))
    assert chain.index.tasks.concludable(1_000) == []
    chain.block(events.JudgeRemoved(1, ORACLE_JUDGE), events.KindDisallowed("waste_disposal"))
    assert chain.index.tasks.concludable(1_000) == [1]
    chain.block(events.Ruled(1, 1, b"\x0a" * 32, Ruling.VOID, Fault.ORACLE, 0, CASE_END, bytes(32)))
    assert chain.index.tasks.concludable(CASE_END) == [] and chain.index.tasks.concludable(CASE_END + 1) == [
        1
    ]


def test_a_service_keeps_the_judge_that_its_provider_agreed_to(chain: Chain) -> None:
    kind = "waste_disposal"
    chain.block(events.KindAllowed(kind, 1, ORACLE_JUDGE, b"\1" * 32, 60, 3600), offered())
    chain.block(
        events.RulesRetired(kind, b"\1" * 32),
        events.KindAllowed(kind, 2, CREATOR, b"\2" * 32, 60, 3600),
        registered(),
    )
    (service,), _ = chain.index.services.find({}, Page(10))
    assert (service["number"], service["place"], task(chain)["number"]) == (1, 1, 2)
    assert (chain.index.rules.number_of(kind), chain.index.rules.of(kind)) == (2, ["0x" + "02" * 32])
    assert chain.index.rules.of(kind, ORACLE_JUDGE) == []
    chain.block(events.ServiceAgreed(1, 2))
    (service,), _ = chain.index.services.find({}, Page(10))
    assert (service["number"], service["place"]) == (2, 2)


def test_a_ruling_of_several_instances_is_challenged_and_its_stakes_are_settled(tmp_path: Path) -> None:
    committee = "0x" + "cc" * 20
    chain = Chain(open_index(tmp_path, contracts={**CONTRACTS, "OracleCommittee": committee}))
    first, last = Instance(committee, 60, 0, 1 * IEC, 2 * IEC), Instance(CREATOR, 0, 60, 0, 0)
    chain.block(events.InstancesChanged("waste_disposal", [first, last]))
    submitted(chain)
    chain.block(
        events.InstanceRuled(1, 1, 0, Ruling.ACCEPTED, bytes(32), 0b1, 1_300),
        events.Reported(1, "file:///r.json", "why"),
        ruled(Ruling.ACCEPTED, until=1_300),
    )
    assert task(chain)["dispute"] == {"instance": 0, "until": 1_300, "stakes_iec": ["1"]}
    assert chain.index.tasks.settleable(1_300) == [] and chain.index.tasks.settleable(1_301) == [(1, 1)]
    chain.block(
        ruled(Ruling.ACCEPTED, until=1_500),
        events.Challenged(1, 0, CREATOR, 1 * IEC, 1_500, "it lies there still"),
    )
    row = task(chain)
    assert (row["reason"], row["standing"]["until"], row["dispute"]["until"]) == ("why", 1_500, 1_500)
    assert (row["dispute"]["challenger"], row["dispute"]["because"]) == (CREATOR, "it lies there still")
    assert chain.index.tasks.settleable(1_301) == []
    chain.block(
        events.InstanceRuled(1, 1, 1, Ruling.REJECTED, bytes(32), 0b1, 0),
        events.Reported(1, "file:///r.json", "it does"),
        ruled(Ruling.REJECTED),
        events.TaskFailed(1, 120 * IEC, 1, Cause.REJECTED),
        time_s=1_400,
    )
    row = task(chain)
    assert (row["verdict"], row["reason"]) == ("rejected", "it does")
    assert row["dispute"] == {"instance": 1, "until": 1_400, "stakes_iec": ["1"]}
    assert chain.index.tasks.settleable(1_400) == [(1, 1)]
    chain.block(events.CaseSettled(1, 1, False))
    assert chain.index.tasks.settleable(10**9) == [] and task(chain)["dispute"]["settled"] is True


def test_the_roots_of_days_are_kept_by_device(chain: Chain) -> None:
    for device, day in ((ROBOT, 3), (ROBOT, 4), (CREATOR, 4)):
        chain.block(events.WitnessRoot(device, day, bytes([day]) * 32, f"file:///{day}"), time_s=day)
    rows, total = chain.index.rules.roots(ROBOT, Page(1))
    assert total == 2
    assert [(row["day"], row["root"], row["uri"]) for row in rows] == [(4, "0x" + "04" * 32, "file:///4")]
    assert chain.index.rules.roots(None, Page(10))[1] == 3


def test_overdue_is_what_runs_beyond_its_window(chain: Chain) -> None:
    chain.block(registered(), offered(), assigned(deadline=4_600))
    assert chain.index.tasks.overdue(4_600) == [] and chain.index.tasks.next_end_s(4_600) == 4_600
    assert chain.index.tasks.overdue(4_601) == [1] and chain.index.tasks.next_end_s(4_601) is None
    chain.block(proved(), time_s=1_100)
    assert chain.index.tasks.overdue(10**9) == [] and chain.index.tasks.next_end_s(1_700) == 1_700
    chain.block(*judged(True), events.TaskSettled(1, ROBOT, 100 * IEC, 0))
    assert chain.index.tasks.overdue(10**9) == []


def test_an_attempt_that_nobody_accepted_is_overdue_after_the_kinds_grace_period(chain: Chain) -> None:
    chain.block(events.WindowsChanged("waste_disposal", WINDOWS, IEC))
    chain.block(registered(), offered(auto_accept=False), assigned(deadline=4_600))
    chain.block(events.WindowsChanged("waste_disposal", replace(WINDOWS, grace=300), IEC))  # for later tasks
    assert task(chain)["grace_s"] == 180
    assert chain.index.tasks.overdue(1_180) == [] and chain.index.tasks.next_end_s(1_180) == 1_180
    assert chain.index.tasks.overdue(1_181) == [1] and chain.index.tasks.next_end_s(1_181) is None
    chain.block(events.TaskAccepted(1, 1, ROBOT))
    assert chain.index.tasks.overdue(4_600) == [] and chain.index.tasks.overdue(4_601) == [1]


SECOND = events.ServiceRegistered(2, ROBOT, "waste_disposal", 90 * IEC, True, "")
"""Another service of the robot."""


def stands_back(chain: Chain) -> list[int]:
    return [row["id"] for row in chain.index.services.idle() if not row["place"]]


def test_a_newcomer_waits_with_one_service_and_rests_after_it_gave_a_task_back(chain: Chain) -> None:
    chain.block(offered(), SECOND, events.ServiceStoodBack(2))
    assert places(chain) == [1, 0] and stands_back(chain) == [2] and chain.index.services.engaged() == {ROBOT}
    chain.block(registered(), assigned(), time_s=1_000)
    chain.block(
        events.TaskPassed(1, 1, False),
        events.TaskRequeued(1, 1, Cause.ABANDONED),
        events.ProviderRests(ROBOT, 1_700),
        time_s=1_100,
    )
    assert task(chain)["passed"] == [{"provider": ROBOT, "gave_up": False}]
    assert places(chain) == [0, 0] and stands_back(chain) == [1, 2] and not chain.index.services.engaged()
    provider = chain.index.services.providers()[ROBOT]
    assert (provider["rests_until"], provider["bond_locked_until"]) == (1_700, 1_100 + 86_400)
    chain.block(events.ProviderWokeUp(ROBOT), events.ServiceStoodBack(2), time_s=1_700)
    assert places(chain) == [2, 0] and stands_back(chain) == [2]


def test_a_task_waits_since_it_was_posted_or_its_last_attempt_ended(chain: Chain) -> None:
    def waiting() -> tuple[list[tuple[int, float]], list[int]]:
        tasks = [(row["id"], row["opened"]) for row in chain.index.tasks.in_state("open")]
        return tasks, [row["id"] for row in chain.index.services.idle()]

    chain.block(registered(), offered(), time_s=1_000)
    assert waiting() == ([(1, 1_000)], [1])
    chain.block(assigned(), time_s=1_050)
    assert waiting() == ([], [])
    chain.block(events.TaskPassed(1, 1, False), events.TaskRequeued(1, 1, Cause.ABANDONED), time_s=1_100)
    assert waiting() == ([(1, 1_100)], [1])


def test_an_accepted_proof_ends_a_rest_and_frees_the_bonds(chain: Chain) -> None:
    chain.block(registered(), offered(), SECOND, events.ServiceStoodBack(2), assigned(), proved())
    chain.block(events.ProviderRests(ROBOT, 1_700))
    *report, ruling = judged(True)
    chain.block(*report, ruling, events.ProviderWokeUp(ROBOT), events.ProviderProven(ROBOT), settled(100))
    provider = chain.index.services.providers()[ROBOT]
    assert (provider["rests_until"], provider["bond_locked_until"], provider["earned"]) == (None, None, True)
    assert places(chain) == [2, 0], "its other service is not offered by that"
    (first, second), _ = chain.index.services.find({}, Page(10))
    assert (first["waits_as_proven"], second["waits_as_proven"]) == (True, False)


def test_the_services_of_whom_the_organization_vouches_for_are_offered_anew(chain: Chain) -> None:
    chain.block(offered(), SECOND, events.ServiceStoodBack(2))
    chain.block(events.ProviderVouched(ROBOT, True))
    assert places(chain) == [2, 3] and chain.index.services.providers()[ROBOT]["vouched"]
    chain.block(events.ProviderVouched(ROBOT, True))
    assert places(chain) == [2, 3], "nothing changed"
    chain.block(events.ProviderVouched(ROBOT, False), events.ServiceStoodBack(2))
    assert places(chain) == [4, 0]


def test_whose_tasks_may_name_a_service_is_in_the_index(chain: Chain) -> None:
    chain.block(offered())
    chain.block(events.NamersChanged(1, Namers.ANYBODY, 20))
    row = chain.index.services.get(1)
    assert row is not None and (row["namers"], row["max_void_percent"]) == ("anybody", 20)


def test_a_withdrawn_service_counts_until_its_locked_bond_is_returned(chain: Chain) -> None:
    chain.block(offered(), events.TermsAgreed(1, 20, 5, 0), SECOND, events.ServiceStoodBack(2))
    chain.block(events.ServiceUpdated(1, 100 * IEC, ServiceState.RETIRED))
    assert [row["id"] for row in chain.index.services.locked_bonds()] == [1]
    assert chain.index.services.providers()[ROBOT]["services"] == [1, 2]
    chain.block(events.BondReturned(1, ROBOT, 20))
    assert not chain.index.services.locked_bonds() and chain.index.services.providers()[ROBOT][
        "services"
    ] == [2]


def test_balances_add_up_and_hold_256_bits(chain: Chain) -> None:
    everything = 2**256 - 1
    chain.block(
        events.Transfer(ZERO_ADDRESS, CREATOR, everything),
        events.Transfer(CREATOR, ROBOT, 3),
        events.Transfer(ROBOT, ROBOT, 2),
        events.Transfer(ROBOT, ZERO_ADDRESS, 1),
    )
    assert chain.index.money.balances() == {CREATOR: everything - 3, ROBOT: 2}


def test_only_active_services_are_on_offer(chain: Chain) -> None:
    chain.block(offered(), events.ServiceRegistered(2, CREATOR, "waste_disposal", 90 * IEC, True, ""))
    assert sorted(chain.index.services.active_prices("waste_disposal")) == [90 * IEC, 100 * IEC]
    chain.block(events.ServiceUpdated(2, 80 * IEC, ServiceState.PAUSED))
    assert chain.index.services.active_prices("waste_disposal") == [100 * IEC]
    assert chain.index.services.active_prices("battery_charging") == []


def places(chain: Chain) -> list[int]:
    return [row["place"] for row in chain.index.services.find({}, Page(10))[0]]


def test_a_service_has_its_place_in_the_line_while_it_waits(chain: Chain) -> None:
    other = events.ServiceRegistered(2, CREATOR, "waste_disposal", 90 * IEC, True, "")
    chain.block(offered(), other)
    assert places(chain) == [1, 2]
    chain.block(events.ServiceUpdated(1, 100 * IEC, ServiceState.ACTIVE))
    assert places(chain) == [3, 2]
    chain.block(registered(), assigned(), proved())
    assert places(chain) == [0, 2]
    chain.block(*judged(True), events.TaskSettled(1, ROBOT, 100 * IEC, 0))
    assert places(chain) == [4, 2]
    chain.block(events.ServiceSuspended(2), events.ServiceUpdated(1, 100 * IEC, ServiceState.PAUSED))
    assert places(chain) == [0, 0]


def test_a_service_that_gets_its_next_task_at_once_never_waited(chain: Chain) -> None:
    again = events.TaskAssigned(2, 1, ROBOT, 1, 100 * IEC, b"\x07" * 32, 5_000)
    chain.block(registered(), registered(2), offered(), assigned())
    chain.block(*judged(True), events.TaskSettled(1, ROBOT, 100 * IEC, 0), again)
    assert places(chain) == [0]
    chain.block(events.TaskFailed(2, 120 * IEC, 3, Cause.REJECTED))
    assert places(chain) == [1]


def test_a_transaction_that_does_several_things_gives_the_places_in_between(chain: Chain) -> None:
    chain.block(offered(), registered(), assigned(), events.TaskRequeued(1, 1, Cause.EXECUTION_EXPIRED))
    assert places(chain) == [2]


def test_a_final_rejection_has_the_task_tried_by_others_before_its_service_waits(chain: Chain) -> None:
    chain.block(offered())
    chain.block(registered(), assigned(), proved())
    chain.block(*judged(False), events.TaskRequeued(1, 1, Cause.REJECTED), assigned(2))
    assert places(chain) == [0] and chain.index.rules.setting("places") == 1


def test_the_terms_suspend_a_service_before_it_could_wait(chain: Chain) -> None:
    chain.block(offered(), registered(), assigned())
    chain.block(events.TaskFailed(1, 120 * IEC, 3, Cause.REJECTED), events.ServiceSuspended(1))
    assert places(chain) == [0]


def test_what_the_token_refused_is_owed_until_it_is_collected(chain: Chain) -> None:
    chain.block(events.PaymentDeferred(ROBOT, 7), events.PaymentDeferred(ROBOT, 2))
    assert (chain.index.money.owed(), chain.index.money.balance(ROBOT)) == ({ROBOT: 9}, 0)
    chain.block(events.PaymentCollected(ROBOT, 9), events.Transfer(CREATOR, ROBOT, 9))
    assert (chain.index.money.owed(), chain.index.money.balance(ROBOT)) == ({}, 9)


def test_what_a_provider_is_owed_goes_to_whom_it_named(chain: Chain) -> None:
    safe, escrow = "0x" + "33" * 20, CONTRACTS["TaskManager"]
    chain.block(offered(), events.PayoutChanged(ROBOT, safe))
    assert chain.index.services.payouts() == {ROBOT: safe}
    chain.block(registered(), assigned(), proved())
    chain.block(
        *judged(True),
        events.TaskSettled(1, safe, 80 * IEC, 40 * IEC),
        events.BondReturned(1, ROBOT, 7),
        events.PaymentDeferred(ROBOT, 9),
        events.PaymentCollected(ROBOT, 9),
        *(events.Transfer(escrow, safe, amount) for amount in (80 * IEC, 7, 9)),
    )
    moved = chain.index.money.transfers(safe, None, 0, 2_000, Page(10))[0]
    assert {row["amount"]: row["reason"] for row in moved} == {
        80 * IEC: "payment",
        7: "bond_returned",
        9: "collected",
    }
    assert task(chain)["executor"] == ROBOT
    chain.block(events.PayoutChanged(ROBOT, ROBOT))
    assert chain.index.services.payouts() == {}


def test_a_payment_that_brings_a_bond_back_is_one(chain: Chain) -> None:
    chain.block(offered(), registered(), assigned(), proved())
    moved = events.Transfer(CONTRACTS["TaskManager"], ROBOT, 80 * IEC + 7)
    chain.block(*judged(True), events.BondReturned(1, ROBOT, 7), settled(80), moved)
    (transfer,), _ = chain.index.money.transfers(ROBOT, None, 0, 2_000, Page(10))
    assert (transfer["reason"], transfer["task_id"]) == ("payment", 1)


def test_kinds_can_be_allowed_and_disallowed(chain: Chain) -> None:
    chain.block(
        events.KindAllowed("a", 1, ORACLE_JUDGE, b"\1" * 32, 60, 3600),
        events.KindAllowed("b", 2, CREATOR, bytes(32), 120, 7200),
        events.KindDisallowed("a"),
        events.WindowsChanged("a", replace(WINDOWS, audit_window=60), IEC),
    )
    assert chain.index.rules.kinds() == ["b"]
    columns = ("number", "audit_window_s", "judges_window_s", "max_case_s")
    judges = {row["kind"]: tuple(row[one] for one in columns) for row in chain.index.rules.all_kinds()}
    assert judges == {"a": (1, 60, 60, 3600), "b": (2, 0, 120, 7200)}
    assert {number: row["judge"] for number, row in chain.index.rules.numbers().items()} == {
        1: ORACLE_JUDGE,
        2: CREATOR,
    }


def test_a_device_is_kept_after_it_is_revoked(chain: Chain) -> None:
    chain.block(events.DeviceRegistered(ROBOT, "robot", CREATOR, "panther1", CREATOR), time_s=5)
    chain.block(events.DeviceRevoked(ROBOT, Revocation.SUPERSEDED), time_s=9)
    (device,) = chain.index.rules.devices()
    assert (device["role"], device["name"]) == ("robot", "panther1")
    assert (device["registered"], device["revoked"], device["revoked_because"]) == (5, 9, "superseded")


def test_a_device_has_the_owner_that_it_was_registered_for_last(chain: Chain) -> None:
    chain.block(events.DeviceRegistered(ROBOT, "robot", CREATOR, "panther1", CREATOR), time_s=5)
    chain.block(events.DeviceOwnerChanged(ROBOT, ROBOT, CREATOR), time_s=9)
    (device,) = chain.index.rules.devices()
    assert (device["owner"], device["registered"], device["revoked"]) == (ROBOT, 5, None)


def test_what_was_published_is_remembered(chain: Chain, tmp_path: Path) -> None:
    chain.block(registered(), offered())
    chain.index.mark_published(1)
    assert open_index(tmp_path).published_seq == 1


@pytest.mark.parametrize(
    "text",
    ["", "clean up", "[]", '{"params": 5}', '{"params": {}, "description": 7}', '{"a": ' * 5_000, "\x00"],
)
def test_a_strangers_task_text_is_kept_as_a_description(text: str) -> None:
    assert parse_task_text(text) == ({}, text)


def test_half_a_character_in_a_posted_task_costs_only_itself() -> None:
    """Anybody may post a task straight to the contract."""
    text = '{"params": {"item_id": "item1", "note": "\\ud800"}, "description": "a \\udc00"}'
    assert parse_task_text(text) == ({"item_id": "item1", "note": "\ufffd"}, "a \ufffd")


def test_a_judge_has_the_stake_that_the_contract_says_it_has(tmp_path: Path) -> None:
    committee, other = "0x" + "cc" * 20, "0x" + "dd" * 20
    named = {**CONTRACTS, "OracleCommittee": committee, "DisputeJudge": "0x" + "ee" * 20}
    chain = Chain(open_index(tmp_path, contracts=named))

    def stake() -> tuple[int, int, int]:
        (judge,) = chain.index.rules.judges()
        return judge["stake"] // IEC, judge["leaving"] // IEC, judge["leaving_until_s"]

    chain.block(events.JudgeSeated(0, CREATOR, ROBOT))
    assert stake() == (0, 0, 0)
    chain.block(
        events.StakeDeposited(committee, 0, CREATOR, 9 * IEC),
        events.StakeDeposited(other, 0, CREATOR, 7 * IEC),  # of anybody's contract
        events.StakeDeposited(other, 63, CREATOR, 7 * IEC),
    )
    assert stake() == (9, 0, 0)
    chain.block(events.WithdrawalAnnounced(committee, 0, 6 * IEC, 5_000))
    assert stake() == (3, 6, 5_000)
    chain.block(events.StakeLost(1, committee, 0, 4 * IEC))
    assert stake() == (0, 5, 5_000)
    chain.block(events.StakeWithdrawn(committee, 0, ROBOT, 5 * IEC))
    assert stake() == (0, 0, 0)
    first, last = Instance(committee, 60, 0, 1, 2 * IEC), Instance(other, 0, 60, 0, 0)
    chain.block(events.InstancesChanged("waste_disposal", [first, last]))
    assert [row["judge_stake"] for row in chain.index.rules.all_kinds()] == [2 * IEC]


def test_judges_of_each_committee_have_seats_and_stakes_of_their_own(tmp_path: Path) -> None:
    oracles, first, second, other = ("0x" + digits * 20 for digits in ("cc", "c1", "c2", "33"))
    committees = {"OracleCommittee": oracles, "DisputeCommittee": first, "AppealCommittee": second}
    chain = Chain(open_index(tmp_path, contracts={**CONTRACTS, **committees}))
    for committee, key in ((oracles, CREATOR), (first, ROBOT), (second, other)):
        chain.block(
            events.JudgeSeated(0, key, key),
            events.QuorumChanged("waste_disposal", 1, 1, 0, 0b1),
            contract=committee,
        )
    instances = [Instance(one, 60, 60, 1, stake * IEC) for stake, one in enumerate(committees.values(), 1)]
    chain.block(
        events.InstancesChanged("waste_disposal", instances),
        events.StakeDeposited(first, 0, CREATOR, 5 * IEC),
        events.StakeDeposited(second, 0, CREATOR, 7 * IEC),
        events.StakeLost(1, second, 0, 3 * IEC),
    )
    chain.block(events.JudgeKeyChanged(0, other, CREATOR), contract=second)

    def found(judges: list[dict[str, Any]]) -> list[tuple[int, str, int]]:
        return [(one["seat"], one["key"], one["stake"] // IEC) for one in judges]

    index = chain.index
    assert found(index.rules.judges()) == [(0, CREATOR, 0)]
    assert found(index.rules.challenge_judges("DisputeCommittee")) == [(0, ROBOT, 5)]
    assert found(index.rules.challenge_judges("AppealCommittee")) == [(0, CREATOR, 4)]
    (row,) = index.rules.all_kinds()
    assert (row["votes"], row["seats"], row["judge_stake"]) == (1, [0], 1 * IEC)
    for committee, stake in (("DisputeCommittee", 2), ("AppealCommittee", 3)):
        (of_kind,) = index.rules.challenge_kinds(committee)
        assert (of_kind["votes"], of_kind["seats"], of_kind["judge_stake"]) == (1, [0], stake * IEC)
    # Whoever hears of it hears of which committee it is.
    told = [event.args["committee"] for event in index.events_after(0, 10, ("JudgeSeated", "QuorumChanged"))]
    assert told == [oracles, oracles, first, first, second, second]
    # Where nobody can challenge any more, none of them needs a stake for it.
    chain.block(events.InstancesChanged("waste_disposal", instances[:1]))
    assert [
        index.rules.challenge_kinds(one)[0]["judge_stake"] for one in ("DisputeCommittee", "AppealCommittee")
    ] == [0, 0]
