"""What a network is tried on beside photos of waste: rendered items and pictures without an item. It learns
from none of them, and none chooses a threshold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rodeo.vision.classifier import Classifier
from services.itrash.training import metrics, others
from services.itrash.training.card import held_out_samples
from services.itrash.training.dataset import Sample, load_photos


@dataclass(frozen=True)
class HeldOut:
    """Pictures of three kinds, at least one of each."""

    rendered: Sequence[Sample]
    """Items."""
    drawn: Sequence[Sample]
    """Without an item."""
    real: Sequence[bytes]
    """Encoded photos of what is no waste."""

    @classmethod
    def load(cls, recipe: dict[str, Any], data: Path, fetched: Path) -> HeldOut:
        """Those of the model card, but for the samples that only the dev extra brings.

        Raises NoSamples, NoPhotos, ImageError, RendererUnavailable.
        """
        real = list(others.measured_photos(fetched).values())
        rendered, drawn = held_out_samples(recipe, load_photos(data / "val"))
        return cls(rendered, drawn, real)

    def shares(self, classifier: Classifier) -> dict[str, float]:
        """Of each kind the share of right answers, by what is counted."""
        return {
            "held-out renderings named rightly": metrics.answers_to_samples(
                classifier, self.rendered
            ).accuracy(),
            "drawn pictures without an item called unknown": metrics.answers_to_samples(
                classifier, self.drawn
            ).unknown_share(),
            "real photos of other things called unknown": metrics.answers_to(
                classifier, self.real, [None] * len(self.real)
            ).unknown_share(),
        }
