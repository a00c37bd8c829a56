"""The brake on guessing, and where people are sent after logging in."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from rodeo.access.accounts import Accounts
from rodeo.access.roles import Role
from rodeo.errors import ConfigError
from rodeo.site.sections import ConsoleConfig
from services.console.errors import TooManyAttempts
from services.console.guard import Guard, origins_of
from services.console.login import Throttle, local_path, router

ORIGIN = "http://127.0.0.1:8088"


def test_failures_close_the_login_until_the_window_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("services.console.login.time.monotonic", lambda: now[0])
    throttle = Throttle(limit=3, window_s=60)
    for _ in range(3):
        throttle.check("eve")
        throttle.failed("eve")
        now[0] += 10
    with pytest.raises(TooManyAttempts) as caught:
        throttle.check("eve")
    assert caught.value.details == {"retry_after_s": 31}
    throttle.check("ada")
    now[0] = 60.0
    throttle.check("eve")


def test_success_forgets_the_failures_before() -> None:
    throttle = Throttle(limit=1, window_s=60)
    throttle.failed("ada")
    throttle.succeeded("ada")
    throttle.check("ada")


@pytest.mark.parametrize(
    ("wanted", "sent"),
    [
        ("/tasks/3", "/tasks/3"),
        ("//evil.example", "/"),
        ("/\\evil.example", "/"),
        ("https://evil.example", "/"),
        ("/a\r\nSet-Cookie: x", "/"),
        ("", "/"),
    ],
)
def test_nobody_is_sent_elsewhere_after_logging_in(wanted: str, sent: str) -> None:
    assert local_path(wanted) == sent


def test_a_console_that_others_reach_needs_tls() -> None:
    with pytest.raises(ConfigError, match="TLS"):
        origins_of(ConsoleConfig(host="0.0.0.0"), 8088)
    assert origins_of(ConsoleConfig(host="0.0.0.0", origin="https://x.example"), 8088) == {
        "https://x.example"
    }
    assert "http://127.0.0.1:8088" in origins_of(ConsoleConfig(), 8088)


@pytest.fixture
def accounts(tmp_path: Path) -> Iterator[Accounts]:
    accounts = Accounts(tmp_path / "accounts.sqlite", ConsoleConfig())
    accounts.add_user("ada", "correct horse battery", [Role.OPERATOR])
    yield accounts
    accounts.close()


def post_link(accounts: Accounts, token: str, config: ConsoleConfig, **options: str) -> httpx.Response:
    """Bring a link's token from the address `client`, to a console that is configured so."""
    api = FastAPI()
    guard = Guard(api, accounts, origins_of(config, 8088), lambda _client: None)
    api.include_router(router(accounts, guard, "lab"))
    transport = httpx.ASGITransport(guard, client=(options.get("client", "127.0.0.1"), 5000))
    origin = config.origin or ORIGIN
    headers = {"Origin": options.get("origin", origin)}

    async def post() -> httpx.Response:
        async with httpx.AsyncClient(transport=transport, base_url=origin) as browser:
            return await browser.post("/login/link", data={"token": token}, headers=headers)

    return asyncio.run(post())


def test_a_link_is_exchanged_for_a_session_once(accounts: Accounts) -> None:
    link = accounts.make_link("ada")
    opened = post_link(accounts, link, ConsoleConfig())
    assert (opened.status_code, opened.headers["location"]) == (303, "/")
    assert accounts.session(opened.cookies["rodeo_session"]).user.name == "ada"
    assert "httponly" in opened.headers["set-cookie"].lower()
    again = post_link(accounts, link, ConsoleConfig())
    assert again.status_code == 401 and "was used, or is too old" in again.text
    assert "set-cookie" not in again.headers


@pytest.mark.parametrize(
    ("config", "options"),
    [
        ({}, {"origin": "https://evil.example"}),
        ({}, {"client": "192.0.2.7"}),
        ({"origin": "https://console.example"}, {}),
    ],
)
def test_a_link_opens_nothing_for_another_page_or_another_machine(
    accounts: Accounts, config: dict[str, str], options: dict[str, str]
) -> None:
    link = accounts.make_link("ada")
    refused = post_link(accounts, link, ConsoleConfig.model_validate(config), **options)
    assert refused.status_code == 403 and "set-cookie" not in refused.headers
    # It was not used up by that.
    assert (post_link(accounts, link, ConsoleConfig())).status_code == 303
