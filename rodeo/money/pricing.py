"""What a robot asks for its work: a `Pricing` turns a situation into a price. The site file chooses one.

Amounts in IEC, energies in Wh, ways in km. A price on chain changes at most every `min_update_s`, and by at
least `min_change` of what it was: each change is a transaction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Annotated, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field

_CENT = Decimal("0.01")
_HOUR_S = 3600.0


@dataclass(frozen=True)
class Experience:
    """What one price has brought so far."""

    offered_s: float = 0.0
    """Site time for which the service was on offer, or at work, at this price."""
    paid_iec: Decimal = Decimal(0)


@dataclass(frozen=True)
class Situation:
    """What a price may depend on."""

    list_iec: Decimal
    """The price of this kind in the site file."""
    energy_wh: float | None = None
    """That a task of this kind takes, as the robot measured it; None before it has done one."""
    way_km: float = 0.0
    """The same for the way that it drives."""
    iec_per_wh: float = 0.0
    """What energy cost the robot."""
    care_iec_per_km: float = 0.0
    """What people are paid to keep it fit, for each km."""
    history: Mapping[Decimal, Experience] = field(default_factory=dict)
    """Price -> what it brought this robot in this kind."""


class Pricing(Protocol):
    def price(self, now: Situation) -> Decimal:
        """What to ask for a task, IEC."""


class Fixed(BaseModel):
    """Always the same."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    method: Literal["fixed"] = "fixed"
    price_iec: Annotated[Decimal, Field(ge=0)] | None = None
    """The price of the kind if left out."""

    def price(self, now: Situation) -> Decimal:
        return now.list_iec if self.price_iec is None else self.price_iec


class Moving(BaseModel):
    """A pricing whose prices change while it runs."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    min_update_s: float = Field(default=3600.0, ge=0)
    """Site time between two changes of a price on chain."""
    min_change: float = Field(default=0.05, ge=0, le=1)
    """A change by less than this part of the price is left out."""

    def is_worth(self, price: Decimal, offered: Decimal) -> bool:
        """Whether to ask `price` instead of what is `offered`."""
        return price != offered and abs(price - offered) >= Decimal(str(self.min_change)) * offered


class CostPlus(Moving):
    """Energy and wear of a task as the robot measured them, and a margin on top. The kind's price before."""

    method: Literal["cost_plus"]
    margin: float = Field(default=0.3, ge=0)
    """Margin on the costs."""
    wear_iec_per_km: float = Field(default=0.0, ge=0)
    """Besides the care that the robot pays people for (`agent.maintenance`)."""

    def price(self, now: Situation) -> Decimal:
        if now.energy_wh is None:
            return now.list_iec
        wear_iec = now.way_km * (self.wear_iec_per_km + now.care_iec_per_km)
        return _rounded((now.energy_wh * now.iec_per_wh + wear_iec) * (1 + self.margin))


class Learned(Moving):
    """The price that brought most in an hour; those that were hardly tried get a bonus.

    UCB1 (Auer, Cesa-Bianchi and Fischer, Machine Learning 47, 2002), with hours on offer for pulls. The
    dearest untried price comes first.
    """

    method: Literal["learned"]
    prices_iec: tuple[Annotated[Decimal, Field(gt=0)], ...] = Field(min_length=2)
    """To choose from."""
    explore: float = Field(default=0.3, ge=0)
    """Weight of the bonus, in parts of the dearest price."""
    memory_h: float = Field(default=14 * 24.0, gt=0)
    """Site hours after which experience is forgotten."""

    def price(self, now: Situation) -> Decimal:
        dearest = max(self.prices_iec)
        tried = {price: now.history.get(price, Experience()) for price in self.prices_iec}
        total_h = sum(one.offered_s for one in tried.values()) / _HOUR_S

        def value(price: Decimal) -> tuple[float, Decimal]:
            hours = tried[price].offered_s / _HOUR_S
            if hours == 0:
                return math.inf, price
            bonus = self.explore * float(dearest) * math.sqrt(2 * math.log1p(total_h) / hours)
            return float(tried[price].paid_iec) / hours + bonus, price

        return max(self.prices_iec, key=value)


AnyPricing = Annotated[Fixed | CostPlus | Learned, Field(discriminator="method")]


class PricingConfig(BaseModel):
    """How a robot prices its work; `kinds` says otherwise for single kinds."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    default: AnyPricing = Fixed()
    kinds: dict[str, AnyPricing] = {}

    def of(self, kind: str) -> Fixed | CostPlus | Learned:
        return self.kinds.get(kind, self.default)


def _rounded(amount: float) -> Decimal:
    return Decimal(str(amount)).quantize(_CENT)
