"""The bin's picture in the proof: there or refused; and the bin said what its network says of it."""

from __future__ import annotations

import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from rodeo.checks.case import CaseError
from rodeo.checks.report import Finding
from rodeo.evidence.proof import Proof, open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo.vision.classification import (
    MODEL_DIR,
    PREPROCESSING,
    UNKNOWN,
    WEIGHTS,
    combined,
    load_preprocessing,
    model_sha256,
    thresholds_sha256,
)
from rodeo.vision.classification import Classification as Answer
from rodeo.vision.classifier import Classifier
from rodeo.witness.statement import Classification
from rodeo_kinds.waste_disposal.checks import picture
from rodeo_kinds.waste_disposal.checks.picture import MAX_PICTURES
from rodeo_testing.recordings import RENDERINGS
from tests.unit.person.test_statement import ALICE, BINDING, NOW_NS, Clock

CAN, TIN, PAPER, BOTTLE = (
    (RENDERINGS / f"{name}.jpg").read_bytes() for name in ("metal_1", "metal_2", "paper_1", "glass_1")
)
OTHER = "0x" + "33" * 32
TOPIC = "/" + topics.BIN_IMAGE.name(bin="itrash")


def digest(picture: bytes) -> str:
    return "0x" + sha256(picture).hexdigest()


def said(image_sha256: str, label: str = "metal", **changed: Any) -> Classification:
    address = "0x" + "11" * 20
    fields = {
        "chain_id": 1, "task_manager": address, "organization": address, "device": "itrash", "seq": 1,
        "previous": None, "time_s": 1.0, "inputs": "sensor", "number": 1, "class": label,
        "probabilities": {label: 0.99}, "compartment": "yellow", "full": False, "image_sha256": image_sha256,
        "model_sha256": model_sha256(), "thresholds_sha256": thresholds_sha256(), "claimants": (),
        "shown_s": 1.0,
    }  # fmt: skip
    known = {name: value for name, value in fields.items() if name in _names()}
    return Classification.model_validate(known | changed)


def _names() -> set[str]:
    return {field.alias or name for name, field in Classification.model_fields.items()}


def shown(proof: Proof, bin_name: str, said: Classification) -> Finding:
    return picture.shown(proof, bin_name, said, [model_sha256()])


def proof(folder: Path, *pictures: bytes) -> Proof:
    recorder = Recorder(folder / "proof.mcap", BINDING, ALICE, Clock())  # type: ignore[arg-type]
    stamp = types.new("builtin_interfaces/msg/Time", sec=1, nanosec=0)
    header = types.new("std_msgs/msg/Header", stamp=stamp, frame_id="camera")
    for one in pictures:
        data = np.frombuffer(one, np.uint8)
        message = types.new(topics.BIN_IMAGE.type, header=header, format="jpeg", data=data)
        recorder.write_ros(TOPIC, topics.BIN_IMAGE.type, types.serialize(message), NOW_NS, NOW_NS)
    return open_proof(recorder.close().path)


def test_the_picture_is_found_by_its_hash_and_the_network_heard_beside_the_bin(tmp_path: Path) -> None:
    found = shown(proof(tmp_path, PAPER, CAN), "itrash", said(digest(CAN)))
    assert (found.passed, found.measured) == (True, "metal")
    assert 'the bin said "metal" (0.99); the same network says metal' in found.detail


def test_what_the_network_that_the_bin_names_does_not_say_of_the_picture_does_not_count(
    tmp_path: Path,
) -> None:
    found = shown(proof(tmp_path, PAPER), "itrash", said(digest(PAPER), "glass"))
    assert found.undecided and found.fault == "the bin itrash"  # the executor could only follow
    assert 'it said "glass", and the network that it names says paper' in found.detail


