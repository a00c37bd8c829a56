"""Errors of the chain, below RodeoError. `translation.py` makes them of what nodes and web3.py raise.

RodeoError
└── ChainError
    ├── ChainUnavailable    the node does not answer
    │   ├── InvalidAnswer   what it answers is no answer to what was asked
    │   ├── RateLimited     it limits how often it is asked
    │   └── NotNow          it says that it cannot do this now
    ├── RpcFailed           the node answered with an error that is no revert
    ├── ContractReverted    a contract refused; `name` and `args` are its custom error's
    ├── TransactionFailed   mined without success for another reason than a revert (gas)
    ├── TransactionTimeout  not mined in time; it may still be
    ├── NotDeployed         no record of the contracts for this chain
    ├── WrongChain          the node's chain is not the one that the site file names
    └── DeploymentMismatch  the record is of other contracts than the chain has
"""

from __future__ import annotations

from typing import Any

from rodeo.chain.contracts.types import to_json
from rodeo.errors import RodeoError, snake_case
from rodeo.money.currency import IEC, Currency


class ChainError(RodeoError):
    """The chain did not do what was asked."""


class ChainUnavailable(ChainError):
    """The node does not answer. Asking again later may help."""

    @property
    def code(self) -> str:
        """One for all of them: whoever asked does the same, which is to ask again."""
        return "chain_unavailable"


class InvalidAnswer(ChainUnavailable):
    """The node's answer cannot be used: `details` say what is wrong with it and quote its beginning, without
    the parts of the node's URL that may be a key."""


class RateLimited(ChainUnavailable):
    """The node limits the rate of requests: `details["retry_after_s"]` is for how long, where it states
    it."""


class NotNow(ChainUnavailable):
    """The node cannot do this now: it is a block behind, busy, or waits for other transactions."""


class RpcFailed(ChainError):
    """The node answered with an error that is no revert; `details` has its code and sentence."""


_AMOUNTS = frozenset({"price", "amount", "bond", "penalty", "balance", "needed", "allowance"})
"""Arguments that are wei of the payment token in every error."""
_AMOUNTS_OF = {
    "InvalidPrice": {"unit", "max"},
    "InvalidAmount": {"max"},
    "WrongAmountReceived": {"expected", "received"},
    "OverBudget": {"left"},
    "BondTooHigh": {"max_bond"},
    "StakeTooLow": {"stake"},
    "WrongStakeReceived": {"expected", "received"},
}
"""The same where another error's argument of that name is something else."""
_NO_AMOUNTS_OF = {name: {"needed"} for name in ("TooFewVotes", "TooFewCredits", "TooLate", "TooLittleGas")}
"""Arguments of these names that are something else: a number of votes or credits, a time, gas."""


class ContractReverted(ChainError):
    """A contract refused. Nothing changed.

    `code` is the error's name in snake case (`wrong_state`), `args` its values in the types of
    `rodeo.chain.contracts.types`, `details` the same for JSON: amounts are decimal strings named `..._iec`.
    """

    def __init__(self, name: str, args: dict[str, Any], currency: Currency = IEC) -> None:
        amounts = (_AMOUNTS | _AMOUNTS_OF.get(name, set())) - _NO_AMOUNTS_OF.get(name, set())
        details = {
            f"{key}_iec" if key in amounts else key: currency.text(arg) if key in amounts else to_json(arg)
            for key, arg in args.items()
        }
        super().__init__(f"the contract refused: {name}", **details)
        self.name = name
        self.args_by_name = args

    @property
    def code(self) -> str:
        return snake_case(self.name)


class TransactionFailed(ChainError):
    """Mined, but it changed nothing, and not because a contract refused: most likely it ran out of gas."""


class TransactionTimeout(ChainError):
    """Not mined in time. It may still be."""


class NotDeployed(ChainError):
    """There is no record of the contracts on this chain; `rodeo site prepare` makes it."""


class WrongChain(ChainError):
    """The node is one of another chain than the site file names. Nothing is sent there."""

    restart_cures = False


class DeploymentMismatch(ChainError):
    """The record does not describe this chain: it was reset, or the contracts were built anew."""
