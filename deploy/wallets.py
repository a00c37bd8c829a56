"""Make the keystores that a site on a chain elsewhere lacks: `python -m deploy.wallets --site FILE`.

They are encrypted with `RODEO_KEYSTORE_PASSPHRASE`. A keystore that was brought along is kept (Web3 Secret
Storage, as `cast wallet` writes it). Prints the accounts, and which need the chain's own currency for gas.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.table import Table

from rodeo import wallets
from rodeo.cli.common import console, reports_errors
from rodeo.config import Site


@reports_errors
def run(site: Site) -> None:
    """Raises WalletError without a passphrase."""
    wallets.make_missing(site)
    table = Table("keystore", "address", "signs", box=None)
    for name in wallets.wallet_names(site):
        table.add_row(name, wallets.address(site, name), "transactions: needs gas money")
    for name in wallets.device_names(site):
        table.add_row(name, wallets.address(site, name), "evidence")
    console.print(table)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="wallets", description=__doc__)
    parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
    run(Site.load(parser.parse_args().site))
