"""Learning from corrections: what was not signed so teaches nothing, and what gets worse is not written."""

from __future__ import annotations

import json
import shutil
import tomllib
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

torch = pytest.importorskip("torch", reason="needs pip install -r training/requirements.txt")

from rodeo.bus.messages import Device  # noqa: E402
from rodeo.bus.session import Bus  # noqa: E402
from rodeo.errors import BusUnavailable  # noqa: E402
from rodeo.evidence.attestation import attest  # noqa: E402
from rodeo.site.config import Site  # noqa: E402
from rodeo.site.names import bin_process  # noqa: E402
from rodeo.vision.classification import MODEL_DIR, WEIGHTS, digest, load_preprocessing  # noqa: E402
from rodeo.vision.classifier import Classifier, to_input  # noqa: E402
from rodeo.vision.images import decode_image  # noqa: E402
from rodeo.witness.statement import Classification, Scope  # noqa: E402
from rodeo_testing.recordings import RENDERINGS  # noqa: E402
from services.itrash.corrections import Kept  # noqa: E402
from training import corrected, crossed  # noqa: E402
from training.allowed import Allowed, SiteSilent  # noqa: E402
from training.compact import compact  # noqa: E402
from training.corrected import (  # noqa: E402
    Material,
    NoCorrections,
    NotCrossValidated,
    SameFolder,
    WorseThanBefore,
    add_corrections,
    gather,
)
from training.cross_validate import learnt_without  # noqa: E402
from training.crossed import Division, OtherRecipe  # noqa: E402
from training.dataset import CLASSES, NoPhotos, Sample  # noqa: E402
from training.held_out import HeldOut  # noqa: E402
from training.network import exported  # noqa: E402
from training.others import World  # noqa: E402
from training.train import Recipe, balanced  # noqa: E402

ANNA, BERT, BIN = Account.create(), Account.create(), Account.create()
SCOPE = {"chain_id": 1, "task_manager": "0x" + "11" * 20, "organization": "0x" + "22" * 20}
CAN, PAPER = ((RENDERINGS / name).read_bytes() for name in ("metal_1.jpg", "paper_1.jpg"))
SHOWN_S = 100.0
THRESHOLDS = MODEL = "0x" + "33" * 32
WORLD = World(
    scenes=(np.full((80, 90, 3), 120, np.uint8),),
    cutouts=(np.full((40, 30, 4), 200, np.uint8),),
    sha256="ab" * 32,
)
TINY = replace(Recipe(), batch=2, known_rejected=0.2)
BRIEF = replace(corrected.GENTLE, steps=1, warmup_steps=1, px=64, rate=1e-6)


@pytest.fixture
def own(site: Site, tmp_path: Path) -> Site:
    return site.model_copy(update={"data_dir": tmp_path / "var"})


def key(account: LocalAccount = BIN, **changed: Any) -> Device:
    return Device(
        address=account.address, role="bin", name="itrash", owner=ANNA.address, registered=10.0
    ).model_copy(update=changed)


def allowed(*keys: Device) -> Allowed:
    """Anna and Bert are auditors."""
    people = frozenset(one.address.lower() for one in (ANNA, BERT))
    return Allowed(Scope.model_validate(SCOPE), people, keys or (key(),))


def correct(
    site: Site,
    who: LocalAccount,
    picture: bytes,
    was: str,
    about: dict[str, Any] | None = None,
    teller: LocalAccount = BIN,
) -> Path:
    """What the bin keeps of a correction. `about` is changed in the bin's statement."""
    (config,) = site.bins
    folder = site.data_dir / bin_process(site, config.name) / "corrections"
    folder.mkdir(parents=True, exist_ok=True)
    name = digest(picture)
    said = {**SCOPE, "type": "bin.correction", "bin": config.name, "image_sha256": name, "class": was}
    told = Classification(
        **SCOPE,
        device=config.name,
        seq=1,
        previous=None,
        time_s=SHOWN_S + 1,
        inputs="closed_bus",
        number=1,
        item_class="metal",
        probabilities={"metal": 1.0},
        compartment="metal",
        full=False,
        image_sha256=name,
        model_sha256=MODEL,
        thresholds_sha256=THRESHOLDS,
        claimants=(),
        shown_s=SHOWN_S,
    ).model_dump(mode="json", by_alias=True) | (about or {})
    kept = Kept(correction=attest(said, who), classification=attest(told, teller))
    (folder / name).write_bytes(picture)
    path = folder / f"{name}-{who.address.lower()}.json"
    path.write_text(kept.model_dump_json())
    return path


