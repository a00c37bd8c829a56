"""An executor concludes the rulings in its own favour that nobody else has concluded.

A ruling stands for a while in which it may be replaced, and is paid when somebody concludes it after that.
The organization's bridge does so at once. If it does not, the executor waits for its money, for the penalty
that is set aside of its bond, or for its service, which a proof on which nobody has ruled keeps busy; and the
judge may still change its mind. So the bridge that has an executor's key concludes rulings in its favour
(`services.bridge.process`), and so does the executor's own process: robots and docks by `Rulings`, other
programs, whose keys may be in no bridge, by `Rulings` or `Participant.conclude_rulings`.
"""

from __future__ import annotations

import logging
import threading
from decimal import Decimal
from typing import Protocol

from rodeo.bus.messages import DaoEvent, Standing
from rodeo.errors import BusError, ClockUnavailable, RemoteError
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent, Rest

log = logging.getLogger(__name__)

GRACE_S = 60.0
"""Site time that others have to conclude a ruling before its executor does."""

_LOOK_WALL_S = 60.0
"""Wall time after which the index is asked again without an event: one may have been lost."""
_RETRY_WALL_S = 5.0

STATES = "submitted,ruled"
"""States of tasks that can be concluded."""
LOST_RACES = frozenset({"wrong_state", "ruling_stands"})
"""Codes of the contracts' refusals to conclude a ruling that somebody has concluded, replaced or challenged
meanwhile."""
_NEWS = ("ProofSubmitted", "Ruled")
"""Events that change when a task can be concluded."""


def due_s(standing: Standing | None, deadline_s: float | None = None) -> float | None:
    """Site time after which the executor concludes its task: the end of the standing ruling's window, or
    `deadline_s` where nobody has ruled. None after a rejection, which costs the executor its penalty."""
    if standing is not None:
        return None if standing.ruling == "rejected" else standing.until + GRACE_S
    return None if deadline_s is None else deadline_s + GRACE_S


def can_only_lose(standing: Standing, price_iec: Decimal, creator: bool, executor: bool) -> str:
    """Why a challenge by a party (the creator's side, the executor's) loses its stake whatever is decided, as
    `DisputeJudge` compares rulings; empty where it may win. A judge wins by any other ruling."""
    if creator == executor:
        return ""
    if creator and standing.ruling == "rejected":
        return "it can only lose its stake: the ruling costs the creator nothing, and none is better for it"
    if executor and standing.ruling == "accepted" and standing.amount_iec >= price_iec:
        return "it can only lose its stake: the ruling pays the executor the full price, and none is better"
    return ""


class _Participant(Protocol):
    """The part of `rodeo.dao.Participant` that is needed here."""

    def conclude_rulings(self, now_s: float) -> float | None: ...


class Rulings:
    """Concludes rulings in favour of `executor` in a thread of its own until `stop` is set."""

    def __init__(self, executor: _Participant, clock: Clock, stop: threading.Event) -> None:
        self._executor = executor
        self._clock = clock
        self._stop = stop
        self._news = ClockedEvent(clock)
        self._thread = threading.Thread(target=self._run, name="rulings", daemon=True)
        self._thread.start()

    def on_event(self, event: DaoEvent) -> None:
        """To be called with the contracts' events."""
        if event.name in _NEWS:
            self._news.set()

    def close(self) -> None:
        """Wait for the thread, which ends when `stop` is set; before the bus is closed."""
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        self._news.loop(self._stop, self._conclude)

    def _conclude(self) -> Rest:
        try:
            return Rest(self._executor.conclude_rulings(self._clock.now_s()), _LOOK_WALL_S)
        except (BusError, RemoteError, ClockUnavailable) as error:
            log.log(_level(error), "cannot conclude rulings now, trying again: %s", error)
            return Rest(wall_s=_RETRY_WALL_S)


def _level(error: BusError | RemoteError | ClockUnavailable) -> int:
    """A bridge that is away says so itself."""
    is_away = not isinstance(error, RemoteError) or error.code == "bridge_not_ready"
    return logging.DEBUG if is_away else logging.WARNING
