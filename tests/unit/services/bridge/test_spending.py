"""What each command counts against the daily limit of its wallet."""

from __future__ import annotations

from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.currency import IEC
from rodeo.messages import Command, Deposit, DepositStake, Transfer, Withdraw, WrapTokens
from services.bridge.commands import Wallet

FIVE = {"amount_iec": Decimal(5)}


@pytest.mark.parametrize(
    "command",
    [
        Transfer(to="bob", **FIVE),
        Deposit(**FIVE),
        Withdraw(to="bob", **FIVE),
        WrapTokens(**FIVE),
        # Its owner, who may be anybody, has it back.
        DepositStake(judge="anna", **FIVE),
    ],
    ids=lambda command: type(command).__name__,
)
def test_what_leaves_the_wallet_counts(command: Command) -> None:
    unused: Any = SimpleNamespace()
    client: Any = SimpleNamespace(currency=IEC)
    wallet = Wallet("alice", client, unused, unused, unused, unused, unused, unused)
    assert wallet._spends(command) == IEC.to_units(Decimal(5))
