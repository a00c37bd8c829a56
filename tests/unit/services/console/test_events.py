"""The stream of events: who was away misses none, and nobody holds up others."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from rodeo.access.accounts import User
from rodeo.access.errors import NotLoggedIn
from rodeo.bus.messages import DaoEvent
from rodeo.bus.queries import Events
from rodeo.errors import NoResponder
from rodeo.host.http import HttpServer
from rodeo_testing.waiting import HANG_S, wait_until
from services.console import events as events_module
from services.console.events import STREAM_S, STREAMS, STREAMS_OF_ONE
from services.console.process import LIMITS
from services.console.rest import make_api

CHAIN, OTHER = "0x" + "aa" * 32, "0x" + "bb" * 32


class Site:
    """The console's parts behind the stream: an index, and what of it is still in memory."""

    def __init__(self) -> None:
        self.chain = CHAIN
        self.index: list[DaoEvent] = []
        self.events: deque[DaoEvent] = deque(maxlen=5)
        self.tokens = {"ada", "bert"} | {f"user{number}" for number in range(20)}
        self.asked = self.rows = 0
        self.is_away = False
        self.listeners: list[Callable[[], None]] = []
        self.loop: asyncio.AbstractEventLoop | None = None

    # -- Console
    @property
    def console(self) -> Any:
        return SimpleNamespace(queries=self, live=self, accounts=self)

    def token_user(self, token: str) -> User:
        if token not in self.tokens:
            raise NotLoggedIn("revoked")
        return User(token, frozenset(), None, False)

    def ask(self, _query: Any, after: int, limit: int) -> Events:
        self.asked += 1
        if self.is_away:
            raise NoResponder("nobody answers")
        found = [one for one in self.index if one.seq > after][:limit]
        self.rows += len(found)
        return Events(events=found, last_seq=len(self.index), chain=self.chain)

    def listen(self, _what: str, listener: Callable[[], None]) -> Callable[[], None]:
        self.loop = asyncio.get_running_loop()
        self.listeners.append(listener)
        return lambda: self.listeners.remove(listener)

    # -- the chain
    def happen(self, *names: str, task_id: int | None = None, tx: str = "0x1") -> None:
        for name in names:
            seq = len(self.index) + 1
            event = DaoEvent(
                seq=seq,
                name=name,
                block=seq,
                log_index=0,
                tx_hash=tx,
                time_s=1.0,
                task_id=task_id,
                args={},
                chain=self.chain,
            )
            self.index.append(event)
            self.events.append(event)
        for listener in list(self.listeners):
            assert self.loop is not None
            self.loop.call_soon_threadsafe(listener)


@pytest.fixture
def site() -> Site:
    return Site()


@pytest.fixture
def client(site: Site) -> Iterator[httpx.Client]:
    api = FastAPI()
    api.mount("/api", make_api(site.console))
    with (
        HttpServer(api, "127.0.0.1", 0, "the console", LIMITS) as server,
        httpx.Client(base_url=f"{server.url}/api", timeout=HANG_S) as client,
    ):
        yield client


class Reader:
    """Reads a stream line by line, as any client does."""

    def __init__(
        self, client: httpx.Client, user: str = "ada", last: str | None = None, **query: Any
    ) -> None:
        headers = {"Authorization": f"Bearer {user}"} | ({} if last is None else {"Last-Event-ID": last})
        self._open = client.stream("GET", "/events", params=query, headers=headers)
        self.answer = self._open.__enter__()
        self.last = last
        if self.answer.status_code != 200:
            self.answer.read()
            return
        self._lines = self.answer.iter_lines()
        if last is None:
            self.take()

    def take(self) -> dict[str, str]:
        said: dict[str, str] = {}
        for line in self._lines:
            if not line:
                break
            key, _, value = line.partition(":")
            said[key] = value.strip()
        self.last = said.get("id", self.last)
        return said

    def read(self, count: int) -> list[str]:
        """Names of the next events."""
        found: list[str] = []
        while len(found) < count:
            said = self.take()
            if "data" in said:
                told = json.loads(said["data"])
                assert told["name"] == said["event"]
                found.append(f"{told['seq']} {told['name']}")
        return found

    def ends(self) -> bool:
        return not [line for line in self._lines if line.startswith("data")]

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_error: object) -> None:
        self._open.__exit__(None, None, None)


def problem(reader: Reader) -> tuple[int, str]:
    told = reader.answer.json()
    assert reader.answer.headers["content-type"] == "application/problem+json"
    return reader.answer.status_code, told["code"]


def test_events_come_as_they_happen_and_only_new_ones(site: Site, client: httpx.Client) -> None:
    site.happen("TaskRegistered")
    with Reader(client) as reader:
        assert reader.answer.headers["content-type"].startswith("text/event-stream")
        site.happen("TaskAssigned")
        site.happen("TaskSettled")
        assert reader.read(2) == ["2 TaskAssigned", "3 TaskSettled"]


def test_who_was_away_misses_none_and_gets_none_twice(site: Site, client: httpx.Client) -> None:
    with Reader(client) as reader:
        site.happen("A", "B")
        assert reader.read(1) == ["1 A"]
        last = reader.last
    site.happen(*"CDEFGHIJ")  # more than memory holds
    with Reader(client, last=last) as reader:
        assert reader.read(9) == ["2 B", *(f"{number} {name}" for number, name in enumerate("CDEFGHIJ", 3))]
        site.happen("K")
        assert reader.read(1) == ["11 K"]


def test_a_client_that_read_nothing_yet_resumes_from_where_it_began(site: Site, client: httpx.Client) -> None:
    with Reader(client) as reader:
        last = reader.last
    site.happen("A")
    with Reader(client, last=last) as reader:
        assert reader.read(1) == ["1 A"]
        last = reader.last
    with Reader(client) as later:
        assert later.last == last


