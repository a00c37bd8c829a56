"""Once a day: the log of what a device signed into the store, and its root on chain."""

from __future__ import annotations

import logging
import threading

from rodeo.bus import queries
from rodeo.commands.devices import PostRoot
from rodeo.dao import Participant
from rodeo.errors import BusError, DiskFull, RemoteError
from rodeo.evidence.errors import BadStatement, EvidenceError
from rodeo.evidence.store import Store
from rodeo.site.config import Site
from rodeo.witness.days import Unposted, day_of
from rodeo.witness.witness import Witness

log = logging.getLogger(__name__)

_LOOK_WALL_S = 5.0
"""Between two looks for a day that is over."""
_RETRY_WALL_S = 60.0
"""After a failure."""
_AFTER_MIDNIGHT_S = 5.0
"""Site time: a statement may be signed a moment after its `time_s`."""


class DailyRoots:
    """Posts for `witness`, from a thread of its own, as `participant`: the device's owner or an operator.

    A day is over when the device signed something on a later one, or when the chain's time is past it. While
    bridge or store are away it waits; nothing is posted twice, because the chain takes one root a day.
    """

    def __init__(self, site: Site, participant: Participant, witness: Witness) -> None:
        self._site = site
        self._participant = participant
        self._witness = witness
        self._closed = threading.Event()
        self._said: str | None = None
        self._given_up: set[Unposted] = set()
        self._thread = threading.Thread(target=self._run, name=f"roots {witness.device}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop posting; what is not posted is at the next start."""
        self._closed.set()

    def post_due(self) -> None:
        """Post every day that is over.

        Raises BusError, RemoteError, EvidenceError and OSError while that cannot be done.
        """
        unposted = self._witness.days.unposted()
        if not unposted:
            return
        today = max(unposted[-1].day, day_of(self._chain_s() - _AFTER_MIDNIGHT_S))
        for one in unposted:
            if one.day < today and one not in self._given_up:
                self._post(one)

    def _run(self) -> None:
        pause_s = _LOOK_WALL_S
        while not self._closed.wait(pause_s):
            try:
                self.post_due()
                self._said, pause_s = None, _LOOK_WALL_S
            except (BusError, RemoteError, EvidenceError, OSError, DiskFull) as error:
                pause_s = _RETRY_WALL_S
                if self._said != str(error):
                    self._said = str(error)
                    log.warning("cannot post a daily root yet: %s", error)

    def _chain_s(self) -> float:
        """Time of the newest block, which is behind the site's; 0 while nobody tells."""
        try:
            return self._participant.ask(queries.CHAIN).time_s
        except (BusError, RemoteError) as error:
            log.debug("cannot read the chain's time: %s", error)
            return 0.0

    def _post(self, one: Unposted) -> None:
        try:
            signed = self._witness.day_log(one)
        except BadStatement as error:
            log.error("cannot post the log of day %d: %s", one.day, error)
            self._given_up.add(one)
            return
        if signed is None:
            return
        uri, root = Store(self._site).put_bytes(signed.model_dump_json().encode(), ".json")
        request = PostRoot(
            request_id=f"root-{one.address}-{one.day}",
            device=one.address,
            day=one.day,
            root=root,
            uri=uri,
        )
        try:
            self._participant.command("post_root", request)
        except RemoteError as error:
            if error.code != "root_already_posted":
                raise
            found = self._posted(one)
            if found != root:
                log.error("somebody posted another root of day %d for %s: %s", one.day, one.address, found)
        self._witness.days.posted(one)
        log.info("the root of day %d is on chain: %s", one.day, root)

    def _posted(self, one: Unposted) -> str | None:
        posted = self._participant.ask(queries.ROOTS, device=one.address).roots
        return next((root.root for root in posted if root.day == one.day), None)
