"""What the bin's own state machine says of an item that is shown from several angles, one after another."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rodeo.lab.config import BinConfig, Pose2
from rodeo.vision.classification import digest
from rodeo.vision.classifier import Classifier
from services.itrash.behaviour import Action, Attest, Bin, ClassificationRecord, Memory, TakePhoto

_STEP_S = 0.1
_SHOWN_S, _AWAY_S = 3.0, 2.0
_SHOWN_M = 0.3


def said_of(classifier: Classifier, views: Sequence[bytes]) -> list[ClassificationRecord]:
    """The bin's classifications of one item. The first view is shown, then the others while the bin asks for
    another angle. `views` are encoded pictures; a view is held still, so its picture counts once."""
    config = BinConfig(pose=Pose2(x_m=0.0, y_m=0.0))
    said: list[ClassificationRecord] = []
    bin_, time_s = Bin(config, Memory()), 0.0
    for view in views:
        answer, name = classifier.classify(view), digest(view)

        def carry_out(actions: list[Action], now_s: float) -> None:
            for action in actions:
                if isinstance(action, TakePhoto):
                    carry_out(bin_.photo(answer, name, now_s), now_s)  # noqa: B023
                elif isinstance(action, Attest) and isinstance(action.record, ClassificationRecord):
                    said.append(action.record)

        for range_m, for_s in ((_SHOWN_M, _SHOWN_S), (math.inf, _AWAY_S)):
            for _ in range(round(for_s / _STEP_S)):
                time_s = round(time_s + _STEP_S, 6)
                carry_out(bin_.presence(range_m, time_s), time_s)
                for compartment in config.compartments:
                    carry_out(bin_.load(compartment, 0.0, time_s), time_s)
        if not said or not said[-1].another_angle:
            break
    return said
