"""Trains the bin's classifier on photos, renderings and pictures of nothing, and writes it with its card. CPU
only.

    python -m training.others
    python -m training.train --data ../shared/data/trashnet --out FOLDER

The first command fetches real photos of what is no waste. One core for under an hour. Needs
`training/requirements.txt` (torch, onnx); nothing at run time does.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import json
import logging
import math
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

if __name__ == "__main__" and importlib.util.find_spec("torch") is None:
    sys.exit(
        "Training needs packages that running does not. Install them first:\n\n"
        "    pip install --constraint constraints.txt -r training/requirements.txt"
    )

import cv2
import numpy as np
import torch
from torch import nn

from rodeo.errors import RodeoError
from rodeo.vision.classification import PREPROCESSING, WEIGHTS, Preprocessing, load_preprocessing
from rodeo.vision.classifier import Classifier, to_input
from training import crossed, metrics, renderings, scenery, weather
from training.abstention import RISK, threshold
from training.answers import ANSWERS, Kept
from training.augment import CHANCES, SELDOM, Chances, augment, drawn
from training.card import held_out_samples, write_card
from training.crossed import FOLDS_DIR, TRAINING, Training
from training.dataset import CLASSES, Sample, load_photos
from training.evaluation import bare_board
from training.network import (
    KEPT_POOLS,
    MEAN,
    NETWORK,
    SCALE,
    Network,
    export,
    exported,
)
from training.others import FETCHED, World
from training.second import Second, Views

log = logging.getLogger("itrash.train")

OUTPUTS = len(CLASSES) + 1
"""The classes, and one for a picture without any of them."""
LOG_EVERY_STEPS = 100
_CHANNELS_LAST: dict[str, Any] = {"memory_format": torch.channels_last}
"""For `Module.to`, in whose types it is missing."""
MALLOPT = {-1: 2**31 - 1, -4: 0, -8: 1}
"""M_TRIM_THRESHOLD, M_MMAP_MAX and M_ARENA_MAX of glibc's malloc.h."""


