"""What the bin looked at: the picture travels in the proof as the camera encoded it.

Whether it is there decides, and whether the bin asked a network that the kind's rules list, and said what
that one says: the network that the bin names is asked again. It is the installed one, or lies in a folder
beside its files that is called by its hash; where it is neither, this oracle cannot tell.
"""

from collections.abc import Collection, Sequence
from functools import cache
from hashlib import sha256
from typing import TYPE_CHECKING

from rodeo.checks.case import CaseError
from rodeo.checks.report import Finding, at_most, undecided
from rodeo.evidence.proof import Proof
from rodeo.ros2 import types
from rodeo.ros2.errors import MalformedMessage
from rodeo.site import topics
from rodeo.text.foreign_text import in_words, quoted
from rodeo.vision.classification import (
    MODEL_DIR,
    UNKNOWN,
    BrokenModel,
    UnlistedModel,
    combined,
    model_sha256,
)
from rodeo.vision.classification import Classification as Answer
from rodeo.vision.images import ImageError
from rodeo.witness.statement import Classification

if TYPE_CHECKING:
    from rodeo.vision.classifier import Classifier

MAX_PICTURES = 1000
"""In one proof: far more than a bin takes while a robot works."""

_ROUNDING = 0.02
"""Between two machines' probabilities of the same pictures."""
_SOURCE = "the picture in the proof, and the bin's signed statement"


def shown(proof: Proof, bin_name: str, said: Classification, listed: Collection[str]) -> Finding:
    """All pictures whose hashes the bin signed are in the proof, and it said what the network that it names
    says of them together.

    Undecided where the bin asked a network that is not `listed`, said what that network does not say, or
    signed what is no picture: its word does not count, and the executor did not choose it. Also where this
    oracle does not have that network. Raises CaseError where the picture is missing, LayoutChanged where its
    topic holds something else.
    """
    topic = "/" + topics.BIN_IMAGE.name(bin=bin_name)
    count = proof.count(topic)
    if count > MAX_PICTURES:
        return at_most(count, MAX_PICTURES, "", source="limit of pictures in a proof", detail="pictures")
    pictures = _pictures(proof, topic, [look.image_sha256 for look in said.looks])
    if said.model_sha256 not in listed:
        return undecided(
            f"it asked the network {said.model_sha256}, which the rules do not list: {', '.join(listed)}",
            f"the bin {bin_name}",
            source=_SOURCE,
        )
    try:
        asked = network(said.model_sha256)
    except (UnlistedModel, BrokenModel) as error:
        return undecided(
            f"it cannot ask the network {said.model_sha256}, which the rules list: {in_words(error)}",
            "the oracle",
            source="the network's files here, and the kind's rules",
        )
    try:
        found = combined([asked.classify(picture) for picture in pictures])
    except ImageError as error:
        # The bin signed the hash of these bytes, so the executor did not exchange them.
        return undecided(
            f"it signed the hash of what is no picture: {error.message}",
            f"the bin {bin_name}",
            source=_SOURCE,
        )
    answer = f"{found.label} ({found.confidence:.2f})"
    if other := _other_words(said, found, answer):
        return undecided(other, f"the bin {bin_name}", source=_SOURCE)
    of_several = f" of {len(pictures)} pictures" if len(pictures) > 1 else ""
    sure = max(said.probabilities.values(), default=0.0)
    return Finding(
        passed=True,
        measured=found.label,
        source=_SOURCE,
        detail=f"the bin said {quoted(said.item_class)} ({sure:.2f}){of_several}; the same network says "
        f"{answer}",
    )


def _other_words(said: Classification, found: Answer, answer: str) -> str:
    """What the bin said that its network does not say of the same pictures; empty where it said the same."""
    named = "the network that it names"
    if said.item_class not in _may_be_said(found):
        return f"it said {quoted(said.item_class)}, and {named} says {answer} of its pictures"
    if _differs(found.told, said.probabilities):
        return f"it signed other probabilities than {named} has: {found.told}"
    if said.thresholds_sha256 != found.thresholds_sha256:
        return f"it signed other thresholds than {named} has: {found.thresholds_sha256}"
    return ""


def _may_be_said(found: Answer) -> set[str]:
    """What a machine may say whose probabilities differ by rounding."""
    best = max(found.told.values())
    over = found.confidence - found.unknown_below
    classes = {name for name, probability in found.told.items() if probability >= best - _ROUNDING}
    return (classes if over >= -_ROUNDING else set()) | ({UNKNOWN} if over < _ROUNDING else set())


def _differs(own: dict[str, float], signed: dict[str, float]) -> bool:
    return any(abs(own.get(name, 0.0) - signed.get(name, 0.0)) > _ROUNDING for name in {*own, *signed})


def _pictures(proof: Proof, topic: str, hashes: Sequence[str]) -> list[bytes]:
    """The encoded pictures of these hashes, in their order. Raises CaseError."""
    column = proof.topics.get(topic)
    if column is None:
        raise CaseError("the picture that the bin classified is not in the recording", topic=topic)
    if column.ros_type != topics.BIN_IMAGE.type:
        raise CaseError("the picture's topic has another type", topic=topic, found=column.ros_type[:200])
    found: dict[str, bytes] = {}
    for index, message in enumerate(column.data):
        try:
            picture = types.deserialize(message, column.ros_type).data.tobytes()
        except MalformedMessage as error:
            raise CaseError(
                "a message on the picture's topic is not an image", topic=topic, index=index
            ) from error
        name = "0x" + sha256(picture).hexdigest()
        if name in hashes:
            found[name] = picture
    for name in hashes:
        if name not in found:
            raise CaseError(
                "no picture in the recording has the hash that the bin signed",
                image_sha256=name,
                pictures=len(column),
            )
    return [found[name] for name in hashes]


@cache
def network(name: str) -> "Classifier":
    """The one of this hash. Loaded when it is first asked: OpenCV takes its time to import.

    Raises UnlistedModel where the files are another one's: somebody exchanged them meanwhile; BrokenModel
    where they are no network's, or not there.
    """
    from rodeo.vision.classifier import Classifier

    return Classifier(MODEL_DIR if name == model_sha256() else MODEL_DIR / name, listed=(name,))
