"""Strangers send anything: requests made from the OpenAPI document, and photos broken in every way."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
import schemathesis
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, settings
from schemathesis.specs.openapi.checks import positive_data_acceptance

from rodeo.vision.images import ImageLimits
from rodeo_testing.recordings import RENDERINGS
from services.itrash.web import make_api
from tests.unit.services.itrash.test_web import QuietBin

PHOTO = cv2.imread(str(RENDERINGS / "metal_1.jpg"))
API = make_api(QuietBin(), ImageLimits(max_bytes=200_000, max_pixels=1_000_000))
SCHEMA = schemathesis.openapi.from_asgi("/openapi.json", API)
REFUSED = {400, 413, 415, 422}


@SCHEMA.parametrize()
@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_whatever_the_document_allows_or_forbids_gets_a_documented_answer(case: schemathesis.Case) -> None:
    # No schema says which bytes are a photo, so random ones are rightly refused.
    case.call_and_validate(excluded_checks=[positive_data_acceptance])


@pytest.fixture(scope="module")
def client() -> Iterator[TestClient]:
    with TestClient(API, raise_server_exceptions=False) as client:
        yield client


def broken(data: bytes, rng: np.random.Generator) -> bytes:
    """The file cut, with bytes overwritten, doubled, or with random bytes spliced in."""
    photo = bytearray(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.4 else data)
    for at in rng.integers(0, min(len(photo), 600), int(rng.integers(0, 12))):
        photo[at] = int(rng.integers(256))
    if rng.random() < 0.3:
        at = int(rng.integers(len(photo)))
        photo[at:at] = rng.bytes(int(rng.integers(1, 200)))
    if rng.random() < 0.1:
        photo += bytes(photo)
    return bytes(photo)


@pytest.mark.long
@pytest.mark.parametrize("extension", [".jpg", ".png", ".webp"])
def test_a_hundred_broken_photos_of_each_format_are_answered_or_refused(
    client: TestClient, extension: str
) -> None:
    rng = np.random.default_rng(5)
    good = cv2.imencode(extension, cv2.resize(PHOTO, (80, 60)))[1].tobytes()
    statuses = {client.post("/classify", content=broken(good, rng)).status_code for _ in range(100)}
    assert statuses <= {200, *REFUSED}
    assert statuses & REFUSED
    assert client.post("/classify", content=good).status_code == 200
