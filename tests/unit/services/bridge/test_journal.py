"""What was written down by an earlier version is still known after an upgrade."""

from pathlib import Path

import pytest
import sqlalchemy
from eth_account import Account

from services.bridge.database import migrate, open_database
from services.bridge.errors import JournalDamaged
from services.bridge.journal import Journal, metadata

KEY = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"
NONCE = 7
OLD_COLUMNS = "wallet, request_id, command, content_sha256, [to], data, tx_hash, raw, state, outcome"


@pytest.mark.parametrize("stamped", [True, False], ids=["with migrations", "from before there were any"])
def test_a_journal_of_the_first_schema_is_upgraded_with_what_is_in_it(tmp_path: Path, stamped: bool) -> None:
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
    engine = open_database(f"sqlite:///{path}", durable=True)
    migrate(engine, "0001")
    with engine.begin() as connection:
        for request_id, state, outcome in [("a", "mined", '{"block": 3}'), ("b", "sent", None)]:
            wallet, *others = values
            connection.exec_driver_sql(
                f"insert into transactions ({OLD_COLUMNS}) values ({', '.join('?' * 10)})",
                (wallet, request_id, *others, bytes(signed.raw_transaction), state, outcome),
            )
        if not stamped:
            connection.exec_driver_sql("drop table alembic_version")
    engine.dispose()

    journal = Journal(path)
    mined, (sent,) = journal.find("panther1", "a"), journal.unfinished()
    assert mined is not None and mined.outcome == {"block": 3}
    assert (sent.request_id, sent.nonce, sent.hashes) == ("b", NONCE, [signed.hash.to_0x_hex()])
    assert journal.spent("panther1", -1.0) == (0, 0)
    journal.finish([{"entry_id": sent.id, "state": "mined", "outcome": {}, "block": 4, "fee": 5}])
    assert [entry.request_id for entry in journal.undone(3)] == ["b"]
    journal.close()


def test_what_the_migrations_make_is_what_the_code_uses(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    journal.close()
    engine = open_database(f"sqlite:///{tmp_path / 'journal.sqlite'}")
    columns = {one["name"] for one in sqlalchemy.inspect(engine).get_columns("transactions")}
    assert columns == set(metadata.tables["transactions"].columns.keys())
    engine.dispose()


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
