"""Gas money: what each wallet needs of an external chain's native currency, and what it holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import ROUND_UP, Context, Decimal

from eth_utils import to_checksum_address
from web3 import Web3
from web3.types import Wei

from rodeo.chain.node.transactions import POLL_S, market_of
from rodeo.chain.node.translation import translated
from rodeo.signing import keystores
from rodeo.site.config import Site

_DEPLOYMENT_GAS = 30_000_000
"""Contracts and rules, with a third to spare: with one robot they took 22.9 million on anvil."""
_WORKING_GAS = 5_000_000
"""A few dozen transactions of one wallet."""
_WEI = Decimal(10**18)
_LOCAL = Wei(10 * 10**18)
"""For each account on a local chain."""


@dataclass(frozen=True)
class Purse:
    """A wallet, and what it should hold for gas, in the chain's native currency."""

    name: str
    address: str
    holds: Decimal
    needs: Decimal

    @property
    def missing(self) -> Decimal:
        """Amount that should be sent to it."""
        return max(self.needs - self.holds, Decimal(0))

    @property
    def funded(self) -> bool:
        return not self.missing

    def __str__(self) -> str:
        """One line with the whole address, to be copied."""
        need = "" if self.funded else f"; send at least {self.missing:f} more to it"
        return f"{self.address} {self.name}: holds {self.holds.normalize():f}{need}"


def purses(site: Site, w3: Web3, deployed: bool) -> Iterator[Purse]:
    """A purse for each wallet that sends transactions, at what gas costs now. Raises ChainUnavailable."""
    fee = market_of(w3).fees().max_fee
    for name in keystores.wallet_names(site):
        address = to_checksum_address(keystores.address(site, name))
        deploys = name == "organization" and not deployed
        gas = _WORKING_GAS + (_DEPLOYMENT_GAS if deploys else 0)
        with translated():
            holds = w3.eth.get_balance(address)
        needs = Context(prec=2, rounding=ROUND_UP).create_decimal(Decimal(gas * fee) / _WEI)
        yield Purse(name, address, Decimal(holds) / _WEI, needs)


def fund(w3: Web3, accounts: list[str]) -> None:
    """Give accounts of a local chain gas money from the account that its node holds itself."""
    with translated():
        rich = w3.eth.accounts[0]
        for account in map(to_checksum_address, accounts):
            if w3.eth.get_balance(account) < _LOCAL // 10:
                sent = w3.eth.send_transaction({"from": rich, "to": account, "value": _LOCAL})
                w3.eth.wait_for_transaction_receipt(sent, poll_latency=POLL_S)
