"""Whether the journal holds what its wallets have sent.

A journal that was deleted, emptied or restored from an older copy forgets which requests were carried out:
repeated, they would be carried out twice. The chain counts each wallet's transactions; the deployment record
says how many of them no bridge has sent. A wallet that also works for another organization sends transactions
that neither of the two knows of, so those of a shared wallet are not counted.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path

from rodeo.chain.node.errors import ChainError, ChainUnavailable
from rodeo.host.files import set_aside
from rodeo.site.config import Site
from rodeo.site.names import BRIDGE
from services.bridge.database import damage
from services.bridge.errors import JournalDamaged, JournalIncomplete, JournalUnwritable
from services.bridge.journal import Accounted, Journal
from services.bridge.node import Node

log = logging.getLogger(__name__)

_GIVEN_UP = "given-up"


def give_up_journal(site: Site, bridge: str = BRIDGE) -> None:
    """Allow a bridge of the site (`bridge`, the process) to continue with a journal that lacks transactions
    sent before, when it opens it next."""
    folder = site.data_dir / bridge
    folder.mkdir(parents=True, exist_ok=True)
    _order(folder).touch()


def _order(folder: Path) -> Path:
    return folder / "new-journal"


def open_journal(
    path: Path,
    folder: Path,
    node: Node,
    addresses: Mapping[str, str],
    sent: Mapping[str, int],
    shared: Collection[str] = (),
) -> Journal:
    """The journal at `path` of the bridge whose data is in `folder`, whole or given up by order.

    `addresses`: name -> address of each wallet that it is to answer for. `sent`: address -> transactions that
    no bridge has sent (`Deployment.sent`). `shared`: names of wallets that others send with as well; their
    transactions are not counted. Raises JournalDamaged, JournalIncomplete and ChainUnavailable.
    """
    ordered = _order(folder).exists()
    try:
        journal = Journal(path)
    except JournalDamaged as error:
        if not ordered:
            raise
        log.warning("kept the damaged journal in %s: %s", set_aside(path, _GIVEN_UP), error)
        for suffix in ("-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        journal = Journal(path)
    try:
        _require_whole(journal, path, node, addresses, sent, shared, ordered)
    except BaseException:
        journal.close()
        raise
    _order(folder).unlink(missing_ok=True)
    return journal


def _require_whole(
    journal: Journal,
    path: Path,
    node: Node,
    addresses: Mapping[str, str],
    sent: Mapping[str, int],
    shared: Collection[str],
    ordered: bool,
) -> None:
    counts, unknown = _counts(node, addresses)
    if unknown is not None:
        raise ChainUnavailable("the node does not report a wallet's transaction count", reason=str(unknown))
    missing = _missing(journal, counts, addresses, sent)
    if missing:
        _take_over(journal, path, missing)
        missing = _missing(journal, counts, addresses, sent)
    if elsewhere := {name: missing.pop(name) for name in shared if name in missing}:
        log.info("shared wallets have sent transactions that the journal lacks: %s", elsewhere)
    if missing and not ordered:
        raise JournalIncomplete(
            f"the journal lacks {sum(missing.values())} transactions that its wallets have sent. Either it "
            "was "
            "deleted, emptied or replaced by an older copy, or somebody used the wallets without this "
            "bridge. "
            "Restore the newest copy. Or wait until no transaction of the wallets is pending, and continue "
            "with `rodeo up --new-journal`; the bridge then treats old request_ids as new. If a wallet also "
            "works for another organization, list it in bridge.shared_wallets",
            path=str(path),
            missing=missing,
        )
    if missing:
        log.warning("continuing without earlier transactions, as ordered by --new-journal: %s", missing)
    journal.account_for({name: _accounted(count, addresses[name], sent) for name, count in counts.items()})


def _missing(
    journal: Journal, counts: Mapping[str, int], addresses: Mapping[str, str], sent: Mapping[str, int]
) -> dict[str, int]:
    """Wallet -> number of its transactions that the journal lacks, where there are any."""
    noted, newest = journal.accounted(), journal.newest_nonces()
    missing: dict[str, int] = {}
    for name, count in counts.items():
        without = sent.get(addresses[name])
        if (before := noted.get(name)) is not None:
            added = max(0, (without or 0) - before.sent_without)
            known = max(before.nonce, newest.get(name, -1) + 1) + added
        elif without is None:
            known = count  # of a wallet that joined later
        else:
            known = max(without, newest.get(name, -1) + 1)
        if count > known:
            missing[name] = count - known
    return missing


def _take_over(journal: Journal, path: Path, wallets: Iterable[str]) -> None:
    """Copy what other bridges of this site have sent for the wallets, if their journals are in the same data
    folder."""
    for other_path in sorted(path.parents[2].glob(f"*/{path.parent.name}/{path.name}")):
        if other_path == path or damage(other_path) is not None:
            continue
        other = Journal(other_path)
        for name in wallets:
            if taken := journal.take_over(other, name):
                log.info("took over %d transactions of %s from %s", taken, name, other_path)
        other.close()


class Continuity:
    """Notes what wallets send without the bridge while it runs, so that it is not missed later."""

    def __init__(
        self, journal: Journal, node: Node, addresses: Mapping[str, str], sent: Mapping[str, int]
    ) -> None:
        self._journal = journal
        self._node = node
        self._addresses = addresses
        self._sent = sent
        self._seen: dict[str, int] = {}

    def note(self, waiting: Callable[[str], int]) -> None:
        """`waiting` returns how many transactions of a wallet the bridge itself has on their way."""
        idle = {name: address for name, address in self._addresses.items() if not waiting(name)}
        try:
            counts, unknown = _counts(self._node, idle)
            if unknown is not None:
                log.info("cannot count yet what some wallets sent without the bridge: %s", unknown)
            new = {name: count for name, count in counts.items() if count > self._seen.get(name, -1)}
            if not new:
                return
            # Read after the counts: the bridge's transactions are in the journal before they are sent.
            newest = self._journal.newest_nonces()
            others = {name: count for name, count in new.items() if count > newest.get(name, -1) + 1}
            self._journal.account_for(
                {name: _accounted(count, idle[name], self._sent) for name, count in others.items()}
            )
            self._seen |= new
        except (ChainUnavailable, JournalUnwritable) as error:
            log.debug("cannot count yet what the wallets sent without the bridge: %s", error)


def _accounted(count: int, address: str, sent: Mapping[str, int]) -> Accounted:
    return Accounted(nonce=count, sent_without=sent.get(address, 0))


def _counts(node: Node, addresses: Mapping[str, str]) -> tuple[dict[str, int], ChainError | None]:
    """Name -> mined transactions of the wallet, and why the node does not report one of them. Raises
    ChainUnavailable."""
    names = list(addresses)
    answers = node.batch([("eth_getTransactionCount", [addresses[name], "latest"]) for name in names])
    unknown = next((answer for answer in answers if isinstance(answer, ChainError)), None)
    told = zip(names, answers, strict=True)
    return {name: int(answer, 16) for name, answer in told if not isinstance(answer, ChainError)}, unknown
