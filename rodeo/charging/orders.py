"""What buyer and seller of a charge agree on: the task's parameters, and when a charge is as ordered."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from rodeo.lab.config import BatteryConfig, DockConfig
from rodeo.site.config import Site
from rodeo.site.sections import RateConfig

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""Not a string or a truth value: parameters go on chain as they came, and their readers count on numbers."""
Name = Annotated[str, Field(min_length=1, max_length=64)]
Share = Annotated[Number, Field(ge=0, le=1)]

LARGEST_ORDER_WH = 1e12
"""A terawatt-hour; a dock's owner decides how much it sells."""
SOC_SLACK = 0.02
"""Resolution of a battery gauge."""
SOC_USED = 0.1
"""Charge that a robot may use between order and dock: the way, and half an hour's wait."""
COMPLETE_SHARE = 0.95
"""Share of the ordered energy that makes a charge complete."""
REACHED_SHARE = 0.75
"""The same for a robot that signs that it reached its target: an order is an upper estimate. With less it was
nearly there before."""


def shown(title: str, form: str, example: object = None) -> Any:
    """How a form shows a parameter (`rodeo.kinds.FORMATS`), and what it proposes."""
    extra: dict[str, Any] = {"format": form} if example is None else {"format": form, "examples": [example]}
    return Field(title=title, json_schema_extra=extra)


class ChargingParams(BaseModel):
    """Parameters of an order of energy."""

    model_config = ConfigDict(extra="allow")

    robot: Annotated[Name, shown("Robot", "robot")]
    dock: Annotated[Name | None, shown("Dock", "dock")] = None
    """Default: the site's first dock."""
    soc_from: Annotated[Share, shown("Charge now (%)", "percent", 0.5)]
    soc_target: Annotated[Share, shown("Charge to (%)", "percent", 0.95)]
    energy_wh: Annotated[Number, Field(gt=0, le=LARGEST_ORDER_WH), shown("Energy (Wh)", "follows")]
    """Ordered energy, at the dock's terminals. The price covers this energy, or less if it reaches
    `soc_target`."""

    def begins_at(self, soc: float) -> bool:
        """Whether a robot that arrives with this state of charge matches the task."""
        return self.soc_from - SOC_USED <= soc <= self.soc_from + SOC_SLACK

    def complete(self, delivered_wh: float, closing_soc: float | None) -> bool:
        """Whether the whole price is due. `closing_soc` is what the robot signed at the end, if it did."""
        reached = closing_soc is not None and closing_soc >= self.soc_target - SOC_SLACK
        return delivered_wh >= (REACHED_SHARE if reached else COMPLETE_SHARE) * self.energy_wh


def dock_of(site: Site, named: object) -> DockConfig:
    """The dock of a charge: the one that its task names, by default the site's first. Raises ConfigError
    if the site has no such dock."""
    return site.dock(site.docks[0].name if named is None and site.docks else str(named))


def most_due_iec(rates: Iterable[RateConfig], energy_wh: float) -> Decimal:
    """Price of that much energy at the highest of the rates; 0 without rates."""
    return max((rate.iec for rate in rates), default=Decimal(0)) * Decimal(str(energy_wh)) / 1000


def costliest_iec(rates: Iterable[RateConfig], site: Site) -> Decimal:
    """Price of the largest order of a robot of the site at the highest of the rates."""
    orders = [order_wh(robot.battery, dock, 0.0, 1.0) for robot in site.robots for dock in site.docks]
    return most_due_iec(rates, max(orders, default=0.0))


def order_wh(battery: BatteryConfig, dock: DockConfig, soc_from: float, soc_target: float) -> float:
    """Energy that a robot orders to get from one state of charge to the other, at the dock's terminals.

    An upper estimate: the charge at the voltage that the dock holds at the end, and what the robot consumes
    meanwhile with its arm held up.
    """
    stored_wh = (soc_target - soc_from) * battery.capacity_ah * dock.voltage_v
    share = (battery.idle_power_w + battery.arm_power_w) / (dock.voltage_v * dock.current_a)
    return round(max(stored_wh / (1 - min(share, 0.5)), 1.0), 1)
