"""Answers on the bus about classified pictures: the pictures themselves, and people's corrections."""

from __future__ import annotations

import base64
import logging
from collections.abc import Callable, Mapping
from typing import Any

from rodeo.bus import queries
from rodeo.bus.session import Request
from rodeo.evidence.attestation import Attestation
from rodeo.runtime.process import Process
from rodeo.site import topics
from rodeo.witness import correction
from rodeo.witness.witness import Witness
from services.itrash.corrections import Corrections, NotYetKnown, pictures_of, read_correction
from services.itrash.pictures import NoSuchPicture, Pictures

log = logging.getLogger(__name__)


class Gallery:
    """Pictures of the bin `name`. `classified` gives the newest classification of each.

    A correction names one of `classes`.
    """

    def __init__(
        self,
        process: Process,
        name: str,
        pictures: Pictures,
        classified: Callable[[], dict[str, Attestation]],
        witness: Witness,
        classes: frozenset[str],
    ) -> None:
        self._process = process
        self._name = name
        self._pictures = pictures
        self._classified = classified
        self._witness = witness
        self._classes = classes
        self._corrections = Corrections(process.data_dir / "corrections", name)
        org = process.site.org
        self._served = [
            process.bus.serve(topics.BIN_PICTURE.name(org=org, bin=name), self._serve_picture),
            process.bus.serve(topics.BIN_CORRECTIONS.name(org=org, bin=name), self._serve_corrections),
        ]

    def _serve_picture(self, request: Request) -> dict[str, Any]:
        wanted = request.parameters.get("sha256", "")
        data = self._pictures.find(wanted)
        return {"sha256": wanted, "data_base64": base64.b64encode(data).decode()}

    def _serve_corrections(self, request: Request) -> dict[str, Any]:
        roles = queries.ask(self._process.bus, self._process.site.org, queries.ORGANIZATION).roles
        listed = roles.get("AUDITOR_ROLE", [])
        auditors = {one.address.lower(): one.name or one.address for one in listed}
        if request.payload:
            self._correct(request.payload, auditors)
        classified = self._classified()
        found = correction.Corrections(
            bin=self._name,
            people=self._corrections.judged(auditors),
            pictures=tuple(
                correction.Pictured(
                    image_sha256=name,
                    item_class=said.payload["class"],
                    shown_s=said.payload["shown_s"],
                    corrections=self._corrections.said_of(name, auditors),
                )
                for name, said in classified.items()
                if self._pictures.has(name)
            ),
        )
        return found.model_dump(by_alias=True)

    def _correct(self, payload: bytes, auditors: Mapping[str, str]) -> None:
        chain = self._witness.chain
        if chain is None:
            raise NotYetKnown("the bin waits for the bridge to name the organization", bin=self._name)
        signed, said = read_correction(payload, chain.scope, self._name)
        classification = self._classified().get(said.image_sha256)
        if classification is None:
            raise NoSuchPicture("the bin said nothing of such a picture lately", sha256=said.image_sha256)
        pictures = pictures_of(classification, self._pictures)
        self._corrections.add(signed, said, classification, pictures, self._classes, auditors)
        log.info("%s says that it was %s", auditors[signed.signer.lower()], said.item_class)
