"""Learns from what people said that items really were.

    python -m training --add-corrections SITE

Fine-tunes the installed weights with the corrections that the bins of a site keep, and writes another model,
which no bin uses yet: its word counts once the organization lists its hash in the kind's rules. The site
must run. Each signature is verified again, and whose it is: a correction counts if an auditor of the
organization signed it, about what a key signed that was registered as the bin's then (`allowed.py`).

The same fine-tuning is done to each cross-validated network, with the photos that it learnt from, and without
those corrected pictures that are near-duplicates of photos of its own fold (`folds.py`): they would flatter
it. Where these name fewer of the photos of their own folds rightly than before, no model is written. Nor is
it where the new network itself does worse than the installed one on what neither learnt from
(`held_out.py`), near-duplicates of corrected pictures left out.

    RodeoError
    ├── NoCorrections         there is nothing to learn from
    ├── NotCrossValidated     a network is missing whose photos would tell whether it gets worse
    ├── SameFolder            the new networks would replace those that they are made from
    └── WorseThanBefore       it does
"""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from eth_utils import to_checksum_address
from pydantic import ValidationError

from rodeo.errors import RodeoError, unreadable
from rodeo.evidence.errors import BadAttestation
from rodeo.kinds import kinds_of
from rodeo.site.config import Site
from rodeo.site.names import bin_process
from rodeo.vision.classification import (
    MODEL_DIR,
    PREPROCESSING,
    UNKNOWN,
    WEIGHTS,
    Preprocessing,
    load_preprocessing,
    model_sha256,
    network_sha256,
)
from rodeo.vision.classifier import Classifier, shrink
from rodeo.vision.images import ImageError, decode_image
from rodeo.witness.correction import Correction
from rodeo.witness.statement import Classification
from services.itrash.corrections import Kept, NotWhatItSays
from training import crossed, renderings
from training.allowed import Allowed
from training.compact import compact, is_compact
from training.cross_validate import learnt_without, seen_by_imagenet
from training.crossed import TRAINING, Crossed, Training
from training.dataset import CLASSES, Sample
from training.folds import FOLDS, joined, near_folds
from training.held_out import HeldOut
from training.network import NETWORK, Network, export
from training.others import World
from training.train import (
    WEATHER,
    Recipe,
    Weather,
    calibrated,
    weathered,
    write_preprocessing,
)

log = logging.getLogger("itrash.corrected")

CORRECTED_SHARE = 0.1
"""Share of the pictures to learn from; a correction is repeated as often as that takes, within
`MOST_REPEATED`."""
MOST_REPEATED = 20
"""Times, the item's pictures taking turns. One person may be wrong: without a bound, a single correction
would be a tenth of what is learnt. It takes eleven corrected items to be a tenth."""

_FOLDS = "folds"
"""Where the cross-validated networks lie, beside the model."""

GENTLE = replace(WEATHER, steps=280, rate=5e-5)
"""The last steps of training once more, taught by the network that there is: it must not forget what it sees
through. A low rate: what it knows is worth more than a few pictures."""


class NoCorrections(RodeoError):
    """No bin of the site keeps a correction that is sound."""


class NotCrossValidated(RodeoError):
    """Not all cross-validated networks are there."""


class SameFolder(RodeoError):
    """The new networks would replace those that they are made from."""


class WorseThanBefore(RodeoError):
    """The corrections cost more right answers than they are worth. `before` and `after` are the shares that
    fell, by what is counted."""


@dataclass(frozen=True)
class Corrected:
    """What was shown to a bin, and what people say that it is."""

    pictures: tuple[bytes, ...]
    """Encoded: the one that was corrected last, then those that the bin combined with it, as far as it kept
    them."""
    label: str | None
    """None where it was no item."""
    name: str
    """Hash of the first picture."""
    people: tuple[str, ...]
    """Addresses of those who signed."""

    @cached_property
    def samples(self) -> list[Sample]:
        """Its pictures in their order."""
        return [
            Sample(shrink(decode_image(one)), self.label, self.name, corrected=True) for one in self.pictures
        ]


@dataclass(frozen=True)
class Material:
    """What networks learn from and are tried on beside photos and corrections."""

    rendered: list[Sample]
    world: World
    held_out: HeldOut

    @classmethod
    def load(cls, recipe: Recipe, data: Path, fetched: Path) -> Material:
        """Takes minutes. Raises NoSamples, NoPhotos, ImageError, RendererUnavailable."""
        world, held_out = World.load(fetched), HeldOut.load(asdict(recipe), data, fetched)
        rendered = renderings.render_samples(recipe.renderings_seed, recipe.renderings_per_class)
        return cls(rendered, world, held_out)


