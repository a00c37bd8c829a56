"""Learning from corrections: what was not signed so teaches nothing, and what gets worse is not written."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

torch = pytest.importorskip("torch", reason="needs the train extra: pip install -e '.[train]'")

from rodeo.config import Site, bin_process  # noqa: E402
from rodeo.evidence import attest  # noqa: E402
from rodeo.vision.classification import MODEL_DIR, WEIGHTS, load_preprocessing  # noqa: E402
from rodeo.vision.classifier import Classifier, to_input  # noqa: E402
from rodeo.vision.images import decode_image  # noqa: E402
from rodeo_testing.recordings import RENDERINGS  # noqa: E402
from services.itrash.corrections import Kept  # noqa: E402
from services.itrash.training import corrected, crossed  # noqa: E402
from services.itrash.training.compact import compact  # noqa: E402
from services.itrash.training.corrected import (  # noqa: E402
    NoCorrections,
    NotCrossValidated,
    WorseThanBefore,
    add_corrections,
    gather,
)
from services.itrash.training.crossed import Division  # noqa: E402
from services.itrash.training.dataset import CLASSES, Sample  # noqa: E402
from services.itrash.training.network import exported  # noqa: E402

ANNA, BERT, BIN = Account.create(), Account.create(), Account.create()
SCOPE = {"chain_id": 1, "task_manager": "0x" + "11" * 20, "organization": "0x" + "22" * 20}
CAN, PAPER = ((RENDERINGS / name).read_bytes() for name in ("metal_1.jpg", "paper_1.jpg"))
TINY = replace(corrected.GENTLE, finish_steps=1, batch=2, finish_rate=1e-6, known_rejected=0.2)


@pytest.fixture
def own(site: Site, tmp_path: Path) -> Site:
    return site.model_copy(update={"data_dir": tmp_path / "var"})


def correct(
    site: Site, who: LocalAccount, picture: bytes, was: str, about: dict[str, Any] | None = None
) -> Path:
    """What the bin keeps of a correction. `about` is changed in the bin's statement."""
    (config,) = site.bins
    folder = site.data_dir / bin_process(site, config.name) / "corrections"
    folder.mkdir(parents=True, exist_ok=True)
    name = "0x" + sha256(picture).hexdigest()
    said = {**SCOPE, "type": "bin.correction", "bin": config.name, "image_sha256": name, "class": was}
    told = {**SCOPE, "device": config.name, "image_sha256": name, "class": "metal"} | (about or {})
    kept = Kept(correction=attest(said, who), classification=attest(told, BIN))
    (folder / name).write_bytes(picture)
    path = folder / f"{name}-{who.address.lower()}.json"
    path.write_text(kept.model_dump_json())
    return path


def test_what_two_people_signed_of_a_picture_teaches_once(own: Site) -> None:
    correct(own, ANNA, CAN, "glass")
    correct(own, BERT, CAN, "glass")
    correct(own, ANNA, PAPER, "unknown")
    found, left_out = gather(own)
    assert {(one.label, len(one.people)) for one in found} == {("glass", 2), (None, 1)}
    assert left_out == []


def test_where_people_disagree_nothing_is_learnt(own: Site) -> None:
    correct(own, ANNA, CAN, "glass")
    correct(own, BERT, CAN, "plastic")
    found, left_out = gather(own)
    assert found == [] and "people disagree" in left_out[0]


def test_what_was_changed_after_it_was_signed_teaches_nothing(own: Site) -> None:
    path = correct(own, ANNA, CAN, "glass")
    kept = json.loads(path.read_text())
    kept["correction"]["payload"]["class"] = "paper"
    path.write_text(json.dumps(kept))
    found, left_out = gather(own)
    assert found == [] and "signature" in left_out[0]


@pytest.mark.parametrize(
    ("about", "reason"),
    [
        ({"device": "elsewhere"}, "another bin"),
        ({"image_sha256": "0x" + "77" * 32}, "differ in image_sha256"),
        ({"chain_id": 2}, "differ in chain_id"),
    ],
)
def test_a_correction_of_another_statement_teaches_nothing(
    own: Site, about: dict[str, Any], reason: str
) -> None:
    correct(own, ANNA, CAN, "glass", about)
    found, left_out = gather(own)
    assert found == [] and reason in left_out[0]


