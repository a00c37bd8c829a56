"""An executor closes the rulings in its own favour that nobody else has closed.

A ruling can be challenged for a while, and is paid when somebody closes it after that. The organization's
bridge does so at once. If it does not, the task ends with its verdict window as if there had been no ruling,
and the executor has worked for nothing. So the bridge that has an executor's key closes rulings in its favour
(`services.bridge.process`), and so does the executor's own process: robots and docks by `Rulings`, other
programs, whose keys may be in no bridge, by `Rulings` or `Participant.close_rulings`.
"""

from __future__ import annotations

import logging
import threading
from typing import Protocol

from rodeo.clock import Clock
from rodeo.errors import BusError, ClockUnavailable, RemoteError
from rodeo.messages import DaoEvent, Dispute

log = logging.getLogger(__name__)

GRACE_S = 60.0
"""Site time that others have to close a ruling before its executor does, at most."""
_GRACE_SHARE = 4
"""And at most this part, one in four, of the time until the verdict window ends."""

_LOOK_WALL_S = 60.0
"""Wall time after which the index is asked again without an event: one may have been lost."""
_RETRY_WALL_S = 5.0

_PAID = ("accepted", "impossible")
"""Outcomes by which the executor is paid."""
_NEWS = ("Ruled", "Challenged")
"""Events that change when a ruling can be closed."""


def due_s(ruling: Dispute | None, state: str, attempt: int, deadline_s: float | None) -> float | None:
    """Site time after which the executor closes the ruling on its task; None if no ruling pays it.

    `state`, `attempt` and `deadline_s`, the end of the verdict window, are the task's.
    """
    if ruling is None or deadline_s is None or state != "submitted":
        return None
    if ruling.vote.outcome not in _PAID or ruling.vote.attempt != attempt:
        return None
    return ruling.until + min(GRACE_S, (deadline_s - ruling.until) / _GRACE_SHARE)


class _Participant(Protocol):
    """The part of `rodeo.dao.Participant` that is needed here."""

    def close_rulings(self, now_s: float) -> float | None: ...


class Rulings:
    """Closes rulings in favour of `executor` in a thread of its own until `stop` is set."""

    def __init__(self, executor: _Participant, clock: Clock, stop: threading.Event) -> None:
        self._executor = executor
        self._clock = clock
        self._stop = stop
        self._news = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rulings", daemon=True)
        self._thread.start()

    def on_event(self, event: DaoEvent) -> None:
        """To be called with the contracts' events."""
        if event.name in _NEWS:
            self._news.set()
            self._clock.notify()

    def close(self) -> None:
        """Wait for the thread, which ends when `stop` is set; before the bus is closed."""
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        with self._clock.acting():
            while not self._stop.is_set():
                self._news.clear()
                next_s, wall_s = None, _LOOK_WALL_S
                try:
                    next_s = self._executor.close_rulings(self._clock.now_s())
                except (BusError, RemoteError, ClockUnavailable) as error:
                    log.log(_level(error), "cannot close rulings now, trying again: %s", error)
                    wall_s = _RETRY_WALL_S
                self._clock.wait_for(
                    self._news.is_set, self._stop, until_s=next_s, wall_s=wall_s, resting=True
                )


def _level(error: BusError | RemoteError | ClockUnavailable) -> int:
    """A bridge that is away says so itself."""
    is_away = not isinstance(error, RemoteError) or error.code == "bridge_not_ready"
    return logging.DEBUG if is_away else logging.WARNING
