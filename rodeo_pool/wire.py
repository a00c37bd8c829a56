"""Messages between client, worker and its helper: a line of JSON, then as many bytes as it announces."""

from __future__ import annotations

from typing import IO, Annotated, Any, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from rodeo.errors import RodeoError, unreadable
from rodeo.jobs.job import BadAnswer, Job, JobError, JobFailed, WorkerDiffers, WorkerLost
from rodeo.text.foreign_text import printable
from rodeo.text.strict_json import write_json

_HEADER_BYTES = 1 << 20
_LOG_CHARACTERS = 64 << 10
_ERRORS = {cls.__name__: cls for cls in (BadAnswer, JobFailed, WorkerDiffers, WorkerLost)}
"""Errors that keep their type on the way; others arrive as JobFailed."""

Text = Annotated[str, AfterValidator(printable)]


class Malformed(ValueError):
    """What was read is no such message, or is larger than allowed."""


class Header(BaseModel):
    """The first line of a message."""

    model_config = ConfigDict(frozen=True)

    bytes: int = Field(default=0, ge=0)
    """Size of what follows the line."""


class Question(Header):
    """A job; the bytes are those of its file."""

    work: str
    given: dict[str, Any]
    suffix: str | None = None
    """The end of the file's name; None where no file is sent."""

    @classmethod
    def of(cls, job: Job) -> Self:
        return cls(work=job.work, given=dict(job.given), suffix=job.file and job.file.suffix)


class Failure(BaseModel):
    """An error on its way."""

    name: str
    message: Text
    log: str = ""
    details: dict[Text, Text] = {}

    @classmethod
    def of(cls, error: RodeoError) -> Self:
        details = {name: str(value) for name, value in error.details.items()}
        log = error.log[-_LOG_CHARACTERS:] if isinstance(error, JobError) else ""
        return cls(name=type(error).__name__, message=error.message, log=log, details=details)

    @property
    def error(self) -> JobError:
        error = _ERRORS.get(self.name, JobFailed)(self.message, log=self.log[-_LOG_CHARACTERS:])
        error.details = dict(self.details)  # of any names
        return error


class Answer(Header):
    """The bytes answer the job, unless it failed."""

    failure: Failure | None = None


M = TypeVar("M", bound=Header)


def packed(header: Header, data: bytes = b"") -> bytes:
    """The message. Raises ValueError for a header that is no JSON."""
    return write_json(header.model_dump(mode="json") | {"bytes": len(data)}) + b"\n" + data


def read(stream: IO[bytes], model: type[M], most_bytes: int) -> tuple[M, bytes] | None:
    """The next message: its header and its bytes; None at the end. Raises Malformed."""
    line = stream.readline(_HEADER_BYTES)
    if not line:
        return None
    try:
        header = model.model_validate_json(line)
    except ValidationError as error:
        raise Malformed(unreadable(error)) from error
    if header.bytes > most_bytes:
        raise Malformed(f"{header.bytes} bytes where {most_bytes} are allowed")
    data = stream.read(header.bytes)
    if len(data) != header.bytes:
        raise Malformed("the bytes end early")
    return header, data
