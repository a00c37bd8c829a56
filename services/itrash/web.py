"""The bin over HTTP: classify a photo, read what happened. What comes in is hostile until checked."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Protocol

import anyio
from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException

from rodeo.errors import RodeoError
from rodeo.host.http import Limits, answer_with_problems, health, problems
from rodeo.text.charset import is_utf8
from rodeo.vision.classification import Classification
from rodeo.vision.classifier import Classifier
from rodeo.vision.images import (
    IMAGE_LIMITS,
    ImageError,
    ImageLimits,
    ImageTooLarge,
    UnsupportedImage,
    media_type,
)

_MULTIPART_OVERHEAD_BYTES = 64 * 1024
_DECODED_AT_ONCE = 2
"""Photos in memory as pixels: one at the network, one on its way. More would wait there, 48 MB each."""
LIMITS = Limits(body_bytes=IMAGE_LIMITS.max_bytes + _MULTIPART_OVERHEAD_BYTES)
_HERE = Path(__file__).parent
_PAGE = (
    ("/", "page.html", "text/html"),
    ("/page.js", "page.js", "text/javascript"),
    ("/page.css", "page.css", "text/css"),
)
_PAGE_HEADERS = {"content-security-policy": "default-src 'self'", "x-content-type-options": "nosniff"}


class MissingPhoto(ImageError):
    """The request carries no photo."""


class BinView(Protocol):
    """What the interface shows of the bin."""

    classifier: Classifier

    def compartment_for(self, label: str, probabilities: Mapping[str, float]) -> str: ...
    def state(self) -> dict[str, Any]: ...
    def events(self) -> list[dict[str, Any]]: ...
    def missing_sensors(self) -> list[str]: ...
    def image(self) -> bytes | None: ...


class Verdict(BaseModel):
    """Answer to a photo."""

    item_class: Annotated[str, Field(serialization_alias="class")]
    """One of the six classes, or `unknown`."""
    compartment: str
    confidence: float
    probabilities: dict[str, float]
    image_sha256: str
    milliseconds: float


_PHOTO_BODY = {
    "requestBody": {
        "required": True,
        "description": "A photo: as the body itself, or as the one file of a form.",
        "content": {
            **{kind: {"schema": {"type": "string", "format": "binary"}}
               for kind in ("image/jpeg", "image/png", "image/webp", "application/octet-stream")},
            "multipart/form-data": {"schema": {
                "type": "object", "required": ["file"],
                "properties": {"file": {"type": "string", "format": "binary"}},
            }},
        },
    }
}  # fmt: skip

_PROBLEMS = problems(
    {
        400: "No photo in the request",
        413: "Too many bytes, pixels or scans",
        415: "Neither JPEG, PNG nor WebP",
        422: "The photo is broken",
    }
)


def make_api(bin_: BinView, limits: ImageLimits = IMAGE_LIMITS) -> FastAPI:
    """The application. It holds no state of its own."""
    api = FastAPI(title="iTrash", summary="Photo in, waste class and compartment out.", version="1")
    decoding = anyio.CapacityLimiter(_DECODED_AT_ONCE)
    answer_with_problems(api, _status_of)

    def classify_bytes(data: bytes) -> Verdict:
        started_s = time.perf_counter()
        found: Classification = bin_.classifier.classify(data, limits)
        return Verdict(
            item_class=found.label,
            compartment=bin_.compartment_for(found.label, found.told),
            confidence=round(found.confidence, 4),
            probabilities=found.told,
            image_sha256="0x" + hashlib.sha256(data).hexdigest(),
            milliseconds=round((time.perf_counter() - started_s) * 1e3, 2),
        )

    @api.post("/classify", responses=_PROBLEMS, openapi_extra=_PHOTO_BODY)
    async def classify(request: Request) -> Verdict:
        """Classify one photo. Nothing is stored."""
        return await anyio.to_thread.run_sync(classify_bytes, await _photo_of(request), limiter=decoding)

    @api.get("/classification", responses={204: {"description": "Nothing classified yet"}})
    def classification() -> Response:
        """The last signed classification."""
        return _data_or_nothing(bin_.state()["classification"])

    @api.get("/disposal", responses={204: {"description": "Nothing has fallen in yet"}})
    def disposal() -> Response:
        """The last signed disposal."""
        return _data_or_nothing(bin_.state()["disposal"])

    @api.get("/events")
    def events() -> list[dict[str, Any]]:
        """The last signed classifications and disposals, newest first."""
        return bin_.events()

    @api.get("/state")
    def state() -> dict[str, Any]:
        """What the bin is doing, and the weight in each compartment (N)."""
        return bin_.state()

    @api.get("/image", responses={200: {"content": {"image/*": {}}}, 204: {"description": "No picture yet"}})
    def image() -> Response:
        """The camera's newest picture."""
        data = bin_.image()
        if data is None:
            return Response(status_code=204)
        return Response(data, media_type=media_type(data), headers={"cache-control": "no-store"})

    def why_not_ready() -> str:
        missing = bin_.missing_sensors()
        return f"no readings from {', '.join(missing)}" if missing else ""

    api.router.routes.extend(health(why_not_ready))
    for path, file, kind in _PAGE:
        api.add_api_route(path, _sends(_HERE / file, kind), include_in_schema=False)
    return api


def _sends(path: Path, media_type: str) -> Callable[[], Response]:
    """A handler that answers with a file of this package."""
    data = path.read_bytes()
    return lambda: Response(data, media_type=media_type, headers=_PAGE_HEADERS)


async def _photo_of(request: Request) -> bytes:
    """The photo in the body. Raises MissingPhoto; starlette's HTTPException 400 for a broken form."""
    if not request.headers.get("content-type", "").lower().startswith("multipart/form-data"):
        data = await request.body()
    else:
        if not is_utf8(request.headers["content-type"]):
            raise HTTPException(400, "the form's charset is not UTF-8")
        async with request.form(max_files=1, max_fields=8, max_part_size=_MULTIPART_OVERHEAD_BYTES) as form:
            files = [value for value in form.values() if isinstance(value, UploadFile)]
            data = await files[0].read() if files else b""
    if not data:
        raise MissingPhoto("the request carries no photo: send it as the body or as a form's file")
    return data


def _status_of(error: RodeoError) -> int:
    if isinstance(error, MissingPhoto):
        return 400
    if isinstance(error, ImageTooLarge):
        return 413
    return 415 if isinstance(error, UnsupportedImage) else 422


def _data_or_nothing(value: dict[str, Any] | None) -> Response:
    return Response(status_code=204) if value is None else JSONResponse(value)
