"""`python -m tests.docs.pictures` takes the documentation's pictures of the console, on a site that does one
cleaning."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from playwright.sync_api import Page, expect

from tests.docs.text import DOCS
from tests.support.browser import chromium
from tests.support.console import Desk, open_page
from tests.support.dao import Dao
from tests.support.site import RunningSite, write_site

SITE = "clock.speed = 10\nclock.idle_speed = 10\nagent.explore_when_idle = false\n"
WIDTH = 1280


def take(page: Page, name: str, height: int) -> None:
    page.set_viewport_size({"width": WIDTH, "height": height})
    page.wait_for_function("document.querySelector('.lab-scene').dataset.drawn > 1")
    page.screenshot(path=DOCS / "images" / f"{name}.png", animations="disabled")


def main() -> None:
    with (
        tempfile.TemporaryDirectory(prefix="rodeo-pictures-") as folder,
        RunningSite(write_site(Path(folder), "eth-tester", SITE)) as running,
    ):
        running.start_founded("console", ready=False)
        running.start("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
        running.wait_ready("console")
        with chromium() as browser:
            _take_both(Desk(running, browser).page("ada"), running)


def _take_both(page: Page, running: RunningSite) -> None:
    item = running.site.items[0]
    place = {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
    task_id = Dao(running).post("100", allow_wait=True, params=place)
    open_page(page, "/")
    expect(page.locator(".lab-map .way:not(.band)").first).to_have_attribute("points", re.compile(" "))
    take(page, "console-overview", 1300)
    open_page(page, f"/tasks/{task_id}")
    expect(page.locator(".page-head .badge")).to_have_text("settled")
    page.get_by_role("button", name="Replay the recording").click()
    page.get_by_role("button", name=re.compile("lifted: .*grasp.* passed")).click()
    page.mouse.move(0, 0)
    take(page, "console-task", 1700)


if __name__ == "__main__":
    main()
