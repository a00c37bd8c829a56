"""The bridge's SQLite files."""

from __future__ import annotations

import sqlite3
import threading
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError

from rodeo_testing.waiting import HANG_S
from services.bridge import database
from services.bridge.database import Checkpointer


class Full:
    """A database whose disk is full."""

    def __init__(self) -> None:
        self.asked = 0
        self.asked_again = threading.Event()

    def connect(self) -> Any:
        self.asked += 1
        if self.asked == 2:
            self.asked_again.set()
        raise OperationalError("pragma", {}, sqlite3.OperationalError("database or disk is full"))


def test_a_full_disk_does_not_end_the_checkpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "_CHECKPOINT_S", 0.0)
    engine: Any = Full()
    checkpointer = Checkpointer(engine)
    assert engine.asked_again.wait(HANG_S), "the thread ended with the first error"
    checkpointer.close()
