"""The bin over HTTP: classify a photo, read what happened. What comes in is hostile until checked."""

from __future__ import annotations

import asyncio
import hashlib
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Protocol, Self

import anyio
import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from rodeo.charset import is_utf8
from rodeo.errors import PortUnavailable, snake_case
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
MAX_CONNECTIONS = 64
_KEEP_ALIVE_S = 5
_REQUEST_S = 30.0
"""For a request and its answer; a large photo over a slow link takes less."""
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

    def compartment_of(self, label: str) -> str: ...
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


class Problem(BaseModel):
    """Every 4xx and 5xx of this interface."""

    code: str
    message: str
    details: dict[str, Any] = {}


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

_PROBLEMS: dict[int | str, dict[str, Any]] = {
    400: {"model": Problem, "description": "No photo in the request"},
    413: {"model": Problem, "description": "Too many bytes, pixels or scans"},
    415: {"model": Problem, "description": "Neither JPEG, PNG nor WebP"},
    422: {"model": Problem, "description": "The photo is broken"},
}


def make_api(bin_: BinView, limits: ImageLimits = IMAGE_LIMITS) -> FastAPI:
    """The application. It holds no state of its own."""
    api = FastAPI(title="iTrash", summary="Photo in, waste class and compartment out.", version="1")
    decoding = anyio.CapacityLimiter(_DECODED_AT_ONCE)
    api.add_middleware(LimitBody, max_bytes=limits.max_bytes + _MULTIPART_OVERHEAD_BYTES)

    @api.exception_handler(ImageError)
    async def refuse(_request: Request, error: ImageError) -> JSONResponse:
        return JSONResponse(error.to_json(), _status_of(error))

    @api.exception_handler(HTTPException)
    async def refuse_http(_request: Request, error: HTTPException) -> JSONResponse:
        problem = Problem(code=snake_case(HTTPStatus(error.status_code).phrase.title().replace(" ", "")),
                          message=str(error.detail))  # fmt: skip
        return JSONResponse(problem.model_dump(), error.status_code, headers=error.headers)

    @api.exception_handler(Exception)
    async def own_up(_request: Request, _error: Exception) -> JSONResponse:
        # Starlette raises the error again behind this answer, and uvicorn logs it with its traceback.
        problem = Problem(code="internal_error", message="the bin failed; its log says why")
        return JSONResponse(problem.model_dump(), 500)

    def classify_bytes(data: bytes) -> Verdict:
        started_s = time.perf_counter()
        found: Classification = bin_.classifier.classify(data, limits)
        return Verdict(
            item_class=found.label,
            compartment=bin_.compartment_of(found.label),
            confidence=round(found.confidence, 4),
            probabilities={name: round(p, 4) for name, p in found.probabilities.items()},
            image_sha256="0x" + hashlib.sha256(data).hexdigest(),
            milliseconds=round((time.perf_counter() - started_s) * 1e3, 2),
        )

    @api.post("/classify", responses=_PROBLEMS, openapi_extra=_PHOTO_BODY)
    async def classify(request: Request) -> Verdict:
        """Classify one photo. Nothing is stored."""
        return await anyio.to_thread.run_sync(classify_bytes, await _photo_of(request), limiter=decoding)

    @api.get("/classification", responses={204: {"description": "Nothing was classified yet"}})
    def classification() -> Response:
        """The last signed classification."""
        return _data_or_nothing(bin_.state()["classification"])

    @api.get("/disposal", responses={204: {"description": "Nothing fell in yet"}})
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

    @api.get("/health", responses={503: {"model": Problem, "description": "A sensor is silent"}})
    def health() -> Response:
        """200 when every sensor reports."""
        missing = bin_.missing_sensors()
        if missing:
            problem = Problem(code="sensors_silent", message="no readings", details={"sensors": missing})
            return JSONResponse(problem.model_dump(), 503)
        return JSONResponse({"status": "ok"})

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


def _status_of(error: ImageError) -> int:
    if isinstance(error, MissingPhoto):
        return 400
    if isinstance(error, ImageTooLarge):
        return 413
    return 415 if isinstance(error, UnsupportedImage) else 422


def _data_or_nothing(value: dict[str, Any] | None) -> Response:
    return Response(status_code=204) if value is None else JSONResponse(value)


class LimitBody:
    """ASGI middleware: reading a body beyond `max_bytes` raises ImageTooLarge, whatever its headers claim."""

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self._app = app
        self._max_bytes = max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        received_bytes = 0

        async def limited() -> Message:
            nonlocal received_bytes
            message = await receive()
            received_bytes += len(message.get("body", b""))
            if received_bytes > self._max_bytes:
                raise ImageTooLarge("the request is too large", max_bytes=self._max_bytes)
            return message

        await self._app(scope, limited, send)


class ImpatientProtocol(H11Protocol):
    """Cuts a connection that did not send its request and read the answer in time. Uvicorn would wait for
    ever, and as many of them as there may be would keep everybody else out."""

    def __init__(self, *arguments: Any, request_s: float, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._request_s = request_s
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._set_deadline()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._set_deadline()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._cancel_deadline()

    def _set_deadline(self) -> None:
        self._cancel_deadline()
        self._deadline = self.loop.call_later(self._request_s, self.transport.abort)

    def _cancel_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()


class HttpServer:
    """Serves an application from a thread of its own while the context is open."""

    def __init__(self, api: FastAPI, host: str, port: int, request_s: float = _REQUEST_S) -> None:
        """`port` 0 takes a free one; slower requests than `request_s` are cut off. Raises PortUnavailable."""
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            raise PortUnavailable.of("the bin's page (itrash.http_port)", host, port, error) from error
        config = uvicorn.Config(
            api,
            http=partial(ImpatientProtocol, request_s=request_s),  # type: ignore[arg-type]
            log_config=None,
            access_log=False,
            lifespan="off",
            limit_concurrency=MAX_CONNECTIONS,
            timeout_keep_alive=_KEEP_ALIVE_S,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, name="http", daemon=True
        )

    @property
    def url(self) -> str:
        host, port = self._socket.getsockname()[:2]
        return f"http://{host}:{port}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.should_exit = True
        self._thread.join(timeout=5.0)
        self._socket.close()
