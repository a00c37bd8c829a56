"""What operators order, over the bus and across restarts.

pause    take no new work and stand still; an attempt under way is finished first, also after a restart
resume   take work again, and let go of a stop
charge   buy a charge now, whatever the state of charge
cancel   give up the attempt under way: arm folded, the failure goes on chain, others may take the task
stop     stand still at once, in the middle of whatever it is, until resumed
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, field_validator

from rodeo.bus.session import Bus, Request, validate
from rodeo.errors import DiskFull, RequestError
from rodeo.host.files import read_model, replace_file
from rodeo.robot.decisions import Decided, Explain, Explained
from rodeo.robot.errors import JournalBroken
from rodeo.site import topics

log = logging.getLogger(__name__)


class Order(StrEnum):
    PAUSE = "pause"
    RESUME = "resume"
    CHARGE = "charge"
    CANCEL = "cancel"
    STOP = "stop"


class NothingToCancel(RequestError):
    """No attempt is under way."""


class Standing(BaseModel):
    """The orders that hold until further notice."""

    model_config = ConfigDict(extra="forbid")

    paused: bool = False
    stopped: bool = False
    charge: bool = False
    """Until the charge is bought."""
    cancel: str | None = None
    """Nonce of the assignment to give up: on another chain task and attempt would be another one's."""

    @field_validator("cancel", mode="before")
    @classmethod
    def _of_before(cls, value: Any) -> Any:
        # Task and attempt, as once written: of an unknown chain.
        return None if isinstance(value, list) else value


class Orders:
    """Takes orders, keeps them on disk before they are answered. Thread-safe.

    Args:
        path: where they are kept. Raises JournalBroken when it holds something else.
        on_change: called after each order, in a thread of the bus.
        state: what `.../state` answers besides the standing orders.
        decided: the newest decisions about a task or all, at most so many: what `.../explain` answers.
    """

    def __init__(
        self,
        bus: Bus,
        org: str,
        robot: str,
        path: Path,
        on_change: Callable[[Order], None],
        state: Callable[[], dict[str, Any]],
        decided: Callable[[int | None, int], list[Decided]] = lambda _task_id, _limit: [],
    ) -> None:
        self._path = path
        self._on_change = on_change
        self._state = state
        self._decided = decided
        self._lock = threading.Lock()
        self._standing = _load(path)
        self._nonce: str | None = None

        def key(order: str) -> str:
            return topics.ROBOT_ORDER.name(org=org, robot=robot, order=order)

        self._queryables = [
            *(bus.serve(key(order), self._taker(order)) for order in Order),
            bus.serve(key("state"), lambda _request: self._answer()),
            bus.serve(key("explain"), self._explain),
        ]

    @property
    def standing(self) -> Standing:
        with self._lock:
            return self._standing

    def working_on(self, nonce: str | None) -> None:
        """Nonce of the assignment that `cancel` would give up."""
        with self._lock:
            self._nonce = nonce

    def cancelled(self, nonce: str | None) -> bool:
        """Whether the assignment with this nonce is to be given up."""
        return nonce is not None and self.standing.cancel == nonce

    def charge_bought(self) -> None:
        with self._lock:
            self._keep(charge=False)

    def close(self) -> None:
        for queryable in self._queryables:
            queryable.undeclare()

    def _explain(self, request: Request) -> dict[str, Any]:
        wanted = validate(Explain, request.parameters)
        decided = self._decided(wanted.task_id, wanted.limit)
        return Explained(decisions=decided).model_dump(mode="json")

    def _taker(self, order: Order) -> Callable[[Request], dict[str, Any]]:
        return lambda _request: self._take(order)

    def _take(self, order: Order) -> dict[str, Any]:
        with self._lock:
            if order is Order.PAUSE:
                self._keep(paused=True)
            elif order is Order.RESUME:
                self._keep(paused=False, stopped=False)
            elif order is Order.CHARGE:
                self._keep(charge=True)
            elif order is Order.STOP:
                self._stop()
            elif self._nonce is None:
                raise NothingToCancel("the robot has no current attempt")
            else:
                self._keep(cancel=self._nonce)
        log.info("ordered: %s", order)
        self._on_change(order)
        return self._answer()

    def _stop(self) -> None:
        """Stop also on a full disk; the operator then learns that a restart would forget it. Raises
        DiskFull."""
        try:
            self._keep(stopped=True)
        except DiskFull:
            self._standing = self._standing.model_copy(update={"stopped": True})
            self._on_change(Order.STOP)
            raise

    def _keep(self, **changes: Any) -> None:
        changed = self._standing.model_copy(update=changes)
        if changed != self._standing:
            replace_file(self._path, changed.model_dump_json())
            self._standing = changed

    def _answer(self) -> dict[str, Any]:
        standing = self.standing
        return {
            "paused": standing.paused,
            "stopped": standing.stopped,
            "charge_ordered": standing.charge,
            **self._state(),
        }


def _load(path: Path) -> Standing:
    words = (
        "the file of the robot's orders is damaged: restore it, or move it away; then no order holds "
        "and the robot works"
    )
    return read_model(Standing, path, JournalBroken, words) or Standing()
