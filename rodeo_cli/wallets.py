"""`rodeo site wallets`: the accounts of a site on a chain elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from typing import Any

from deploy import contracts
from deploy.gas_money import purses
from rodeo.chain.client import connect
from rodeo.chain.node.errors import ChainUnavailable
from rodeo.signing import keystores, wallets
from rodeo.site.config import Site
from rodeo_cli.layout import Row

COLUMNS = ("address", "name", "signs", "holds", "send at least")


def accounts(site: Site) -> dict[str, Any]:
    """Make the missing keystores; returns all accounts, as `--json` prints them.

    Raises WalletError without a passphrase. `holds_eth` and `missing_eth` are decimal numbers of the chain's
    native currency. They are None for a device, because it sends nothing. They are also None if no node
    answers, or the organization there is of another release; then `problem` is the reason.
    """
    wallets.make_missing(site)
    w3 = connect(site.chain.url)
    problem = ""
    try:
        found = [
            _account(one.name, one.address, "transactions", f"{one.holds.normalize():f}", f"{one.missing:f}")
            for one in purses(site, w3, contracts.recorded(site, w3))
        ]
    except ChainUnavailable:
        problem = f"no node answers at {site.chain.shown_url}: the wallets' gas balances are unknown"
    except contracts.OtherRelease as error:
        problem = error.message
    if problem:
        found = [
            _account(n, keystores.address(site, n), "transactions") for n in keystores.wallet_names(site)
        ]
    found += [_account(n, keystores.address(site, n), "evidence") for n in keystores.device_names(site)]
    return {"chain_url": site.chain.shown_url, "problem": problem, "accounts": found}


def _account(
    name: str, address: str, signs: str, holds_eth: str | None = None, missing_eth: str | None = None
) -> dict[str, str | None]:
    return {
        "name": name,
        "address": address,
        "signs": signs,
        "holds_eth": holds_eth,
        "missing_eth": missing_eth,
    }


def rows(found: dict[str, Any]) -> Iterator[Row]:
    """Rows of `accounts`, for a table of `COLUMNS`."""
    for one in found["accounts"]:
        missing = one["missing_eth"] if Decimal(one["missing_eth"] or 0) else ""
        yield Row((one["address"], one["name"], f"signs {one['signs']}", one["holds_eth"] or "", missing))