@pytest.fixture
def second(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of another network than the installed one, where an oracle looks for it."""
    beside = tmp_path_factory.mktemp("model")
    folder = beside / "made"
    folder.mkdir()
    (folder / WEIGHTS).write_bytes((MODEL_DIR / WEIGHTS).read_bytes())
    softer = load_preprocessing().model_copy(update={"temperature": 2.0})
    (folder / PREPROCESSING).write_text(softer.model_dump_json())
    named = folder.rename(beside / Classifier(folder).model_sha256)
    monkeypatch.setattr(picture, "MODEL_DIR", beside)
    return named


def test_another_listed_network_is_asked_where_the_oracle_has_it(tmp_path: Path, second: Path) -> None:
    answered, listed = Classifier(second).classify(PAPER), [model_sha256(), second.name]
    own = {"model_sha256": answered.model_sha256, "thresholds_sha256": answered.thresholds_sha256}
    file = proof(tmp_path, PAPER)
    honest = said(digest(PAPER), "paper", probabilities=answered.told, **own)
    found = picture.shown(file, "itrash", honest, listed)
    assert (found.passed, found.measured) == (True, "paper"), found.detail
    for label, probabilities in (("glass", {"glass": 1.0}), ("paper", {"paper": 1.0})):
        lie = said(digest(PAPER), label, probabilities=probabilities, **own)
        found = picture.shown(file, "itrash", lie, listed)
        assert found.undecided and found.fault == "the bin itrash"
        assert "than the network that it names has" in found.detail or "says paper" in found.detail


def test_what_is_said_in_the_name_of_a_listed_network_that_the_oracle_does_not_have_is_for_others(
    tmp_path: Path,
) -> None:
    """Else a bin that names it could say what it likes."""
    other = said(digest(PAPER), "glass", model_sha256=OTHER)
    found = picture.shown(proof(tmp_path, PAPER), "itrash", other, [model_sha256(), OTHER])
    assert found.undecided and found.fault == "the oracle"
    assert str(MODEL_DIR / OTHER) in found.detail


def test_another_network_in_the_folder_of_a_listed_one_is_not_asked(tmp_path: Path, second: Path) -> None:
    second.rename(second.parent / OTHER)
    other = said(digest(PAPER), "paper", model_sha256=OTHER)
    found = picture.shown(proof(tmp_path, PAPER), "itrash", other, [OTHER])
    assert found.undecided and found.fault == "the oracle"
    assert second.name in found.detail


def answer(plastic: float, item: float = 1.0) -> Answer:
    return Answer("", {"plastic": plastic, "paper": round(1 - plastic, 4)}, item, unknown_below=0.5)


@pytest.mark.parametrize(
    ("found", "may_be_said"),
    [
        (answer(0.9), {"plastic"}),
        (answer(0.505), {"plastic", "paper", UNKNOWN}),
        (answer(0.54), {"plastic"}),
        (answer(0.9, item=0.5), {UNKNOWN}),
        (answer(0.9, item=0.545), {"plastic", UNKNOWN}),
    ],
)
def test_two_machines_may_differ_by_rounding(found: Answer, may_be_said: set[str]) -> None:
    assert picture._may_be_said(found) == may_be_said


def test_other_thresholds_than_those_of_the_named_network_do_not_count(tmp_path: Path) -> None:
    found = shown(proof(tmp_path, CAN), "itrash", said(digest(CAN), thresholds_sha256=OTHER))
    assert found.undecided and found.fault == "the bin itrash"
    assert "other thresholds" in found.detail


def test_a_listed_network_with_classes_exchanged_is_another_one_and_does_not_count(tmp_path: Path) -> None:
    (tmp_path / WEIGHTS).write_bytes((MODEL_DIR / WEIGHTS).read_bytes())
    text = (MODEL_DIR / PREPROCESSING).read_text()
    exchanged = text.replace("glass", "-").replace("plastic", "glass").replace("-", "plastic")
    (tmp_path / PREPROCESSING).write_text(exchanged)
    answered = Classifier(tmp_path).classify(BOTTLE)
    assert answered.label == "plastic"  # the installed one says glass
    statement = said(
        digest(BOTTLE),
        answered.label,
        probabilities=answered.told,
        model_sha256=answered.model_sha256,
        thresholds_sha256=answered.thresholds_sha256,
    )
    found = shown(proof(tmp_path, BOTTLE), "itrash", statement)
    assert found.undecided and found.fault == "the bin itrash"
    assert "which the rules do not list" in found.detail


def test_the_word_of_a_network_that_the_rules_do_not_list_does_not_count(tmp_path: Path) -> None:
    other, file = said(digest(CAN), model_sha256=OTHER), proof(tmp_path, CAN)
    found = shown(file, "itrash", other)
    assert found.undecided and found.fault == "the bin itrash"  # the executor did not choose it
    assert OTHER in found.detail and model_sha256() in found.detail


def test_a_file_that_is_not_the_network_of_the_rules_is_not_loaded_and_the_oracle_is_at_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = model_sha256()
    monkeypatch.setattr(picture, "model_sha256", lambda: OTHER)  # as the rules had it before the file changed
    picture.network.cache_clear()
    file = proof(tmp_path, CAN)
    found = picture.shown(file, "itrash", said(digest(CAN), model_sha256=OTHER), [OTHER])
    assert found.undecided and found.fault == "the oracle"
    assert OTHER in found.detail and installed in found.detail


def test_a_proof_without_pictures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="not in the recording"):
        shown(proof(tmp_path), "itrash", said(digest(CAN)))


def test_a_picture_of_another_hash_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CaseError) as refused:
        shown(proof(tmp_path, PAPER), "itrash", said(digest(CAN)))
    assert refused.value.details["pictures"] == 1


def test_the_picture_of_another_bin_is_not_this_ones(tmp_path: Path) -> None:
    with pytest.raises(CaseError):
        shown(proof(tmp_path, CAN), "elsewhere", said(digest(CAN)))


@pytest.mark.parametrize("picture", [b"", b"\xff\xd8\xff\xe0 no picture"], ids=["empty", "no picture"])
def test_a_bin_that_signs_what_is_no_picture_costs_the_robot_nothing(tmp_path: Path, picture: bytes) -> None:
    """The picture has the hash that the bin signed: the robot cannot have put another one there."""
    found = shown(proof(tmp_path, picture), "itrash", said(digest(picture)))
    assert found.undecided and found.fault == "the bin itrash"
    assert "no picture" in found.detail


def test_a_hash_of_zeros_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CaseError):
        shown(proof(tmp_path, CAN, b""), "itrash", said("0x" + "00" * 32))


def test_more_pictures_than_a_bin_takes_are_refused_before_they_are_read(tmp_path: Path) -> None:
    found = shown(proof(tmp_path, *[b"x"] * (MAX_PICTURES + 1)), "itrash", said(digest(CAN)))
    assert (found.passed, found.limit) == (False, MAX_PICTURES)


@pytest.mark.long
def test_the_checks_start_without_opencv_and_onnxruntime() -> None:
    program = (
        "import sys, rodeo_kinds.waste_disposal.checks.picture; "
        "print(bool({'cv2', 'onnxruntime'} & set(sys.modules)))"
    )
    answer = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert answer.stdout.strip() == "False"


def test_a_malformed_message_on_the_pictures_topic_is_a_finding(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", BINDING, ALICE, Clock())  # type: ignore[arg-type]
    recorder.write_ros(TOPIC, topics.BIN_IMAGE.type, b"\0\1\0\0", NOW_NS, NOW_NS)
    with pytest.raises(CaseError):
        shown(open_proof(recorder.close().path), "itrash", said(digest(CAN)))


def look(picture: bytes, taken_s: float = 0.5) -> dict[str, Any]:
    return {"image_sha256": digest(picture), "taken_s": taken_s}


def test_all_pictures_that_were_combined_must_be_in_the_proof(tmp_path: Path) -> None:
    both = said(digest(CAN), earlier=[look(TIN)])
    found = shown(proof(tmp_path, TIN, CAN), "itrash", both)
    assert found.passed and "of 2 pictures; the same network says" in found.detail
    (tmp_path / "other").mkdir()
    with pytest.raises(CaseError) as refused:
        shown(proof(tmp_path / "other", CAN), "itrash", both)
    assert refused.value.details["image_sha256"] == digest(TIN)


def test_probabilities_that_the_named_pictures_do_not_make_do_not_count(tmp_path: Path) -> None:
    """By them the site's costs choose the compartment."""
    file = proof(tmp_path, TIN, CAN)
    network = picture.network(model_sha256())
    honest = combined([network.classify(one) for one in (TIN, CAN)]).told
    assert shown(file, "itrash", said(digest(CAN), probabilities=honest, earlier=[look(TIN)])).passed
    for other in ({"metal": 0.9, "glass": 0.1}, {}):
        padded = shown(file, "itrash", said(digest(CAN), probabilities=other))
        assert padded.undecided and padded.fault == "the bin itrash"
        assert "other probabilities" in padded.detail


@pytest.mark.parametrize(
    ("earlier", "problem"),
    [
        ([look(CAN)], "named twice"),
        ([look(PAPER), look(PAPER)], "named twice"),
        ([look(PAPER, 1.5)], "order of their times"),
        ([look(bytes([n])) for n in range(9)], "at most 8"),
    ],
)
def test_a_statement_names_each_picture_once_in_their_order(
    earlier: list[dict[str, Any]], problem: str
) -> None:
    with pytest.raises(ValidationError, match=problem):
        said(digest(CAN), earlier=earlier)