def gather(site: Site, allowed: Allowed) -> tuple[list[Corrected], list[str]]:
    """What the sound corrections of all bins of the site are about, and why others are left out."""
    words: list[_Word] = []
    left_out: list[str] = []
    for config in site.bins:
        folder = site.data_dir / bin_process(site, config.name) / "corrections"
        for path in sorted(folder.glob("*.json")):
            try:
                words.append(_sound(path, config.name, allowed))
            except (OSError, ValidationError) as error:
                left_out.append(f"{config.name}/{path.name}: {unreadable(error)}")
            except (BadAttestation, ImageError, NotWhatItSays, _Unsound) as error:
                left_out.append(f"{config.name}/{path.name}: {error}")
    corrected = []
    for of_one in _by_item(words):
        last = max(of_one, key=lambda word: (word.shown_s, word.name))
        if len({word.label for word in of_one}) > 1:
            left_out.append(f"{last.name}: people disagree")
            continue
        pictures = {**last.pictures, **{name: one for word in of_one for name, one in word.pictures.items()}}
        people = tuple(sorted({word.signer for word in of_one}))
        label = None if last.label == UNKNOWN else last.label
        corrected.append(Corrected(tuple(pictures.values()), label, last.name, people))
    return sorted(corrected, key=lambda one: one.name), left_out


@dataclass(frozen=True)
class _Word:
    """What one person says of one answer."""

    label: str
    signer: str
    shown_s: float
    pictures: dict[str, bytes]
    """By their hashes, the corrected one first."""

    @property
    def name(self) -> str:
        return next(iter(self.pictures))


def _by_item(words: Sequence[_Word]) -> list[list[_Word]]:
    """Answers that share a picture are about one item."""
    having: dict[str, list[int]] = defaultdict(list)
    for number, word in enumerate(words):
        for name in word.pictures:
            having[name].append(number)
    pairs = [pair for numbers in having.values() for pair in pairwise(numbers)]
    items: dict[int, list[_Word]] = defaultdict(list)
    least = joined(len(words), np.array(pairs, int).reshape(-1, 2))
    for word, item in zip(words, least.tolist(), strict=True):
        items[item].append(word)
    return list(items.values())


class _Unsound(Exception):
    """What is in the file does not belong together."""


def _sound(path: Path, bin_name: str, allowed: Allowed) -> _Word:
    kept = Kept.model_validate_json(path.read_bytes())
    # As the bin does when it starts: a copy, or a person's second word, in another file counts in neither.
    kept.verify(path.stem, bin_name)
    signer, teller = (to_checksum_address(one.signer) for one in (kept.correction, kept.classification))
    said = Correction.model_validate(kept.correction.payload)
    told = Classification.model_validate(kept.classification.payload)
    for field, own in allowed.scope.model_dump().items():
        if {str(getattr(one, field)).lower() for one in (said, told)} != {str(own).lower()}:
            raise _Unsound(f"it, the bin's statement and the organization differ in {field}")
    if signer.lower() not in allowed.auditors:
        raise _Unsound(f"{signer} is no auditor of the organization")
    if not allowed.speaks_for(teller, bin_name, told.shown_s):
        raise _Unsound(f"{teller} was not registered as the bin's key when it signed")
    if said.item_class not in (*CLASSES, UNKNOWN):
        raise _Unsound("the network knows no such class")
    # The corrected one must be there; the bin may have let go of an earlier one before it was corrected.
    kept_too = [one.image_sha256 for one in told.earlier if (path.parent / one.image_sha256).exists()]
    names = (said.image_sha256, *kept_too)
    return _Word(said.item_class, signer, told.shown_s, {name: _picture(path.parent, name) for name in names})


def _picture(folder: Path, name: str) -> bytes:
    picture = (folder / name).read_bytes()
    if "0x" + sha256(picture).hexdigest() != name:
        raise _Unsound("the picture has another hash")
    decode_image(picture)
    return picture


