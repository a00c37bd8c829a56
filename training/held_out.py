"""What a network is tried on beside photos of waste: rendered items and pictures without an item. It learns
from none of them, and none chooses a threshold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from rodeo.vision.classifier import Classifier, shrink
from rodeo.vision.images import decode_image
from training import metrics, others
from training.card import held_out_samples
from training.dataset import Sample, load_photos
from training.folds import near

_KINDS = {
    "rendered": "held-out renderings",
    "drawn": "drawn pictures without an item",
    "real": "real photos of other things",
}


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

    def apart_from(
        self, corrected: Sequence[Sample], seen: Callable[[list[Sample]], np.ndarray]
    ) -> tuple[HeldOut, list[str]]:
        """Without what is a near-duplicate of a corrected picture, and how many these are: who learnt from
        one answers the other easily. Of a kind of which nothing would be left all stay. `seen` tells what a
        network sees in pictures."""
        kept: dict[str, Any] = {}
        told = []
        own = seen(list(corrected))
        for field in fields(self):
            pictures = getattr(self, field.name)
            samples = [
                one if isinstance(one, Sample) else Sample(shrink(decode_image(one)), None)
                for one in pictures
            ]
            alike = np.asarray(near(samples, seen(samples), corrected, own).any(axis=1))
            some = 0 < alike.sum() < len(pictures)
            kept[field.name] = [o for o, a in zip(pictures, alike, strict=True) if not (some and a)]
            if alike.any():
                counted = "not counted" if some else "counted all the same, as no others are there"
                told.append(
                    f"{alike.sum()} of {len(pictures)} {_KINDS[field.name]} are near-duplicates of corrected "
                    f"pictures: {counted}"
                )
        return replace(self, **kept), told

    def shares(self, classifier: Classifier) -> dict[str, float]:
        """For each kind the share of right answers, by what is counted."""
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
