"""What the guard refuses before anybody has said who they are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.testclient import TestClient
from starlette.types import Receive, Scope, Send

from rodeo.access.errors import NotLoggedIn
from services.console.guard import MAX_LOGIN_BODY_BYTES, Guard

ORIGIN = "http://127.0.0.1:8088"
FORM = "application/x-www-form-urlencoded"


async def _reads_the_form(scope: Scope, receive: Receive, send: Send) -> None:
    async with Request(scope, receive).form() as form:
        await PlainTextResponse(str(form.get("name")))(scope, receive, send)


def _nobody(*_: Any, **__: Any) -> None:
    raise NotLoggedIn("nobody is logged in")


@pytest.fixture
def client() -> TestClient:
    accounts: Any = SimpleNamespace(session=_nobody)
    guard = Guard(_reads_the_form, accounts, {ORIGIN}, lambda _client: None)
    return TestClient(guard, base_url=ORIGIN, headers={"origin": ORIGIN})


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        (FORM, 200),
        (f"{FORM}; charset=utf-8", 200),
        (f"{FORM}; charset=punycode", 415),
        ("multipart/form-data; boundary=x; charset=punycode", 415),
        (f"{FORM}; charset=idna", 415),
        (f"{FORM}; charset=utf-7", 415),
        (f"{FORM}; charset=none-such", 415),
    ],
)
def test_texts_are_utf8(client: TestClient, kind: str, status: int) -> None:
    answer = client.post("/login", content=b"name=ada", headers={"content-type": kind})
    assert answer.status_code == status


def test_a_login_is_short(client: TestClient) -> None:
    def status(size_bytes: int) -> int:
        body = b"name=" + b"a" * (size_bytes - 5)
        return client.post("/login", content=body, headers={"content-type": FORM}).status_code

    assert status(MAX_LOGIN_BODY_BYTES) == 200
    assert status(MAX_LOGIN_BODY_BYTES + 1) == 413