def test_what_two_people_signed_of_a_picture_teaches_once(own: Site) -> None:
    correct(own, ANNA, CAN, "glass")
    correct(own, BERT, CAN, "glass")
    correct(own, ANNA, PAPER, "unknown")
    found, left_out = gather(own, allowed())
    assert {(one.label, len(one.people)) for one in found} == {("glass", 2), (None, 1)}
    assert left_out == []


def test_all_pictures_that_the_bin_combined_teach_and_are_one_item(own: Site) -> None:
    """The bin asked for another angle: a second answer names the pictures of the first, too."""
    earlier = [{"image_sha256": digest(PAPER), "taken_s": SHOWN_S - 1}]
    first = correct(own, BERT, PAPER, "glass", {"shown_s": SHOWN_S - 1})
    path = correct(own, ANNA, CAN, "glass", {"earlier": earlier})
    (found,), left_out = gather(own, allowed())
    assert (found.pictures, found.name, left_out) == ((CAN, PAPER), digest(CAN), [])
    assert set(found.people) == {ANNA.address, BERT.address}
    assert [sample.label for sample in found.samples] == ["glass", "glass"]
    correct(own, BERT, PAPER, "plastic")  # of the same item, though of another picture
    found_now, reasons = gather(own, allowed())
    assert found_now == [] and "people disagree" in reasons[0]
    first.unlink()
    (first.parent / digest(PAPER)).unlink()  # the bin had let go of it
    (alone,), _ = gather(own, allowed())
    assert alone.pictures == (CAN,)
    (path.parent / digest(PAPER)).write_bytes(CAN)
    assert gather(own, allowed()) == ([], [f"itrash/{path.name}: the picture has another hash"])


def test_a_copy_of_a_correction_teaches_nothing_and_counts_for_nobody(own: Site) -> None:
    path = correct(own, ANNA, CAN, "glass")
    for number in range(4):
        shutil.copy(path, path.with_name(f"{number}.json"))
    (found,), left_out = gather(own, allowed())
    assert (found.label, found.people) == ("glass", (ANNA.address,))
    assert len(left_out) == 4 and all("another picture, or by somebody else" in one for one in left_out)


def test_a_second_word_of_the_same_person_in_another_file_changes_nothing(own: Site) -> None:
    """The bin refuses it (`AlreadyCorrected`), so it is nobody's disagreement."""
    second = correct(own, ANNA, CAN, "plastic")
    second.rename(second.with_name("second.json"))
    correct(own, ANNA, CAN, "glass")
    (found,), (reason,) = gather(own, allowed())
    assert (found.label, found.people) == ("glass", (ANNA.address,))
    assert "second.json" in reason


def test_where_people_disagree_nothing_is_learnt(own: Site) -> None:
    correct(own, ANNA, CAN, "glass")
    correct(own, BERT, CAN, "plastic")
    found, left_out = gather(own, allowed())
    assert found == [] and "people disagree" in left_out[0]


def test_what_was_changed_after_it_was_signed_teaches_nothing(own: Site) -> None:
    path = correct(own, ANNA, CAN, "glass")
    kept = json.loads(path.read_text())
    kept["correction"]["payload"]["class"] = "paper"
    path.write_text(json.dumps(kept))
    found, left_out = gather(own, allowed())
    assert found == [] and "signature" in left_out[0]


