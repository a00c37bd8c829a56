"""Errors of the bridge.

    RodeoError
    ├── RequestError
    │   ├── UnknownCommand        no such command
    │   ├── UnknownQuery          no such query
    │   ├── RequestIdReused       the same request_id with another content
    │   ├── FeeTooHigh            the chain asks for more than the wallet may pay
    │   ├── WalletElsewhere       the participant signs for itself: prepare and broadcast
    │   └── NotThisWallets        what is to be broadcast was signed by another key, or is for another chain
    ├── BridgeNotReady            no node, no contracts or not caught up yet; `reason` says which
    ├── IndexUnusable             the index's file is not a database
    ├── JournalDamaged            the journal's file is not what was written
    ├── JournalIncomplete         the journal lacks transactions that its wallets have sent
    ├── JournalUnwritable         the journal's file cannot be written now; what waits stays in the queue
    ├── TransactionDropped        the node forgot the transaction and used its nonce for another
    └── ChainReorganized          blocks that were indexed are not on the chain any more

What contracts refuse arrives as `rodeo.chain.ContractReverted`, under the code of its custom error.
"""

from __future__ import annotations

from rodeo.errors import RequestError, RodeoError


class UnknownCommand(RequestError):
    """There is no such command."""


class UnknownQuery(RequestError):
    """There is no such query."""


class RequestIdReused(RequestError):
    """The request_id was used before for a request with another content."""


class FeeTooHigh(RequestError):
    """The chain asks for more than the wallet's limits allow."""


class WalletElsewhere(RequestError):
    """The bridge has no key of this participant, which signs for itself: `prepare`, sign, `broadcast`."""


class NotThisWallets(RequestError):
    """What is to be broadcast was not signed by this participant's key for this chain and these contracts."""


class BridgeNotReady(RodeoError):
    """The bridge cannot answer now; asking again later may help."""


class IndexUnusable(RodeoError):
    """The index's file is not a database. Deleting it is safe: it is rebuilt from the chain."""


class JournalDamaged(RodeoError):
    """The journal's file was changed after it was written: it does not show what the wallets have sent."""

    restart_cures = False


class JournalIncomplete(RodeoError):
    """The journal lacks transactions of its wallets: it was deleted, or restored from an older copy. Their
    requests would be carried out a second time."""

    restart_cures = False


class JournalUnwritable(RodeoError):
    """The journal cannot be written now. Nothing is sent that it does not hold; what waits stays queued."""


class TransactionDropped(RodeoError):
    """The node forgot the transaction and its nonce went to another one. Nothing happened."""


class ChainReorganized(RodeoError):
    """Blocks that were indexed are not on the chain any more."""
