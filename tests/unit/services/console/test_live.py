"""The console asks the bridge while somebody looks."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus
from rodeo.ros2 import types, wire
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, wait_until
from services.console import glance as glance_module
from services.console.live import Live
from services.robot_sim.messages import planar_pose, pose_stamped
from tests.support.site import LAB

SEEN_M = 1.5
EVENT = {
    "name": "Transfer",
    "block": 1,
    "log_index": 1,
    "tx_hash": "0x",
    "time_s": 1.0,
    "task_id": None,
    "args": {},
}


class Bridge:
    """Answers as the bridge of an organization in which nothing is."""

    def __init__(self) -> None:
        self.asked = 0
        """How often all of it was asked."""

    def tasks(self, *_args: object, **_options: object) -> tuple[list[Any], int]:
        return [], 0

    def ask(self, query: Any, **_options: object) -> SimpleNamespace:
        self.asked += query.what == "organization"
        return SimpleNamespace(
            wallets=[], supply_iec=Decimal(0), services=[], things=[], delay_s=0.0, kinds=[]
        )


class Following:
    """`Live` in an event loop of its own."""

    def __init__(self, bus: Bus, site: Site) -> None:
        self.bridge, self._bus, self._site = Bridge(), bus, site
        self.live = Live(bus, site, self.bridge)  # type: ignore[arg-type]
        self._heard = 0
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()

    @contextmanager
    def running(self) -> Iterator[None]:
        thread = threading.Thread(target=lambda: self._loop.run_until_complete(self._run()))
        thread.start()
        try:
            yield
        finally:
            self._loop.call_soon_threadsafe(self._ended.set)
            thread.join()
            self._loop.close()

    async def _run(self) -> None:
        running = asyncio.create_task(self.live.run())
        await self._ended.wait()
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running

    def look(self) -> None:
        """Somebody opens a page."""
        asyncio.run_coroutine_threadsafe(self.live.glance.current(), self._loop).result()

    def listen(self, what: str = "clock") -> Callable[[], None]:
        """Somebody listens to `what`; a page, which stays open, to the clock. Returns what ends it."""

        async def listen() -> Callable[[], None]:
            return self.live.listen(what, lambda: None)

        return asyncio.run_coroutine_threadsafe(listen(), self._loop).result()

    def see(self, item: str, asked: Callable[[], Any] | None = None) -> dict[str, Any]:
        """Motion capture sees an item; what the map says of it."""
        name, typename = topics.MOCAP_POSE.name(body=item), topics.MOCAP_POSE.type
        said = types.serialize(pose_stamped(0, planar_pose(SEEN_M, 0.0, 0.0)))
        self._bus.session.put(wire.data_key(self._site.bus.domain_id, name, typename), said)
        seen = self.live.map if asked is None else asked()
        found: dict[str, Any] = seen["items"].get(item, {})
        return found

    def happen(self, count: int) -> None:
        """So many events, one after the other."""
        for _ in range(count):
            self._heard += 1
            event = DaoEvent.model_validate(EVENT | {"seq": self._heard})
            wait_until(lambda event=event: self._told(event))

    def _told(self, event: DaoEvent) -> bool:
        # Again and again: it may not listen yet.
        self._bus.put_json(topics.EVENT.name(org=self._site.org, event=event.name), event)
        return len(self.live.events) == event.seq


@pytest.fixture
def following(connect: Callable[[], zenoh.Session], monkeypatch: pytest.MonkeyPatch) -> Iterator[Following]:
    monkeypatch.setattr(glance_module, "_ASKED_S", HANG_S)  # no look gives up because the machine is slow
    with Bus(connect()) as bus:
        following = Following(bus, Site.load(LAB))
        with following.running():
            yield following


def test_nobody_is_asked_before_somebody_looks(following: Following) -> None:
    following.happen(3)
    assert following.bridge.asked == 0
    assert following.live.summary.problem
    following.look()
    assert following.bridge.asked == 1
    assert not following.live.summary.problem


def test_a_program_that_follows_events_has_the_bridge_asked_nothing(following: Following) -> None:
    following.listen("events")
    following.happen(3)
    assert following.bridge.asked == 0


def test_where_something_was_last_seen_is_not_shown_as_where_it_is(following: Following) -> None:
    leave = following.listen("map")
    item = Site.load(LAB).items[0].id
    wait_until(lambda: following.see(item).get("fresh"))
    leave()
    wait_until(lambda: not following.live.map["items"][item]["fresh"])
    assert following.live.map["items"][item]["x"] == SEEN_M
    # A program that asks for it has it kept.
    wait_until(lambda: following.see(item, following.live.asked_map).get("fresh"))


def test_an_open_page_hears_of_each_change(following: Following) -> None:
    following.listen()
    following.look()
    for _ in range(3):
        before = following.bridge.asked
        following.happen(1)
        wait_until(lambda before=before: following.bridge.asked > before)


def test_who_looks_again_later_is_shown_nothing_old(
    following: Following, monkeypatch: pytest.MonkeyPatch
) -> None:
    following.look()
    monkeypatch.setattr(glance_module, "_LEFT_S", 0.0)
    following.happen(1)
    wait_until(lambda: following.live.summary.problem)
    before = following.bridge.asked
    following.happen(3)
    assert following.bridge.asked == before
    monkeypatch.undo()
    following.look()
    assert following.bridge.asked > before
    assert not following.live.summary.problem