@dataclass(frozen=True)
class Recipe:
    """Everything that decides the outcome."""

    seed: int = 8
    stable_steps: int = 1100
    cooldown_steps: int = 500
    """The learning rate rises, stays, and falls to zero in the cooldown (warmup-stable-decay)."""
    warmup_steps: int = 50
    batch: int = 32
    stable_px: int = 176
    cooldown_px: int = 208
    """Small pictures first, they train faster (progressive resizing, Tan and Le, 2021, arXiv:2104.00298)."""
    input_px: int = 256
    """Random crops enlarge what they show, so a network tested on whole photos wants a larger side there than
    in training (Touvron et al., 2019, arXiv:1906.06423)."""
    rendered_share: float = 0.12
    nothing_share: float = 0.13
    real_nothing: float = 0.6
    """So much of it comes from real photos: who knows only drawn pictures takes a portrait for metal."""
    learning_rate: float = 5e-4
    rate_decay: float = 0.75
    """The head learns at the full rate, each eighth of the blocks before it at so much of the next one's:
    what ImageNet taught first holds for waste too (Howard and Ruder, 2018, arXiv:1801.06146)."""
    weight_decay: float = 0.02
    label_smoothing: float = 0.05
    drop_connect: float = 0.1
    ema_decay: float = 0.995
    renderings_seed: int = 7
    renderings_per_class: int = 180
    held_out_renderings_per_class: int = 50
    finish_steps: int = 300
    finish_rate: float = 1e-4
    finish_ema_decay: float = 0.99
    """At the end a few steps on pictures as large and as clean as most that the bin is shown."""
    pretrained_share: float = 0.2
    """In the end so much of each weight before the head is ImageNet's again: between what was learnt before
    and after lie networks that know new photos better (Wortsman et al., 2022, arXiv:2109.01903)."""
    second_share: float = 1.5
    """How much the second opinion counts where the picture is clear (`second.py`)."""
    second_foul_share: float = 0.5
    """And where it is not."""
    second_alone: float = 1.6
    """And so much the first one there: the temperatures that calibrate it alone and both together, 0.68 and
    1.05, have about this ratio."""
    second_nothing_share: float = 0.5
    """How much it counts where the second takes it for more probable that there is no item."""
    second_ridge: float = 0.003
    """Its features outnumber the photos."""
    second_foul_ridge: float = 0.01
    second_disturbed: int = 3
    """So often it sees each photo disturbed, each time in another way."""
    second_faint: int = 2
    """And so often faintly."""
    second_nothing: int = 2000
    """So many pictures of nothing are drawn for it."""
    known_rejected: float = RISK
    """Share of known photos that may be called unknown; sets the threshold."""

    def shortened(self, times: int) -> Recipe:
        """To try the program out: so many times fewer steps and renderings."""
        parts = ("stable_steps", "cooldown_steps", "finish_steps", "renderings_per_class", "second_nothing")
        return replace(self, **{part: max(getattr(self, part) // times, 1) for part in parts})


@dataclass(frozen=True)
class Weather:
    """The last steps, of which a part of the pictures is disturbed strongly (`weather.py`, decisions 0077 and
    0083). They start from an exported network."""

    steps: int = 380
    warmup_steps: int = 20
    px: int = 208
    rate: float = 1.5e-4
    rate_decay: float = 0.8
    """Noise is met by the first layers, so they learn at more of the rate than before."""
    nothing_share: float = 0.2
    """More than before: what is hard to see is not therefore no item, and what is none is none in haze."""
    real_nothing: float = 0.75
    disturbed: float = 0.5
    taught: float = 0.5
    """So much of what a picture is to be called is what the network called it before, undisturbed: it learns
    to see through, and forgets little else (Hinton et al., 2015, arXiv:1503.02531)."""

    def shortened(self, times: int) -> Weather:
        """To try the program out."""
        parts = ("steps", "warmup_steps")
        return replace(self, **{part: max(getattr(self, part) // times, 1) for part in parts})


WEATHER = Weather()
"""Weather of the shipped networks."""


class Batch(NamedTuple):
    """Pictures to learn from."""

    inputs: np.ndarray
    """(batch, 3, side, side), float32."""
    targets: np.ndarray
    """What to call each: distributions over the outputs, (batch, OUTPUTS), float32."""
    clear: np.ndarray
    """The inputs before any was disturbed."""
    corrected: np.ndarray
    """Which a person named against a network, (batch,), bool."""


@dataclass(frozen=True)
class Teacher:
    """A network whose answers to the clear pictures are a share of what is learnt, but of those that a person
    corrected."""

    network: Network
    share: float

    def targets(self, batch: Batch) -> torch.Tensor:
        """What to call each picture, (batch, OUTPUTS)."""
        clear = torch.from_numpy(batch.clear).to(memory_format=torch.channels_last)
        with torch.no_grad(), _bfloat16():
            said = torch.softmax(self.network(clear).float(), dim=1)
        share = torch.where(torch.from_numpy(batch.corrected), 0.0, self.share)
        return torch.from_numpy(batch.targets).lerp(said, share[:, None])


class Draws:
    """Random training pictures. Rare classes come more often than their share, yet not the same few photos
    all the time: a class is drawn by the square root of its size."""

    def __init__(
        self,
        photos: list[Sample],
        rendered: list[Sample],
        world: World,
        recipe: Recipe,
        seed: int,
        chances: Chances,
        disturbed: float = 0.0,
    ) -> None:
        """So much of the pictures is `disturbed`, those of nothing too: haze alone must not tell waste."""
        self._world = world
        self._rng = np.random.default_rng(seed)
        self._chances, self._disturbed = chances, disturbed
        self._recipe = recipe
        self._photos = photos
        self._items = [sample for sample in rendered if sample.label is not None]
        self._empty = [sample for sample in rendered if sample.label is None]
        self._photo_weights, self._item_weights = balanced(self._photos), balanced(self._items)

    @property
    def state(self) -> dict[str, Any]:
        """Where in its random numbers it is."""
        return dict(self._rng.bit_generator.state)

    @state.setter
    def state(self, state: dict[str, Any]) -> None:
        self._rng.bit_generator.state = state

    def batch(self, side: int) -> Batch:
        """The next pictures."""
        rng, recipe = self._rng, self._recipe
        inputs = np.empty((recipe.batch, 3, side, side), np.float32)
        clear = np.empty_like(inputs) if self._disturbed else inputs
        targets = np.full((recipe.batch, OUTPUTS), recipe.label_smoothing / OUTPUTS, np.float32)
        corrected = np.zeros(recipe.batch, bool)
        for row in range(recipe.batch):
            source = rng.random()
            if source < recipe.nothing_share:
                sample = Sample(self.nothing(side), None)
            elif source < recipe.nothing_share + recipe.rendered_share:
                sample = self._items[rng.choice(len(self._items), p=self._item_weights)]
            else:
                sample = self._photos[rng.choice(len(self._photos), p=self._photo_weights)]
            chances = self._chances
            if source <= recipe.nothing_share + recipe.rendered_share:
                chances = replace(chances, clutter=0.0)
            view = augment(sample.image_bgr, side, rng, chances, self._background)
            clear[row] = _input(view)
            if self._disturbed:
                foul = rng.random() < self._disturbed
                inputs[row] = _input(weather.disturbed(view, rng)) if foul else clear[row]
            target = len(CLASSES) if sample.label is None else CLASSES.index(sample.label)
            targets[row, target] += 1 - recipe.label_smoothing
            corrected[row] = sample.corrected
        return Batch(inputs, targets, clear, corrected)

    def nothing(self, side: int) -> np.ndarray:
        """A picture without an item."""
        rng = self._rng
        if rng.random() < self._recipe.real_nothing:
            return self._real_nothing(side)
        which = rng.random()
        if which < 0.45:
            return self._empty[rng.integers(len(self._empty))].image_bgr
        if which < 0.55:
            board = self._board()
            if board is not None:
                return board
        if which < 0.75:
            return scenery.hand(side, rng)
        return scenery.TEXTURES[int(rng.integers(len(scenery.TEXTURES)))](side, rng)

    def _real_nothing(self, side: int) -> np.ndarray:
        """Part of a photo of something else, or a thing cut out of one: half of these before the board of a
        photo of waste, so that the board does not tell."""
        rng = self._rng
        if rng.random() < 0.5:
            return self._world.scene(rng)
        behind = self._board() if rng.random() < 0.5 else None
        if behind is None:
            behind = self._background(rng)
        return self._world.thing(cv2.resize(behind, (side, side), interpolation=cv2.INTER_AREA), rng)

    def _board(self) -> np.ndarray | None:
        return bare_board(self._photos[self._rng.integers(len(self._photos))].image_bgr)

    def _background(self, rng: np.random.Generator) -> np.ndarray:
        """What stands behind items and other things: half of it real, so that it tells nothing of either."""
        return self._world.scene(rng) if rng.random() < 0.5 else drawn(rng)


def _input(view: np.ndarray) -> np.ndarray:
    """(side, side, 3) BGR as (3, side, side) for the network."""
    return (view[..., ::-1].transpose(2, 0, 1).astype(np.float32) - MEAN) * SCALE


def balanced(samples: list[Sample]) -> np.ndarray:
    """How often each is drawn, (n,): a class by the square root of its size.

    A few pictures of no class, which people corrected, are not drawn more often than those of the rarest.
    """
    counts = Counter(sample.label for sample in samples)
    rarest = min((count for label, count in counts.items() if label is not None), default=1)
    weight = np.array([1 / np.sqrt(max(counts[sample.label], rarest)) for sample in samples])
    return weight / weight.sum()


Schedule = list[tuple[int, float]]
"""For each step the pictures' side (px) and the learning rate."""


def beginning(recipe: Recipe) -> Schedule:
    """The learning rate rises, stays, and falls to zero."""
    stable, cooldown, peak = recipe.stable_steps, recipe.cooldown_steps, recipe.learning_rate
    rise = [(recipe.stable_px, peak * min((step + 1) / recipe.warmup_steps, 1.0)) for step in range(stable)]
    return rise + [(recipe.cooldown_px, peak * _fall(step / cooldown)) for step in range(cooldown)]


def finish(recipe: Recipe) -> Schedule:
    """A low rate that falls to zero."""
    steps = recipe.finish_steps
    return [(recipe.input_px, recipe.finish_rate * _fall(step / steps)) for step in range(steps)]


def foul(after: Weather) -> Schedule:
    """The rate rises, and falls to zero: from the first step at the full rate networks do not recover."""
    rising = after.warmup_steps
    rise = [(after.px, after.rate * (step + 1) / rising) for step in range(rising)]
    return rise + [(after.px, after.rate * _fall(step / after.steps)) for step in range(after.steps)]


def _fall(share: float) -> float:
    """From 1 to 0 along half a cosine."""
    return 0.5 + 0.5 * float(np.cos(np.pi * share))


def _groups(network: Network, decay: float) -> list[dict[str, Any]]:
    """The network's parts with their share of the learning rate; frozen ones have no gradient and stay."""
    body, depth = network.body, len(network.body._blocks)
    shares = [decay ** ((depth - index) / depth * 8) for index in range(depth)]
    head = nn.ModuleList([body._conv_head, body._bn1, body._fc])
    return [
        {"params": list(part.parameters()), "share": share}
        for part, share in zip([*body._blocks, head], [*shares, 1.0], strict=True)
    ]


class Stateful(Protocol):
    """A network or an optimizer."""

    def state_dict(self) -> dict[str, Any]:
        """All that it must not forget."""

    def load_state_dict(self, state_dict: dict[str, Any], /) -> Any:
        """Be as it was when `state_dict` was taken."""


class Checkpoint:
    """A file from which a stage of training that was killed continues, to the same weights bit for bit."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def save(self, step: int, draws: Draws, *parts: Stateful) -> None:
        """After `step` steps. A kill at any moment leaves this one or the one before."""
        state = {
            "step": step,
            "draws": json.dumps(draws.state),  # its integers are longer than torch writes
            "torch": torch.get_rng_state(),
            "parts": [part.state_dict() for part in parts],
        }
        beside = self._path.with_suffix(".new")
        torch.save(state, beside)
        beside.replace(self._path)

    def load(self, draws: Draws, *parts: Stateful) -> int:
        """How many steps were done; 0 and nothing changed where there is no file."""
        if not self._path.exists():
            return 0
        state = torch.load(self._path, weights_only=True)
        draws.state = json.loads(state["draws"])
        torch.set_rng_state(state["torch"])
        for part, kept in zip(parts, state["parts"], strict=True):
            part.load_state_dict(kept)
        return int(state["step"])


def fit(
    network: Network,
    draws: Draws,
    schedule: Schedule,
    recipe: Recipe,
    ema_decay: float,
    checkpoint: Checkpoint | None = None,
    teacher: Teacher | None = None,
) -> Iterator[tuple[int, float, Network]]:
    """Yields (step, mean loss since the last, averaged network) now and then and at the end. The averaged
    network is the exponential moving average of the weights. Goes on from the checkpoint, if there is one."""
    network = network.to(**_CHANNELS_LAST).train()
    average = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(ema_decay), use_buffers=True
    )
    optimizer = torch.optim.AdamW(_groups(network, recipe.rate_decay), weight_decay=recipe.weight_decay)
    averaged = average.module
    assert isinstance(averaged, Network)
    losses: list[float] = []
    done = checkpoint.load(draws, network, average, optimizer) if checkpoint else 0
    if done == len(schedule):
        yield done, math.nan, averaged
    for step, (side, rate) in enumerate(schedule[done:], done + 1):
        for group in optimizer.param_groups:
            group["lr"] = rate * group["share"]
        batch = draws.batch(side)
        x = torch.from_numpy(batch.inputs).to(memory_format=torch.channels_last)
        with _bfloat16():
            logits = network(x)
        targets = torch.from_numpy(batch.targets) if teacher is None else teacher.targets(batch)
        loss = nn.functional.cross_entropy(logits.float(), targets)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        average.update_parameters(network)
        losses.append(loss.item())
        if step % LOG_EVERY_STEPS == 0 or step == len(schedule):
            if checkpoint:
                checkpoint.save(step, draws, network, average, optimizer)
            yield step, float(np.mean(losses)), averaged
            losses.clear()


def _bfloat16() -> torch.autocast:
    """A step takes half the time of float32 with AVX-512; other processors would emulate it, slowly."""
    return torch.autocast("cpu", torch.bfloat16, enabled=torch.backends.cpu.get_cpu_capability() == "AVX512")


def prepare() -> None:
    """Set torch, OpenCV and the allocator up for training, for the whole process."""
    torch.use_deterministic_algorithms(True)
    deterministic: Any = torch.utils.deterministic  # torch's types do not have what follows
    deterministic.fill_uninitialized_memory = False  # nothing reads it, and filling takes time
    torch.set_num_threads(1)  # the result must not depend on how many cores the machine has
    cv2.setNumThreads(1)
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        # Each step frees what the next one takes; glibc would give it back to the system between, and each
        # of its pages costs anew: a tenth of the time.
        for parameter, value in MALLOPT.items():
            libc.mallopt(parameter, value)


def train(
    photos: list[Sample],
    rendered: list[Sample],
    world: World,
    recipe: Recipe,
    checkpoints: Path | None = None,
) -> Network:
    """Train to the end; the averaged network in evaluation mode. Goes on from what is in the folder
    `checkpoints`."""
    torch.manual_seed(recipe.seed)
    often = Draws(photos, rendered, world, recipe, recipe.seed, CHANCES)
    network = Network(OUTPUTS, recipe.drop_connect)
    kept = _checkpoint(checkpoints, "beginning")
    network = last(fit(network, often, beginning(recipe), recipe, recipe.ema_decay, kept))
    return finished(network, photos, rendered, world, recipe, checkpoints)


def finished(
    network: Network,
    photos: list[Sample],
    rendered: list[Sample],
    world: World,
    recipe: Recipe,
    checkpoints: Path | None = None,
) -> Network:
    """After the last steps."""
    torch.manual_seed(recipe.seed + 1)  # these steps can be repeated alone
    seldom = Draws(photos, rendered, world, recipe, recipe.seed + 1, SELDOM)
    kept = _checkpoint(checkpoints, "finish")
    network = last(fit(network, seldom, finish(recipe), recipe, recipe.finish_ema_decay, kept))
    return settled(network, photos, rendered, world, recipe)


def wholly(
    photos: list[Sample],
    rendered: list[Sample],
    world: World,
    recipe: Recipe,
    after: Weather,
    path: Path,
    checkpoints: Path | None = None,
) -> Network:
    """All steps of the recipe, and those in all weathers. `path` is where the weights between them go."""
    export(train(photos, rendered, world, recipe, checkpoints), path, recipe.input_px)
    network = weathered(path, photos, rendered, world, recipe, after, checkpoints)
    network.second = seconded(photos, rendered, world, recipe)
    return network


def seconded(photos: list[Sample], rendered: list[Sample], world: World, recipe: Recipe) -> Second:
    """The second opinion. Clear to it are the photos as they are, and mirrored; foul are those that are
    disturbed, strongly or faintly, and what else it is shown."""
    opinion = Second(
        len(CLASSES),
        share=recipe.second_share,
        foul_share=recipe.second_foul_share,
        alone=recipe.second_alone,
        nothing_share=recipe.second_nothing_share,
    )
    side = recipe.input_px

    def square(sample: Sample) -> np.ndarray:
        return cv2.resize(sample.image_bgr, (side, side), interpolation=cv2.INTER_AREA)

    def seen(views: Iterable[np.ndarray]) -> torch.Tensor:
        with torch.no_grad():
            return torch.cat([opinion.features(torch.from_numpy(_input(view)[None])) for view in views])

    def targets(samples: list[Sample]) -> torch.Tensor:
        label = torch.tensor([CLASSES.index(str(sample.label)) for sample in samples])
        smoothing = recipe.label_smoothing
        return nn.functional.one_hot(label, len(CLASSES)) * (1 - smoothing) + smoothing / len(CLASSES)

    draws = Draws(photos, rendered, world, recipe, recipe.seed + 4, SELDOM)
    rng = np.random.default_rng(recipe.seed + 4)
    as_they_are, mirrored = seen(map(square, photos)), seen(square(photo)[:, ::-1] for photo in photos)
    log.info("second opinion: the photos are seen")
    of_photos = targets(photos)

    def changed(how: weather.Disturbance, times: int, share: float) -> Views:
        views = [seen(how(square(photo), rng) for photo in photos) for _ in range(times)]
        return Views(torch.cat(views), of_photos.repeat(times, 1), share)

    disturbed = changed(weather.disturbed, recipe.second_disturbed, 0.4)
    faint = changed(weather.faintly, recipe.second_faint, 0.3)
    log.info("second opinion: the disturbed photos are seen")
    items = [sample for sample in rendered if sample.label is not None]
    empty = [square(sample) for sample in rendered if sample.label is None]
    nothing = [square(Sample(draws.nothing(side), None)) for _ in range(recipe.second_nothing)]
    opinion.learn(
        Views(torch.cat([as_they_are, mirrored]), of_photos.repeat(2, 1)),
        [disturbed, faint, Views(seen(map(square, items)), targets(items), 0.1)],
        seen([*nothing, *empty]),
        recipe.second_ridge,
        recipe.second_foul_ridge,
    )
    return opinion


def weathered(
    weights: Path,
    photos: list[Sample],
    rendered: list[Sample],
    world: World,
    recipe: Recipe,
    after: Weather,
    checkpoints: Path | None = None,
) -> Network:
    """The exported network of `weights` after the steps in all weathers; in evaluation mode."""
    torch.manual_seed(recipe.seed + 3)
    changed = {name: getattr(after, name) for name in ("rate_decay", "nothing_share", "real_nothing")}
    recipe = replace(recipe, **changed)
    draws = Draws(photos, rendered, world, recipe, recipe.seed + 3, SELDOM, after.disturbed)
    network, kept = exported(weights, recipe.drop_connect), _checkpoint(checkpoints, "weather")
    opinion, network.second = network.second, None
    teacher = Teacher(exported(weights).to(**_CHANNELS_LAST).eval(), after.taught)
    progress = fit(network, draws, foul(after), recipe, recipe.finish_ema_decay, kept, teacher)
    learnt = last(progress).eval()
    learnt.second = opinion
    return learnt


def _checkpoint(folder: Path | None, stage: str) -> Checkpoint | None:
    return None if folder is None else Checkpoint(folder / f"{stage}.pt")


def settled(
    network: Network, photos: list[Sample], rendered: list[Sample], world: World, recipe: Recipe
) -> Network:
    """Moved back towards ImageNet, its head cut to what is worth its time; in evaluation mode."""
    network.towards_pretrained(recipe.pretrained_share)
    views = Draws(photos, rendered, world, recipe, recipe.seed + 2, SELDOM)
    pictures = (torch.from_numpy(views.batch(recipe.input_px)[0]) for _ in range(8))
    network.eval().keep_pools(KEPT_POOLS, pictures)
    return network


def last(progress: Iterator[tuple[int, float, Network]]) -> Network:
    """The network of the last step; each is logged."""
    trained: list[Network] = []
    for step, loss, network in progress:
        log.info("step %d, loss %.3f", step, loss)
        trained = [network]
    return trained[0]


def calibrate(
    photos: metrics.Outputs, rendered: metrics.Outputs, preprocessing: Preprocessing, rejected: float
) -> Preprocessing:
    """Temperature that minimises the photos' log loss, and the threshold that rejects at most `rejected` of
    the photos and of the renderings."""
    best = best_temperature(photos)
    below = min(float(np.quantile(known.confidence(best), rejected)) for known in (photos, rendered))
    return preprocessing.model_copy(update={"temperature": best, "unknown_below": round(below, 4)})


def best_temperature(photos: metrics.Outputs) -> float:
    """The temperature that minimises the log loss."""
    temperatures = np.geomspace(0.2, 3.0, 200)
    best = min(temperatures, key=lambda t: metrics.log_loss(photos.probabilities(t), photos.truth))
    return round(float(best), 4)


def calibrated(found: crossed.Crossed, folds: Path, risk: float) -> dict[str, float]:
    """Temperature and threshold for a network of the same recipe as those in `folds`, from their answers to
    photos that they did not learn from."""
    own = [load_preprocessing(crossed.folder_of(folds, fold)).temperature for fold in found.folds]
    further = best_temperature(found.answers)
    return {
        "temperature": round(float(np.exp(np.mean(np.log(own)))) * further, 4),
        "unknown_below": threshold(found.answers.confidence(further), risk),
    }


def uncalibrated(recipe: Recipe) -> Preprocessing:
    """Before anything is measured: probabilities as they come, nothing is unknown."""
    return Preprocessing(
        classes=list(CLASSES),
        input_px=recipe.input_px,
        mean=MEAN,
        scale=SCALE,
        temperature=1.0,
        unknown_below=0.0,
    )


def main(
    data: Path,
    fetched: Path,
    out: Path,
    recipe: Recipe,
    folds: Path,
    learn_all: bool = False,
    checkpoints: Path | None = None,
    after: Weather = WEATHER,
) -> None:
    """Train, export, calibrate and write the model card, whose figures are of what the bin answers. `fetched`
    is the folder that `others` fetched photos into.

    With `learn_all` it learns from the val list too; then the cross-validated networks in `folds` choose
    temperature and threshold and are measured in its place. Goes on from what is in the folder `checkpoints`.
    Raises NoSamples, Unfinished, OtherRecipe.
    """
    world = World.load(fetched)
    made_by = Training(
        architecture=NETWORK,
        recipe=asdict(recipe),
        others_sha256=world.sha256,
        learnt=crossed.PARTS if learn_all else ("train",),
        weather=asdict(after),
    )
    if learn_all:
        crossed.check(folds, made_by)
    photos = crossed.all_photos(data) if learn_all else load_photos(data / "train")
    rendered = renderings.render_samples(recipe.renderings_seed, recipe.renderings_per_class)
    log.info("%d photos, %d renderings to learn from", len(photos), len(rendered))
    if checkpoints is not None:
        checkpoints.mkdir(parents=True, exist_ok=True)
    out.mkdir(parents=True, exist_ok=True)
    network = wholly(photos, rendered, world, recipe, after, out / WEIGHTS, checkpoints)
    publish(network, made_by, data, fetched, out, recipe, folds)


def publish(
    network: Network,
    training: Training,
    data: Path,
    fetched: Path,
    out: Path,
    recipe: Recipe,
    folds: Path,
) -> None:
    """Export, calibrate, measure; write the model, its card and its cross-validated answers into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    val_photos = load_photos(data / "val")
    (out / TRAINING).write_text(training.model_dump_json(indent=2) + "\n")
    export(network, out / WEIGHTS, recipe.input_px)
    preprocessing = uncalibrated(recipe)
    write_preprocessing(out, preprocessing)
    classifier = Classifier(out)
    _assert_same(network, classifier, val_photos[0])
    kept = None
    if training.learnt_all:
        changed = calibrated(crossed.measured(folds, data), folds, recipe.known_rejected)
        write_preprocessing(out, preprocessing.model_copy(update=changed))
        kept = Kept.measured(folds, data, Classifier(out).model_sha256)
        kept.write(out / ANSWERS)
    else:
        on_photos = metrics.answers_to_files(classifier, data / "val", val_photos)
        on_rendered = metrics.answers_to_samples(classifier, held_out_samples(training.recipe, val_photos)[0])
        write_preprocessing(out, calibrate(on_photos, on_rendered, preprocessing, recipe.known_rejected))
    log.info("%s", write_card(out, data, fetched, kept, out))


def write_preprocessing(out: Path, preprocessing: Preprocessing) -> None:
    """Beside the weights in `out`."""
    (out / PREPROCESSING).write_text(preprocessing.model_dump_json(indent=2) + "\n")


def _assert_same(network: nn.Module, classifier: Classifier, sample: Sample) -> None:
    """The exported network must answer as the trained one: fp16 rounding only."""
    with torch.inference_mode():
        x = torch.from_numpy(to_input(sample.image_bgr, classifier.preprocessing))
        trained = network(x).numpy().reshape(-1)
    exported = classifier.logits(sample.image_bgr)
    if np.abs(trained - exported).max() > 0.1:
        raise RuntimeError(f"the export changed the network: {trained} became {exported}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Train the bin's classifier.")
    parser.add_argument("--data", type=Path, required=True, help="folder of train/<class>/ and val/<class>/")
    parser.add_argument("--others", type=Path, default=FETCHED, help="folder of photos of other things")
    # Not the installed model unless it is named: it would be replaced.
    parser.add_argument("--out", type=Path, required=True, help="folder for the model and its card")
    parser.add_argument(
        "--all", action="store_true", help="learn from the val list too; the networks in --folds measure"
    )
    parser.add_argument(
        "--folds", type=Path, default=FOLDS_DIR, help="folder of the cross-validated networks"
    )
    parser.add_argument(
        "--checkpoints", type=Path, metavar="FOLDER", help="continue from here after it was killed"
    )
    parser.add_argument("--shorten", type=int, default=1, metavar="TIMES", help="less work, to try it out")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    prepare()
    try:
        main(
            arguments.data,
            arguments.others,
            arguments.out,
            Recipe().shortened(arguments.shorten),
            arguments.folds,
            arguments.all,
            arguments.checkpoints,
            WEATHER.shortened(arguments.shorten),
        )
    except RodeoError as error:
        sys.exit(str(error))
