"""Logs of every process: one line per message, with the task that it is about.

    2026-03-01 12:00:00,123 INFO    bridge: [task 7] organization: rule in block 12

`RODEO_LOG` is the level, `RODEO_LOG_FORMAT=json` writes one JSON object per line instead. A message is there
whole or not at all.
"""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any

from rodeo.text.foreign_text import printable
from rodeo.text.redaction import hide_in_tracebacks, redacted, redacted_json

_task: ContextVar[int | None] = ContextVar("task", default=None)

_CHATTY = ("httpx", "urllib3", "web3", "asyncio", "websockets")


@contextmanager
def about_task(task_id: int | None) -> Iterator[None]:
    """Everything logged inside, by this thread, is about the task."""
    token = _task.set(task_id)
    try:
        yield
    finally:
        _task.reset(token)


class Redacting(logging.Formatter):
    """Leaves out the secrets in addresses, and what others wrote into a message to steer a terminal or to
    look like another message."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - its name
        return printable(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:  # noqa: N802 - its name
        return "\n".join(map(printable, super().formatException(ei).splitlines()))

    def format(self, record: logging.LogRecord) -> str:
        return redacted(super().format(record))


class _Formatter(Redacting):
    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def fields(self, record: logging.LogRecord) -> dict[str, object]:
        task = getattr(record, "task", None)
        return {"process": self._process, "task": _task.get() if task is None else task}


class TextFormatter(_Formatter):
    """For people."""

    def format(self, record: logging.LogRecord) -> str:
        task = self.fields(record)["task"]
        about = "" if task is None else f"[task {task}] "
        when = f"{self.formatTime(record)} {record.levelname:<7} {self._process}: {about}"
        return when + super().format(record)


class JsonFormatter(_Formatter):
    """For machines: time (UTC, ISO 8601), level, process, logger, task, message, exception."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(),
            "level": record.levelname.lower(),
            **self.fields(record),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps({key: redacted_json(value) for key, value in line.items() if value is not None})


class WholeLines(logging.Handler):
    """Writes each message to a descriptor as a whole, or not at all.

    A disk that is full loses messages and nothing else: no process ends on it, and no line is cut in the
    middle. Once there is room again a line says how many were lost.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._lost = 0
        self._torn = _ends_within_a_line(descriptor)
        """Whether the last line has no end."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            line = self.format(record)
        except Exception:  # noqa: BLE001 - logging's own way to tell of a message that does not fit its format
            self.handleError(record)
            return
        if self._lost:
            said = logging.makeLogRecord(
                {"name": __name__, "levelno": logging.WARNING, "levelname": "WARNING"}
                | {"msg": "%d messages before this one are lost: the log could not be written"}
                | {"args": (self._lost,)}
            )
            if not self._write(self.format(said)):
                self._lost += 1
                return
            self._lost = 0
        if not self._write(line):
            self._lost += 1

    def _write(self, text: str) -> bool:
        """Whether the line is there."""
        data = ("\n" if self._torn else "").encode() + text.encode(errors="replace") + b"\n"
        written = 0
        try:
            while written < len(data):
                written += os.write(self._descriptor, data[written:])
        except OSError:
            self._torn = bool(written) and not self._take_back(written)
            return False
        self._torn = False
        return True

    def _take_back(self, written: int) -> bool:
        """Cut off the file's last bytes, which are the beginning of a line; whether that could be done."""
        try:
            end = os.lseek(self._descriptor, 0, os.SEEK_CUR)
            if end != os.fstat(self._descriptor).st_size:  # somebody else has written behind them
                return False
            os.ftruncate(self._descriptor, end - written)
            os.lseek(self._descriptor, end - written, os.SEEK_SET)
        except OSError:  # no file: a pipe or a terminal
            return False
        return True


def _ends_within_a_line(descriptor: int) -> bool:
    """Whether a process that was killed, or another program, left half a line in the file."""
    try:
        size = os.fstat(descriptor).st_size
        if not size:
            return False
        # It is open for writing alone.
        with open(f"/proc/self/fd/{descriptor}", "rb") as file:
            if not file.seekable():
                return False
            file.seek(size - 1)
            return file.read(1) != b"\n"
    except OSError:
        return False


def configure(process: str) -> None:
    """Once per process, before anything is logged."""
    handler = WholeLines(sys.stderr.fileno())
    as_json = os.environ.get("RODEO_LOG_FORMAT") == "json"
    handler.setFormatter(JsonFormatter(process) if as_json else TextFormatter(process))
    logging.basicConfig(level=os.environ.get("RODEO_LOG", "INFO"), handlers=[handler])
    hide_in_tracebacks()
    for chatty in _CHATTY:
        logging.getLogger(chatty).setLevel(logging.WARNING)
