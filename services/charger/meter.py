"""The meter: readings of the dock's terminals into a register and a chain of statements to be signed."""

from __future__ import annotations

from pydantic import BaseModel

from rodeo.metering import MeterSample, MeterStatement, segment_wh


class Register(BaseModel):
    """What the meter keeps across restarts."""

    energy_wh: float = 0.0
    """Delivered since the session began."""
    last: MeterSample | None = None
    seq: int = 0
    """Of the last statement."""
    previous: str | None = None
    """Its digest."""
    unsaid: list[MeterSample] = []
    """Readings that are in no statement yet."""


class Meter:
    """Counts one session's energy."""

    def __init__(
        self, name: str, task_id: int, attempt: int, register: Register, readings_per_statement: int
    ) -> None:
        self.register = register
        self._name = name
        self._task_id = task_id
        self._attempt = attempt
        self._readings = readings_per_statement

    @property
    def energy_wh(self) -> float:
        return self.register.energy_wh

    def reading(self, time_s: float, voltage_v: float, current_a: float) -> MeterStatement | None:
        """Count one reading; a statement when it is due. What is not newer than the last is left out."""
        register = self.register
        if register.last is not None and time_s <= register.last.time_s:
            return None
        sample = MeterSample(
            time_s=time_s, voltage_v=voltage_v, current_a=current_a, power_w=voltage_v * current_a
        )
        if register.last is not None:
            register.energy_wh += segment_wh(register.last, sample)
        register.last = sample
        register.unsaid.append(sample)
        return self.statement() if len(register.unsaid) >= self._readings else None

    def statement(self) -> MeterStatement | None:
        """All readings that are in no statement yet; None when there are none."""
        register = self.register
        if not register.unsaid:
            return None
        *earlier, newest = register.unsaid
        register.seq += 1
        statement = MeterStatement(
            **newest.model_dump(),
            meter=self._name,
            task_id=self._task_id,
            attempt=self._attempt,
            seq=register.seq,
            previous=register.previous,
            earlier=earlier,
            energy_wh=register.energy_wh,
        )
        register.previous = statement.digest()
        register.unsaid = []
        return statement
