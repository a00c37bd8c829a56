"""The oracles that vote, as the organization has them at present, and what each signs."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass

from rodeo.bus import queries
from rodeo.bus.messages import Vote
from rodeo.dao import Participant
from rodeo.errors import BusError, RemoteError
from rodeo.judging import votes
from rodeo.signing.keys import Signer
from rodeo.site.config import Site
from rodeo.site.names import votes_needed

log = logging.getLogger(__name__)

ASK_S = 5.0
"""Wall time after which the bridge is asked again who votes."""


@dataclass(frozen=True)
class Committee:
    """The voters, and the contract that they vote for."""

    chain_id: int
    address: str
    keys: Mapping[str, str]
    """Oracle -> address of its key."""
    needed: Mapping[str, int]
    """Kind -> how many of them have to agree."""
    panels: Mapping[str, tuple[int, int]]
    """Kind -> how many may vote at once, and the time after which one more may, s; 0 for never."""
    seats: Mapping[int, str]
    """Seat -> oracle."""
    unstaked: Mapping[str, frozenset[str]]
    """Kind -> oracles whose stake is too low. The contract refuses a set of votes with one of theirs in
    it."""

    @property
    def counted(self) -> tuple[Mapping[str, int], Mapping[str, frozenset[str]]]:
        """Facts that decide whether votes are enough."""
        return self.needed, self.unstaked


class Voters:
    """The committee that the bridge named last; signs with this oracle's key, `account`."""

    def __init__(self, site: Site, account: Signer, wallet: Participant) -> None:
        self._site, self._account, self._wallet = site, account, wallet
        self.known: Committee | None = None
        self._asked_s = -ASK_S

    def forget(self) -> None:
        """The chain is another one."""
        self.known, self._asked_s = None, -ASK_S

    def current(self) -> Committee | None:
        """The present voters. The bridge is asked once in ASK_S, however many votes strangers publish."""
        if time.monotonic() >= self._asked_s + ASK_S:
            try:
                self.ask()
            except (BusError, RemoteError) as error:
                log.warning("who votes cannot be learnt: %s", error)
        return self.known

    def ask(self) -> Committee:
        """Raises BusError, RemoteError."""
        self._asked_s = time.monotonic()
        chain = self._wallet.ask(queries.CHAIN)
        rules = self._wallet.ask(queries.ORGANIZATION)
        judges = {one.name: one for one in rules.judges if one.name is not None}
        voted = [one for one in rules.kinds if one.votes]
        self.known = Committee(
            chain.chain_id,
            chain.contracts.oracle_committee,
            keys={name: one.key for name, one in judges.items()},
            needed={one.kind: one.votes for one in voted},
            panels={one.kind: (one.panel, one.rotation_s) for one in voted},
            seats={one.seat: name for name, one in judges.items()},
            unstaked={
                one.kind: frozenset(
                    name for name, judge in judges.items() if judge.stake_iec < one.judge_stake_iec
                )
                for one in voted
            },
        )
        return self.known

    def needed(self, kind: str) -> int:
        """Votes needed, as last set: the organization may have changed it since the site was prepared."""
        said = None if self.known is None else self.known.needed.get(kind)
        return said or votes_needed(self._site, kind)

    def unstaked(self, kind: str) -> frozenset[str]:
        """Oracles whose votes on a task of this kind the contract refuses."""
        return frozenset() if self.known is None else self.known.unstaked.get(kind, frozenset())

    def sign(self, vote: Vote) -> str:
        """This oracle's signature. Raises BusError, RemoteError."""
        by = self.known or self.ask()
        return votes.sign(vote, self._account, by.chain_id, by.address, self._site.economy.currency)

    def signing_key(self, vote: Vote, signature: str) -> str | None:
        """Address of the key that signed it; None if it is nobody's, or the voters are not known."""
        if self.known is None:
            return None
        currency = self._site.economy.currency
        return votes.signer(vote, signature, self.known.chain_id, self.known.address, currency)
