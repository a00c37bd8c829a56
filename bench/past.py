"""Tasks of a long past as contracts log them, taken in by the bridge's index without a chain."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from sqlalchemy import Table

from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import Cause, Fault, Ruling
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import Event
from services.bridge import schema
from services.bridge.index import Index, TimedLog

IEC = 10**18
KIND = "waste_disposal"
CANCELLED = 7
"""Every so many tasks one is cancelled."""
_FAILS = {Ruling.REJECTED: 31, Ruling.VOID: 53}
"""Every so many tasks one ends with this ruling."""
TASK_S = 600
"""Between two tasks: 100,000 of them take 23 months."""
WRITTEN = 1_000
_TIMES = (
    "registered",
    "opened",
    "assigned",
    "proof_submitted",
    "settled",
    "ended",
    "execution_deadline",
    "verdict_deadline",
    "case_end",
    "time_s",
)
"""Columns of times, s."""


def offered(robot: str) -> Event:
    """Service 1, which does all the work."""
    return events.ServiceRegistered(1, robot, KIND, IEC, True, "")


def history(number: int, creator: str, robot: str, manager: str) -> Iterator[list[Event]]:
    """What is logged of task `number`, transaction by transaction; `manager` holds the reward."""
    proof = number.to_bytes(32)
    place = {"item_id": "item1", "x_m": 1.0, "y_m": 2.0}
    text = json.dumps({"params": place, "description": f"note {number}"})
    escrow = events.Transfer(creator, manager, IEC)
    refund = events.Transfer(manager, creator, IEC)
    posted = events.TaskRegistered(number, creator, KIND, IEC, 600, 600, 1, proof, text)
    if number % CANCELLED == 0:
        yield [escrow, posted]
        yield [events.TaskCancelled(number, IEC), refund]
        return
    yield [escrow, posted, events.TaskAssigned(number, 1, robot, 1, IEC, proof, 10**9)]
    yield [events.ProofSubmitted(number, 1, robot, proof, f"file:///store/{proof.hex()}.mcap")]
    ruling = next((one for one, each in _FAILS.items() if number % each == 0), Ruling.ACCEPTED)
    ruled = events.Ruled(number, 1, proof, ruling, Fault.NOBODY, IEC, 0, proof)
    told = [events.Reported(number, "", "as the oracle saw it"), ruled]
    if ruling is Ruling.ACCEPTED:
        yield [*told, events.TaskSettled(number, robot, IEC, 0), events.Transfer(manager, robot, IEC)]
    else:
        yield [*told, events.TaskFailed(number, IEC, 1, Cause[ruling.name]), refund]


def take_in(index: Index, database: Path, first: int, tasks: int, creator: str, robot: str) -> None:
    """Add tasks to the index in `database` that follows a chain, as if its newest block had them all; they
    ended one after the other until then, and nothing of it is published. `tasks` are a multiple of WRITTEN.

    The projection writes the rows of the first ones. Those of the others are copies with other numbers, ids
    of transactions and times: it would take minutes to write them all.
    """
    position, manager = index.position, index.contracts["TaskManager"]
    block = position.block, position.block_hash
    begun_s, last_seq = position.block_time_s - TASK_S * tasks, index.last_seq()
    happened: list[tuple[int, list[Event]]] = [(begun_s, [offered(robot)])]
    for number in range(first, first + WRITTEN):
        happened += [
            (begun_s + TASK_S * (number - first), one) for one in history(number, creator, robot, manager)
        ]
    logs = [
        # No two of one transaction, as on a chain.
        TimedLog(Log(event, manager, *block, at * 100 + place, f"0x{at:064x}"), time_s)
        for at, (time_s, logged) in enumerate(happened)
        for place, event in enumerate(logged)
    ]
    # Far below the head: nothing is kept to undo it.
    index.apply(logs, position, head=position.block + 10**6)
    written = index.last_seq() - last_seq
    with closing(sqlite3.connect(database)) as connection, connection:
        # The first of the events is no task's.
        for table, key, least in (
            (schema.tasks, "id", first),
            (schema.texts, "task_id", first),
            (schema.events, "task_id", first),
            (schema.transfers, "task_id", first),
            (schema.transactions, "seq", last_seq + 2),
        ):
            connection.execute(_copies(table, key, written), (tasks // WRITTEN - 1, least))
    index.mark_published(index.last_seq())


def _copies(table: Table, key: str, events_written: int) -> str:
    """Copies of the table's newest rows. Its parameters: how many, and the least `key` of such a row."""
    later = dict.fromkeys(_TIMES, WRITTEN * TASK_S)
    shifts = later | {"seq": events_written, "task_id": WRITTEN} | ({"id": WRITTEN} if key == "id" else {})
    other = {name: f"{name} + copy * {by}" for name, by in shifts.items()}
    note = f"'note ' || ({key} + copy * {WRITTEN})"
    other |= {
        "tx_hash": "'0x' || printf('%08x', copy) || substr(tx_hash, 11)",
        "description": note,
        "text": f"replace(text, 'note ' || {key}, {note})",
    }
    names = [column.name for column in table.columns]
    return (
        "with recursive copies(copy) as (select 1 union all select copy + 1 from copies where copy < ?) "
        f"insert into {table.name} ({', '.join(map(_quoted, names))}) "
        f"select {', '.join(other.get(name, _quoted(name)) for name in names)} "
        f"from {table.name}, copies where {key} >= ? order by copy"
    )


def _quoted(name: str) -> str:
    return f'"{name}"'
