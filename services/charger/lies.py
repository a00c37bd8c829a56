"""What a meter and a contactor cannot truthfully show, each a type of its own.

A meter has two accounts of the same energy: the power that it shows, and its register. Only the power is
sold, and the register has to agree with it: an order too small for the register's steps is not sold
(`least_order_wh`). A contactor that was opened lets nothing through.

    MeterLie
    ├── WrongMeter          another meter answers than the site file names
    ├── ImplausibleReading  no number, or none that this meter can show
    ├── CurrentWhileOpen    the contactor was opened, and current flows
    └── RegisterLie         holds until the process is started again: no later reading can refute it
        ├── RegisterFrozen  power flows, and the register stands still
        ├── RegisterFell    the register is lower than before
        ├── RegisterReset   it began again
        └── RegisterOff     register and power disagree by more than a meter may be wrong
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rodeo.charging.metering import MAX_GAP_S, METER_CLASS, S_PER_H
from rodeo.charging.orders import REACHED_SHARE
from rodeo.errors import RodeoError

OPENS_S = 3.0
"""Time after which a contactor has opened and the meter's filter shows it."""
_SHARE = 2.5 * METER_CLASS
"""By how much power, added up once a second, and register may differ: both are of the same meter, but the
power changes between two readings."""
NOTICED_SHARE = 0.2
"""A register that is off by so much is noticed in each charge that is sold."""
_WINDOW_WH = 100.0
"""After so much energy, or what the register's steps need, the comparison begins anew, so that a long truth
hides no lie."""
_RESET_SHARE = 0.01
"""A register that fell below this share of what it showed began again."""


class MeterLie(RodeoError):
    """The meter or the contactor contradicts itself."""


class WrongMeter(MeterLie):
    """Another meter answers."""


class ImplausibleReading(MeterLie):
    """A value is none that this meter can show."""


class CurrentWhileOpen(MeterLie):
    """Current flows although the contactor was opened."""


class RegisterLie(MeterLie):
    """The register contradicts the power."""


class RegisterFrozen(RegisterLie):
    """Power flows, and the register stands still."""


class RegisterFell(RegisterLie):
    """The register is lower than before."""


class RegisterReset(RegisterLie):
    """The register began again."""


class RegisterOff(RegisterLie):
    """Register and power disagree."""


class Shown(NamedTuple):
    """What a meter shows at one moment."""

    time_s: float
    voltage_v: float
    power_w: float
    """Positive towards the robot."""
    import_wh: float
    """The register of the energy that it counted."""


def least_order_wh(step_wh: float) -> float:
    """Smallest order in which a register that moves in such steps shows that it is off by `NOTICED_SHARE`. A
    charge may be complete with `REACHED_SHARE` of its order."""
    return _confirmed_wh(step_wh) / REACHED_SHARE


def _confirmed_wh(step_wh: float) -> float:
    """Energy after which it shows that: an honest one may be off by a step, too."""
    return 2 * step_wh / (NOTICED_SHARE - _SHARE * (1 + NOTICED_SHARE))


