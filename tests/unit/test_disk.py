"""A disk without room: what is reported of it, and that nothing is torn. A small tmpfs is mounted where that
is allowed; elsewhere the largest file that a process may write (RLIMIT_FSIZE) stands in for it."""

from __future__ import annotations

import logging
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from eth_account import Account

from rodeo.errors import DiskFull
from rodeo.evidence.attestation import attest
from rodeo.host.files import is_full, replace_file
from rodeo.runtime import disk
from rodeo.runtime.logs import TextFormatter, WholeLines
from rodeo.site.config import Site
from rodeo.witness.journal import Journal
from rodeo_testing.waiting import HANG_S
from tests.support.site import LAB


@contextmanager
def no_file_beyond(size: int) -> Iterator[None]:
    """No file of this process grows beyond `size` bytes: as on a full disk, part of a write may succeed."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def handler(path: Path) -> tuple[logging.Handler, int]:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    made = WholeLines(descriptor)
    made.setFormatter(TextFormatter("test"))
    return made, descriptor


def say(to: logging.Handler, text: str) -> None:
    to.emit(logging.makeLogRecord({"msg": text, "levelname": "INFO"}))


def test_a_log_loses_whole_lines_and_says_how_many(tmp_path: Path) -> None:
    path = tmp_path / "log"
    to, descriptor = handler(path)
    say(to, "before")
    with no_file_beyond(path.stat().st_size + 20):
        for number in range(5):
            say(to, f"lost {number}")
    say(to, "after")
    os.close(descriptor)
    lines = path.read_text().splitlines()
    assert [line.partition("test: ")[2] for line in lines] == [
        "before",
        "5 messages before this one are lost: the log could not be written",
        "after",
    ]


def test_a_log_that_ends_within_a_line_goes_on_with_a_new_one(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_text("2026-03-01 of a process that was ki")
    to, descriptor = handler(path)
    say(to, "after")
    os.close(descriptor)
    assert path.read_text().splitlines()[0] == "2026-03-01 of a process that was ki"
    assert path.read_text().splitlines()[1].endswith("test: after")


def test_a_process_logs_on_when_its_log_has_room_again(tmp_path: Path) -> None:
    """The log as a launcher gives it to a process."""
    logs = """
import logging, resource
from rodeo.runtime.logs import configure
configure("p")
log = logging.getLogger("x")
log.warning("one")
before = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (60, before[1]))
log.warning("two")
try:
    raise ValueError("with a traceback")
except ValueError:
    log.exception("three")
resource.setrlimit(resource.RLIMIT_FSIZE, before)
log.warning("four")
"""
    with (tmp_path / "p.log").open("ab") as output:
        subprocess.run([sys.executable, "-c", logs], stdout=output, stderr=output, check=True, timeout=HANG_S)
    said = [line.partition("p: ")[2] for line in (tmp_path / "p.log").read_text().splitlines()]
    assert said == ["one", "2 messages before this one are lost: the log could not be written", "four"]


def test_a_file_that_does_not_fit_leaves_the_old_one_and_no_part_of_it(tmp_path: Path) -> None:
    path = tmp_path / "journal.json"
    replace_file(path, "old")
    with no_file_beyond(100), pytest.raises(DiskFull) as full:
        replace_file(path, "new" * 1000)
    assert str(path) in full.value.message and is_full(full.value)
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("journal.json", "old")]


def test_a_number_that_could_not_be_journaled_is_the_next_statements(tmp_path: Path) -> None:
    """What was not told to anybody must not turn up later beside another statement of the same number."""
    account = Account.create()
    said = [attest({"seq": seq, "text": text}, account) for seq, text in ((1, "a"), (2, "lost"), (2, "b"))]
    with Journal(tmp_path / "statements.jsonl") as journal:
        journal.add(said[0])
        with no_file_beyond((tmp_path / "statements.jsonl").stat().st_size + 50), pytest.raises(DiskFull):
            journal.add(said[1])
        assert journal.seq == 1
        journal.add(said[2])
        assert journal.after(0, 10) == [said[0], said[2]]
    with Journal(tmp_path / "statements.jsonl") as journal:
        assert (journal.seq, journal.after(0, 10)) == (2, [said[0], said[2]])


def test_too_little_room_is_told_with_its_folder_and_threshold(tmp_path: Path) -> None:
    folders = [tmp_path / "not" / "there" / "yet"]
    assert disk.problem(folders, 0.0) == ""
    found = os.statvfs(tmp_path)
    free_mb = found.f_bavail * found.f_frsize / 1e6
    wanted_mb = 0.05 * found.f_blocks * found.f_frsize / 1e6
    problem = disk.problem(folders, 1e12)
    # Never more than a twentieth of the file system.
    assert bool(problem) == (free_mb < wanted_mb)


def test_data_logs_and_a_store_that_is_a_folder_are_looked_at(tmp_path: Path) -> None:
    own = Site.load(LAB).model_copy(update={"data_dir": tmp_path / "with space"})
    folders = disk.written_folders(own, own.data_dir / "oracle")
    assert folders == [own.data_dir / "oracle", own.data_dir / "logs", own.data_dir / "store"]
    elsewhere = own.model_copy(update={"store": own.store.model_copy(update={"url": "s3://bucket"})})
    assert disk.written_folders(elsewhere, own.data_dir / "oracle") == folders[:2]
