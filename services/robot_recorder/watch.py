"""What a recorder does by itself: it watches body, mind and chain, repeats a stop, and signs for charges."""

from __future__ import annotations

import logging
from typing import Any

from rodeo.attempts.orders import Orders
from rodeo.bus.messages import Task
from rodeo.dao import Participant
from rodeo.errors import BusError, DiskFull, RemoteError
from rodeo.host.clocked import ClockedEvent, Rest
from rodeo.robot.receipts import Receipts
from rodeo.robot.ros_body import RosBody
from rodeo.runtime.process import Process
from services.robot_recorder.mind import Mind
from services.robot_recorder.takes import Takes

log = logging.getLogger(__name__)

_LOOK_WALL_S = 2.0
"""Wall time between two looks while nothing happens."""
_ORDERED = ("open", "assigned")


class Watch:
    """`run` returns when the process is asked to end."""

    def __init__(
        self,
        process: Process,
        dao: Participant,
        body: RosBody,
        mind: Mind,
        takes: Takes,
        orders: Orders,
        charges: Charges,
        news: ClockedEvent,
    ) -> None:
        self._process, self._dao, self._body, self._mind = process, dao, body, mind
        self._takes, self._orders, self._charges, self._news = takes, orders, charges, news

    def run(self) -> None:
        asked = True

        def look() -> Rest:
            nonlocal asked
            try:
                asked = self._look()
            except (BusError, RemoteError) as error:
                self._process.not_ready(f"waiting for the organization: {error.message}")
            except DiskFull as error:
                self._process.not_ready(error.message)
            return Rest(wall_s=_LOOK_WALL_S, resting=not asked)

        self._news.loop(self._process.stop, look)

    def _look(self) -> bool:
        """Whether the mind has something to do, so that no time may be jumped over."""
        standing, take = self._orders.standing, self._takes.running
        self._mind.tell(standing, take is not None and self._orders.cancelled(take.attempt.task.nonce))
        if standing.stopped:
            # Also a body that was started again meanwhile.
            self._body.emergency_stop(True)
        assigned = self._dao.tasks(state="assigned", executor=self._dao.name)
        charge = self._charges.look()
        self._report(assigned)
        if standing.charge and charge is not None:
            self._orders.charge_bought()
        if take is not None and not take.resumed:
            take.wrong_clock = take.wrong_clock or self._body.wrong_clock
        if unfit := self._process.clock_check.problem or self._body.unfit():
            self._process.not_ready(unfit)
        else:
            self._process.ready()
        return bool(assigned or charge or take)

    def _report(self, assigned: list[Task]) -> None:
        nodes = self._mind.nodes
        concern = self._process.notices.concern
        concern("body", self._body.unknown)
        concern("mind", "" if nodes else f"{self._dao.name} has no mind: no node of it is here")
        take = self._takes.running
        if self._orders.standing.stopped:
            text = "stopped by an operator"
        elif take is not None:
            text = f"recording task {take.attempt.task.id}"
        elif assigned:
            text = f"waiting for the mind to begin task {assigned[0].id}"
        else:
            text = "nothing to record"
        self._process.activity(text, mind=nodes, **self._body.vitals())

    def state(self) -> dict[str, Any]:
        """What operators are told of the robot beside the orders that hold."""
        take = self._takes.running
        return {
            "task_id": take and take.attempt.task.id,
            "attempt": take and take.attempt.task.attempt,
            "activity": "recording" if take else "nothing to record",
            "mind": ", ".join(self._mind.nodes) or None,
            **self._body.vitals(),
        }


class Charges:
    """The device's side of the charges that the robot buys: the key signs for what the meter counts."""

    def __init__(self, dao: Participant, energy: str, receipts: Receipts, body: RosBody) -> None:
        self._dao, self._energy, self._receipts, self._body = dao, energy, receipts, body

    def look(self) -> Task | None:
        """The charge that is ordered or delivered, if there is one."""
        bought = self._dao.tasks(kind=self._energy, creator=self._dao.name)
        live = max((one for one in bought if one.state in _ORDERED), key=lambda one: one.id, default=None)
        if live is not None:
            self._receipts.begin(live)
            self._receipts.remind()
        return live
