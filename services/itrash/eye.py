"""A photo of what the bin is shown, and its class."""

from __future__ import annotations

import logging

from rodeo.errors import RodeoError
from rodeo.host.clock import Clock
from rodeo.vision.classifier import Classifier
from services.itrash.behaviour import TakePhoto
from services.itrash.camera import Camera
from services.itrash.pictures import Pictures
from services.itrash.steps import Steps

log = logging.getLogger(__name__)


class Eye:
    """Takes a photo with `camera`, keeps it in `pictures` and feeds its class to the state machine."""

    def __init__(self, camera: Camera, classifier: Classifier, pictures: Pictures, clock: Clock) -> None:
        self.camera = camera
        self.classifier = classifier
        self._pictures = pictures
        self._clock = clock

    def look(self, request: TakePhoto, steps: Steps) -> None:
        try:
            time_s, data = self.camera.capture(request.after_s)
            classification = self.classifier.classify(data)
            image_sha256 = self._pictures.keep(data)
        except RodeoError as error:
            log.warning("no photo of the item: %s", error)
            failed_s = self._clock.now_s()
            steps.feed("photo", lambda: steps.bin.photo_failed(failed_s))
            return
        steps.feed("photo", lambda: steps.bin.photo(classification, image_sha256, time_s))
