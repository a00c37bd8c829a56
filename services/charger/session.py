"""One charging session: a state machine fed with stamped readings. It reads no clock and does no I/O.

    waiting -> awaiting_receipt -> closing -> charging -> opening -> ended
       ^              ^_______________________________|  the robot did not sign for the last step
       |______________________________________________|  it slipped off the contacts and may come back

The caller moves the contactor as `contactor_wanted` says and reports how it stands; everything is keyed on
the stamps of the dock's readings, which may come hundreds of times faster than real time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from pydantic import BaseModel

NEARLY_FULL = 0.995
"""A higher target counts as reached here: a charge comes close to full ever more slowly, and battery gauges
do not resolve the rest."""


class Phase(StrEnum):
    WAITING = "waiting"
    """The robot is to stand on the contacts."""
    AWAITING_RECEIPT = "awaiting_receipt"
    """The robot stands there; the contactor is open until it signs for what the meter shows."""
    CLOSING = "closing"
    """The contactor was commanded to close."""
    CHARGING = "charging"
    OPENING = "opening"
    """The contactor was commanded to open: for good, or until the robot is back."""
    ENDED = "ended"


class End(StrEnum):
    """Why a session ended. The first three are a full delivery."""

    TARGET_REACHED = "target_reached"
    FULL = "full"
    """The current tapered off at the voltage limit."""
    ENERGY_LIMIT = "energy_limit"
    """The ordered energy is delivered."""
    ROBOT_LEFT = "robot_left"
    """It was charging, left the contacts and did not come back."""
    NO_ROBOT = "no_robot"
    NOT_SIGNED = "not_signed"
    """A robot stood on the contacts, and signed for nothing that was delivered."""
    NO_CURRENT = "no_current"
    DEADLINE = "deadline"
    CANCELLED = "cancelled"
    """The task is no longer assigned to us."""
    BAD_TASK = "bad_task"
    """The task names a robot or dock that this charger does not serve."""
    OTHER_CHARGE = "other_charge"
    """The robot arrived with another state of charge than its task says."""
    METER_LIES = "meter_lies"
    """Meter or contactor contradict themselves (`services.charger.lies`). Nothing of the session is sold."""


@dataclass(frozen=True)
class SessionLimits:
    """What bounds a session: site values first, times in s of site time."""

    voltage_v: float
    cutoff_a: float
    max_energy_wh: float
    soc_target: float
    deadline_s: float
    """By then the contactor opens, to leave time for the proof."""
    give_back_s: float = math.inf
    """By then the robot has signed for something, or the task is given back while that costs nothing."""
    present_s: float = 2.0
    """A robot stands on the contacts once they have reported it for this time."""
    absent_s: float = 3.0
    """The contactor opens once the contacts have been empty for this time."""
    return_s: float = 120.0
    """A robot that left may come back within this time; one that was restarted docks anew."""
    taper_s: float = 30.0
    """At the voltage limit the current must stay below the cut-off for this time."""
    no_current_s: float = 120.0
    reclose_s: float = 10.0
    """After this time without current below the voltage limit, the contactor gets the command to close
    again."""
    voltage_share: float = 0.98
    """From this share of the voltage limit on, a small current means full rather than a bad contact."""


class SessionState(BaseModel):
    """What survives a restart."""

    phase: Phase = Phase.WAITING
    end: End | None = None
    started_s: float | None = None
    """When the first current was delivered."""
    ended_s: float | None = None
    wait_until_s: float
    """While waiting: when to give up."""
    soc: float | None = None
    """Last state of charge that the robot signed, 0..1."""
    paused: bool = False
    """The contactor opens until the robot signs."""
    lie: dict[str, Any] | None = None
    """With METER_LIES: the contradiction, as `RodeoError.to_json` says it."""
    sold: bool = False
    """The robot signed for something that was delivered."""


def is_handed_in(state: SessionState, in_grace: bool) -> bool:
    """Whether the recording of an ended session is handed in as a proof; else the task is given back.

    A proof of nothing is rejected: why nothing was signed is one party's word against the other's. While it
    costs nothing (`in_grace`) such a task is given back. What a meter showed until it was caught is not sold,
    whatever giving it back costs.
    """
    return state.end is not End.METER_LIES and (state.sold or not in_grace)


class Session:
    """The state machine. Not thread-safe: one thread feeds it."""

    def __init__(self, state: SessionState, limits: SessionLimits) -> None:
        self.state = state
        self._limits = limits
        self._present_since_s: float | None = None
        self._absent_since_s: float | None = None
        self._small_since_s: float | None = None
        """Since when the current is below the cut-off."""
        self._told_s = 0.0
        """When the contactor was last commanded to close for want of current."""
        if state.phase is Phase.CHARGING:
            # The dock may have opened while we were away; another command to close costs nothing.
            state.phase = Phase.CLOSING

    @property
    def contactor_wanted(self) -> bool:
        """Whether the contactor should be closed now."""
        return self.state.phase in (Phase.CLOSING, Phase.CHARGING)

    @property
    def commands_contactor(self) -> bool:
        """Whether the contactor needs a command: report back with `contactor`."""
        return self.state.phase in (Phase.CLOSING, Phase.OPENING)

    @property
    def ended(self) -> bool:
        return self.state.phase is Phase.ENDED

    def contactor(self, closed: bool, time_s: float) -> None:
        """The dock confirmed how the contactor stands."""
        if self.state.phase is Phase.CLOSING and closed:
            self.state.phase = Phase.CHARGING
        elif self.state.phase is Phase.OPENING and not closed:
            if self.state.end is None and self.state.paused:
                self.state.phase = Phase.AWAITING_RECEIPT
                self.state.paused = False
            elif self.state.end is None:
                self._await_return(time_s)
            else:
                self.state.phase = Phase.ENDED
                self.state.ended_s = time_s

    def signed(self, soc: float) -> None:
        """What the robot signed of its state of charge, 0..1."""
        self.state.soc = soc

    def stop(self, end: End) -> None:
        """End the session for a reason from outside; the first reason stays."""
        if self.state.end is None:
            self.state.end = end
            self.state.phase = Phase.OPENING

    def reading(
        self,
        time_s: float,
        voltage_v: float,
        current_a: float,
        present: bool,
        energy_wh: float,
        covered: bool,
    ) -> None:
        """One reading of the dock's terminals.

        Args:
            energy_wh: metered in this session up to it.
            covered: whether the robot signed for all of it but a step.
        """
        self._follow_presence(present, time_s)
        state = self.state
        if state.phase in (Phase.OPENING, Phase.ENDED):
            return
        if time_s >= self._limits.deadline_s:
            self.stop(End.DEADLINE)
        elif time_s >= self._gives_back_s:
            self.stop(End.NO_ROBOT if state.phase is Phase.WAITING else End.NOT_SIGNED)
        elif state.phase is Phase.WAITING:
            self._wait(time_s)
        elif self._lasted(self._absent_since_s, time_s, self._limits.absent_s):
            if state.phase is Phase.AWAITING_RECEIPT:
                self._await_return(time_s)
            else:
                state.phase = Phase.OPENING
        elif state.phase is Phase.AWAITING_RECEIPT:
            if covered:
                state.phase = Phase.CLOSING
                self._small_since_s = None
        elif not covered:
            state.phase, state.paused = Phase.OPENING, True
        elif state.phase is Phase.CHARGING:
            self._charge(time_s, voltage_v, current_a, energy_wh)

    @property
    def due_s(self) -> float:
        """Site time before which there is nothing to do, however much is delivered: arrivals, departures,
        receipts and switched power are heard in between. -inf where each reading may decide."""
        state, limits = self.state, self._limits
        if state.phase in (Phase.AWAITING_RECEIPT, Phase.CLOSING):
            return -math.inf
        since = [
            (self._present_since_s if state.phase is Phase.WAITING else None, limits.present_s),
            (self._absent_since_s if state.phase is Phase.CHARGING else None, limits.absent_s),
        ]
        if state.phase is Phase.CHARGING and self._small_since_s is not None:
            told_s = max(self._told_s, self._small_since_s)
            since += [(self._small_since_s, limits.taper_s), (told_s, limits.reclose_s)]
            since.append((self._small_since_s, limits.no_current_s))
        ends_s = [begun_s + lasts_s for begun_s, lasts_s in since if begun_s is not None]
        give_up_s = state.wait_until_s if state.phase is Phase.WAITING else math.inf
        return min([*ends_s, give_up_s, self._gives_back_s, limits.deadline_s])

    # -- inside ----------------------------------------------------------------------------------------

    @property
    def _gives_back_s(self) -> float:
        """When the session ends for want of a robot that signs; never while power flows to one."""
        waits = self.state.phase in (Phase.WAITING, Phase.AWAITING_RECEIPT) and not self.state.sold
        return self._limits.give_back_s if waits else math.inf

    def _wait(self, time_s: float) -> None:
        if self._lasted(self._present_since_s, time_s, self._limits.present_s):
            self.state.phase = Phase.AWAITING_RECEIPT
        elif time_s >= self.state.wait_until_s:
            self.stop(End.NO_ROBOT if self.state.started_s is None else End.ROBOT_LEFT)

    def _await_return(self, time_s: float) -> None:
        self.state.phase = Phase.WAITING
        self.state.wait_until_s = time_s + self._limits.return_s

    def _charge(self, time_s: float, voltage_v: float, current_a: float, energy_wh: float) -> None:
        limits, state = self._limits, self.state
        if current_a > 0 and state.started_s is None:
            state.started_s = time_s
        started = state.started_s is not None
        if energy_wh >= limits.max_energy_wh:
            self.stop(End.ENERGY_LIMIT)
        elif started and state.soc is not None and state.soc >= min(limits.soc_target, NEARLY_FULL):
            self.stop(End.TARGET_REACHED)
        elif current_a > limits.cutoff_a:
            self._small_since_s = None
        else:
            if self._small_since_s is None:
                self._small_since_s = self._told_s = time_s
            small_s = time_s - self._small_since_s
            if started and voltage_v >= limits.voltage_share * limits.voltage_v:
                if small_s >= limits.taper_s:
                    self.stop(End.FULL)
            elif small_s >= limits.no_current_s:
                self.stop(End.NO_CURRENT)
            elif time_s - self._told_s >= limits.reclose_s:
                # The dock may have restarted with an open contactor.
                self._told_s = time_s
                state.phase = Phase.CLOSING

    def _follow_presence(self, present: bool, time_s: float) -> None:
        if present:
            self._absent_since_s = None
            self._present_since_s = time_s if self._present_since_s is None else self._present_since_s
        else:
            self._present_since_s = None
            self._absent_since_s = time_s if self._absent_since_s is None else self._absent_since_s

    @staticmethod
    def _lasted(since_s: float | None, now_s: float, seconds: float) -> bool:
        return since_s is not None and now_s - since_s >= seconds
