"""How quickly a page of the console is there, how soon it shows an event, what drawing and twenty open
browsers cost, and how quick pages and answers are with a hundred thousand tasks.

Router, chain, bridge and console run as processes; Chromium is real, and a robot circles on the bus.
"""

from __future__ import annotations

import math
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import httpx
from playwright.sync_api import Browser, Locator, Page

from bench import drawing, past
from bench.cpu import cpu_s
from rodeo.access.accounts import Accounts, accounts_path
from rodeo.access.roles import Role
from rodeo.bus.messages import DaoEvent
from rodeo.chain.deployment import Deployment
from rodeo.host.clock import WallClock
from rodeo.lab.geometry import quaternion_of
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.site.names import BRIDGE
from services.bridge.index import Index, sqlite_url
from tests.support.browser import chromium
from tests.support.dao import Dao, founded
from tests.support.page_figures import kept, latency_ms, measured, wait_seen
from tests.support.site import RunningSite, write_site

PASSPHRASE = "correct horse battery"
LOADS = 5
EVENTS = 40
BROWSERS = 20
CPU_S = 20.0
FIRST, TASKS = 1_001, 100_000
"""The number of the first task that the index is given, after those that were really posted, and how many."""
NEWEST = FIRST + TASKS - 1
_POSE_S = 0.02

_WATCH = """() => { window.seen = {}; new MutationObserver(() => {
  for (const link of document.querySelectorAll('a[href^="/tasks/"]'))
    window.seen[link.getAttribute('href')] ??= Date.now();
}).observe(document.body, {childList: true, subtree: true, characterData: true}); }"""

_COUNT = """() => { window.moves = 0; new MutationObserver(() => { window.moves += 1; }).observe(
  document.querySelector(".lab-map .robot .moving"), {attributes: true, attributeFilter: ["style"]}); }"""


def run() -> dict[str, float | None]:
    """`console_interactive_ms` (median, from asking to a page that answers clicks),
    `console_event_to_page_p50_ms` and `_p95_ms` (from the event on the bus to the text in the page),
    `console_cpu_20_browsers` (cores of the console's process, a robot moving on the overviews of 20 people
    who logged in) and `console_map_updates_per_s` (of the browser that drew fewest);
    with a hundred thousand tasks, medians from the click to what it asked for:
    `console_tasks100000_overview_ms`, `_list_ms` and `_treasury_ms` (from asking to a page that shows its
    rows), `_filter_ms`, `_search_ms` (with the 300 ms in which people continue typing) and `_next_page_ms`,
    `_event_to_page_p95_ms` on the overview, `_api_p95_ms`, of what pages ask for, and `_api_slowest_p95_ms`,
    of the slowest path; and what `bench.drawing` measures with 1 and 10 robots. A figure is None, and a line
    says why, where a page did not answer in time or was loaded again."""
    with _console(_robots(10)) as (running, _, origin), _circling_robots(running):
        figures = _drawing(origin, 10)
    with _console(_robots(1)) as (running, dao, origin):
        with _circling_robots(running):
            figures |= _drawing(origin, 1)
            with chromium(three_d=False) as browser:
                figures |= _with_few_tasks(_logged_in(browser, origin), running, dao)
        with chromium(three_d=False) as browser:
            figures |= _with_a_past(_logged_in(browser, origin), running, dao, origin)
    return figures


def _drawing(origin: str, robots: int) -> dict[str, float | None]:
    """What drawing costs the browser: of the map alone, and with the 3-D view beside it."""
    figures: dict[str, float | None] = {}
    for three_d in (False, True):
        with chromium(three_d) as browser:
            figures |= drawing.cost(_logged_in(browser, origin), robots, three_d)
    return figures


def _with_few_tasks(page: Page, running: RunningSite, dao: Dao) -> dict[str, float | None]:
    events = "console_event_to_page_p50_ms", "console_event_to_page_p95_ms"
    return (
        drawing.once(page)
        | measured(lambda: _interactive_ms(page), "console_interactive_ms")
        | measured(lambda: _event_to_page_ms(page, running, dao), *events)
        | measured(
            lambda: _many_browsers(page, running), "console_cpu_20_browsers", "console_map_updates_per_s"
        )
    )


