"""The contracts' events as a stream of server-sent events, which continues where a client stopped reading.

Each client reads at its own pace: it holds a place in the sequence and no queue. The newest events come from
memory, older ones from the bridge's index, for two clients at a time.
"""

from __future__ import annotations

import asyncio
import hashlib
import re
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from fastapi.sse import ServerSentEvent

from rodeo.access.errors import NotLoggedIn
from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent
from rodeo.errors import BusError, RemoteError
from services.console.errors import InvalidEventId, TooManyStreams, UnknownEventId
from services.console.pages.frame import Console

STREAM_S = 240.0
"""Wall time after which a stream ends and its client resumes: before the server cuts the connection."""
CHECK_S = 5.0
"""Wall time after which a token that was revoked reads nothing more."""
STREAMS_OF_ONE, STREAMS = 8, 64
"""At the same time: of one account, and of all."""
_PAGE = 500
_RETRY_S = 2.0
_ID = re.compile(r"([0-9a-f]{8})-(\d{1,18})-([0-9a-f]{8})")
_NOTHING_YET = "0" * 8


@dataclass(frozen=True)
class Place:
    """After one event of one chain: the id of a server-sent event."""

    chain: str
    """Beginning of its genesis hash."""
    seq: int
    mark: str
    """The event's own: after a reorganization an index that was built anew may count others."""

    @classmethod
    def after(cls, event: DaoEvent) -> Place:
        said = f"{event.tx_hash} {event.log_index} {event.name}"
        return cls(_short(event.chain), event.seq, hashlib.sha256(said.encode()).hexdigest()[:8])

    @classmethod
    def parse(cls, text: str) -> Place:
        """Raises InvalidEventId."""
        found = _ID.fullmatch(text)
        if found is None:
            raise InvalidEventId("this is no id of an event: send one as it came, or none", id=text[:100])
        return cls(found[1], int(found[2]), found[3])

    def __str__(self) -> str:
        return f"{self.chain}-{self.seq}-{self.mark}"


class Streams:
    """All streams of the console. They belong to the event loop."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._open: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._asking = asyncio.Semaphore(2)

    @contextmanager
    def admitted(self, account: str) -> Iterator[None]:
        """While one more stream of this account is open. Raises TooManyStreams."""
        with self._lock:
            own = self._open[account] >= STREAMS_OF_ONE
            if own or self._open.total() >= STREAMS:
                raise TooManyStreams(
                    "your account reads too many streams of events: close one"
                    if own
                    else "too many streams of events are read at the moment: try again later",
                    open=self._open[account],
                    limit=STREAMS_OF_ONE if own else STREAMS,
                )
            self._open[account] += 1
        try:
            yield
        finally:
            with self._lock:
                self._open[account] -= 1

    async def start(self, last_id: str | None, after: int | None) -> Place:
        """The place that a client names, or that of the newest event. Raises InvalidEventId, UnknownEventId
        and the bridge's errors."""
        named = None if last_id is None else Place.parse(last_id)
        async with self._asking:
            return await asyncio.to_thread(self._start, named, after)

    def _start(self, named: Place | None, after: int | None) -> Place:
        if named is not None:
            self._page(named, 1)
            return named
        newest = self._ask(2**63 - 1, 1)
        seq = newest.last_seq if after is None else after
        if seq == 0:
            return Place(_short(newest.chain), 0, _NOTHING_YET)
        at = self._ask(seq - 1, 1).events
        if not at:
            raise UnknownEventId("there is no event of this number yet", seq=seq, last_seq=newest.last_seq)
        return Place.after(at[0])

    async def follow(
        self, place: Place, wanted: Callable[[DaoEvent], bool], allowed: Callable[[], object]
    ) -> AsyncIterator[ServerSentEvent]:
        """Everything wanted after `place`, until `STREAM_S` or until `allowed` raises NotLoggedIn."""
        changed = asyncio.Event()
        leave = self._console.live.listen("events", changed.set)
        ends_s, check_s = time.monotonic() + STREAM_S, 0.0
        try:
            # A client that has read no event yet resumes from here.
            yield ServerSentEvent(id=str(place), retry=1000)
            while (now_s := time.monotonic()) < ends_s:
                changed.clear()
                if now_s >= check_s:
                    allowed()
                    check_s = now_s + CHECK_S
                try:
                    found = await self._after(place)
                except (BusError, RemoteError) as error:
                    yield ServerSentEvent(comment=f"{error.code}: the bridge is asked again")
                    await asyncio.sleep(_RETRY_S)
                    continue
                for event in found:
                    place = Place.after(event)
                    if wanted(event):
                        yield ServerSentEvent(
                            id=str(place), event=event.name, raw_data=event.model_dump_json()
                        )
                if found and not wanted(found[-1]):
                    # Else a client of few events would have all the others read again when it resumes.
                    yield ServerSentEvent(id=str(place))
                if not found:
                    with suppress(TimeoutError):
                        await asyncio.wait_for(changed.wait(), min(check_s, ends_s) - now_s)
        except (NotLoggedIn, UnknownEventId):
            return  # the client resumes, and learns why not
        finally:
            leave()

    async def _after(self, place: Place) -> list[DaoEvent]:
        """What came next. Raises UnknownEventId when another chain or another sequence has begun."""
        found: list[DaoEvent] = []
        for event in reversed(self._console.live.events):
            if event.chain and _short(event.chain) != place.chain:
                break
            if event.seq <= place.seq:
                if event.seq == place.seq:
                    _require(event, place)
                    return found[::-1]
                if not found:
                    return []  # the console itself is still catching up
                break
            found.append(event)
        if place.seq == 0 and found and found[-1].seq == 1:
            return found[::-1]
        if not self._console.live.events:
            return []
        async with self._asking:
            return await asyncio.to_thread(self._page, place)

    def _page(self, place: Place, limit: int = _PAGE) -> list[DaoEvent]:
        """From the index. Raises UnknownEventId."""
        answer = self._ask(max(0, place.seq - 1), limit)
        if _short(answer.chain) != place.chain:
            raise _unknown("this id is of another chain, whose events are gone", place, chain=answer.chain)
        if place.seq == 0:
            return answer.events
        if not answer.events:
            away = "this id is of an event that is not there yet, or no more"
            raise _unknown(away, place, last_seq=answer.last_seq)
        _require(answer.events[0], place)
        return answer.events[1:]

    def _ask(self, after: int, limit: int) -> queries.Events:
        return self._console.queries.ask(queries.EVENTS, after=after, limit=limit)


def _require(event: DaoEvent, place: Place) -> None:
    """Raises UnknownEventId unless the client has seen this event under this number."""
    if Place.after(event) != place:
        other = "another event has this number now, because the index was built anew"
        raise _unknown(other, place, seq=event.seq)


def _unknown(why: str, place: Place, **more: Any) -> UnknownEventId:
    return UnknownEventId(f"{why}: begin without an id", id=str(place), **more)


def _short(chain: str) -> str:
    return chain.removeprefix("0x")[:8].rjust(8, "0")
