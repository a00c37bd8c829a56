"""Make the keystores that a site on a chain elsewhere lacks: `python -m deploy.wallets --site FILE`.

They are encrypted with `RODEO_KEYSTORE_PASSPHRASE`. A keystore that was brought along is kept (Web3 Secret
Storage, as `cast wallet` writes it). Prints the accounts, and which need the chain's own currency for gas.
`rodeo site prepare` does this and the rest.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.markup import escape

from deploy import contracts
from deploy.gas_money import purses
from rodeo import wallets
from rodeo.chain import ChainUnavailable
from rodeo.chain.client import connect
from rodeo.cli.common import console, reports_errors
from rodeo.config import Site


@reports_errors
def run(site: Site) -> None:
    """Raises WalletError without a passphrase."""
    wallets.make_missing(site)
    # Whole lines, however narrow the terminal: people copy the addresses.
    for line in (*_wallets(site), *_devices(site)):
        console.print(escape(line), highlight=False, soft_wrap=True)


def _wallets(site: Site) -> list[str]:
    w3 = connect(site.chain.url)
    try:
        return [str(purse) for purse in purses(site, w3, contracts.recorded(site, w3))]
    except ChainUnavailable:
        found = [
            f"{wallets.address(site, name)} {name}: sends transactions" for name in wallets.wallet_names(site)
        ]
        return [*found, f"no node answers at {site.chain.url}: what they hold for gas is not known"]


def _devices(site: Site) -> list[str]:
    return [f"{wallets.address(site, name)} {name}: signs evidence" for name in wallets.device_names(site)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="wallets", description=__doc__)
    parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
    run(Site.load(parser.parse_args().site))
