"""What a transaction may cost: EIP-1559 fees at send time, within the limits of its wallet."""

from __future__ import annotations

from collections.abc import Mapping

from rodeo.chain.node.fees import Fees, Market
from rodeo.commands.errors import DailyLimitReached
from rodeo.money.currency import ETHER, Currency
from rodeo.site.sections import WalletLimits
from services.bridge.errors import FeeTooHigh

GAS_MARGIN = 1.25
"""Gas limit of a transaction, as a multiple of the estimate: another transaction may be mined before it, and
change what it needs."""

GAS_HEADROOM = 300_000
"""Gas beyond that, as far as the limits have room for it: after a transaction in between, this one may make
and pay for a match."""

_GWEI = 10**9


class Limits:
    """Spending limits of a wallet, from the site file."""

    def __init__(self, config: WalletLimits, currency: Currency) -> None:
        """`currency` is what the organization pays with."""
        self._currency = currency
        self._max_fee_per_gas = (
            None if config.max_fee_per_gas_gwei is None else int(config.max_fee_per_gas_gwei * _GWEI)
        )
        self._max_fee = None if config.max_fee_eth is None else ETHER.to_units(config.max_fee_eth)
        self._daily_fee = None if config.daily_fee_eth is None else ETHER.to_units(config.daily_fee_eth)
        self._daily_iec = None if config.daily_iec is None else currency.to_units(config.daily_iec)

    @property
    def has_daily_iec(self) -> bool:
        return self._daily_iec is not None

    @property
    def has_daily(self) -> bool:
        return self._daily_fee is not None or self._daily_iec is not None

    def offer(self, wanted: Fees, market: Market, estimate: int, spent: int = 0) -> tuple[int, Fees]:
        """Gas and fees for a transaction whose gas was estimated, where `spent` wei of fees are spent today.

        Fees are as `wanted`, or lower, so that gas times fee is within each limit. For a limit the gas gives
        up its headroom and nothing else. Raises FeeTooHigh or DailyLimitReached where the rest would
        not be mined now.
        """
        least = int(estimate * GAS_MARGIN)
        most = [] if self._max_fee is None else [self._max_fee]
        needed = market.base_fee + market.priority_fee
        if self._daily_fee is not None:
            self.check_day((0, spent), 0, least * needed)
            most.append(max(0, self._daily_fee - spent))
        caps = [wanted.max_fee, *(one // least for one in most)]
        cap = min(caps if self._max_fee_per_gas is None else [*caps, self._max_fee_per_gas])
        if cap < needed:
            raise FeeTooHigh(
                "the transaction's fee exceeds this wallet's limit",
                needed_wei_per_gas=str(needed),
                limit_wei_per_gas=str(cap),
                gas=least,
            )
        gas = min([least + GAS_HEADROOM, *(one // cap for one in most if cap)])
        return gas, Fees(cap, min(wanted.priority_fee, cap))

    def check_day(self, spent: tuple[int, int], spends: int, fee: int) -> None:
        """Raises DailyLimitReached when `spends` wei of the payment token, or `fee` wei more, are too much
        for one day."""
        limits: Mapping[str, tuple[int | None, int, int]] = {
            "IEC": (self._daily_iec, spent[0], spends),
            "fees": (self._daily_fee, spent[1], fee),
        }
        for what, (limit, before, more) in limits.items():
            if limit is not None and more and before + more > limit:
                unit, counted = ("iec", self._currency) if what == "IEC" else ("eth", ETHER)
                raise DailyLimitReached(
                    "the wallet has reached its daily spending limit",
                    what=what,
                    **{
                        f"{name}_{unit}": counted.text(wei)
                        for name, wei in (("limit", limit), ("spent", before), ("more", more))
                    },
                )