@pytest.mark.parametrize(
    ("about", "reason"),
    [
        ({"device": "elsewhere"}, "another bin"),
        ({"image_sha256": "0x" + "77" * 32}, "another picture"),
        ({"chain_id": 2}, "differ in chain_id"),
        ({"class": 7}, "class: Input should be a valid string"),
    ],
)
def test_a_correction_of_another_statement_teaches_nothing(
    own: Site, about: dict[str, Any], reason: str
) -> None:
    correct(own, ANNA, CAN, "glass", about)
    found, left_out = gather(own, allowed())
    assert found == [] and reason in left_out[0]


def test_an_exchanged_picture_teaches_nothing(own: Site) -> None:
    path = correct(own, ANNA, CAN, "glass")
    (path.parent / ("0x" + sha256(CAN).hexdigest())).write_bytes(PAPER)
    found, left_out = gather(own, allowed())
    assert found == [] and "another hash" in left_out[0]


def test_what_somebody_else_than_an_auditor_signed_teaches_nothing(own: Site) -> None:
    stranger = Account.create()
    correct(own, stranger, CAN, "glass")
    correct(own, ANNA, PAPER, "paper")
    (found,), (reason,) = gather(own, allowed())
    assert found.people == (ANNA.address,)
    assert f"{stranger.address} is no auditor" in reason


@pytest.mark.parametrize(
    ("keys", "counts"),
    [
        ((key(),), True),
        ((key(revoked=SHOWN_S + 50, revoked_because="superseded"),), True),
        ((key(revoked=SHOWN_S - 50, revoked_because="superseded"),), False),
        ((key(revoked=SHOWN_S + 50, revoked_because="compromised"),), False),
        ((key(registered=SHOWN_S + 50),), False),
        ((key(name="elsewhere"),), False),
        ((key(role="robot"),), False),
        ((key(Account.create()),), False),
    ],
)
def test_a_statement_counts_if_its_key_was_the_bins_when_it_signed(
    own: Site, keys: tuple[Device, ...], counts: bool
) -> None:
    correct(own, ANNA, CAN, "glass")
    found, left_out = gather(own, allowed(*keys))
    assert bool(found) is counts
    assert counts or f"{BIN.address} was not registered as the bin's key" in left_out[0]


def test_a_statement_that_was_forged_beside_a_picture_teaches_nothing(own: Site) -> None:
    """Somebody who can write into the bin's folder signs for the bin, and has an auditor's word from
    elsewhere."""
    forger = Account.create()
    correct(own, ANNA, CAN, "glass", teller=forger)
    found, left_out = gather(own, allowed())
    assert found == [] and f"{forger.address} was not registered" in left_out[0]


def test_a_correction_for_another_organization_teaches_nothing(own: Site) -> None:
    correct(own, ANNA, CAN, "glass")
    elsewhere = replace(allowed(), scope=Scope.model_validate(SCOPE | {"organization": "0x" + "99" * 20}))
    found, left_out = gather(own, elsewhere)
    assert found == [] and "differ in organization" in left_out[0]


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


def test_the_same_corrections_make_the_same_network() -> None:
    one = corrected.Corrected((CAN,), "metal", "a can", (ANNA.address,))
    arguments = (MODEL_DIR / WEIGHTS, drawn(), [one], material(), TINY, BRIEF)
    first, second = (corrected.tuned(*arguments).state_dict() for _ in range(2))
    assert all(torch.equal(value, second[name]) for name, value in first.items())
    installed = exported(MODEL_DIR / WEIGHTS).state_dict()
    opinion = [name for name in installed if name.startswith("second.")]
    assert opinion and all(torch.equal(first[name], installed[name]) for name in opinion), "it stays as it is"


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


