"""Login and logout: a plain form without a script, so that nobody reaches the rest before it."""

from __future__ import annotations

import asyncio
import ipaddress
import time
from collections import defaultdict, deque
from collections.abc import Callable
from functools import partial
from html import escape
from pathlib import Path
from string import Template

from fastapi import APIRouter, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from rodeo.access.accounts import Accounts
from rodeo.access.errors import LoginRefused
from services.console.errors import TooManyAttempts
from services.console.guard import Guard

PAIR_FAILURES = 5
"""Failures of one address with one name."""
ADDRESS_FAILURES = 20
"""Failures of one address, whatever the names."""
WINDOW_S = 300.0
_HASHES_AT_ONCE = 2
"""argon2 takes 64 MiB and a core each."""
_MAX_KEYS = 10_000

_STATIC = Path(__file__).parent / "static"
_PAGE = Template((_STATIC / "login.html").read_text())
_LINK_PAGE = (_STATIC / "link.html").read_text()
_NEW_LINK = "Make another on the command line: rodeo console link"


class Throttle:
    """Counts failures in a sliding window of wall time."""

    def __init__(self, limit: int, window_s: float) -> None:
        self._limit = limit
        self._window_s = window_s
        self._failures: defaultdict[str, deque[float]] = defaultdict(deque)

    def check(self, key: str) -> None:
        """Raises TooManyAttempts."""
        now_s = time.monotonic()
        failures = self._failures.get(key, deque())
        while failures and failures[0] <= now_s - self._window_s:
            failures.popleft()
        if len(failures) >= self._limit:
            wait_s = round(failures[0] + self._window_s - now_s) + 1
            raise TooManyAttempts(f"too many attempts; try again in {wait_s} s", retry_after_s=wait_s)

    def failed(self, key: str) -> None:
        if len(self._failures) >= _MAX_KEYS:
            self._failures.clear()
        self._failures[key].append(time.monotonic())

    def succeeded(self, key: str) -> None:
        self._failures.pop(key, None)


def _page(organization: str, status: int, next_path: str, name: str = "", problem: str = "") -> HTMLResponse:
    notice = f'<p class="problem" role="alert">{escape(problem)}</p>' if problem else ""
    texts = {"organization": organization, "next": next_path, "name": name}
    values = {key: escape(text) for key, text in texts.items()}
    return HTMLResponse(_PAGE.substitute(values, notice=notice), status)


def _logged_in(guard: Guard, token: str, path: str) -> Response:
    response = RedirectResponse(path, 303)
    response.set_cookie(guard.cookie, token, path="/", httponly=True, secure=guard.secure, samesite="strict")
    return response


def _add_links(
    routes: APIRouter, accounts: Accounts, guard: Guard, page: Callable[..., HTMLResponse]
) -> None:
    # A link is /login/link#TOKEN. Browsers send what is behind # to nobody: it is in no log and no Referer.
    # The page's script takes it out of the address, and posts it.
    @routes.get("/login/link")
    async def show_link() -> Response:
        return HTMLResponse(_LINK_PAGE)

    @routes.post("/login/link")
    async def log_in_by_link(request: Request, token: str = Form(max_length=64, default="")) -> Response:
        if not guard.is_local or not _is_loopback(request):
            return page(403, "/", problem="Links work only on the machine where the console runs.")
        try:
            opened = await run_in_threadpool(accounts.log_in_by_link, token)
        except LoginRefused:
            return page(401, "/", problem=f"This link was used, or is too old. {_NEW_LINK}")
        return _logged_in(guard, opened, "/")


def router(accounts: Accounts, guard: Guard, organization: str) -> APIRouter:
    """GET and POST /login and /login/link, POST /logout."""
    routes = APIRouter(include_in_schema=False)
    pairs, addresses = Throttle(PAIR_FAILURES, WINDOW_S), Throttle(ADDRESS_FAILURES, WINDOW_S)
    hashing = asyncio.Semaphore(_HASHES_AT_ONCE)
    page = partial(_page, organization)

    @routes.get("/login")
    async def show(request: Request, next: str = "/") -> Response:
        if request.state.session is not None:
            return RedirectResponse(local_path(next), 303)
        return page(200, local_path(next))

    @routes.post("/login")
    async def log_in(
        request: Request,
        name: str = Form(max_length=64, default=""),
        passphrase: str = Form(max_length=1024, default=""),
        next: str = Form(max_length=512, default="/"),
    ) -> Response:
        address = request.client.host if request.client else ""
        pair = f"{address} {name}"
        try:
            pairs.check(pair)
            addresses.check(address)
        except TooManyAttempts as error:
            refusal = page(429, local_path(next), name, error.message)
            refusal.headers["Retry-After"] = str(error.details["retry_after_s"])
            return refusal
        # Counted before the result is known, so that simultaneous attempts do not all get in.
        pairs.failed(pair)
        addresses.failed(address)
        try:
            async with hashing:
                token = await run_in_threadpool(accounts.log_in, name, passphrase)
        except LoginRefused:
            return page(401, local_path(next), name, "The name or the passphrase is wrong. Try again.")
        pairs.succeeded(pair)
        addresses.succeeded(address)
        return _logged_in(guard, token, local_path(next))

    _add_links(routes, accounts, guard, page)

    @routes.post("/logout")
    async def log_out(request: Request) -> Response:
        accounts.log_out(guard.token(request.headers))
        response = RedirectResponse("/login", 303)
        response.delete_cookie(guard.cookie, path="/", secure=guard.secure, httponly=True, samesite="strict")
        return response

    return routes


def _is_loopback(request: Request) -> bool:
    try:
        return request.client is not None and ipaddress.ip_address(request.client.host).is_loopback
    except ValueError:
        return False


def local_path(path: str) -> str:
    """`path` where it is one of ours: nobody is sent elsewhere after logging in."""
    plain = path.startswith("/") and not path.startswith(("//", "/\\")) and "\\" not in path
    return path if plain and path.isprintable() else "/"
