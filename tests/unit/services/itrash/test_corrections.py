"""What people say that items really were: counted, once each, also after a restart."""

from __future__ import annotations

from pathlib import Path

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.evidence import attest
from rodeo.witness.correction import Correction, Judged
from services.itrash.corrections import AlreadyCorrected, Corrections, NotAnAuditor

ANNA, BERT = Account.create(), Account.create()
AUDITORS = {ANNA.address.lower(): "anna", BERT.address.lower(): "bert"}
CLASSES = {"glass", "metal", "unknown"}
BIN = Account.create()


def add(kept: Corrections, who: LocalAccount, number: int, was: str, told: str) -> None:
    said = Correction(
        chain_id=1,
        task_manager="0x" + "11" * 20,
        organization="0x" + "22" * 20,
        bin="itrash",
        image_sha256="0x" + f"{number:064x}",
        item_class=was,
    )
    signed, classification = attest(said.model_dump(), who), attest({"class": told}, BIN)
    kept.add(signed, said, classification, b"picture", CLASSES, AUDITORS)


def test_how_often_the_bin_was_right_is_counted_by_person_and_survives_a_restart(tmp_path: Path) -> None:
    kept = Corrections(tmp_path)
    add(kept, ANNA, 1, "glass", told="metal")
    add(kept, ANNA, 2, "glass", told="glass")
    add(kept, BERT, 1, "metal", told="metal")
    told = {(one.name, one.items, one.right) for one in kept.judged(AUDITORS)}
    assert told == {("anna", 2, 1), ("bert", 1, 1)}
    again = Corrections(tmp_path)
    assert again.judged(AUDITORS) == kept.judged(AUDITORS)
    with pytest.raises(AlreadyCorrected) as refused:
        add(again, ANNA, 1, "metal", told="metal")
    assert refused.value.details["said"] == "glass"


def test_a_person_who_is_no_auditor_changes_nothing_and_one_who_was_still_counts(tmp_path: Path) -> None:
    kept = Corrections(tmp_path)
    with pytest.raises(NotAnAuditor):
        add(kept, Account.create(), 1, "glass", told="glass")
    assert list(tmp_path.iterdir()) == []
    add(kept, ANNA, 1, "glass", told="glass")
    (only,) = kept.judged({})
    assert only == Judged(address=ANNA.address.lower(), name=None, items=1, right=1)


def test_a_damaged_file_does_not_count_and_keeps_the_bin_running(tmp_path: Path) -> None:
    (tmp_path / "0x12-0x34.json").write_text("{")
    assert Corrections(tmp_path).judged(AUDITORS) == []