def test_an_exchanged_picture_teaches_nothing(own: Site) -> None:
    path = correct(own, ANNA, CAN, "glass")
    (path.parent / ("0x" + sha256(CAN).hexdigest())).write_bytes(PAPER)
    found, left_out = gather(own)
    assert found == [] and "another hash" in left_out[0]


@pytest.mark.parametrize("small", [False, True])
def test_what_was_exported_learns_on_from_where_it_was(tmp_path: Path, small: bool) -> None:
    weights = (MODEL_DIR / WEIGHTS).read_bytes()
    path = tmp_path / "before" / WEIGHTS
    path.parent.mkdir()
    path.write_bytes(compact(weights) if small else weights)
    shutil.copy(MODEL_DIR / "preprocessing.json", path.parent)
    before = Classifier(path.parent)
    picture = decode_image(CAN)
    with torch.inference_mode():
        found = exported(path).eval()(torch.from_numpy(to_input(picture, before.preprocessing)))
    np.testing.assert_allclose(found[0].numpy(), before.logits(picture), atol=0.05)


def drawn() -> list[Sample]:
    """Two photos of each class; the renderings of the tests will do."""
    return [
        Sample(
            decode_image((RENDERINGS / f"{label}_1.jpg").read_bytes()), label, f"{label}/{label}{number}.png"
        )
        for label in CLASSES
        for number in range(2)
    ]


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for part in crossed.PARTS:
        for photo in drawn():
            path = tmp_path / "data" / part / photo.name
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), photo.image_bgr)
    return tmp_path / "data"


@pytest.fixture
def folds(data: Path, tmp_path: Path) -> Path:
    """The installed network in place of each of the five."""
    names = [photo.name for photo in crossed.all_photos(data)]
    out = tmp_path / "folds"
    for fold in range(5):
        shutil.copytree(MODEL_DIR, out / f"fold{fold}")
    division = Division.of_arrays(names, np.arange(len(names)) % 5, np.arange(len(names)))
    (out / crossed.DIVISION).write_text(division.model_dump_json())
    return out


def rendered() -> list[Sample]:
    return [*drawn(), Sample(np.full((64, 64, 3), 90, np.uint8), None)]


def test_a_site_without_corrections_is_told_so(own: Site, data: Path, folds: Path, tmp_path: Path) -> None:
    with pytest.raises(NoCorrections):
        add_corrections(own, data, folds, rendered(), tmp_path / "out", TINY)


def test_without_all_cross_validated_networks_nothing_is_written(
    own: Site, data: Path, folds: Path, tmp_path: Path
) -> None:
    correct(own, ANNA, CAN, "metal")
    shutil.rmtree(folds / "fold4")
    with pytest.raises(NotCrossValidated) as refused:
        add_corrections(own, data, folds, rendered(), tmp_path / "out", TINY)
    assert refused.value.details["there"] == [0, 1, 2, 3]
    assert not (tmp_path / "out").exists()


def test_another_model_is_written_with_a_table_of_answers_and_its_hash(
    own: Site, data: Path, folds: Path, tmp_path: Path
) -> None:
    correct(own, ANNA, CAN, "metal")
    out = tmp_path / "out"
    report = add_corrections(own, data, folds, rendered(), out, TINY)
    (row,) = [line for line in report if line.startswith("| 0x")]
    assert row.count("metal (") == 2
    assert f"{ANNA.address} judged 1 pictures" in report
    made = Classifier(out)
    assert f"model_sha256 {made.model_sha256}" in report
    assert made.model_sha256 != Classifier().model_sha256
    assert made.preprocessing.temperature != load_preprocessing().temperature


def test_a_model_that_names_fewer_photos_rightly_is_not_written(
    own: Site, data: Path, folds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    correct(own, ANNA, CAN, "metal")

    def spoilt(*arguments: Any) -> Any:
        network = exported(MODEL_DIR / WEIGHTS).eval()
        torch.nn.init.zeros_(network.body._fc.weight)
        return network

    monkeypatch.setattr(corrected, "tuned", spoilt)
    with pytest.raises(WorseThanBefore) as refused:
        add_corrections(own, data, folds, rendered(), tmp_path / "out", TINY)
    assert refused.value.details["after"] < refused.value.details["before"]
    assert not (tmp_path / "out" / WEIGHTS).exists()
