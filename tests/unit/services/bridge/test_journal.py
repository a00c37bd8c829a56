"""What was written down by an earlier version is still known after an upgrade."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from eth_account import Account

from services.bridge.errors import JournalDamaged
from services.bridge.journal import Journal

KEY = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"
NONCE = 7
FIRST = (
    "create table transactions (id integer not null primary key, wallet varchar(64) not null, "
    "request_id varchar(128), command varchar(64) not null, content_sha256 varchar(64) not null, "
    "[to] varchar(42) not null, data blob not null, tx_hash varchar(66) not null, raw blob not null, "
    "state varchar(8) not null, outcome json, unique (wallet, request_id))"
)
"""The journal's only table before its versions were numbered."""
COLUMNS = "wallet, request_id, command, content_sha256, [to], data, tx_hash, raw, state, outcome"


def test_a_journal_of_the_first_schema_is_upgraded_with_what_is_in_it(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    signed = Account.sign_transaction(
        {
            "type": 2,
            "chainId": 31_337,
            "nonce": NONCE,
            "to": "0x" + "11" * 20,
            "data": "0x",
            "value": 0,
            "gas": 21_000,
            "maxFeePerGas": 1,
            "maxPriorityFeePerGas": 1,
        },
        KEY,
    )
    values = ("panther1", "transfer", "c" * 64, "0x" + "11" * 20, b"", signed.hash.to_0x_hex())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(FIRST)
        for request_id, state, outcome in [("a", "mined", '{"block": 3}'), ("b", "sent", None)]:
            wallet, *others = values
            connection.execute(
                f"insert into transactions ({COLUMNS}) values ({', '.join('?' * 10)})",
                (wallet, request_id, *others, bytes(signed.raw_transaction), state, outcome),
            )

    journal = Journal(path)
    mined, (sent,) = journal.find("panther1", "a"), journal.unfinished()
    assert mined is not None and mined.outcome == {"block": 3}
    assert (sent.request_id, sent.nonce, sent.hashes) == ("b", NONCE, [signed.hash.to_0x_hex()])
    assert journal.spent("panther1", -1.0) == (0, 0)
    journal.finish([{"entry_id": sent.id, "state": "mined", "outcome": {}, "block": 4, "fee": 5}])
    assert [entry.request_id for entry in journal.undone(3)] == ["b"]
    journal.close()


def test_an_upgraded_journal_has_the_columns_and_indexes_of_a_new_one(tmp_path: Path) -> None:
    old, new = tmp_path / "old.sqlite", tmp_path / "new.sqlite"
    with closing(sqlite3.connect(old)) as connection, connection:
        connection.execute(FIRST)
    for path in (old, new):
        Journal(path).close()
        Journal(path).close()  # what is of this version stays as it is
    assert made(old) == made(new)


def made(path: Path) -> tuple[int, dict[str, set[tuple[str, str]]], set[str]]:
    """Version, columns with their types by table, and indexes."""
    with closing(sqlite3.connect(path)) as connection:
        tables = [
            name for (name,) in connection.execute("select name from sqlite_master where type = 'table'")
        ]
        columns = {
            table: {
                (row[1], row[2].upper())
                for row in connection.execute(f"pragma table_info({table})").fetchall()
            }
            for table in tables
        }
        indexes = {
            name for (name,) in connection.execute("select name from sqlite_master where type = 'index'")
        }
        (version,) = connection.execute("pragma user_version").fetchone()
    return version, columns, indexes


def test_a_damaged_journal_is_refused_by_its_own_name(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    Journal(path).close()
    spoilt = bytearray(path.read_bytes())
    for number in range(40):
        spoilt[4096 + 13 * number] ^= 1 << number % 8
    path.write_bytes(spoilt)
    with pytest.raises(JournalDamaged) as refused:
        Journal(path)
    assert refused.value.details["path"] == str(path)
    assert path.read_bytes() == spoilt, "nothing is done to it"


def test_requests_that_were_made_to_other_contracts_may_be_made_anew(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    old, new = "0x" + "11" * 20, "0x" + "22" * 20
    sent = {
        "wallet": "panther1",
        "command": "register_service",
        "content_sha256": "",
        "data": b"",
        "raw": b"",
    }
    journal.add(
        [
            {**sent, "request_id": request_id, "to": to, "nonce": nonce, "tx_hash": f"0x{nonce}"}
            for nonce, (request_id, to) in enumerate([("service", old), ("charge", new)])
        ]
    )
    assert journal.free_requests([new]) == 1
    assert journal.find("panther1", "service") is None
    assert journal.find("panther1", "charge") is not None
    assert len(journal.unfinished()) == 2
    journal.close()
