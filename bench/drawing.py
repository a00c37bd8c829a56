"""What drawing costs a browser: first content, script for each drawing of map and 3-D view, and long tasks.

The views are drawn by the processor, so frames per second would measure that; script does not depend on it.
"""

from __future__ import annotations

import statistics
import threading
import time
from typing import Any

import httpx
from playwright.sync_api import Page

from tests.support.accessibility import axe_faults
from tests.support.console import open_page
from tests.support.page_figures import FigureMissing, kept, measured

LOADS = 5
WATCHED_S = 15.0
CALLS = 20
ASKED = (
    *(f"/tasks?state={state}&limit=50" for state in ("ruled", "submitted", "assigned", "open", "settled")),
    "/tasks?limit=25",
    "/tasks?limit=25&offset={one}",
    "/tasks?state=cancelled&limit=25",
    "/tasks?kind=waste_disposal&limit=25",
    "/tasks?text=note+{one}",
    "/tasks?text=note",
    "/tasks/{one}",
    "/tasks/{one}/attempts",
    "/tasks/{one}/dispute",
    "/transfers?limit=20",
    "/transfers?limit=500",
    "/transfers?account=panther1&limit=20",
    "/organization",
    "/participants",
    "/services",
    "/wallets",
    "/devices",
    "/chain",
    "/processes",
    "/lab",
)
"""What pages ask for; `one` is the number of a task."""
PATHS = ("/", "/tasks", "/services", "/treasury", "/proposals", "/work", "/operator", "/accounts", "/replay")

_LONG = """() => { window.long = 0;
  const count = (list) => { window.long += list.getEntries().length; };
  new PerformanceObserver(count).observe({type: "longtask", buffered: true}); }"""
_DRAWN = """() => { window.drawn = 0; document.querySelector(".lab-views").addEventListener("lab-shown",
  () => { window.drawn += 1; }); }"""
_AT_REST = """() => [...document.querySelectorAll(".q-loading-bar")].every(
  (one) => getComputedStyle(one).opacity === "0")"""
_FIRST_CONTENT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"


def once(page: Page) -> dict[str, float | None]:
    """`console_first_content_ms`, and `console_axe_serious`: serious and critical findings on all pages."""
    first = measured(lambda: _first_content_ms(page), "console_first_content_ms")
    return first | measured(lambda: _axe_findings(page), "console_axe_serious")


def _first_content_ms(page: Page) -> float:
    """Median over `LOADS` times of the time from asking for the overview to its first content."""
    took_ms = []
    for _ in range(LOADS):
        page.goto("/")
        page.wait_for_function(f"{_FIRST_CONTENT} !== null")
        took_ms.append(float(page.evaluate(_FIRST_CONTENT)))
    return statistics.median(took_ms)


def cost(page: Page, robots: int, three_d: bool) -> dict[str, float | None]:
    """`console_map_script_ms_<n>_robots`, or `views` with the 3-D view beside the map: script of the browser
    for each drawing; `..._long_tasks_...`: tasks over 50 ms while the page loads and draws for 15 s."""
    view = "views" if three_d else "map"
    names = f"console_{view}_script_ms_{robots}_robots", f"console_{view}_long_tasks_{robots}_robots"
    return measured(lambda: _watched(page, three_d), *names)


def _watched(page: Page, three_d: bool) -> tuple[float, float]:
    page.add_init_script(f"({_LONG})()")
    page.goto("/")
    page.locator(".lab-map .robot .moving").first.wait_for()
    if three_d:
        # It draws only where somebody looks.
        page.locator(".lab-scene").scroll_into_view_if_needed()
        page.locator(".lab-scene[data-drawn]").wait_for()
    page.evaluate(_DRAWN)
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")

    def script_s() -> float:
        found: list[dict[str, Any]] = session.send("Performance.getMetrics")["metrics"]
        return next(float(one["value"]) for one in found if one["name"] == "ScriptDuration")

    before_s, before = script_s(), kept(page, "drawn")
    threading.Event().wait(WATCHED_S)
    used_s, drawn = script_s() - before_s, kept(page, "drawn") - before
    if not drawn:
        raise FigureMissing("the map drew nothing: no robot moved")
    return 1e3 * used_s / drawn, float(kept(page, "long"))


def _axe_findings(page: Page) -> float:
    total = 0
    for path in PATHS:
        open_page(page, path)
        page.wait_for_function(_AT_REST)
        total += len(axe_faults(page))
    return float(total)


def api_p95_ms(client: httpx.Client, tasks: int) -> tuple[float, float]:
    """95th percentile over all that the pages ask for, each `CALLS` times, with so many tasks; and that of
    the path where it is highest."""
    took_ms = {path.format(one=tasks // 2): list[float]() for path in ASKED}
    for path, taken in took_ms.items():
        for _ in range(CALLS):
            started_s = time.perf_counter()
            client.get(path).raise_for_status()
            taken.append((time.perf_counter() - started_s) * 1e3)
    each = {path: statistics.quantiles(taken, n=20)[-1] for path, taken in took_ms.items()}
    for path, p95_ms in sorted(each.items(), key=lambda one: -one[1]):
        print(f"{p95_ms:8.1f} ms  {path}")
    everything = [one for taken in took_ms.values() for one in taken]
    return statistics.quantiles(everything, n=20)[-1], max(each.values())
