"""All that a site needs before its processes start, on any chain: keys, certificates, gas money, contracts.

A step that is done already is reported and skipped, so the command may be repeated at any time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from web3 import Web3

from deploy import contracts
from deploy.certificates import ensure_certificates
from deploy.contracts import WithoutGasMoney
from deploy.gas_money import purses
from deploy.launcher import Launcher
from rodeo.chain.client import connect, require_chain
from rodeo.chain.node.errors import ChainUnavailable
from rodeo.chain.node.translation import translated
from rodeo.kinds import kinds_of
from rodeo.signing import keystores, wallets
from rodeo.site.config import Site
from rodeo.site.tls import wants_certificates

Say = Callable[[str], object]
_LOOK_S = 2.0
"""Between two looks for money that was sent (wall time)."""


def prepare(path: Path, say: Say, stop: threading.Event, wait: bool = False) -> None:
    """Do what is missing for the site at `path`; `say` gets a sentence for each step.

    `wait`: where wallets need gas money, wait until they have it. Raises WithoutGasMoney otherwise, and
    ConfigError, WalletError, OtherRelease, ChainError: nothing is done on another chain than the site file
    names.
    """
    site = Site.load(path)
    kinds_of(site)  # what cannot be judged is refused before anything is made
    elsewhere = site.chain.backend == "external"
    folder = site.data_dir / "keys"
    made = wallets.make_missing(site) if elsewhere else wallets.ensure_wallets(site)
    say(
        f"keystores: generated {', '.join(made)} in {folder}"
        if made
        else f"keystores: all present in {folder}"
    )
    if wants_certificates(site):
        given = ensure_certificates(site)
        say(f"certificates: generated for {', '.join(given)}" if given else "certificates: all present")
    else:
        say("certificates: not needed for this bus")
    w3 = connect(site.chain.url)
    with _node(site, path, w3, say):
        if not contracts.wait_for_node(site, w3, stop, lambda text: say(f"chain: {text}")):
            return
        require_chain(w3, site.chain)
        with translated():
            say(f"chain: {site.chain.id}, at block {w3.eth.block_number}, at {site.chain.shown_url}")
        if elsewhere:
            _await_gas_money(site, w3, say, stop, wait)
        contracts.run(site, stop, lambda text: say(f"contracts: {text}"))
    if not stop.is_set():
        say(f"the site is prepared: `rodeo up --site {path}` starts it")


@contextmanager
def _node(site: Site, path: Path, w3: Web3, say: Say) -> Iterator[None]:
    """A local chain that does not run is started meanwhile."""
    if site.chain.backend == "external" or _answers(w3):
        yield
        return
    say("chain: running the local chain until this command ends")
    with Launcher(path, ("chain",)):
        yield


def _answers(w3: Web3) -> bool:
    try:
        with translated():
            return w3.eth.chain_id > 0
    except ChainUnavailable:
        return False


def _await_gas_money(site: Site, w3: Web3, say: Say, stop: threading.Event, wait: bool) -> None:
    deployed, senders = contracts.recorded(site, w3), keystores.sender_names(site)
    said: dict[str, str] = {}
    while True:
        found = list(purses(site, w3, deployed))
        for purse in found:
            if said.get(purse.name) != str(purse):
                said[purse.name] = str(purse)
                others = purse.name not in senders and not purse.funded
                say(f"gas money: {purse}" + (" (not needed if others send for it)" if others else ""))
        empty = [purse.name for purse in found if not purse.funded and purse.name in senders]
        if not empty:
            return
        if not wait:
            raise WithoutGasMoney(
                f"{', '.join(empty)} cannot pay for gas yet: send the amounts above in the chain's native "
                "currency, then run this command again, or wait for the money with --wait"
            )
        if stop.wait(_LOOK_S):
            return