def test_the_past_is_read_from_a_number_on_and_filtered(site: Site, client: httpx.Client) -> None:
    site.happen("A", "B", "C", task_id=7)
    site.happen("B", task_id=8)
    with Reader(client, after=0) as reader:
        assert reader.read(4) == ["1 A", "2 B", "3 C", "4 B"]
    with Reader(client, after=1, name="A,B") as reader:
        assert reader.read(2) == ["2 B", "4 B"]
    with Reader(client, after=0, name="B", task_id=8) as reader:
        assert reader.read(1) == ["4 B"]


def test_a_client_of_few_events_resumes_behind_all_that_it_did_not_want(
    site: Site, client: httpx.Client
) -> None:
    with Reader(client, name="Z") as reader:
        site.happen(*"ABCDEFGH")
        while not (reader.last or "").startswith("aaaaaaaa-8-"):
            assert "data" not in reader.take()
    rows = site.rows
    with Reader(client, last=reader.last, name="Z") as reader:
        site.happen("Z")
        assert reader.read(1) == ["9 Z"]
    assert site.rows - rows == 1  # that of its id


def test_an_id_of_another_chain_of_the_future_or_of_a_former_index_is_refused(
    site: Site, client: httpx.Client
) -> None:
    site.happen("A", "B")
    with Reader(client, after=0) as reader:
        reader.read(2)
        last = reader.last or ""
    changed = last[:-1] + ("1" if last.endswith("0") else "0")
    for wrong in (last.replace("aaaaaaaa", "bbbbbbbb"), last.replace("-2-", "-9-"), changed):
        with Reader(client, last=wrong) as reader:
            assert problem(reader) == (409, "unknown_event_id"), wrong
    for wrong in ("7", "", "x" * 200, f"{last}0"):
        with Reader(client, last=wrong) as reader:
            assert problem(reader) == (422, "invalid_event_id"), wrong
    with Reader(client, after=9) as reader:
        assert problem(reader) == (409, "unknown_event_id")
    # The index is built anew and counts another event as its second.
    del site.index[1]
    site.events.clear()
    site.happen("B", tx="0x2")
    with Reader(client, last=last) as reader:
        assert problem(reader) == (409, "unknown_event_id")


def test_a_stream_ends_when_another_chain_begins(site: Site, client: httpx.Client) -> None:
    site.happen("A")
    with Reader(client, after=0) as reader:
        assert reader.read(1) == ["1 A"]
        site.chain = OTHER
        site.index.clear()
        site.happen("A", "B")
        assert reader.ends()
        last = reader.last
    with Reader(client, last=last) as reader:
        assert problem(reader) == (409, "unknown_event_id")


def test_nobody_reads_without_a_token_and_a_revoked_one_reads_no_more(
    site: Site, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events_module, "CHECK_S", 0.05)
    assert client.get("/events").status_code == 401
    with Reader(client, user="mallory") as reader:
        assert problem(reader) == (401, "not_logged_in")
    with Reader(client) as reader:
        site.happen("A")
        assert reader.read(1) == ["1 A"]
        site.tokens.remove("ada")
        assert reader.ends()


def test_a_client_reads_few_streams_and_leaves_room_for_others(site: Site, client: httpx.Client) -> None:
    readers = [Reader(client) for _ in range(STREAMS_OF_ONE)]
    for _ in range(100):
        with Reader(client) as reader:
            assert problem(reader) == (429, "too_many_streams")
    with Reader(client, user="bert") as other:
        site.happen("A")
        assert other.read(1) == ["1 A"]
    readers[0].__exit__()

    def reads_again() -> bool:
        with Reader(client) as reader:
            return reader.answer.status_code == 200

    wait_until(reads_again)
    for reader in readers[1:]:
        reader.__exit__()


def test_all_together_read_a_bounded_number(site: Site) -> None:
    streams = events_module.Streams(site.console)
    held = [streams.admitted(f"user{number % 20}") for number in range(STREAMS)]
    for one in held:
        one.__enter__()
    with pytest.raises(events_module.TooManyStreams) as caught, streams.admitted("somebody"):
        raise AssertionError("admitted")
    assert caught.value.details == {"open": 0, "limit": STREAMS}
    held[0].__exit__(None, None, None)
    with streams.admitted("somebody"):
        return


def test_a_client_that_reads_nothing_holds_nobody_up(site: Site, client: httpx.Client) -> None:
    with Reader(client) as slow, Reader(client, user="bert") as quick:
        for number in range(20):
            site.happen(*["A" * 60_000] * 5)
            assert len(quick.read(5)) == 5, number
        assert len(slow.read(100)) == 100


def test_a_bridge_that_is_away_is_said_before_and_waited_for_within(
    site: Site, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events_module, "_RETRY_S", 0.02)
    site.is_away = True
    with Reader(client) as reader:
        assert problem(reader) == (503, "no_responder")
    site.is_away = False
    with Reader(client) as reader:
        site.is_away = True
        site.happen(*"ABCDEFGH")  # of which memory lacks the first
        asked = site.asked
        wait_until(lambda: site.asked > asked)
        site.is_away = False
        assert len(reader.read(8)) == 8


def test_a_stream_ends_in_time_and_goes_on(
    site: Site, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events_module, "STREAM_S", 0.05)
    assert LIMITS.request_s > STREAM_S
    with Reader(client) as reader:
        assert reader.ends()
        last = reader.last
    site.happen("A")
    with Reader(client, last=last) as reader:
        assert reader.read(1) == ["1 A"]
