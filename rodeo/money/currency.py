"""Amounts of a token: decimal numbers for people, whole numbers of its smallest unit on chain.

The only place that converts between the two. How many decimals a token has, the deployment record says
(`Deployment.currency`), and the site file for those who ask no chain (`EconomyConfig.currency`); both are
compared with the token's `decimals()`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal, Inexact, localcontext
from fractions import Fraction

from rodeo.errors import RequestError

MIN_DECIMALS, MAX_DECIMALS = 2, 18
"""Decimals that a payment token may have, as `Units.unitOf` on chain: prices are named in cents, and have
88 bits."""

_DIGITS = 77
"""A uint256 holds every number with this many digits."""


class InvalidAmount(RequestError, ValueError):
    """Less than nothing, no number, more than a contract can count, or finer than the token."""


@dataclass(frozen=True)
class Currency:
    """A token with so many decimals."""

    decimals: int

    @property
    def price_unit(self) -> int:
        """What each price is a multiple of, in the token's smallest unit, as `Units.unitOf` on chain."""
        return int(10 ** max(0, self.decimals - 9))

    def reward_for(self, price: int) -> int:
        """The least reward for which a service of this price is found among those that wait: three digits
        count, as `Units.levelFor` on chain."""
        units = -(-price // self.price_unit)
        step = 10 ** max(0, len(str(units)) - 3)
        return -(-units // step) * step * self.price_unit

    def to_units(self, amount: Decimal) -> int:
        """In the smallest unit. Raises InvalidAmount."""
        if not amount.is_finite() or amount < 0:
            raise InvalidAmount("not an amount", amount=str(amount))
        if amount and amount.adjusted() + self.decimals >= _DIGITS:
            raise InvalidAmount("more than a contract can count", amount=str(amount))
        # With more digits than the largest amount has, only amounts finer than the smallest unit are inexact.
        with localcontext(prec=100) as context:
            context.traps[Inexact] = True
            try:
                return int(amount.scaleb(self.decimals).to_integral_exact())
            except Inexact as error:
                raise InvalidAmount(
                    f"more than {self.decimals} decimals", amount=str(amount), decimals=self.decimals
                ) from error

    def payable(self, due: Fraction) -> Decimal:
        """What is paid of it: rounded down to the smallest unit, but at least one where anything is due.
        Work that is accepted is never paid nothing, which the contracts refuse."""
        return self.from_units(max(math.floor(due * 10**self.decimals), due > 0))

    def from_units(self, units: int) -> Decimal:
        """Without trailing zeros, or an exponent when formatted with `f"{amount:f}"`."""
        with localcontext(prec=100):
            whole, rest = divmod(units, 10**self.decimals)
            return Decimal(whole) if rest == 0 else Decimal(units).scaleb(-self.decimals).normalize()

    def text(self, units: int) -> str:
        """As the DAO plane writes amounts: a decimal string without exponent."""
        return f"{self.from_units(units):f}"


IEC = Currency(18)
"""IECoin, which the deployment makes if the site file names no other token."""

ETHER = Currency(18)
"""What gas is paid with."""