def _with_a_past(page: Page, running: RunningSite, dao: Dao, origin: str) -> dict[str, float | None]:
    _take_in_a_past(running, dao)
    api = "console_tasks100000_api_p95_ms", "console_tasks100000_api_slowest_p95_ms"
    event = "console_tasks100000_event_to_page_p95_ms"
    return (
        _with_many_tasks(page)
        | measured(lambda: _event_to_overview_p95_ms(page, running, dao), event)
        | measured(lambda: _api_p95_ms(running, origin), *api)
    )


def _robots(robots: int) -> str:
    rows = [
        f'[[robots]]\nname = "panther{number}"\npose = {{ x_m = {0.1 + 1.4 * number:.1f}, y_m = 6.5 }}\n'
        for number in range(1, robots + 1)
    ]
    return "lab.size_m = [17.0, 8.0]\n" + "".join(rows)


def _take_in_a_past(running: RunningSite, dao: Dao) -> None:
    """Add tasks to the index; the chain knows of those that were posted."""
    deployment = Deployment.load(running.site.data_dir, running.site.chain.id)
    (database,) = (running.site.data_dir / BRIDGE).glob("*/index.sqlite")
    identity = deployment.chain_id, deployment.genesis_hash, deployment.contracts
    wallets = {one["name"]: one["address"] for one in dao.state("wallets")["wallets"]}
    with closing(Index(sqlite_url(database), *identity, currency=deployment.currency)) as index:
        robot = wallets[running.site.robots[0].name]
        past.take_in(index, database, FIRST, TASKS, wallets["organization"], robot)


def _api_p95_ms(running: RunningSite, origin: str) -> tuple[float, float]:
    accounts = Accounts(accounts_path(running.site), running.site.console)
    headers = {"Authorization": f"Bearer {accounts.issue_token('ada', 'bench')}"}
    with httpx.Client(base_url=f"{origin}/api", headers=headers, timeout=60) as client:
        return drawing.api_p95_ms(client, TASKS)


@contextmanager
def _console(extra: str) -> Iterator[tuple[RunningSite, Dao, str]]:
    """An organization with its console, and where that is."""
    with (
        tempfile.TemporaryDirectory() as folder,
        founded(write_site(Path(folder), extra=extra), "console") as dao,
    ):
        running = dao.running
        accounts = Accounts(accounts_path(running.site), running.site.console)
        accounts.add_user("ada", PASSPHRASE, [Role.OPERATOR])
        yield running, dao, str(running.status("console").details["http"])


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
    def open_page() -> None:
        page.goto("/")
        _wait_interactive(page)

    return _median_ms(open_page, lambda: None)


def _event_to_overview_p95_ms(page: Page, running: RunningSite, dao: Dao) -> float:
    # Not on the list: a task of the past has a higher number than those that are posted now.
    page.goto("/")
    _wait_interactive(page)
    return _event_to_page_ms(page, running, dao)[1]


def _event_to_page_ms(page: Page, running: RunningSite, dao: Dao) -> tuple[float, float]:
    """Median and 95th percentile. Raises FigureMissing where the page was loaded again meanwhile."""
    published_ms: dict[str, float] = {}

    def on_event(_key: str, data: dict[str, object]) -> None:
        event = DaoEvent.model_validate(data)
        published_ms[f"/tasks/{event.task_id}"] = time.time() * 1e3

    key = topics.EVENT.name(org=running.site.org, event="TaskRegistered")
    subscriber = running.bus.subscribe_json(key, on_event)
    try:
        page.evaluate(_WATCH)
        for _ in range(EVENTS):
            # Cancelled at once, so that the queue that the page shows stays short.
            task_id = dao.post(allow_wait=True)
            try:
                wait_seen(page, f"/tasks/{task_id}")
            finally:
                dao.command("organization", "cancel_task", task_id=task_id)
    finally:
        subscriber.undeclare()
    return latency_ms(published_ms, kept(page, "seen"))


