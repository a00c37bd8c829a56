"""What the bin says of a picture, and the data that decide it: weights, classes, preprocessing, thresholds.

Preprocessing, classes and thresholds are data beside the weights (`model/preprocessing.json`, written by
`training.train`). A network is known by one hash of both files: the same weights with other
classes, another temperature or another threshold say something else, and are another network. It stands in
what the bin signs, and in the rules that list the networks whose word counts.

    RodeoError
    ├── BrokenModel           a file is missing, or is no network or no preprocessing of one
    └── UnlistedModel         the network is none of those that may be loaded
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from rodeo.errors import RodeoError, unreadable
from rodeo.lab.config import ItemClass

MODEL_DIR = Path(__file__).parent / "model"
WEIGHTS = "trash.onnx"
PREPROCESSING = "preprocessing.json"

_LEAST = 1e-4
"""No picture rules anything out further than the probabilities that are signed can tell."""
UNKNOWN = "unknown"
"""The label of a photo the model is not sure about. Never a class of the model."""


class BrokenModel(RodeoError):
    """No network that turns a picture into one number for each class of waste and one more: a file is
    missing, or is none of one."""


class UnlistedModel(RodeoError):
    """The network is none of those that may be loaded."""


class Preprocessing(BaseModel):
    """How a BGR photo becomes the network's input, and its output a verdict."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    classes: list[str]
    """Names of all `ItemClass`, as the network's outputs in order; one more follows, for a picture that shows
    none of them."""
    input_px: int
    """Side of the square input. The whole photo is squeezed into it: the bin's camera frames the item, so
    cropping would lose what the picture is about."""
    mean: float
    scale: float
    """Input = (RGB - mean) * scale."""
    temperature: float = Field(gt=0)
    """Logits are divided by it before the softmax (Guo et al., 2017, arXiv:1706.04599)."""
    unknown_below: float = Field(ge=0, le=1)
    """A photo whose best class is less probable than this, `none of them` included, is `unknown`."""


@dataclass(frozen=True)
class Classification:
    """`label` is a class or `unknown`; `probabilities` of the classes sum to one either way: they say which
    class it is if it is one. `item_probability` says whether it is one at all."""

    label: str
    probabilities: dict[str, float]
    item_probability: float = 1.0
    model_sha256: str = ""
    """The network that was asked, and `thresholds_sha256`, a part of it: of the bytes in use. Empty where the
    answer is computed from logits alone."""
    thresholds_sha256: str = ""
    unknown_below: float = 0.0
    """The threshold that the label was decided by."""

    @property
    def told(self) -> dict[str, float]:
        """The probabilities as they are said and signed, and decided by."""
        return {name: round(p, 4) for name, p in self.probabilities.items()}

    @property
    def best_class(self) -> str:
        """The most probable class, however sure."""
        return max(self.probabilities, key=self.probabilities.__getitem__)

    @property
    def confidence(self) -> float:
        """How probable it is that this is an item of the best class, 0..1."""
        return max(self.probabilities.values()) * self.item_probability


def verdict(logits: np.ndarray, preprocessing: Preprocessing) -> Classification:
    """Logits (classes + 1,) -> calibrated probabilities and the label."""
    scaled = logits.astype(np.float64) / preprocessing.temperature
    exponentials = np.exp(scaled - scaled.max())
    shares = exponentials / exponentials.sum()
    item = float(shares[:-1].sum())
    # Scaled again on their own: where no item is all but certain, `item` may vanish.
    classes = np.exp(scaled[:-1] - scaled[:-1].max())
    return _decided(
        Classification(
            label=UNKNOWN,
            probabilities=dict(zip(preprocessing.classes, map(float, classes / classes.sum()), strict=True)),
            item_probability=item,
            unknown_below=preprocessing.unknown_below,
        )
    )


def combined(looks: Sequence[Classification]) -> Classification:
    """What several pictures of one thing say together, decided by the threshold of the last.

    The log-probabilities are averaged, those of "none of them" included. Pictures of one thing err together,
    so their sum would be surer than they are right.
    """
    if len(looks) == 1:
        return looks[0]
    names = list(looks[-1].probabilities)
    shares = np.array([
        [*(look.probabilities[name] * look.item_probability for name in names), 1 - look.item_probability]
        for look in looks
    ])  # fmt: skip
    means = np.log(np.maximum(shares, _LEAST)).mean(axis=0)
    joint = np.exp(means - means.max())
    classes = joint[:-1]
    return _decided(
        replace(
            looks[-1],
            probabilities=dict(zip(names, map(float, classes / classes.sum()), strict=True)),
            item_probability=float(classes.sum() / joint.sum()),
        )
    )


def _decided(found: Classification) -> Classification:
    sure = found.confidence >= found.unknown_below
    return replace(found, label=found.best_class if sure else UNKNOWN)


def load_preprocessing(model_dir: Path = MODEL_DIR) -> Preprocessing:
    """The preprocessing beside the weights in `model_dir`. Raises BrokenModel."""
    return parse_preprocessing(file_of(model_dir, PREPROCESSING))


def parse_preprocessing(data: bytes) -> Preprocessing:
    """Raises BrokenModel for what is none of a network that names the classes of waste."""
    try:
        found = Preprocessing.model_validate_json(data)
    except ValueError as error:
        raise BrokenModel("the preprocessing cannot be read", problem=unreadable(error)) from error
    if sorted(found.classes) != sorted(ItemClass):
        raise BrokenModel(
            "the preprocessing names other classes", found=found.classes, expected=[*map(str, ItemClass)]
        )
    return found


def file_of(model_dir: Path, name: str) -> bytes:
    """What is in one of a network's files. Raises BrokenModel where it cannot be read."""
    try:
        return (model_dir / name).read_bytes()
    except OSError as error:
        raise BrokenModel(
            "a file of the network cannot be read", path=str(model_dir / name), problem=unreadable(error)
        ) from error


def digest(data: bytes) -> str:
    """SHA-256 (0x)."""
    return "0x" + sha256(data).hexdigest()


def network_sha256(weights: bytes, preprocessing: bytes) -> str:
    """What a network is known by: SHA-256 (0x) of the SHA-256 of its two files, the weights' first."""
    return digest(sha256(weights).digest() + sha256(preprocessing).digest())


@cache
def model_sha256(model_dir: Path = MODEL_DIR) -> str:
    """`network_sha256` of its files when it was first asked for. What a `Classifier` loaded, it tells.

    Raises BrokenModel.
    """
    return network_sha256(*(file_of(model_dir, name) for name in (WEIGHTS, PREPROCESSING)))


@cache
def thresholds_sha256(model_dir: Path = MODEL_DIR) -> str:
    """SHA-256 (0x) of the file with classes, preprocessing, temperature and threshold, as `model_sha256`.

    It tells people which of a network's two files is another; nothing is decided by it alone. Raises
    BrokenModel.
    """
    return digest(file_of(model_dir, PREPROCESSING))
