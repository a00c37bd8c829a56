"""The bin over HTTP: photos in, verdicts out; strangers get a clear 4xx and the service stays up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from rodeo.lab.config import BinConfig, Pose2
from rodeo.vision.classifier import Classifier
from rodeo.vision.images import ImageLimits
from rodeo_testing.recordings import RENDERINGS
from services.itrash.web import make_api

CAN = (RENDERINGS / "metal_1.jpg").read_bytes()
LIMITS = ImageLimits(max_bytes=200_000, max_pixels=1_000_000)


class QuietBin:
    """A bin in which nothing has happened yet."""

    def __init__(self) -> None:
        self.classifier = Classifier()
        self.missing: list[str] = []
        self.classification: dict[str, Any] | None = None
        self.picture: bytes | None = None

    def compartment_for(self, label: str, probabilities: Mapping[str, float]) -> str:
        return BinConfig(pose=Pose2(x_m=0, y_m=0)).compartment_for(label, probabilities)

    def state(self) -> dict[str, Any]:
        return {"state": "idle", "classification": self.classification, "disposal": None}

    def events(self) -> list[dict[str, Any]]:
        return []

    def missing_sensors(self) -> list[str]:
        return self.missing

    def image(self) -> bytes | None:
        return self.picture


@pytest.fixture(scope="module")
def quiet_bin() -> QuietBin:
    return QuietBin()


@pytest.fixture(scope="module")
def client(quiet_bin: QuietBin) -> Iterator[TestClient]:
    with TestClient(make_api(quiet_bin, LIMITS), raise_server_exceptions=False) as client:
        yield client


def test_a_raw_photo_and_a_form_give_the_same_verdict(client: TestClient) -> None:
    raw = client.post("/classify", content=CAN, headers={"content-type": "image/jpeg"})
    form = client.post("/classify", files={"file": ("can.jpg", CAN)})
    assert raw.status_code == form.status_code == 200
    verdict = raw.json()
    assert (verdict["class"], verdict["compartment"]) == ("metal", "yellow")
    assert sum(verdict["probabilities"].values()) == pytest.approx(1.0, abs=1e-3)
    assert verdict["image_sha256"].startswith("0x")
    assert {**form.json(), "milliseconds": 0} == {**verdict, "milliseconds": 0}


@pytest.mark.parametrize("extension", [".png", ".webp"])
def test_other_formats_are_classified_too(client: TestClient, extension: str) -> None:
    image = cv2.imdecode(np.frombuffer(CAN, np.uint8), cv2.IMREAD_COLOR)
    answer = client.post("/classify", content=cv2.imencode(extension, image)[1].tobytes())
    assert answer.json()["class"] == "metal"


@pytest.mark.parametrize(
    ("request_", "status", "code"),
    [
        ({"content": b""}, 400, "missing_photo"),
        ({"files": {"file": ("empty.jpg", b"")}}, 400, "missing_photo"),
        ({"data": {"file": "text"}}, 415, "unsupported_image"),
        ({"content": b"GIF89a" + b"\0" * 100}, 415, "unsupported_image"),
        ({"content": CAN[:200]}, 422, "broken_image"),
        ({"content": CAN[:2] + b"\0" * 1000}, 422, "broken_image"),
        ({"content": b"\xff\xd8\xff" + b"\0" * 300_000}, 413, "image_too_large"),
        ({"files": {"file": ("big.jpg", b"\xff" * 300_000)}}, 413, "image_too_large"),
        (
            {"content": b"--x\r\nnonsense", "headers": {"content-type": "multipart/form-data; boundary=x"}},
            400,
            "missing_photo",
        ),
        ({"content": CAN, "headers": {"content-type": "multipart/form-data"}}, 400, "bad_request"),
        (
            {"files": [("a", ("a.jpg", CAN)), ("b", ("b.jpg", CAN))]},
            400,
            "bad_request",
        ),
    ],
)
def test_what_is_no_photo_is_refused_with_a_reason(
    client: TestClient, request_: dict[str, Any], status: int, code: str
) -> None:
    answer = client.post("/classify", **request_)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert answer.json()["detail"]
    assert client.post("/classify", content=CAN).status_code == 200


FORM = b'--x\r\nContent-Disposition: form-data; name="file"; filename="a"\r\n\r\n' + CAN + b"\r\n--x--\r\n"


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        ("Multipart/Form-Data; boundary=x", 200),
        ("multipart/form-data; boundary=x; charset=UTF8", 200),
        ("multipart/form-data; boundary=x; charset=Latin-1", 400),
        ("multipart/form-data; boundary=x; charset=undefined", 400),
        ("multipart/form-data; boundary=x; charset=punycode", 400),
        ("multipart/form-data; boundary=x; charset=rot13", 400),
        ("multipart/form-data; boundary=x; charset=none-such", 400),
    ],
)
def test_a_form_is_read_as_its_type_says(client: TestClient, kind: str, status: int) -> None:
    assert client.post("/classify", content=FORM, headers={"content-type": kind}).status_code == status


def test_a_long_text_in_a_form_is_refused(client: TestClient) -> None:
    text = b'--x\r\nContent-Disposition: form-data; name="a"\r\n\r\n' + bytes(100_000) + b"\r\n--x--\r\n"
    headers = {"content-type": "multipart/form-data; boundary=x"}
    assert client.post("/classify", content=text, headers=headers).status_code == 400


def test_the_bins_own_failure_is_a_problem_too(
    client: TestClient, quiet_bin: QuietBin, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> dict[str, Any]:
        raise RuntimeError("a defect")

    monkeypatch.setattr(quiet_bin, "state", broken)
    answer = client.get("/state")
    assert (answer.status_code, answer.json()["code"]) == (500, "internal_error")


def test_a_small_file_of_too_many_pixels_is_refused(client: TestClient) -> None:
    bomb = cv2.imencode(".png", np.zeros((2000, 2000), np.uint8))[1].tobytes()
    answer = client.post("/classify", content=bomb)
    assert (answer.status_code, answer.json()["code"]) == (413, "image_too_large")


def test_corrupted_photos_by_the_dozen_never_break_the_service(client: TestClient) -> None:
    rng = np.random.default_rng(3)
    statuses = set()
    for _ in range(60):
        photo = bytearray(CAN[: rng.integers(1, len(CAN))])
        for at in rng.integers(0, len(photo), 5):
            photo[at] = int(rng.integers(256))
        statuses.add(client.post("/classify", content=bytes(photo)).status_code)
    assert statuses <= {200, 413, 415, 422}


def test_nothing_yet_is_no_content_and_then_the_last_statement(
    client: TestClient, quiet_bin: QuietBin
) -> None:
    assert client.get("/classification").status_code == 204
    assert client.get("/disposal").status_code == 204
    quiet_bin.classification = {"payload": {"seq": 1}}
    assert client.get("/classification").json() == {"payload": {"seq": 1}}
    quiet_bin.classification = None
    assert client.get("/state").json()["state"] == "idle"
    assert client.get("/events").json() == []


def test_health_names_the_sensors_that_are_silent(client: TestClient, quiet_bin: QuietBin) -> None:
    assert client.get("/readyz").status_code == 200
    quiet_bin.missing = ["itrash/presence"]
    answer = client.get("/readyz")
    quiet_bin.missing = []
    assert (answer.status_code, answer.json()["detail"]) == (503, "no readings from itrash/presence")


def test_the_page_and_the_newest_picture_are_served_to_a_browser(
    client: TestClient, quiet_bin: QuietBin
) -> None:
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    for part in ("/page.js", "/page.css"):
        assert part[1:] in page.text
        assert client.get(part).status_code == 200
    assert client.get("/image").status_code == 204
    quiet_bin.picture = CAN
    answer = client.get("/image")
    quiet_bin.picture = None
    assert (answer.headers["content-type"], answer.content) == ("image/jpeg", CAN)


def test_the_interface_describes_itself(client: TestClient) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    assert set(paths) == {
        "/classify",
        "/classification",
        "/disposal",
        "/events",
        "/state",
        "/image",
    }
    assert set(paths["/classify"]["post"]["requestBody"]["content"]) >= {"image/jpeg", "multipart/form-data"}