@pytest.fixture(autouse=True)
def seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a network sees in pictures, without one: where they are light and dark."""

    def features(samples: list[Sample]) -> np.ndarray:
        small = [cv2.resize(one.image_bgr, (8, 8), interpolation=cv2.INTER_AREA) for one in samples]
        flat = np.stack(small).astype(float).reshape(len(samples), -1)
        return np.asarray(flat - flat.mean(axis=1, keepdims=True))

    monkeypatch.setattr(corrected, "seen_by_imagenet", features)


def material() -> Material:
    nothing = (RENDERINGS / "unknown_1.jpg").read_bytes()
    empty = Sample(decode_image(nothing), None)
    return Material(rendered(), WORLD, HeldOut(drawn(), [empty], [nothing]))


def too_early() -> Any:
    raise AssertionError("takes minutes, and there is nothing to learn")


def test_a_site_without_corrections_is_told_so(own: Site, data: Path, folds: Path, tmp_path: Path) -> None:
    with pytest.raises(NoCorrections):
        add_corrections(own, allowed(), data, folds, too_early, tmp_path / "out", TINY, BRIEF)


def test_a_folder_without_photos_is_told_before_anything_is_rendered(
    own: Site, folds: Path, tmp_path: Path
) -> None:
    correct(own, ANNA, CAN, "metal")
    with pytest.raises(NoPhotos) as refused:
        add_corrections(own, allowed(), tmp_path, folds, too_early, tmp_path / "out", TINY, BRIEF)
    assert refused.value.details == {"folder": str(tmp_path / "train" / CLASSES[0])}


def test_a_site_that_does_not_run_is_to_be_started(own: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    def silent(*_arguments: Any, **_more: Any) -> Any:
        raise BusUnavailable("no router answers")

    monkeypatch.setattr(Bus, "open", silent)
    with pytest.raises(SiteSilent, match="rodeo up") as refused:
        Allowed.at(own)
    assert "no router answers" in refused.value.details["reason"]


def test_without_all_cross_validated_networks_nothing_is_written(
    own: Site, data: Path, folds: Path, tmp_path: Path
) -> None:
    correct(own, ANNA, CAN, "metal")
    shutil.rmtree(folds / "fold4")
    with pytest.raises(NotCrossValidated) as refused:
        add_corrections(own, allowed(), data, folds, material, tmp_path / "out", TINY, BRIEF)
    assert refused.value.details["there"] == [0, 1, 2, 3]
    assert not (tmp_path / "out").exists()


def test_networks_of_another_recipe_than_the_installed_one_measure_nothing(
    own: Site, data: Path, folds: Path, tmp_path: Path
) -> None:
    correct(own, ANNA, CAN, "metal")
    path = folds / "fold2" / crossed.TRAINING
    path.write_text(path.read_text().replace('"seed": 8', '"seed": 9'))
    with pytest.raises(OtherRecipe):
        add_corrections(own, allowed(), data, folds, material, tmp_path / "out", TINY, BRIEF)


def test_another_model_is_written_with_a_table_of_answers_and_its_hash(
    own: Site, data: Path, folds: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    correct(own, ANNA, CAN, "metal")
    correct(own, Account.create(), PAPER, "paper")
    caplog.set_level("INFO")
    out = tmp_path / "out"
    report = add_corrections(own, allowed(), data, folds, material, out, TINY, BRIEF)
    (row,) = [line for line in report if line.startswith("| 0x")]
    assert row.count("metal (") == 2
    assert f"{ANNA.address} judged 1 item" in report
    said = [record.getMessage() for record in caplog.records]
    first = next(number for number, line in enumerate(said) if line.startswith("network 1 of 6"))
    assert "1 corrected item to learn from" in said[:first]
    assert any("is no auditor" in line for line in said[:first])  # not after hours
    made = Classifier(out)
    assert f"model_sha256 {made.model_sha256}" in report
    assert made.model_sha256 != Classifier().model_sha256
    kept = crossed.Training.model_validate_json((out / crossed.TRAINING).read_bytes())
    assert kept.learnt_all
    crossed.check(out / "folds", kept)  # the next corrections can be learnt from where these are installed
    assert made.preprocessing.temperature != load_preprocessing().temperature
    assert any(str(MODEL_DIR) in line for line in report)  # where it is to be put
    assert any(f"--folds {out / 'folds'} and another --out" in line for line in report)
    # What is to be written into the site file: the rules are the same before and after the files are copied.
    start = report.index("    [[kinds]]")
    text = "\n".join(report[start : report.index("", start)])
    listed = {one["name"]: one["models_sha256"] for one in tomllib.loads(text)["kinds"]}
    assert listed == {"waste_disposal": sorted([made.model_sha256, Classifier().model_sha256])}


@pytest.mark.parametrize("small", [True, False])
def test_nothing_but_the_corrections_makes_a_difference_between_before_and_after(
    own: Site, data: Path, folds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small: bool
) -> None:
    """Each network learns on from the photos that it learnt from, and has weights of as many bits."""
    correct(own, ANNA, CAN, "metal")
    weights = (MODEL_DIR / WEIGHTS).read_bytes()
    for fold in range(5):
        (folds / f"fold{fold}" / WEIGHTS).write_bytes(compact(weights) if small else weights)
    learnt: list[list[str]] = []

    def unchanged(source: Path, photos: list[Sample], *_more: Any) -> Any:
        learnt.append([photo.name for photo in photos])
        return exported(source).eval()

    monkeypatch.setattr(corrected, "tuned", unchanged)
    out = tmp_path / "out"
    add_corrections(own, allowed(), data, folds, material, out, TINY, BRIEF)
    photos, division = crossed.all_photos(data), crossed.division_in(folds)
    assert division is not None
    *of_folds, of_all = learnt
    assert of_folds == [[one.name for one in learnt_without(photos, division, fold)] for fold in range(5)]
    assert of_all == [photo.name for photo in photos]
    before, after = crossed.measured(folds, data), crossed.measured(out / "folds", data)
    np.testing.assert_allclose(after.answers.logits, before.answers.logits, atol=0.05)
    for fold in range(5):
        was, now = ((one / f"fold{fold}" / WEIGHTS).stat().st_size for one in (folds, out / "folds"))
        assert now == pytest.approx(was, rel=0.01)


def test_no_network_learns_from_a_near_duplicate_of_the_photos_that_measure_it(
    own: Site, data: Path, folds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The can's photos are in all folds but one."""
    darker = cv2.imencode(".png", cv2.convertScaleAbs(decode_image(CAN), alpha=0.8))[1].tobytes()
    nothing = (RENDERINGS / "unknown_1.jpg").read_bytes()
    correct(own, ANNA, darker, "metal")
    correct(own, ANNA, nothing, "unknown")
    learnt: list[set[str | None]] = []

    def unchanged(source: Path, _photos: list[Sample], given: list[corrected.Corrected], *_more: Any) -> Any:
        learnt.append({one.label for one in given})
        return exported(source).eval()

    monkeypatch.setattr(corrected, "tuned", unchanged)
    report = add_corrections(own, allowed(), data, folds, material, tmp_path / "out", TINY, BRIEF)
    assert learnt == [{None}, {None}, {None}, {"metal", None}, {None}, {"metal", None}]
    said = "learns without 1 corrected item: near-duplicates of photos that measure it"
    assert [line for line in report if "learns without" in line] == [
        f"network {n} {said}" for n in (1, 2, 3, 5)
    ]


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
        add_corrections(own, allowed(), data, folds, material, tmp_path / "out", TINY, BRIEF)
    ((what, before),) = refused.value.details["before"].items()
    after = refused.value.details["after"][what]
    assert what.startswith("24 photos named rightly") and after < before
    assert list((tmp_path / "out").iterdir()) == []


