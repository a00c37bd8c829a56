"""What people say that items really were: counted, once each, also after a restart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.evidence.attestation import attest
from rodeo.witness.correction import Correction, Judged
from rodeo.witness.statement import Classification, Look
from services.itrash.corrections import AlreadyCorrected, Corrections, NotAnAuditor, pictures_of
from services.itrash.pictures import NoSuchPicture, Pictures

ANNA, BERT = Account.create(), Account.create()
AUDITORS = {ANNA.address.lower(): "anna", BERT.address.lower(): "bert"}
CLASSES = {"glass", "metal", "unknown"}
BIN = Account.create()
SCOPE = {"chain_id": 1, "task_manager": "0x" + "11" * 20, "organization": "0x" + "22" * 20}


def add(kept: Corrections, who: LocalAccount, number: int, was: str, told: str, earlier: int = 0) -> None:
    """A correction of the picture of that number, which the bin combined with so many before."""
    said = Correction(
        **SCOPE,
        bin="itrash",
        image_sha256="0x" + f"{number:064x}",
        item_class=was,
    )
    signed, classification = (
        attest(said.model_dump(by_alias=True), who),
        attest(stated(number, told, earlier), BIN),
    )
    kept.add(signed, said, classification, {said.image_sha256: b"picture"}, CLASSES, AUDITORS)


def stated(number: int, told: str, earlier: int = 0) -> dict[str, Any]:
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
        shown_s=float(number),
        earlier=[
            Look(image_sha256=f"0x{one:064x}", taken_s=float(one)) for one in range(number - earlier, number)
        ],
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


def test_an_item_that_was_shown_from_several_angles_counts_once_by_the_bins_last_answer(
    tmp_path: Path,
) -> None:
    kept = Corrections(tmp_path, "itrash")
    add(kept, ANNA, 9, "glass", told="glass", earlier=8)
    add(kept, ANNA, 3, "glass", told="metal", earlier=2)
    add(kept, ANNA, 6, "glass", told="metal", earlier=5)
    add(kept, ANNA, 12, "glass", told="metal", earlier=2)
    (anna,) = kept.judged(AUDITORS)
    assert (anna.items, anna.right) == (2, 1)


def test_two_items_are_one_where_a_later_answer_names_pictures_of_both(tmp_path: Path) -> None:
    kept = Corrections(tmp_path, "itrash")
    add(kept, ANNA, 1, "glass", told="metal")
    add(kept, ANNA, 2, "glass", told="metal")
    add(kept, ANNA, 3, "glass", told="glass", earlier=2)
    (anna,) = kept.judged(AUDITORS)
    assert (anna.items, anna.right) == (1, 1)


def test_all_pictures_of_a_corrected_answer_are_kept_that_the_bin_still_has(tmp_path: Path) -> None:
    gallery = Pictures(tmp_path / "pictures")
    first, last = (gallery.keep(data) for data in (b"first", b"last"))
    said = stated(3, "glass")
    said |= {
        "image_sha256": last,
        "earlier": [{"image_sha256": one, "taken_s": 0.0} for one in ("0x" + "99" * 32, first)],
    }
    found = pictures_of(attest(said, BIN), gallery)
    assert found == {last: b"last", first: b"first"}
    kept = Corrections(tmp_path / "corrections", "itrash")
    correction = Correction(**SCOPE, bin="itrash", image_sha256=last, item_class="glass")
    signed = attest(correction.model_dump(by_alias=True), ANNA)
    kept.add(signed, correction, attest(said, BIN), found, CLASSES, AUDITORS)
    assert {(tmp_path / "corrections" / name).read_bytes() for name in (first, last)} == {b"first", b"last"}


def test_an_answer_whose_own_picture_is_gone_is_not_corrected(tmp_path: Path) -> None:
    with pytest.raises(NoSuchPicture):
        pictures_of(attest(stated(1, "glass"), BIN), Pictures(tmp_path))


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