def add_corrections(
    site: Site,
    allowed: Allowed,
    data: Path,
    folds: Path,
    load: Callable[[], Material],
    out: Path,
    recipe: Recipe,
    weather: Weather,
) -> list[str]:
    """Write the model that learnt from them into `out`, beside its five cross-validated networks in `folds`;
    the report as lines. Nothing is written there before all of them are known to be no worse.

    `folds` holds the cross-validated networks from before. `load` takes minutes and is called once there is
    something to learn. Raises what `load` does, NoCorrections, NotCrossValidated, SameFolder, KindError,
    NoPhotos, WorseThanBefore, OtherRecipe where the installed network was made by another recipe than they
    were, and OtherPhotos where they did not learn from those in `data`.
    """
    for source, made in ((MODEL_DIR, out), (folds, out / _FOLDS)):
        if made.resolve() == source.resolve():
            raise SameFolder(
                "name another --out: the networks there are what is learnt on from", folder=str(source)
            )
    corrected, left_out = gather(site, allowed)
    if not corrected:
        raise NoCorrections("no bin keeps a sound correction", org=site.org, left_out=left_out)
    # Before the hours of work: whoever reads that a correction is missing can still stop it.
    for line in found_lines(corrected, left_out):
        log.info("%s", line)
    there = [fold for fold in range(FOLDS) if crossed.is_there(folds, fold)]
    if len(there) < FOLDS or not (folds / crossed.DIVISION).exists():
        raise NotCrossValidated("cross-validated networks are missing", folder=str(folds), there=there)
    crossed.check(folds, Training.model_validate_json((MODEL_DIR / TRAINING).read_bytes()))
    listed = {name: models for name, kind in kinds_of(site).items() if (models := kind.models())}
    photos, material = crossed.all_photos(data), load()
    samples = [sample for one in corrected for sample in one.samples]
    division = crossed.division_in(folds)
    assert division is not None
    division.check([photo.name for photo in photos])
    fold_of = np.array([division.of(photo.name).fold for photo in photos])
    apart = ~near_folds(samples, seen_by_imagenet(samples), photos, seen_by_imagenet(photos), fold_of)
    held_out, doubles = material.held_out.apart_from(samples, seen_by_imagenet)
    own = [_without(corrected, apart[:, fold]) for fold in range(FOLDS)]
    doubles = [*apart_lines(corrected, own), *doubles]
    for line in doubles:
        log.info("%s", line)
    installed = Classifier()
    out.mkdir(parents=True, exist_ok=True)
    training = Training(
        architecture=NETWORK,
        recipe=asdict(recipe),
        others_sha256=material.world.sha256,
        learnt=crossed.PARTS,
        weather=asdict(weather),
    )
    before = crossed.measured(folds, data)
    # Beside their places until all are known to be no worse.
    with TemporaryDirectory(dir=out) as beside:
        made = Path(beside)
        after = _cross_validated(photos, own, material, data, folds, made / _FOLDS, training, recipe, weather)
        what = f"{len(photos)} photos named rightly, each by a network that did not learn from it"
        was, now = {what: before.answers.accuracy()}, {what: after.answers.accuracy()}
        refuse_worse(was, now)
        log.info("network %d of %d, the installed one, learns from the corrections", FOLDS + 1, FOLDS + 1)
        network = tuned(MODEL_DIR / WEIGHTS, photos, corrected, material, recipe, weather)
        changed = calibrated(after, made / _FOLDS, recipe.known_rejected)
        _write(network, load_preprocessing().model_copy(update=changed), training, made)
        was |= held_out.shares(installed)
        now |= held_out.shares(Classifier(made))
        refuse_worse(was, now)
        if (out / _FOLDS).exists():  # of an earlier run: a folder replaces no other one that has files
            (out / _FOLDS).rename(made / "earlier")
        for name in (_FOLDS, WEIGHTS, PREPROCESSING, TRAINING):
            (made / name).replace(out / name)
    return [
        *found_lines(corrected, left_out),
        *doubles,
        *answers_table(corrected, installed, Classifier(out)),
        *(f"{what}: {was[what]:.4f}, now {now[what]:.4f}" for what in was),
        *next_steps(listed, out),
    ]


def _without(corrected: Sequence[Corrected], apart: np.ndarray) -> list[Corrected]:
    """Those of which every picture is apart; `apart` (pictures,) are in the order of items and pictures."""
    ends = np.cumsum([len(one.pictures) for one in corrected])
    return [
        one for one, pictures in zip(corrected, np.split(apart, ends[:-1]), strict=True) if pictures.all()
    ]


def _write(network: Network, preprocessing: Preprocessing, training: Training, into: Path) -> None:
    export(network, into / WEIGHTS, preprocessing.input_px)
    write_preprocessing(into, preprocessing)
    (into / TRAINING).write_text(training.model_dump_json(indent=2) + "\n")


def refuse_worse(before: Mapping[str, float], after: Mapping[str, float]) -> None:
    """Compare shares of right answers, by what is counted. Raises WorseThanBefore."""
    fell = [what for what in before if after[what] < before[what]]
    if fell:
        raise WorseThanBefore(
            "fewer answers are right than before",
            before={what: before[what] for what in fell},
            after={what: after[what] for what in fell},
        )


def found_lines(corrected: Sequence[Corrected], left_out: Sequence[str]) -> list[str]:
    """What is learnt from, by whom, and what is not."""
    people = Counter(person for one in corrected for person in one.people)
    return [
        f"{len(corrected)} corrected {_items(len(corrected))} to learn from",
        *(f"{person} judged {count} {_items(count)}" for person, count in sorted(people.items())),
        *(f"left out: {reason}" for reason in left_out),
    ]


