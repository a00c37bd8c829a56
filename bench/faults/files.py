"""Files that are damaged, emptied or deleted, and put back."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

from bench.faults.case import case
from bench.faults.lab import Lab, need
from rodeo.host.instance import lock_holder

CHAIN = "chain/eth-tester/chain.sqlite"


def _file(lab: Lab, pattern: str) -> Path:
    (found,) = lab.data.glob(pattern)
    return found


def stopped(lab: Lab, process: str, pattern: str) -> Path:
    """Stop the process and keep a copy of its file, which `_restore` puts back."""
    lab.down(process)
    path = _file(lab, pattern)
    for one in path.parent.glob(path.name + "*"):
        if one.name.endswith(("-wal", "-shm")):
            # What SQLite left beside it belongs to the file.
            with closing(sqlite3.connect(path)) as connection:
                connection.execute("pragma wal_checkpoint(truncate)")
            break
    shutil.copy(path, path.with_name("kept"))
    return path


def remove(path: Path) -> None:
    for one in path.parent.glob(path.name + "*"):
        one.unlink()


def _restore(lab: Lab, process: str, path: Path) -> None:
    """Put the copy back. A process that waits for it continues; one that gave up is started again."""
    waits = lock_holder(lab.data / process) is not None
    remove(path)
    path.with_name("kept").rename(path)
    if not waits:
        lab.down(process)
        lab.up(process)


def _flip(path: Path, count: int = 40) -> None:
    """Change so many bytes, in the middle of pages that are in use."""
    data = bytearray(path.read_bytes())
    for number in range(count):
        place = 4096 + (len(data) - 4096) * number // count
        data[place] ^= 0xFF
    path.write_bytes(data)


def halve(path: Path) -> bytes:
    """Cut the second half off. The answer is what was there."""
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    return whole


def give_up_chain(lab: Lab) -> None:
    """Begin a new one. Nobody keeps the file of the old one."""
    path = stopped(lab, "chain", CHAIN)
    remove(path)
    path.with_name("kept").unlink()
    lab.new_chain()


def _empty(path: Path) -> None:
    remove(path)
    path.touch()


def _harmed(lab: Lab, process: str, pattern: str, harm: Callable[[Path], object]) -> Iterator[None]:
    """The process's file is harmed while it is stopped, and put back when the fault ends."""
    path = stopped(lab, process, pattern)
    harm(path)
    lab.up(process)
    yield
    _restore(lab, process, path)
    yield


# -- the embedded chain ------------------------------------------------------------------------------------


@case("the chain's file is deleted", said="--new-chain", asks=False)
def chain_file_deleted(lab: Lab) -> Iterator[None]:
    yield from _harmed(lab, "chain", CHAIN, remove)


@case("the chain's file is empty", said="--new-chain", asks=False)
def chain_file_emptied(lab: Lab) -> Iterator[None]:
    yield from _harmed(lab, "chain", CHAIN, _empty)


@case("pages of the chain's file are damaged", said="chain file is damaged", asks=False)
def chain_file_damaged(lab: Lab) -> Iterator[None]:
    yield from _harmed(lab, "chain", CHAIN, lambda path: _flip(path, 400))


# -- the bridge's journal and index ------------------------------------------------------------------------

JOURNAL, INDEX = "bridge/*/journal.sqlite", "bridge/*/index.sqlite"
WITHOUT = (
    r"journal.*(without|lacks|does not (hold|have|know)|missing|knows nothing|fewer)|"
    r"(without|lacks|missing).*journal"
)


def _harmed_journal(lab: Lab, harm: Callable[[Path], object]) -> Iterator[None]:
    yield from _harmed(lab, "bridge", JOURNAL, harm)
    need(lab.post("before") == 1, "a repeated request_id posted a second task")


@case("the bridge's journal is deleted", said=WITHOUT, asks=False)
def journal_deleted(lab: Lab) -> Iterator[None]:
    yield from _harmed_journal(lab, remove)


@case("the bridge's journal is empty", said=WITHOUT, asks=False)
def journal_emptied(lab: Lab) -> Iterator[None]:
    yield from _harmed_journal(lab, _empty)


@case("40 bytes of the bridge's journal are flipped", said=r"journal is damaged.*journal\.sqlite", asks=False)
def journal_damaged(lab: Lab) -> Iterator[None]:
    yield from _harmed_journal(lab, _flip)


@case(
    "the second half of the bridge's journal is cut off",
    said=r"journal is damaged.*journal\.sqlite",
    asks=False,
)
def journal_cut(lab: Lab) -> Iterator[None]:
    yield from _harmed_journal(lab, halve)


@case("one balance in the bridge's index is another number", said=r"rebuil|made anew|does not agree|differ")
def index_value_changed(lab: Lab) -> Iterator[None]:
    lab.down("bridge")
    with closing(sqlite3.connect(_file(lab, INDEX))) as connection, connection:
        changed = connection.execute(
            "update balances set balance = '9999' where address = (select address from balances order by "
            "length(balance) desc limit 1)"
        ).rowcount
    need(changed == 1, "the index has no balances")
    lab.up("bridge")
    yield
    yield
    balances = [entry["balance_iec"] for entry in lab.state("wallets")["wallets"]]
    need(all(float(one) == 0 or float(one) > 1e-9 for one in balances), f"a made up balance: {balances}")


@case("the bridge's index is no database", said=r"rebuil|made anew|index.*(damaged|not a database)")
def index_malformed(lab: Lab) -> Iterator[None]:
    lab.down("bridge")
    path = _file(lab, INDEX)
    remove(path)
    path.write_bytes(b"no database" * 1000)
    lab.up("bridge")
    yield
    yield


@case("the bridge's index is deleted")
def index_deleted(lab: Lab) -> Iterator[None]:
    lab.down("bridge")
    remove(_file(lab, INDEX))
    lab.up("bridge")
    yield
    yield


@case("the deployment record is cut", said=r"deployment record.*damaged|record is damaged", asks=False)
def deployment_record_cut(lab: Lab) -> Iterator[None]:
    lab.down("bridge")
    path = _file(lab, "deployments/*.json")
    whole = halve(path)
    lab.up("bridge")
    yield
    # Put back as it was; nobody is asked to start anything.
    path.write_bytes(whole)
    yield
