"""The console of a running site, as people and programs reach it."""

from __future__ import annotations

import re
import secrets

import httpx
from playwright.sync_api import Browser, BrowserContext, Page, expect

from rodeo.access.accounts import Accounts, accounts_path
from rodeo.access.roles import Role
from rodeo_testing.waiting import HANG_S
from tests.support.browser import log_in
from tests.support.site import RunningSite

PASSPHRASE = "correct horse battery"
WAIT_MS = 1e3 * HANG_S
expect.set_options(timeout=WAIT_MS)


class Desk:
    """`ada` may do everything but work for pay, `eva` works for pay under that name, `reader` may look."""

    def __init__(self, running: RunningSite, browser: Browser) -> None:
        self.running = running
        self.browser = browser
        self._browsers: dict[str, BrowserContext] = {}
        self.origin = str(running.status("console").details["http"])
        self.accounts = Accounts(accounts_path(running.site), running.site.console)
        self.accounts.add_user("ada", PASSPHRASE, [role for role in Role if role is not Role.EXECUTOR])
        self.accounts.add_user("eva", PASSPHRASE, [Role.EXECUTOR], "eva")
        self.accounts.add_user("reader", PASSPHRASE, [])

    def somebody(self, *roles: Role) -> str:
        """Name of an account that nobody had before."""
        name = f"guest-{secrets.token_hex(4)}"
        self.accounts.add_user(name, PASSPHRASE, roles)
        return name

    def page(self, user: str | None, path: str = "/") -> Page:
        """A page in the browser of `user`, who logged in once, or of a stranger, who is sent to the login."""
        context = None if user is None else self._browsers.get(user)
        known = context is not None
        if context is None:
            context = self.browser.new_context(base_url=self.origin, viewport={"width": 1280, "height": 900})
            context.set_default_timeout(WAIT_MS)
        page = context.new_page()
        page.goto(path)
        if user is not None:
            if not known:
                log_in(page, user, PASSPHRASE)
                self._browsers[user] = context
            there(page)
        return page

    def client(self, user: str | None) -> httpx.Client:
        """A program with a token of `user`."""
        token = "none" if user is None else self.accounts.issue_token(user, "test")
        headers = {"Authorization": f"Bearer {token}"}
        return httpx.Client(base_url=f"{self.origin}/api", headers=headers, timeout=HANG_S)


def open_page(page: Page, path: str) -> None:
    page.goto(path)
    there(page)


def there(page: Page, heading: str | re.Pattern[str] = "") -> None:
    """Wait until the page with this heading shows what it asked for and hears keys and clicks."""
    expect(page.get_by_role("heading", level=1, name=heading)).to_have_count(1)
    page.wait_for_function("window.did_handshake === true")
    expect(page.get_by_text("Loading …")).to_have_count(0)


def click_map(page: Page, x_m: float, y_m: float) -> None:
    """Click the floor at this place of the map frame."""
    page.locator(".lab-map .floor").wait_for()
    x, y = page.evaluate(
        """([x, y]) => { const svg = document.querySelector('.lab-map svg');
        svg.scrollIntoView({block: 'center'});
        const p = new DOMPoint(x, -y).matrixTransform(svg.getScreenCTM()); return [p.x, p.y]; }""",
        [x_m, y_m],
    )
    page.mouse.click(x, y)
