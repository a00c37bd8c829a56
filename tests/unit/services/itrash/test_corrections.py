"""What people say that items really were: counted, once each, also after a restart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.evidence import attest
from rodeo.witness.correction import Correction, Judged
from rodeo.witness.statement import Classification
from services.itrash.corrections import AlreadyCorrected, Corrections, NotAnAuditor

ANNA, BERT = Account.create(), Account.create()
AUDITORS = {ANNA.address.lower(): "anna", BERT.address.lower(): "bert"}
CLASSES = {"glass", "metal", "unknown"}
BIN = Account.create()
SCOPE = {"chain_id": 1, "task_manager": "0x" + "11" * 20, "organization": "0x" + "22" * 20}


def add(kept: Corrections, who: LocalAccount, number: int, was: str, told: str) -> None:
    said = Correction(
        **SCOPE,
        bin="itrash",
        image_sha256="0x" + f"{number:064x}",
        item_class=was,
    )
    signed, classification = attest(said.model_dump(by_alias=True), who), attest(stated(number, told), BIN)
    kept.add(signed, said, classification, b"picture", CLASSES, AUDITORS)


def stated(number: int, told: str) -> dict[str, Any]:
    """What the bin signed of its picture of that number."""
    return Classification(
        **SCOPE,
        device="itrash",
        seq=number,
        previous=None,
        time_s=2.0,
        inputs="closed_bus",
        number=number,
        item_class=told,
        probabilities={told: 1.0},
        compartment="rest",
        full=False,
        image_sha256="0x" + f"{number:064x}",
        model_sha256="0x" + "33" * 32,
        thresholds_sha256="0x" + "44" * 32,
        claimants=(),
        shown_s=1.0,
    ).model_dump(mode="json", by_alias=True)


def test_how_often_the_bin_was_right_is_counted_by_person_and_survives_a_restart(tmp_path: Path) -> None:
    kept = Corrections(tmp_path, "itrash")
    add(kept, ANNA, 1, "glass", told="metal")
    add(kept, ANNA, 2, "glass", told="glass")
    add(kept, BERT, 1, "metal", told="metal")
    told = {(one.name, one.items, one.right) for one in kept.judged(AUDITORS)}
    assert told == {("anna", 2, 1), ("bert", 1, 1)}
    again = Corrections(tmp_path, "itrash")
    assert again.judged(AUDITORS) == kept.judged(AUDITORS)
    with pytest.raises(AlreadyCorrected) as refused:
        add(again, ANNA, 1, "metal", told="metal")
    assert refused.value.details["said"] == "glass"


def test_a_person_who_is_no_auditor_changes_nothing_and_one_who_was_still_counts(tmp_path: Path) -> None:
    kept = Corrections(tmp_path, "itrash")
    with pytest.raises(NotAnAuditor):
        add(kept, Account.create(), 1, "glass", told="glass")
    assert list(tmp_path.iterdir()) == []
    add(kept, ANNA, 1, "glass", told="glass")
    (only,) = kept.judged({})
    assert only == Judged(address=ANNA.address.lower(), name=None, items=1, right=1)


def test_a_damaged_file_does_not_count_and_keeps_the_bin_running(tmp_path: Path) -> None:
    (tmp_path / "0x12-0x34.json").write_text("{")
    assert Corrections(tmp_path, "itrash").judged(AUDITORS) == []


@pytest.mark.parametrize("forgery", ["signature", "statement", "name", "bin"])
def test_what_somebody_wrote_into_the_folder_does_not_count(tmp_path: Path, forgery: str) -> None:
    add(Corrections(tmp_path, "itrash"), ANNA, 1, "glass", told="metal")
    (path,) = tmp_path.glob("*.json")
    kept, own = json.loads(path.read_text()), "itrash"
    if forgery == "signature":
        kept["correction"]["payload"]["class"] = "metal"
    elif forgery == "statement":
        kept["classification"]["payload"]["class"] = "glass"
    elif forgery == "name":
        path = path.with_name(f"0x{2:064x}-{ANNA.address.lower()}.json")  # so that it counts twice
    else:
        own = "another"
    path.write_text(json.dumps(kept))
    told = [(one.items, one.right) for one in Corrections(tmp_path, own).judged(AUDITORS)]
    assert told == ([(1, 0)] if forgery == "name" else [])


def test_what_people_say_of_a_picture_is_told_by_their_names(tmp_path: Path) -> None:
    kept = Corrections(tmp_path, "itrash")
    add(kept, ANNA, 1, "glass", told="metal")
    add(kept, BERT, 1, "metal", told="metal")
    add(kept, BERT, 2, "glass", told="metal")
    auditors = {ANNA.address.lower(): "anna"}
    assert kept.said_of("0x" + f"{1:064x}", auditors) == {"anna": "glass", BERT.address: "metal"}
