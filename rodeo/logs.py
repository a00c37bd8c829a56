"""Logs of every process: one line per message, with the task that it is about.

    2026-03-01 12:00:00,123 INFO    bridge: [task 7] organization: post_verdict in block 12

`RODEO_LOG` is the level, `RODEO_LOG_FORMAT=json` writes one JSON object per line instead.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime

_task: ContextVar[int | None] = ContextVar("task", default=None)

_CHATTY = ("httpx", "urllib3", "web3", "asyncio", "alembic", "websockets")


@contextmanager
def about_task(task_id: int | None) -> Iterator[None]:
    """Everything logged inside, by this thread, is about the task."""
    token = _task.set(task_id)
    try:
        yield
    finally:
        _task.reset(token)


class _Formatter(logging.Formatter):
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
        return json.dumps({key: value for key, value in line.items() if value is not None})


def configure(process: str) -> None:
    """Once per process, before anything is logged."""
    handler = logging.StreamHandler()
    as_json = os.environ.get("RODEO_LOG_FORMAT") == "json"
    handler.setFormatter(JsonFormatter(process) if as_json else TextFormatter(process))
    logging.basicConfig(level=os.environ.get("RODEO_LOG", "INFO"), handlers=[handler])
    for chatty in _CHATTY:
        logging.getLogger(chatty).setLevel(logging.WARNING)