def test_a_model_that_takes_what_is_no_waste_for_waste_is_not_written(
    own: Site, data: Path, folds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its photos are named as before, so the cross-validated networks do not show it."""
    correct(own, ANNA, CAN, "metal")

    def credulous(source: Path, *_more: Any) -> Any:
        network = exported(source).eval()
        if source.parent == MODEL_DIR:
            with torch.no_grad():
                network.body._fc.bias[-1] -= 100.0
        return network

    monkeypatch.setattr(corrected, "tuned", credulous)
    monkeypatch.setattr(corrected, "calibrated", lambda *_: {"unknown_below": 0.01})
    with pytest.raises(WorseThanBefore) as refused:
        add_corrections(own, allowed(), data, folds, material, tmp_path / "out", TINY, BRIEF)
    counted = ("drawn pictures without an item called unknown", "real photos of other things called unknown")
    assert refused.value.details == {
        "before": dict.fromkeys(counted, 1.0),
        "after": dict.fromkeys(counted, 0.0),
    }
    assert list((tmp_path / "out").iterdir()) == [], "neither is what a later run would take for the folds"


def test_what_is_learnt_on_from_is_not_replaced(own: Site, data: Path, folds: Path, tmp_path: Path) -> None:
    correct(own, ANNA, CAN, "metal")
    for out, source in ((tmp_path, folds), (MODEL_DIR, MODEL_DIR)):
        with pytest.raises(SameFolder) as refused:
            add_corrections(own, allowed(), data, folds, too_early, out, TINY, BRIEF)
        assert refused.value.details == {"folder": str(source)}


def test_the_next_corrections_replace_what_an_earlier_run_wrote(
    own: Site, data: Path, folds: Path, tmp_path: Path
) -> None:
    correct(own, ANNA, CAN, "metal")
    out = tmp_path / "out"
    (out / "folds" / "fold0").mkdir(parents=True)
    (out / "folds" / "fold0" / "of an earlier run").touch()
    add_corrections(own, allowed(), data, folds, material, out, TINY, BRIEF)
    written = {"folds", WEIGHTS, "preprocessing.json", crossed.TRAINING}
    assert {path.name for path in out.iterdir()} == written
    assert {path.name for path in (out / "folds" / "fold0").iterdir()} == written - {"folds"}


def test_each_share_that_fell_is_told_and_what_stayed_or_rose_is_not() -> None:
    before = {"photos": 0.9, "renderings": 1.0, "drawn": 0.8}
    corrected.refuse_worse(before, before | {"photos": 0.95})
    with pytest.raises(WorseThanBefore) as refused:
        corrected.refuse_worse(before, {"photos": 0.95, "renderings": 0.99, "drawn": 0.8})
    assert refused.value.details == {"before": {"renderings": 1.0}, "after": {"renderings": 0.99}}


@pytest.mark.parametrize(("corrections", "times"), [(1, 20), (10, 20), (100, 2), (1000, 1)])
def test_a_single_correction_is_no_tenth_of_what_is_learnt(corrections: int, times: int) -> None:
    assert corrected.repeated(2091, corrections) == times


def test_a_network_that_may_learn_from_no_correction_repeats_none() -> None:
    assert corrected.repeated(2091, 0) == 0


def test_a_thing_that_is_no_waste_is_not_drawn_more_often_than_a_photo_of_the_rarest_class() -> None:
    """The photos of waste have no such class, so it would count as a very rare one."""
    nothing = Sample(np.zeros((8, 8, 3), np.uint8), None, "a hand")
    photos = [*drawn() * 10, *[one for one in drawn() if one.label == "glass"] * 30]
    alone, among = balanced(photos), balanced([*photos, nothing])
    assert among[-1] == pytest.approx(among[:-1].max())
    np.testing.assert_allclose(among[:-1] / among[:-1].sum(), alone)


def test_a_correction_is_learnt_from_as_often_as_it_may_be_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    learnt: list[str] = []

    def steps(_weights: Path, photos: list[Sample], *_more: Any) -> None:
        learnt.extend(photo.name for photo in photos)
        raise KeyboardInterrupt

    monkeypatch.setattr(corrected, "weathered", steps)
    one = corrected.Corrected((CAN,), "metal", "a can", (ANNA.address,))
    with pytest.raises(KeyboardInterrupt):
        corrected.tuned(MODEL_DIR / WEIGHTS, drawn() * 200, [one], material(), TINY, BRIEF)
    assert learnt.count("a can") == corrected.MOST_REPEATED
    learnt.clear()
    several = replace(one, pictures=(CAN, PAPER, CAN))
    with pytest.raises(KeyboardInterrupt):
        corrected.tuned(MODEL_DIR / WEIGHTS, drawn() * 200, [several], material(), TINY, BRIEF)
    assert learnt.count("a can") == corrected.MOST_REPEATED, "one item, however many pictures it has"