class Watch:
    """Compares what one meter shows with what it showed before. One thread at a time.

    Args:
        volts: what its voltage can be.
        resolution_wh: what its register resolves.
        idle_w: most that flows while the contactor is open.
        most_w: most that the supply delivers.
    """

    def __init__(
        self, volts: tuple[float, float], resolution_wh: float, idle_w: float, most_w: float
    ) -> None:
        self._volts, self._resolution_wh = volts, resolution_wh
        self._idle_w, self._most_w = idle_w, most_w
        self._closed = False
        self._since_s = -math.inf
        """When the contactor was moved."""
        self._last: Shown | None = None
        self._moved_wh = self._flowed_wh = 0.0
        """By register and by power, since the comparison began."""
        self._still_wh = 0.0
        """By power, since the register moved last."""

    def contactor(self, closed: bool, time_s: float) -> None:
        """The contactor was commanded."""
        if closed is not self._closed:
            self._closed, self._since_s = closed, time_s
            self._begin()

    @property
    def least_order_wh(self) -> float:
        """Smallest order that this register confirms."""
        return least_order_wh(self._step_wh(0.0 if self._last is None else self._last.import_wh))

    def see(self, shown: Shown) -> None:
        """The newest of what the meter shows, which is believed if this raises no MeterLie."""
        last = self._last
        if wrong := self._implausible(shown):
            raise ImplausibleReading(wrong, **shown._asdict())
        self._last = shown
        if last is None:
            self._since_s = max(self._since_s, shown.time_s)
        if not self._closed:
            # Whoever resets an idle meter sells nothing by it.
            if shown.power_w > self._idle_w and shown.time_s - self._since_s > OPENS_S:
                raise CurrentWhileOpen(
                    "current flows although the contactor was opened: look at the contactor",
                    power_w=round(shown.power_w, 1),
                )
        elif last is not None:
            self._compare(last, shown)

    def _begin(self) -> None:
        self._moved_wh = self._flowed_wh = self._still_wh = 0.0

    def _implausible(self, shown: Shown) -> str:
        if not all(map(math.isfinite, shown)):
            return "the meter shows what is no number"
        if not self._volts[0] <= shown.voltage_v <= self._volts[1]:
            return f"the voltage is not between {self._volts[0]:g} and {self._volts[1]:g} V"
        if shown.import_wh < 0:
            return "the register is negative"
        if shown.power_w < -self._idle_w:
            return "power flows from the robot to the mains: is the meter connected backwards?"
        if shown.power_w > 2 * self._most_w:
            return f"the power is more than the dock delivers, {self._most_w:.0f} W: is its unit right?"
        return ""

    def _compare(self, last: Shown, shown: Shown) -> None:
        moved_wh = shown.import_wh - last.import_wh
        values = {"before_wh": round(last.import_wh, 1), "now_wh": round(shown.import_wh, 1)}
        if shown.import_wh < min(_RESET_SHARE * last.import_wh, last.import_wh - self._resolution_wh):
            raise RegisterReset("the meter's register began again", **values)
        if moved_wh < 0:
            raise RegisterFell("the meter's register fell", **values)
        seconds = shown.time_s - last.time_s
        if not 0 < seconds <= MAX_GAP_S:
            # Nobody saw what flowed meanwhile, and nobody sells it.
            if moved_wh > self._most_w * max(seconds, 0.0) / S_PER_H * (1 + _SHARE) + self._resolution_wh:
                raise RegisterOff(
                    "the meter's register rose by more than the dock delivers", seconds=seconds, **values
                )
            self._begin()
            return
        self._moved_wh += moved_wh
        flowed_wh = (last.power_w + shown.power_w) / 2 * seconds / S_PER_H
        self._flowed_wh += flowed_wh
        self._still_wh = 0.0 if moved_wh else self._still_wh + flowed_wh
        step_wh = self._step_wh(shown.import_wh)
        slack_wh = step_wh + _SHARE * max(self._flowed_wh, self._moved_wh)
        values = {"by_power_wh": round(self._flowed_wh, 1), "by_register_wh": round(self._moved_wh, 1)}
        if self._still_wh > step_wh * (1 + _SHARE):
            raise RegisterFrozen("power flows, and the meter's register stands still", **values)
        if abs(self._flowed_wh - self._moved_wh) > slack_wh:
            raise RegisterOff("the meter's power and its register disagree", **values)
        if self._flowed_wh > max(_WINDOW_WH, _confirmed_wh(step_wh)):
            self._begin()

    def _step_wh(self, import_wh: float) -> float:
        """What the register resolves there: a 32-bit float of kWh has 24 binary digits."""
        return max(self._resolution_wh, 2000.0 * math.ldexp(1.0, math.frexp(import_wh / 1000)[1] - 24))
