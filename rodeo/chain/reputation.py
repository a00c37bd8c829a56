"""A provider's record, computed from events as Providers computes it.

reputation = 64 * (done + PRIOR) / (done + failed + 2 * PRIOR)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rodeo.money.currency import IEC, Currency

_DAY_S = 86_400
_HALF_LIFE_DAYS = 90
_DAILY = 18_305_219_661_902_323_056
"""What a day leaves of work: 2 ** (-1 / 90), times 2 ** 64."""
_PRIOR_TOKENS = 100
_MAX = 2**56 - 1
_SIGNS = 2**16 - 1


@dataclass(frozen=True)
class Work:
    """Work of a provider for others, in units of prices, as of a day (from 1970-01-01 UTC)."""

    done: int = 0
    """Payments for accepted work."""
    failed: int = 0
    """Payments that rejected or late work would have brought."""
    day: int = 0
    creator: int = 0
    """A number, which few have in common, for the creator whose attempt counted last on that day; 0:
    nobody, or only the organization."""

    def at(self, time_s: float) -> Work:
        """The remainder of it."""
        today = int(time_s) // _DAY_S
        halves, rest = divmod(today - self.day, _HALF_LIFE_DAYS)
        done, failed, factor = self.done >> halves, self.failed >> halves, _DAILY
        while rest:
            if rest & 1:
                done, failed = done * factor >> 64, failed * factor >> 64
            factor = factor * factor >> 64
            rest >>= 1
        return Work(done, failed, today, self.creator if today == self.day else 0)

    def plus(
        self, value_wei: int, accepted: bool, time_s: float, creator: str = "", currency: Currency = IEC
    ) -> Work:
        """With work that was judged, or that never came, at `time_s`. Less than a unit changes nothing, nor
        does the second attempt of a day for the same creator in a row. `creator`: empty for the organization,
        whose attempts all count."""
        value, now = value_wei // currency.price_unit, self.at(time_s)
        sign = int(creator, 16) % _SIGNS + 1 if creator else now.creator
        if value == 0 or (creator and sign == now.creator):
            return self
        if accepted:
            return Work(min(now.done + value, _MAX), now.failed, now.day, sign)
        return Work(now.done, min(now.failed + value, _MAX), now.day, sign)

    def reputation(self, time_s: float, currency: Currency = IEC) -> int:
        """In 64ths."""
        now, prior = self.at(time_s), _PRIOR_TOKENS * 10**currency.decimals // currency.price_unit
        return (now.done + prior) * 64 // (now.done + now.failed + 2 * prior)


def is_own(creator: str, provider: str, owners: Mapping[str, str], payout: str) -> bool:
    """Whether both are one, or one owns the other, or somebody owns both, or what the provider earns goes
    back to whoever pays. `owners`: device -> owner; `payout`: who is paid."""
    return owners.get(creator, creator) in (owners.get(provider, provider), payout)
