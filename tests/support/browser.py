"""A real Chromium for tests, cut off from everything but the page under test."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Error, Page, Request, sync_playwright

from rodeo_testing.waiting import HANG_S

_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


def chromium_path() -> str:
    """Where Chromium is; skips the test where it is missing."""
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        pytest.skip("Chromium is missing: make system")
    return found


@contextmanager
def chromium(three_d: bool = True) -> Iterator[Browser]:
    """No name but this machine's resolves in it. `three_d`: WebGL, by the processor."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            timeout=1e3 * HANG_S,
            executable_path=chromium_path(),
            args=[
                "--no-sandbox",
                "--enable-unsafe-swiftshader" if three_d else "--disable-3d-apis",
                "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
            ],
        )
        yield browser
        browser.close()


def watch(page: Page, origin: str) -> list[str]:
    """Fills with what no page of the console may do: ask elsewhere, break its policy, raise an error."""
    faults: list[str] = []
    own = (origin, origin.replace("http", "ws", 1), "data:", "blob:")

    def asked(request: Request) -> None:
        if not request.url.startswith(own):
            faults.append(f"asked {request.url}")

    def raised(error: Error) -> None:
        faults.append(f"raised {error}")

    def complained(message: ConsoleMessage) -> None:
        if message.type == "error":
            faults.append(f"complained {message.text}")

    page.on("request", asked)
    page.on("pageerror", raised)
    page.on("console", complained)
    return faults


def log_in(page: Page, name: str, passphrase: str) -> None:
    """Fill in the login that the page shows."""
    page.get_by_label("Name").fill(name)
    page.get_by_label("Passphrase").fill(passphrase)
    page.get_by_role("button", name="Log in").click()