def apart_lines(corrected: Sequence[Corrected], own: Sequence[Sequence[Corrected]]) -> list[str]:
    """How many corrected items each cross-validated network goes without; `own` are those that it learns
    from."""
    missing = [len(corrected) - len(of_one) for of_one in own]
    return [
        f"network {number} learns without {count} corrected {_items(count)}: near-duplicates of photos that "
        "measure it"
        for number, count in enumerate(missing, 1)
        if count
    ]


def _items(count: int) -> str:
    return "item" if count == 1 else "items"


def next_steps(listed: Mapping[str, Sequence[str]], out: Path) -> list[str]:
    """What makes the model in `out` count. `listed` are the networks whose word counts, by kind of task: they
    stay listed, so that the rules have the same hash before and after a machine gets the new one, and the
    word of bins that still have an earlier one counts."""
    made = network_sha256(*((out / name).read_bytes() for name in (WEIGHTS, PREPROCESSING)))
    files = ", ".join((WEIGHTS, PREPROCESSING, TRAINING))
    return [
        f"model_sha256 {made}",
        "",
        "No bin uses this network yet, and its word does not count yet. To change that:",
        "",
        "1. Write into the site file of each machine, beside its other kinds, and restart the site:",
        "",
        *(
            line
            for kind, models in listed.items()
            for line in (
                "    [[kinds]]",
                f'    name = "{kind}"',
                "    models_sha256 = [",
                *(f'        "{one}",' for one in sorted({*models, made})),
                "    ]",
                "",
            )
        ),
        "2. `rodeo organization rules` says whether the newest rules are installed here. If not, announce:",
        "",
        *(f"    rodeo organization kind {kind} --judge oracle" for kind in listed),
        "",
        f"3. Where oracles run, copy {files}",
        f"   from {MODEL_DIR} to {MODEL_DIR / model_sha256()}:",
        "   they ask the earlier network while bins have it.",
        "",
        f"4. Where oracles run, and then where bins do, copy the same files from {out}",
        f"   to {MODEL_DIR}, and restart them.",
        "",
        f"Then learn from the next corrections with --folds {out / _FOLDS} and another --out.",
    ]


def tuned(
    weights: Path,
    photos: list[Sample],
    corrected: Sequence[Corrected],
    material: Material,
    recipe: Recipe,
    weather: Weather,
) -> Network:
    """The network of `weights` after these steps with the corrected pictures among the photos."""
    turns = range(repeated(len(photos), len(corrected)))
    again = [one.samples[turn % len(one.samples)] for turn in turns for one in corrected]
    return weathered(weights, [*photos, *again], material.rendered, material.world, recipe, weather)


def repeated(photos: int, corrected: int) -> int:
    """How often each of so many corrections stands among so many photos."""
    if not corrected:
        return 0
    return min(max(round(CORRECTED_SHARE * photos / corrected), 1), MOST_REPEATED)


def answers_table(corrected: Sequence[Corrected], before: Classifier, after: Classifier) -> list[str]:
    """What each model says of the pictures that people corrected."""
    rows = ["| picture | people say | before | after |", "|---|---|---|---|"]
    for one in corrected:
        was, now = before.classify(one.pictures[0]), after.classify(one.pictures[0])
        rows.append(
            f"| {one.name[:12]} | {one.label or UNKNOWN} | {was.label} ({was.confidence:.2f}) "
            f"| {now.label} ({now.confidence:.2f}) |"
        )
    return rows


def _cross_validated(
    photos: list[Sample],
    corrected: Sequence[Sequence[Corrected]],
    material: Material,
    data: Path,
    folds: Path,
    out: Path,
    training: Training,
    recipe: Recipe,
    weather: Weather,
) -> Crossed:
    """The answers of the cross-validated networks after the same fine-tuning, by their own thresholds.
    `corrected` is what each learns from.

    So that nothing but the corrections makes a difference, each learns again from the photos that it learnt
    from, and its weights have as many bits as before.
    """
    division = crossed.division_in(folds)
    assert division is not None
    out.mkdir()
    (out / crossed.DIVISION).write_text(division.model_dump_json())
    for fold in range(FOLDS):
        source, folder = crossed.folder_of(folds, fold), crossed.folder_of(out, fold)
        folder.mkdir()
        learnt = learnt_without(photos, division, fold)
        log.info("network %d of %d learns from the corrections", fold + 1, FOLDS + 1)
        network = tuned(source / WEIGHTS, learnt, corrected[fold], material, recipe, weather)
        _write(network, load_preprocessing(source), training, folder)
        if is_compact((source / WEIGHTS).read_bytes()):
            (folder / WEIGHTS).write_bytes(compact((folder / WEIGHTS).read_bytes()))
    return crossed.measured(out, data)
