"""After a drop: the bin's own word on it, and that what fell stays in the bin."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from rodeo.bus.messages import Task
from rodeo.host.clock import Clock
from rodeo.lab.drop import JUDGED_AFTER_DROP_S, RECORDED_AFTER_DROP_S, SPEAKS_AGAIN_S, SUBMITTED_S
from rodeo.robot.behaviour import Record
from rodeo.robot.bin import SmartBin
from rodeo.robot.errors import NoAnswer, TakenOut
from rodeo.witness.statement import Drop

log = logging.getLogger(__name__)

_LOOK_AROUND_S = 1.0
"""Site time after which a robot that waits hears of orders."""


@dataclass(frozen=True)
class Aftermath:
    """What is waited for after the drop, whichever mind the robot has. `wait` waits for seconds of site time,
    and raises what ends or interrupts the work."""

    task: Task
    recording: Record
    bin: SmartBin
    clock: Clock
    wait: Callable[[float], None]

    def confirmation(self, after_s: float, patience_s: float) -> Drop | None:
        """The bin's word on what fell after `after_s` (site time). Without it, the recording stands as it is
        and the oracle decides."""
        try:
            return self.bin.wait_for(Drop, after_s, patience_s)
        except NoAnswer as error:
            log.warning("%s; submitting without its confirmation", error)
            self.recording.note({"event": "unconfirmed", **error.to_json()})
            return None

    def stay(self, dropped_s: float, drop: Drop | None) -> None:
        """Record until what fell has stayed in the bin for as long as the oracle asks. Raises TakenOut."""
        until_s = dropped_s + RECORDED_AFTER_DROP_S
        while (now_s := self.clock.now_s()) < until_s:
            self.wait(min(until_s - now_s, _LOOK_AROUND_S))
        # Whoever pulled the plug of motion capture is at fault only if it is seen to speak again, or if the
        # bin missed it: then the robot need not wait indefinitely.
        latest_s = until_s + SPEAKS_AGAIN_S
        if self.task.execution_deadline is not None:
            latest_s = min(latest_s, self.task.execution_deadline - SUBMITTED_S)
        if not self.recording.await_motion(until_s - RECORDED_AFTER_DROP_S + JUDGED_AFTER_DROP_S, latest_s):
            self.recording.note({"event": "unwitnessed", "waited_s": self.clock.now_s() - until_s})
        if drop is not None and (removal := self.bin.removed(drop)) is not None:
            raise TakenOut(
                "something was taken out of the bin after the drop",
                compartment=removal.compartment,
                weight_n=removal.weight_n,
                after_s=round(removal.settled_s - drop.settled_s, 3),
            )
