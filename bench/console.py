"""How quickly a page of the console is there, how soon it shows an event, what twenty open browsers cost.

Router, chain, bridge and console run as processes; Chromium is real, and a robot circles on the bus.
"""

from __future__ import annotations

import math
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page

from rodeo import topics
from rodeo.clock import WallClock
from rodeo.messages import DaoEvent
from rodeo.ros2 import Node, types
from services.console.accounts import Accounts, accounts_path
from services.console.roles import Role
from tests.support.browser import chromium
from tests.support.dao import Dao
from tests.support.site import RunningSite, write_site

PASSPHRASE = "correct horse battery"
LOADS = 7
EVENTS = 40
BROWSERS = 20
CPU_S = 20.0
_POSE_S = 0.02

_WATCH = """() => { window.seen = {}; new MutationObserver(() => {
  for (const link of document.querySelectorAll('a[href^="/tasks/"]'))
    window.seen[link.getAttribute('href')] ??= Date.now();
}).observe(document.body, {childList: true, subtree: true, characterData: true}); }"""


def run() -> dict[str, float]:
    """`console_interactive_ms` (median, from asking to a page that answers clicks),
    `console_event_to_page_p50_ms` and `_p95_ms` (from the event on the bus to the text in the page),
    `console_cpu_20_browsers` (cores of the console's process while a robot moves on 20 open overviews)."""
    with tempfile.TemporaryDirectory() as folder:
        running = RunningSite(write_site(Path(folder)))
        dao = Dao(running)
        try:
            dao.start()
            running.start("console")
            origin = str(running.status("console").details["http"])
            accounts = Accounts(accounts_path(running.site), running.site.console)
            accounts.add_user("ada", PASSPHRASE, [Role.OPERATOR])
            with chromium() as browser, _circling_robot(running):
                page = _logged_in(browser, origin)
                figures = {"console_interactive_ms": _interactive_ms(page)}
                figures |= _event_to_page_ms(page, running, dao)
                figures["console_cpu_20_browsers"] = _cpu(page, running)
            return figures
        finally:
            dao.stop()
            running.stop()


def _logged_in(browser: Browser, origin: str) -> Page:
    page = browser.new_context(base_url=origin).new_page()
    page.set_default_timeout(60_000)
    page.goto("/")
    page.get_by_label("Name").fill("ada")
    page.get_by_label("Passphrase").fill(PASSPHRASE)
    page.get_by_role("button", name="Log in").click()
    _wait_interactive(page)
    return page


def _wait_interactive(page: Page) -> None:
    """Drawn, and its websocket has shaken hands."""
    page.locator(".page h1").wait_for()
    page.wait_for_function("window.did_handshake === true")


def _interactive_ms(page: Page) -> float:
    took_ms = []
    for _ in range(LOADS):
        started_s = time.perf_counter()
        page.goto("/")
        _wait_interactive(page)
        took_ms.append((time.perf_counter() - started_s) * 1e3)
    return statistics.median(took_ms)


def _event_to_page_ms(page: Page, running: RunningSite, dao: Dao) -> dict[str, float]:
    published_ms: dict[str, float] = {}

    def on_event(_key: str, data: dict[str, object]) -> None:
        event = DaoEvent.model_validate(data)
        published_ms[f"/tasks/{event.task_id}"] = time.time() * 1e3

    key = topics.EVENT.name(org=running.site.org, event="TaskRegistered")
    subscriber = running.bus.subscribe_json(key, on_event)
    page.evaluate(_WATCH)
    for _ in range(EVENTS):
        # Cancelled at once, so that the queue that the page shows stays short.
        task_id = dao.post(allow_wait=True)
        page.wait_for_function(f"window.seen['/tasks/{task_id}'] !== undefined")
        dao.command("organization", "cancel_task", task_id=task_id)
    subscriber.undeclare()
    seen_ms: dict[str, float] = page.evaluate("window.seen")
    took_ms = [seen_ms[path] - sent for path, sent in published_ms.items() if path in seen_ms]
    return {
        "console_event_to_page_p50_ms": statistics.median(took_ms),
        "console_event_to_page_p95_ms": statistics.quantiles(took_ms, n=20)[-1],
    }


def _cpu(first: Page, running: RunningSite) -> float:
    """Cores used by the console while the pages are open."""
    context = first.context
    pages = [first, *(context.new_page() for _ in range(BROWSERS - 1))]
    for page in pages:
        page.goto("/")
        _wait_interactive(page)
    pid = running.children["console"].pid
    before_s, started_s = _cpu_s(pid), time.monotonic()
    threading.Event().wait(CPU_S)
    return (_cpu_s(pid) - before_s) / (time.monotonic() - started_s)


def _cpu_s(pid: int) -> float:
    """User and system time of a process (proc(5), fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _circling_robot(running: RunningSite) -> Iterator[None]:
    """Motion capture of the site's first robot at 50 Hz, driving in a circle."""
    stop = threading.Event()
    node = Node(running.bus.session, "circling", "", running.site.bus.domain_id, WallClock())
    name = topics.MOCAP_POSE.name(body=running.site.robots[0].name)
    publisher = node.publisher(name, topics.MOCAP_POSE.type)

    def drive() -> None:
        pose = types.new("geometry_msgs/msg/PoseStamped")
        while not stop.wait(_POSE_S):
            angle = time.monotonic() / 3
            pose.pose.position.x, pose.pose.position.y = 3.5 + math.cos(angle), 1.5 + math.sin(angle)
            pose.pose.orientation.z, pose.pose.orientation.w = math.sin(angle / 2), math.cos(angle / 2)
            publisher.publish(pose)

    thread = threading.Thread(target=drive, name="circling", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        node.close()
