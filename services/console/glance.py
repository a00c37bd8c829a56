"""The organization at a glance, kept for all pages while somebody looks."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.display.story import accounts
from rodeo.errors import BusError, RemoteError, RodeoError
from services.console.queries import Queries

SETTLE_S = 0.03
"""Wall time in which several events become one update."""
_ASKED_S = 1.0
"""Longest wall time for which a page waits for the bridge before it is drawn."""
_LEFT_S = 60.0
"""Wall time after which nobody looks any more: between two pages none is open."""
_NOT_YET = "The bridge has not answered yet"
_RETRY_S = 2.0
QUEUE_SHOWN = 8
VERDICTS_SHOWN = 6
_ENDED_ASKED = 30
_CASES_ASKED = 50
_PROPOSALS_ASKED = 20


@dataclass
class Summary:
    """The organization at a glance. `problem` says why the rest is not current."""

    problem: str = _NOT_YET
    counts: dict[str, int] = field(default_factory=dict)
    """Tasks by state."""
    queue: list[Task] = field(default_factory=list)
    verdicts: list[Task] = field(default_factory=list)
    wallets: list[queries.Wallet] = field(default_factory=list)
    services: list[queries.Offer] = field(default_factory=list)
    cases: list[Task] = field(default_factory=list)
    """Submitted and ruled tasks, the oldest first."""
    proposals: list[queries.Proposal] = field(default_factory=list)
    seen: list[queries.SeenThing] = field(default_factory=list)
    """What robots have seen on the floor and is neither dismissed nor gone."""
    organization: queries.Organization | None = None
    supply_iec: Decimal = Decimal(0)

    @property
    def rules(self) -> dict[str, list[str]]:
        """Kind -> hashes of the rules under which its tasks may be posted, the newest last."""
        kinds = [] if self.organization is None else self.organization.kinds
        return {one.kind: one.rules_sha256 for one in kinds}

    @property
    def names(self) -> dict[str, str]:
        """Account -> its name, where the site has one for it."""
        return {} if self.organization is None else accounts(self.organization, self.wallets)


class Glance:
    """Belongs to the event loop: `follow` there.

    Args:
        is_watched: whether a page is open.
        tell: called after each answer, with whether the summary's problem is another one.
    """

    def __init__(self, asked: Queries, is_watched: Callable[[], bool], tell: Callable[[bool], None]) -> None:
        self._queries, self._is_watched, self._tell = asked, is_watched, tell
        self.summary = Summary()
        self.changed, self.looks = asyncio.Event(), asyncio.Event()
        """Set when it may be old, and when somebody looks."""
        self._followed = asyncio.Event()
        self._looked_s = -math.inf
        """Wall (monotonic) time at which somebody opened a page last."""

    async def current(self) -> None:
        """Somebody opens a page: return when the summary is followed, or takes so long that the page has to
        say so."""
        self._looked_s = time.monotonic()
        self.looks.set()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._followed.wait(), _ASKED_S)

    async def follow(self) -> None:
        """Until it is cancelled."""
        while True:
            await self._somebody_looks()
            problem = self.summary.problem
            try:
                self.summary = await asyncio.to_thread(self._summarize)
            except (BusError, RemoteError) as error:
                # Known values stay, marked as not current.
                self.summary.problem = f"The bridge does not answer: {error.message}"
            except RodeoError as error:
                self.summary.problem = f"The bridge's answer cannot be read: {error.message}"
            self._followed.set()
            self._tell(self.summary.problem != problem)
            wait_s = _RETRY_S if self.summary.problem else None
            try:
                await asyncio.wait_for(self.changed.wait(), wait_s)
            except TimeoutError:
                continue
            await asyncio.sleep(SETTLE_S)
            self.changed.clear()

    async def _somebody_looks(self) -> None:
        """Wait while nobody does: nobody is asked for what nobody reads."""
        while not self._is_watched() and time.monotonic() - self._looked_s > _LEFT_S:
            self._followed.clear()
            self.summary.problem = _NOT_YET
            self.looks.clear()
            await self.looks.wait()
            self.changed.clear()

    def _summarize(self) -> Summary:
        counts: dict[str, int] = {}
        queue: list[Task] = []
        for state in ("ruled", "submitted", "assigned", "open"):
            found, counts[state] = self._queries.tasks(_CASES_ASKED, state=state, order="oldest")
            queue += found
        judged, counts["ended"] = self._queries.tasks(_ENDED_ASKED, state="settled,failed")
        _, counts["settled"] = self._queries.tasks(1, state="settled")
        judged.sort(key=lambda task: task.settled or task.proof_submitted or task.registered, reverse=True)
        wallets = self._queries.ask(queries.WALLETS)
        organization = self._queries.ask(queries.ORGANIZATION)
        # Where the administrator's key acts at once, nothing is proposed.
        asked = self._queries.ask(queries.PROPOSALS, limit=_PROPOSALS_ASKED) if organization.delay_s else None
        return Summary(
            problem="",
            counts=counts,
            queue=queue[:QUEUE_SHOWN],
            verdicts=judged[:VERDICTS_SHOWN],
            wallets=wallets.wallets,
            supply_iec=wallets.supply_iec,
            services=self._queries.ask(queries.SERVICES).services,
            cases=[one for one in queue if one.state in ("ruled", "submitted")],
            proposals=[] if asked is None else asked.proposals,
            seen=self._queries.ask(queries.SEEN).things,
            organization=organization,
        )
