"""The journal keeps the last attestations and survives a kill between any two bytes."""

from __future__ import annotations

from pathlib import Path

import pytest
from eth_account import Account

from rodeo.evidence.attestation import attest
from services.itrash.behaviour import State
from services.itrash.journal import Journal, JournalBroken

ACCOUNT = Account.create()


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    journal = Journal()
    journal.memory.state = State.AWAITING_DROP
    journal.memory.drops = 3
    journal.add("disposal", attest({"seq": 3}, ACCOUNT))
    journal.save(tmp_path / "journal.json")
    assert Journal.load(tmp_path / "journal.json") == journal


def test_a_bin_without_a_past_starts_empty(tmp_path: Path) -> None:
    assert Journal.load(tmp_path / "journal.json") == Journal()


def test_a_half_written_file_does_not_replace_the_journal(tmp_path: Path) -> None:
    Journal().save(tmp_path / "journal.json")
    (tmp_path / "journal.part").write_text('{"memory": {"sta')
    assert Journal.load(tmp_path / "journal.json") == Journal()


def test_a_broken_journal_is_an_error_and_not_an_empty_one(tmp_path: Path) -> None:
    (tmp_path / "journal.json").write_text("{}x")
    with pytest.raises(JournalBroken) as broken:
        Journal.load(tmp_path / "journal.json")
    assert broken.value.details["path"].endswith("journal.json")


def test_the_last_of_a_kind_is_found_and_old_ones_are_let_go() -> None:
    journal = Journal()
    assert journal.last("classification") is None
    for seq in range(60):
        journal.add("disposal" if seq % 2 else "classification", attest({"seq": seq}, ACCOUNT))
    last = journal.last("classification")
    assert last is not None
    assert last.payload == {"seq": 58}
    assert len(journal.entries) == 50
