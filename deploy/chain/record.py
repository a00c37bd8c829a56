"""The local chain's place in the site: a new chain begins only if no record names an earlier one."""

from __future__ import annotations

import time
from pathlib import Path

from deploy.chain.errors import ChainLost
from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import NotDeployed
from rodeo.site.config import Site


def check_not_lost(site: Site, path: Path) -> None:
    """Raises ChainLost where a new chain would take the place of one that holds the site's contracts."""
    if path.exists() and path.stat().st_size:
        return
    try:
        record = Deployment.load(site.data_dir, site.chain.id)
    except NotDeployed:
        return
    raise ChainLost(
        "the chain file is empty or missing. It held all tasks and balances: restore it from a backup, or "
        "start a new chain with `rodeo up --new-chain`",
        path=str(path),
        record=str(Deployment.path(site.data_dir, site.chain.id)),
        genesis_hash=record.genesis_hash,
    )


def give_up_chain(site: Site) -> Path | None:
    """Put the record of the local chain aside, so that a new one may begin; where it lies now."""
    record = Deployment.path(site.data_dir, site.chain.id)
    if not record.exists():
        return None
    aside = record.with_name(f"{record.stem}-given-up-{int(time.time())}.json")
    return record.rename(aside)
