"""Cross-validation: what a fold learns from, how it is resumed, and that it is exported and calibrated."""

from __future__ import annotations

import shutil
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install -r training/requirements.txt")

from rodeo.vision.classification import MODEL_DIR, WEIGHTS, load_preprocessing  # noqa: E402
from rodeo.vision.classifier import Classifier  # noqa: E402
from rodeo_testing.recordings import RENDERINGS  # noqa: E402
from training import abstention, answers, card, cross_validate, crossed, metrics, renderings  # noqa: E402
from training import train as training  # noqa: E402
from training.compact import compact, is_compact  # noqa: E402
from training.crossed import Division, OtherRecipe, Unfinished  # noqa: E402
from training.dataset import CLASSES, Sample  # noqa: E402
from training.others import World  # noqa: E402

TINY = replace(
    training.Recipe(), stable_steps=2, cooldown_steps=1, finish_steps=2, batch=2, stable_px=64,
    cooldown_px=64, input_px=64, second_disturbed=1, second_faint=1, second_nothing=2, known_rejected=0.2,
)  # fmt: skip
BRIEF = training.Weather(steps=2, warmup_steps=1, px=64)
WORLD = World(
    scenes=(np.full((80, 90, 3), 120, np.uint8),),
    cutouts=(np.full((40, 30, 4), 200, np.uint8),),
    sha256="ab" * 32,
)
EACH = 12
"""Photos of each class."""


def picture(number: int, colour: int) -> np.ndarray:
    rng = np.random.default_rng(number)
    drawn = np.full((96, 128, 3), 210, np.uint8)
    cv2.circle(drawn, (64, 48), 20 + number % 9, tuple(map(int, rng.integers(0, 200, 3))), -1)
    drawn[:8] = colour * 30
    return drawn


def drawn(each: int = EACH) -> list[Sample]:
    return [
        Sample(picture(100 * colour + number, colour), label, f"train/{label}/{label}{number}.png")
        for colour, label in enumerate(CLASSES)
        for number in range(each)
    ]


@pytest.fixture
def photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Sample]:
    """In memory, in files, and as what is rendered."""
    empty = [Sample(np.full((64, 64, 3), 90, np.uint8), None)]
    monkeypatch.setattr(World, "load", lambda _fetched: WORLD)
    monkeypatch.setattr(renderings, "render_samples", lambda _seed, _each: [*drawn(2), *empty])
    for photo in drawn():
        path = tmp_path / "data" / photo.name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), photo.image_bgr)
    (tmp_path / "data" / "val").mkdir()
    for label in CLASSES:
        (tmp_path / "data" / "val" / label).mkdir()
    return drawn()


@pytest.fixture
def division(photos: list[Sample]) -> Division:
    fold = np.arange(len(photos)) % 5
    return Division.of_arrays([photo.name for photo in photos], fold, np.arange(len(photos)))


def test_a_network_learns_from_all_photos_but_those_of_its_own_fold(
    photos: list[Sample], division: Division
) -> None:
    for fold in range(5):
        learnt = {one.name for one in cross_validate.learnt_without(photos, division, fold)}
        own = {photo.name for photo in photos if division.of(photo.name).fold == fold}
        assert own and not own & learnt
        assert len(own | learnt) == len(photos)


def test_no_photo_chooses_the_threshold_of_the_network_that_it_measures(
    photos: list[Sample], division: Division, tmp_path: Path
) -> None:
    """Where every photo of one fold is hard, its own threshold does not fall, and those of the others do."""
    data, out = tmp_path / "data", tmp_path / "out"
    large = replace(TINY, input_px=load_preprocessing().input_px)
    for fold in range(5):
        shutil.copytree(MODEL_DIR, out / f"fold{fold}")
    (out / crossed.DIVISION).write_text(division.model_dump_json())

    def chosen() -> list[tuple[float, float]]:
        cross_validate.calibrate(out, data, large)
        found = [load_preprocessing(out / f"fold{fold}") for fold in range(5)]
        return [(one.temperature, one.unknown_below) for one in found]

    before = chosen()
    assert all(below > 0 for _, below in before)
    rng = np.random.default_rng(0)
    for photo in photos:
        if division.of(photo.name).fold == 3:
            cv2.imwrite(str(data / photo.name), rng.integers(0, 256, photo.image_bgr.shape).astype(np.uint8))
    after = chosen()
    assert [one == other for one, other in zip(before, after, strict=True)] == [False] * 3 + [True, False]
    shutil.rmtree(out / "fold4")
    cross_validate.calibrate(out, data, large)
    kept = load_preprocessing(out / "fold3")
    assert (kept.temperature, kept.unknown_below) == after[3], "as it was before one was missing"