def _with_many_tasks(page: Page) -> dict[str, float | None]:
    rows = page.locator("table.data tbody tr")

    def opened(path: str, shown: Locator) -> float:
        def open_page() -> None:
            page.goto(path)
            _wait_interactive(page)
            shown.nth(1).wait_for()

        return _median_ms(open_page, lambda: None)

    def shown(condition: str) -> None:
        page.wait_for_function(
            f"() => {{ const rows = [...document.querySelectorAll('table.data tbody tr')];"
            f" return rows.length && {condition}; }}"
        )

    def every_task() -> None:
        page.goto("/tasks")
        _wait_interactive(page)
        shown(f"rows[0].textContent.startsWith('{NEWEST} ')")

    def cancelled_only() -> None:
        page.get_by_role("option", name="cancelled").click()
        shown("rows.every((row) => row.querySelector('.badge').textContent === 'cancelled')")

    def open_filter() -> None:
        every_task()
        page.get_by_label("State").click()
        page.get_by_role("option", name="cancelled").wait_for()

    def search() -> None:
        page.get_by_label("Number or words").fill("note 77777")
        shown("rows.length === 1 && rows[0].textContent.includes('note 77777')")

    def next_page() -> None:
        page.locator(".q-pagination button").last.click()
        shown(f"!rows[0].textContent.startsWith('{NEWEST} ')")

    asked: dict[str, Callable[[], float]] = {
        "overview": lambda: opened("/", page.locator("ul.list li")),
        "list": lambda: opened("/tasks", rows),
        "treasury": lambda: opened("/treasury", rows),
        "filter": lambda: _median_ms(cancelled_only, open_filter),
        "search": lambda: _median_ms(search, every_task),
        "next_page": lambda: _median_ms(next_page, every_task),
    }
    figures: dict[str, float | None] = {}
    for name, measure in asked.items():
        figures |= measured(measure, f"console_tasks100000_{name}_ms")
    return figures


def _median_ms(action: Callable[[], None], before: Callable[[], None]) -> float:
    """Median over `LOADS` times, ms. The run of `before` is not counted."""
    took_ms = []
    for _ in range(LOADS):
        before()
        started_s = time.perf_counter()
        action()
        took_ms.append((time.perf_counter() - started_s) * 1e3)
    return statistics.median(took_ms)


def _many_browsers(page: Page, running: RunningSite) -> tuple[float, float]:
    """Contexts of their own, each following the robot on the overview, as who is logged in on `page`.

    Cores of the console's process, and drawings a second of the browser that drew fewest. Raises
    FigureMissing where a page was loaded again meanwhile.
    """
    browser, known = page.context.browser, page.context.storage_state()
    assert browser is not None
    made = [browser.new_context(base_url=page.url, storage_state=known) for _ in range(BROWSERS)]
    try:
        pages = [context.new_page() for context in made]
        for one in pages:
            one.set_default_timeout(60_000)
            one.goto("/")
            _wait_interactive(one)
        for page in pages:
            page.locator(".lab-map .robot .moving").wait_for()
            page.evaluate(_COUNT)
        pid = running.children["console"].pid
        drawn_before = [kept(page, "moves") for page in pages]
        before_s, started_s = cpu_s(pid), time.monotonic()
        threading.Event().wait(CPU_S)
        used_s, took_s = cpu_s(pid) - before_s, time.monotonic() - started_s
        drawn = [kept(page, "moves") - before for page, before in zip(pages, drawn_before, strict=True)]
    finally:
        for context in made:
            context.close()
    return used_s / took_s, min(drawn) / took_s


@contextmanager
def _circling_robots(running: RunningSite) -> Iterator[None]:
    """Motion capture of the site's robots at 50 Hz, driving in circles."""
    stop = threading.Event()
    node = Node(running.bus.session, "circling", "", running.site.bus.domain_id, WallClock())
    names = [topics.MOCAP_POSE.name(body=one.name) for one in running.site.robots]
    publishers = [node.publisher(name, topics.MOCAP_POSE.type) for name in names]

    def drive() -> None:
        pose = types.new("geometry_msgs/msg/PoseStamped")
        while not stop.wait(_POSE_S):
            angle = time.monotonic() / 3
            pose.pose.orientation.w, _, _, pose.pose.orientation.z = quaternion_of(angle)
            for number, publisher in enumerate(publishers):
                x_m = 3.5 + 1.2 * number
                pose.pose.position.x, pose.pose.position.y = x_m + math.cos(angle), 1.5 + math.sin(angle)
                publisher.publish(pose)

    thread = threading.Thread(target=drive, name="circling", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        node.close()
