"""What fell into one compartment, read from its load cell: a step up that settles."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from pydantic import BaseModel


@dataclass(frozen=True)
class LoadLimits:
    """When a change of weight counts. The lightest item weighs 0.2 N; a good cell repeats to 0.02 N."""

    settle_s: float = 0.5
    """A reading counts once the force has stayed within `tolerance_n` for this time."""
    tolerance_n: float = 0.05
    step_n: float = 0.1
    """Smaller changes of a settled reading are drift."""
    stay_s: float = 0.5
    """A change that is gone within this time after it settled does not count: it was a touch or a push."""
    out_n: float = 1.0
    """A cell that carries less than minus this has lost its container, which was part of its zero: an empty
    container weighs more, and a zero drifts by less."""


LOAD_LIMITS = LoadLimits()


class Cell(BaseModel):
    """What is remembered of one load cell across restarts."""

    settled_n: float | None = None
    """The last weight accounted for, N; None before the first settled reading."""
    seen_s: float = 0.0
    """Site time at which the cell last showed that weight."""
    held_n: float = 0.0
    """What it held, N, when it was last lifted out."""


@dataclass(frozen=True)
class Step:
    """The settled weight has been `settled_n` instead of the accounted one since `time_s` (site time).

    The weight changed between `after_s`, when it was still the accounted one, and `time_s`. That is about a
    second, or the whole time without readings.
    """

    settled_n: float
    delta_n: float
    """What came in, N; 0 or less when the container was emptied, lifted out or put back."""
    after_s: float
    time_s: float
    ripe: bool
    """Whether it has stayed."""


class LoadCell:
    """Follows one cell. The first settled reading ever is the zero; later ones are compared with the last.

    That comparison is with `memory`, so what fell while the process was down is still seen. A step stands
    until its weight goes away again or somebody calls `account`.
    """

    def __init__(self, memory: Cell, limits: LoadLimits = LOAD_LIMITS) -> None:
        self.memory = memory
        self._limits = limits
        self._window: deque[tuple[float, float]] = deque()
        self._step: Step | None = None

    @property
    def step(self) -> Step | None:
        """The change of weight that stands and is not accounted for."""
        return self._step

    @property
    def lifted(self) -> bool:
        """Whether the container was out when its weight was last accounted for."""
        return self._out(self.memory.settled_n or 0.0)

    @property
    def restless(self) -> bool:
        """Whether the last reading was not the accounted weight at rest."""
        return bool(self._window) and self.memory.seen_s < self._window[-1][0]

    def reading(self, force_n: float, time_s: float) -> Step | None:
        """One reading in N at site time `time_s`; the step that stands after it, if any."""
        if self._window and time_s < self._window[-1][0]:
            self._window.clear()  # a sensor that restarted its clock starts anew
            self._step = None
        self._window.append((time_s, force_n))
        settled_n = self._settled()
        if settled_n is None:
            self._step = None
            return None
        accounted_n = settled_n if self.memory.settled_n is None else self.memory.settled_n
        self.memory.settled_n = accounted_n
        if abs(settled_n - accounted_n) < self._limits.step_n:
            self._step = None
            self.memory.seen_s = time_s
            return None
        since_s = self._step.time_s if self._step else time_s
        self._step = Step(
            settled_n,
            self._came_n(settled_n, accounted_n),
            self.memory.seen_s,
            since_s,
            ripe=time_s - since_s >= self._limits.stay_s,
        )
        return self._step

    def account(self) -> None:
        """Make the weight that stands the new reference."""
        if self._step is not None:
            accounted_n = self.memory.settled_n or 0.0
            if not self._out(accounted_n):
                self.memory.held_n = accounted_n
            self.memory.settled_n = self._step.settled_n
            self.memory.seen_s = self._step.time_s
            self._step = None

    def _out(self, weight_n: float) -> bool:
        return weight_n < -self._limits.out_n

    def _came_n(self, settled_n: float, accounted_n: float) -> float:
        if not self._out(accounted_n):
            return settled_n - accounted_n
        # A container that is put back brings the rest of its old content; only more than that came into it.
        more_n = settled_n - self.memory.held_n
        return more_n if more_n >= self._limits.step_n else min(more_n, 0.0)

    def _settled(self) -> float | None:
        """Mean of the last `settle_s` if they are complete and quiet; older readings are let go."""
        newest_s = self._window[-1][0] if self._window else 0.0
        while len(self._window) >= 2 and self._window[1][0] <= newest_s - self._limits.settle_s:
            self._window.popleft()
        if not self._window or newest_s - self._window[0][0] < self._limits.settle_s:
            return None
        forces_n = [force_n for _, force_n in self._window]
        if max(forces_n) - min(forces_n) > self._limits.tolerance_n:
            return None
        return sum(forces_n) / len(forces_n)