def test_training_that_was_killed_goes_on_to_the_same_weights(
    photos: list[Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "LOG_EVERY_STEPS", 1)
    rendered = renderings.render_samples(0, 2)
    whole = training.train(photos, rendered, WORLD, TINY)
    save, steps = training.Checkpoint.save, []

    def killed(self: training.Checkpoint, step: int, *state: training.Draws) -> None:
        save(self, step, *state)
        steps.append(step)
        if len(steps) in (2, 4):
            raise KeyboardInterrupt

    monkeypatch.setattr(training.Checkpoint, "save", killed)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            training.train(photos, rendered, WORLD, TINY, tmp_path)
    resumed = training.train(photos, rendered, WORLD, TINY, tmp_path)
    assert steps == [1, 2, 3, 1, 2]
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name


def test_as_many_pictures_are_disturbed_as_is_asked_and_no_other_is_drawn_otherwise(
    photos: list[Sample], monkeypatch: pytest.MonkeyPatch
) -> None:
    rendered, recipe = renderings.render_samples(0, 2), replace(TINY, batch=64)

    def batch(*share: float) -> np.ndarray:
        draws = training.Draws(photos, rendered, WORLD, recipe, 5, training.SELDOM, *share)
        return draws.batch(64)[0]

    assert np.array_equal(batch(), batch(0.0))  # the steps before are as they were
    monkeypatch.setattr(training.weather, "disturbed", lambda view, _rng: np.zeros_like(view))
    black = (batch(0.5) == batch(0.5).min()).all(axis=(1, 2, 3))
    assert 20 < black.sum() < 44
    assert (batch(1.0) == batch(1.0).min()).all()


def test_a_fold_is_trained_once_and_measured_from_its_files(
    photos: list[Sample], division: Division, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    out.mkdir()
    (out / crossed.DIVISION).write_text(division.model_dump_json())
    cross_validate.main(data, tmp_path / "others", out, TINY, [3], BRIEF)
    found = crossed.measured(out, data)
    own = sum(place.fold == 3 for place in division.photos.values())
    assert (found.folds, len(found.group)) == ((3,), own)
    assert load_preprocessing(out / "fold3").unknown_below == 0, "the others' answers are missing"
    assert not list((out / "fold3").glob("*.pt"))

    def again(*_: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(cross_validate, "wholly", again)
    cross_validate.main(data, tmp_path / "others", out, TINY, [3], BRIEF)
    assert is_compact((out / "fold3" / WEIGHTS).read_bytes())


def test_what_was_learnt_in_all_weathers_follows_what_was_learnt_before(
    photos: list[Sample], division: Division, tmp_path: Path
) -> None:
    data, out, others = (tmp_path / name for name in ("data", "out", "others"))
    out.mkdir()
    (out / crossed.DIVISION).write_text(division.model_dump_json())
    cross_validate.main(data, others, out, TINY, [3], BRIEF)
    kept = crossed.Training.model_validate_json((out / "fold3" / crossed.TRAINING).read_bytes())
    assert kept.weather == asdict(BRIEF)
    learnt = cross_validate.learnt_without(crossed.all_photos(data), division, 3)
    rendered = renderings.render_samples(0, 2)
    before, after = tmp_path / "before.onnx", tmp_path / "after.onnx"
    training.export(training.train(learnt, rendered, WORLD, TINY), before, TINY.input_px)
    weathered = training.weathered(before, learnt, rendered, WORLD, TINY, BRIEF)
    assert weathered.second is None
    weathered.second = training.seconded(learnt, rendered, WORLD, TINY)
    training.export(weathered, after, TINY.input_px)
    found = (out / "fold3" / WEIGHTS).read_bytes()
    assert found == compact(after.read_bytes()) != compact(before.read_bytes())


def test_a_teachers_share_of_what_is_learnt_is_what_it_says_of_the_clear_picture(
    photos: list[Sample], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training.weather, "disturbed", lambda view, _rng: np.zeros_like(view))
    rendered, recipe = renderings.render_samples(0, 2), replace(TINY, batch=8)
    batch = training.Draws(photos, rendered, WORLD, recipe, 5, training.SELDOM, 1.0).batch(64)
    assert (batch.inputs == batch.inputs.min()).all() and batch.clear.std() > 0
    network = training.Network(training.OUTPUTS, 0.0).eval()
    with torch.no_grad():
        said = torch.softmax(network(torch.from_numpy(batch.clear)), dim=1)
    half = training.Teacher(network, 0.5).targets(batch)
    expected = 0.5 * torch.from_numpy(batch.targets) + 0.5 * said
    assert torch.allclose(half, expected, atol=0.02)  # bfloat16, where the processor has it
    assert torch.equal(training.Teacher(network, 0.0).targets(batch), torch.from_numpy(batch.targets))


def test_no_teacher_contradicts_a_person(photos: list[Sample]) -> None:
    """The network that a person corrected is the teacher, and would teach its error again."""
    recipe = replace(TINY, batch=16)
    corrected = [replace(photo, corrected=photo.label == "glass") for photo in photos]
    batch = training.Draws(
        corrected, renderings.render_samples(0, 2), WORLD, recipe, 5, training.SELDOM
    ).batch(64)
    assert batch.corrected.tolist() != [False] * 16 and not batch.corrected.all()
    glass = CLASSES.index("glass")
    assert (batch.targets[batch.corrected].argmax(axis=1) == glass).all()
    whole = training.Teacher(training.Network(training.OUTPUTS, 0.0).eval(), 1.0).targets(batch)
    own = torch.isclose(whole, torch.from_numpy(batch.targets)).all(dim=1)
    assert own.tolist() == batch.corrected.tolist()


def test_weights_of_8_bits_take_half_the_room_and_answer_alike(tmp_path: Path) -> None:
    weights = (MODEL_DIR / WEIGHTS).read_bytes()
    small = compact(weights)
    assert len(small) < 0.55 * len(weights)
    (tmp_path / WEIGHTS).write_bytes(small)
    (tmp_path / "preprocessing.json").write_text(load_preprocessing().model_dump_json())
    picture = (RENDERINGS / "metal_1.jpg").read_bytes()
    before, after = Classifier().classify(picture), Classifier(tmp_path).classify(picture)
    assert after.best_class == before.best_class
    assert all(abs(p - before.probabilities[name]) < 0.1 for name, p in after.probabilities.items())


def test_all_networks_together_choose_the_threshold_of_the_model(
    photos: list[Sample], division: Division, tmp_path: Path
) -> None:
    data, out, model = (tmp_path / name for name in ("data", "out", "model"))
    for fold in range(5):
        shutil.copytree(MODEL_DIR, out / f"fold{fold}")
    shutil.copytree(MODEL_DIR, model)
    (out / crossed.DIVISION).write_text(division.model_dump_json())
    cross_validate.choose(data, out, model, 0.1)
    classifier = Classifier(model)
    said = metrics.answers_to_files(classifier, data, photos)
    rank = abstention.rank(len(photos), 0.1)
    # All five are the installed network, so the threshold lies just at its own rank.
    assert rank > 1 and round(said.unknown_share() * len(photos)) in (rank - 1, rank)
    shutil.rmtree(out / "fold2")
    with pytest.raises(Unfinished):
        cross_validate.choose(data, out, model, 0.1)


def test_who_learns_from_all_photos_is_measured_by_networks_that_did_not(
    photos: list[Sample], division: Division, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, folds, out, others = (tmp_path / name for name in ("data", "folds", "out", "others"))
    made_by = crossed.Training(
        architecture="any", recipe=asdict(TINY), others_sha256=WORLD.sha256, weather=asdict(BRIEF)
    )
    for fold in range(5):
        shutil.copytree(MODEL_DIR, folds / f"fold{fold}")
        (folds / f"fold{fold}" / crossed.TRAINING).write_text(made_by.model_dump_json())
    (folds / crossed.DIVISION).write_text(division.model_dump_json())
    real = {"one": (RENDERINGS / "unknown_1.jpg").read_bytes()}
    monkeypatch.setattr(card.others, "installed_photos", lambda: real)
    monkeypatch.setattr(card.others, "measured_photos", lambda _fetched: real)
    one = metrics.Answers(np.zeros((1, 7)), np.zeros(1, int), np.zeros(1, int), np.array(["blue"]))
    monkeypatch.setattr(answers.evaluation, "corrupted_answers", lambda *_: {"snow": one})
    monkeypatch.setattr(card, "held_out_samples", lambda *_: (drawn(1), [Sample(picture(1, 1), None)]))
    monkeypatch.setattr(training, "load_photos", lambda _: photos)
    training.main(data, others, out, TINY, folds, learn_all=True, after=BRIEF)
    kept = crossed.Training.model_validate_json((out / crossed.TRAINING).read_bytes())
    assert kept.learnt_all and kept.others_sha256 == WORLD.sha256
    found = crossed.measured(folds, data)
    told = (out / card.CARD).read_text()
    assert f"by a network that did not learn from it ({len(photos)}) | {found.answers.accuracy():.1%}" in told
    measured, _, chosen = told.partition("## How it was chosen")
    assert "val photos" not in measured and card.TRIALS in chosen
    expected = training.calibrated(found, folds, TINY.known_rejected)
    assert load_preprocessing(out).model_dump().items() >= expected.items()
    beside = answers.Kept.load(out / answers.ANSWERS)
    beside.check(Classifier(out).model_sha256, kept)
    assert beside.crossed().answers.accuracy() == found.answers.accuracy()


def test_networks_of_another_recipe_tell_nothing_of_this_one(division: Division, tmp_path: Path) -> None:
    for fold in range(5):
        shutil.copytree(MODEL_DIR, tmp_path / f"fold{fold}")
    (tmp_path / crossed.DIVISION).write_text(division.model_dump_json())
    installed = crossed.Training.model_validate_json((MODEL_DIR / crossed.TRAINING).read_bytes())
    crossed.check(tmp_path, installed)
    with pytest.raises(OtherRecipe):
        crossed.check(tmp_path, installed.model_copy(update={"others_sha256": "ab" * 32}))
    shutil.rmtree(tmp_path / "fold3")
    with pytest.raises(Unfinished):
        crossed.check(tmp_path, installed)
