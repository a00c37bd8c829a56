"""The index of a bridge that does not run, read from a copy of its file: the bridge's own stays as it is."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import create_engine, select
from sqlalchemy.exc import DBAPIError

from rodeo.bus.messages import Task
from rodeo.bus.queries import Transaction
from rodeo.chain.deployment import Deployment
from rodeo.site.config import Site
from rodeo.site.names import BRIDGE
from services.bridge import schema
from services.bridge.errors import IndexUnusable
from services.bridge.index import NOWHERE, Index, sqlite_url
from services.bridge.names import Names
from services.bridge.queries import task_json, transaction_json
from services.bridge.reading import Page, Row

_PAGE_ROWS = 500


@contextmanager
def _copied(site: Site, deployment: Deployment) -> Iterator[Index]:
    """Raises IndexUnusable."""
    chain = f"{deployment.chain_id}-{deployment.genesis_hash[2:18]}"
    path = site.data_dir / BRIDGE / chain / "index.sqlite"
    if site.bridge.database is not None or not path.exists():
        raise IndexUnusable("the bridge does not run and left no index file here", path=str(path))
    with tempfile.TemporaryDirectory(prefix="rodeo-index-") as folder:
        for part in path.parent.glob("index.sqlite*"):
            if not part.name.endswith("-shm"):
                shutil.copy(part, folder)
        url = sqlite_url(Path(folder) / path.name)
        engine = create_engine(url)
        try:
            with engine.connect() as connection:
                found = connection.scalar(select(schema.cursor.c.version))
        except DBAPIError as error:
            raise IndexUnusable(
                "the index cannot be read", path=str(path), problem=str(error.orig)
            ) from error
        finally:
            engine.dispose()
        if found != schema.version():
            raise IndexUnusable(
                "another version wrote the index: start the site once, and it is made anew", path=str(path)
            )
        index = Index(
            url,
            deployment.chain_id,
            deployment.genesis_hash,
            deployment.contracts,
            currency=deployment.currency,
        )
        try:
            if index.position == NOWHERE:
                raise IndexUnusable("the index is of other contracts: start the site once", path=str(path))
            yield index
        finally:
            index.close()


def read(site: Site) -> tuple[list[Task], list[Transaction]]:
    """All tasks and transactions in the index, with the gas of those that somebody has asked for.

    Raises NotDeployed, IndexUnusable and WalletError.
    """
    deployment = Deployment.load(site.data_dir, site.chain.id)
    names = Names(site, deployment)
    with _copied(site, deployment) as index:
        return (
            [
                Task.model_validate(task_json(row, names, deployment.currency))
                for row in _all(lambda page: index.tasks.find({}, page, newest_first=False)[0])
            ],
            [
                Transaction.model_validate(transaction_json(row, names))
                for row in _all(lambda page: index.money.transactions(None, page)[0])
            ],
        )


def _all(rows: Callable[[Page], list[Row]]) -> Iterator[Row]:
    offset = 0
    while found := rows(Page(_PAGE_ROWS, offset)):
        yield from found
        offset += len(found)
