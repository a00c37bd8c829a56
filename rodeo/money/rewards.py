"""Rewards that rise while a task waits for somebody to take it."""

from __future__ import annotations

from decimal import ROUND_CEILING, Decimal

from pydantic import BaseModel, ConfigDict, Field

_CENT = Decimal("0.01")


class Rise(BaseModel):
    """How a reward rises."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    up_to_iec: Decimal = Field(gt=0)
    """It never rises above this."""
    by: float = Field(default=0.1, gt=0, le=10)
    """Part of the present reward that each rise adds."""
    every_s: float = Field(default=3600.0, ge=1)
    """Site time between two rises."""

    def after(self, reward_iec: Decimal) -> Decimal | None:
        """The next reward after `reward_iec`; None if that is the highest."""
        if reward_iec >= self.up_to_iec:
            return None
        raised = reward_iec * (1 + Decimal(str(self.by)))
        return min(self.up_to_iec, max(raised.quantize(_CENT, ROUND_CEILING), reward_iec + _CENT))
