"""What people say that items really were, kept with picture and statement for a later training.

RodeoError
├── NotWhatItSays         a correction's file has another's name
├── NotYetKnown           the bin does not know yet for which organization it speaks
└── RequestError
    ├── ForAnotherBin     it names another bin or organization
    ├── NoSuchClass       the network knows no such class
    ├── NotAnAuditor      the organization does not list the signer
    └── AlreadyCorrected  the same person said so of the same picture
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Collection, Mapping
from pathlib import Path

from pydantic import BaseModel, ValidationError

from rodeo.errors import InvalidRequest, RequestError, RodeoError, unreadable, wrong_fields
from rodeo.evidence.attestation import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation
from rodeo.host.files import replace_file
from rodeo.witness.correction import Correction, Judged
from rodeo.witness.statement import Classification, Scope
from services.itrash.pictures import NoSuchPicture, Pictures

log = logging.getLogger(__name__)


class NotYetKnown(RodeoError):
    """The bin does not know yet for which organization it speaks."""


class ForAnotherBin(RequestError):
    """The correction names another bin or another organization."""


class NoSuchClass(RequestError):
    """The bin's network knows no such class."""


class NotAnAuditor(RequestError):
    """The organization does not list the signer as an auditor."""


class AlreadyCorrected(RequestError):
    """This person already corrected this picture. The first correction stands."""


class NotWhatItSays(RodeoError):
    """The file of a correction has another's name."""


class Kept(BaseModel):
    """A correction as it lies in its file."""

    correction: Attestation
    classification: Attestation
    """The bin's statement that is corrected or confirmed."""

    @property
    def right(self) -> bool:
        return bool(self.classification.payload["class"] == self.correction.payload["class"])

    @property
    def told(self) -> Classification:
        return Classification.model_validate(self.classification.payload)

    def verify(self, name: str, bin_name: str) -> None:
        """Raises BadAttestation, ValidationError, and NotWhatItSays if it does not belong to this bin, into a
        file of this name: write access to the folder signs for nobody else. Only the chain knows whether a
        signer was an auditor then, and whose key signed for the bin: training asks it."""
        signer = verify_attestation(self.correction)
        verify_attestation(self.classification)
        said = Correction.model_validate(self.correction.payload)
        told = self.told
        if {said.bin, told.device} != {bin_name}:
            raise NotWhatItSays("it is about another bin", bin=said.bin, own=bin_name)
        if name != f"{said.image_sha256}-{signer.lower()}" or told.image_sha256 != said.image_sha256:
            raise NotWhatItSays("it is about another picture, or by somebody else", signer=signer)


def read_correction(payload: bytes, scope: Scope, bin_name: str) -> tuple[Attestation, Correction]:
    """A signed correction for this bin. Raises InvalidRequest, BadAttestation, ForAnotherBin."""
    try:
        signed = Attestation.model_validate_json(payload)
        said = Correction.model_validate(signed.payload)
    except ValidationError as error:
        raise InvalidRequest("this is not a signed correction", fields=wrong_fields(error)) from error
    own = scope.model_dump().items()
    for_us = all(str(getattr(said, name)).lower() == str(value).lower() for name, value in own)
    if said.bin != bin_name or not for_us:
        raise ForAnotherBin("the correction is for another bin or organization", bin=said.bin, own=bin_name)
    verify_attestation(signed)
    return signed, said


class Corrections:
    """A folder with one file for each correction, and once each picture that the bin combined for a corrected
    answer, as far as it still had them. Thread-safe."""

    def __init__(self, folder: Path, bin_name: str) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)
        self._kept: dict[str, Kept] = {}
        for path in sorted(folder.glob("*.json")):
            try:
                kept = Kept.model_validate_json(path.read_bytes())
                kept.verify(path.stem, bin_name)
                self._kept[path.stem] = kept
            except (OSError, ValidationError) as error:
                log.warning("a correction is damaged and does not count: %s: %s", path, unreadable(error))
            except (BadAttestation, NotWhatItSays) as error:
                log.warning("a correction does not count: %s: %s", path, error)

    def add(
        self,
        signed: Attestation,
        said: Correction,
        classification: Attestation,
        pictures: Mapping[str, bytes],
        classes: Collection[str],
        auditors: Mapping[str, str],
    ) -> None:
        """Keep an auditor's correction (`read_correction`) of `classification`. `pictures` holds the
        classified pictures by hash, including the corrected one.

        `auditors` are names by lower-case address.

        Raises NoSuchClass, NotAnAuditor, AlreadyCorrected, DiskFull.
        """
        address = signed.signer.lower()
        if said.item_class not in classes:
            raise NoSuchClass("there is no such class", given=said.item_class, classes=sorted(classes))
        if address not in auditors:
            raise NotAnAuditor("only auditors of the organization correct its bins", signer=signed.signer)
        name = f"{said.image_sha256}-{address}"
        with self._lock:
            if name in self._kept:
                first = self._kept[name].correction.payload["class"]
                raise AlreadyCorrected(
                    "this person already said what it was", image_sha256=said.image_sha256, said=first
                )
            kept = Kept(correction=signed, classification=classification)
            # The pictures first: a correction without its own teaches nothing.
            for sha256, picture in pictures.items():
                replace_file(self._folder / sha256, picture)
            replace_file(self._folder / f"{name}.json", kept.model_dump_json())
            self._kept[name] = kept

    def said_of(self, image_sha256: str, auditors: Mapping[str, str]) -> dict[str, str]:
        """The class that people gave this picture, by their names, or addresses if they have none now."""
        with self._lock:
            kept = [one.correction for one in self._kept.values()]
        return {
            auditors.get(one.signer.lower(), one.signer): one.payload["class"]
            for one in kept
            if one.payload["image_sha256"] == image_sha256
        }

    def judged(self, auditors: Mapping[str, str]) -> list[Judged]:
        """How often the bin was right, by each person, former auditors included. An item counts once."""
        with self._lock:
            kept = list(self._kept.values())
        people = sorted({one.correction.signer.lower() for one in kept})
        answers = {
            who: _last_of_each_item([one for one in kept if one.correction.signer.lower() == who])
            for who in people
        }
        return [
            Judged(address=who, name=auditors.get(who), items=len(right), right=sum(right))
            for who, right in answers.items()
        ]


def pictures_of(classification: Attestation, kept: Pictures) -> dict[str, bytes]:
    """The pictures that the bin combined for this answer, by their hashes, as far as it still has them.

    Raises NoSuchPicture where it does not have the last one.
    """
    told = Classification.model_validate(classification.payload)
    found = {told.image_sha256: kept.find(told.image_sha256)}
    for look in told.earlier:
        try:
            found[look.image_sha256] = kept.find(look.image_sha256)
        except NoSuchPicture:
            log.info("the bin has let go of a picture of %s", told.image_sha256)
    return found


def _last_of_each_item(judged: Collection[Kept]) -> list[bool]:
    """For each item, whether the bin's last answer about it was right. An answer about another angle names
    the earlier pictures."""
    items: list[tuple[set[str], bool]] = []
    for one in sorted(judged, key=lambda one: one.told.shown_s):
        pictures = {look.image_sha256 for look in one.told.looks}
        same = [item for item in items if item[0] & pictures]
        items = [item for item in items if not item[0] & pictures]
        items.append((pictures.union(*(item[0] for item in same)), one.right))
    return [right for _, right in items]
