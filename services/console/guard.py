"""What every request passes before anything else sees it: host, origin, session, size, headers.

Pages and the websocket need a session cookie, programs under /api bring a token instead. Changes must come
from a page of ours (Origin), and so must a websocket, which browsers would otherwise open for any page with
our cookie.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rodeo.access.accounts import Accounts, Session
from rodeo.access.errors import NotLoggedIn
from rodeo.errors import ConfigError
from rodeo.host.http import LimitBody, problem
from rodeo.host.proxies import is_loopback
from rodeo.site.sections import ConsoleConfig
from rodeo.text.charset import is_utf8

MAX_BODY_BYTES = 12 << 20
"""A photo of a finished task, and the form around it."""
MAX_API_BODY_BYTES = 256 << 10
MAX_LOGIN_BODY_BYTES = 16 << 10
"""The longest name and passphrase, each byte of them escaped, and the form around them."""
_WITH_PHOTOS = "/api/actions/submit-work"

_SAFE_METHODS = {"GET", "HEAD", "OPTIONS"}
_HEALTH = ("/livez", "/readyz")
_PUBLIC = ("/login", "/docs", "/api/", "/static/", "/favicon.ico", *_HEALTH)
_PORTS = {"http": ":80", "https": ":443"}
_USER_EVENT = '42["event"'
"""Start of socket.io's messages for people's actions on the page; everything else is housekeeping."""
_POLICY_VIOLATION = 1008

_CSP = "; ".join(
    (
        "default-src 'none'",
        # Vue compiles templates in the browser, and NiceGUI evaluates event handlers that it sends: both need
        # unsafe-eval. No inline script runs without the nonce of its page.
        "script-src 'self' 'nonce-{nonce}' 'unsafe-eval'",
        # Quasar and Vue add style elements and attributes at run time.
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "font-src 'self'",
        "connect-src 'self'",
        "manifest-src 'self'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)


def origins_of(config: ConsoleConfig, port: int) -> set[str]:
    """Where people may open the console. Raises ConfigError when it would be open without TLS."""
    local = {f"http://{host}:{port}" for host in ("127.0.0.1", "localhost", "[::1]")}
    if config.origin is not None:
        return {_plain(config.origin)}
    if not is_loopback(config.host):
        raise ConfigError(
            "only this machine may reach the console without TLS: put a proxy in front and name its address "
            "in console.origin",
            host=config.host,
        )
    return local


class Guard:
    """ASGI middleware around the whole application.

    `origins` are the addresses under which people open the console; `owner(client_id)` names the session
    that a page was made for.
    """

    def __init__(
        self, app: ASGIApp, accounts: Accounts, origins: set[str], owner: Callable[[str], str | None]
    ) -> None:
        sizes = (MAX_BODY_BYTES, MAX_API_BODY_BYTES, MAX_LOGIN_BODY_BYTES)
        self._limited = {size: LimitBody(app, size) for size in sizes}
        self._accounts = accounts
        self._origins = origins
        self._hosts = {urlsplit(origin).netloc for origin in origins}
        self._schemes = {urlsplit(origin).scheme for origin in origins}
        self._owner = owner
        self.is_local = all(is_loopback(urlsplit(origin).hostname or "") for origin in origins)
        """Whether people open the console only on the machine where it runs."""
        self.secure = any(origin.startswith("https:") for origin in origins)
        self.cookie = "__Host-rodeo_session" if self.secure else "rodeo_session"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._websocket(scope, receive, send)
        else:
            await self._http(scope, receive, send)

    async def _app(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._limited[_limit_bytes(scope.get("path", ""))](scope, receive, send)

    # -- HTTP ------------------------------------------------------------------------------------------

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        path, method = scope["path"], scope["method"]
        nonce = secrets.token_urlsafe(16)
        scope.setdefault("state", {})["csp_nonce"] = nonce
        respond: ASGIApp = self._app
        try:
            session: Session | None = self._accounts.session(self.token(headers), touch=True)
        except NotLoggedIn:
            session = None
        scope["state"]["session"] = session
        # Health checks address the machine, by whatever name.
        if path not in _HEALTH and not self._is_host(headers):
            respond = problem(421, "unknown_host", "the console does not serve this host name")
        elif path.startswith("/_nicegui_ws/"):
            respond = problem(400, "websocket_only", "a page connects to the console over a WebSocket")
        elif not is_utf8(headers.get("content-type", "")):
            respond = problem(415, "unknown_charset", "the request's text is not UTF-8")
        elif method not in _SAFE_METHODS and not path.startswith("/api/") and not self._is_origin(headers):
            respond = problem(403, "foreign_origin", "this request comes from a page of another site")
        elif session is None and not _is_public(path):
            wants_page = method == "GET" and "text/html" in headers.get("accept", "")
            asked = f"{path}?{scope['query_string'].decode('latin-1')}".removesuffix("?")
            respond = (
                RedirectResponse(f"/login?next={quote(asked)}", 303)
                if wants_page
                else problem(401, "not_logged_in", "log in first")
            )
        elif (client_id := _client_of(path)) is not None and not self._owns(session, client_id):
            respond = problem(403, "forbidden", "this page belongs to another session")
        await respond(scope, receive, self._with_headers(send, scope, nonce))

    def token(self, headers: Headers) -> str | None:
        """What the session's cookie holds."""
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return None
        return None if morsel is None else morsel.value

    def _is_host(self, headers: Headers) -> bool:
        host = headers.get("host", "")
        return any(urlsplit(_plain(f"{scheme}://{host}")).netloc in self._hosts for scheme in self._schemes)

    def _is_origin(self, headers: Headers) -> bool:
        return _plain(headers.get("origin", "")) in self._origins

    def _owns(self, session: Session | None, client_id: str) -> bool:
        return session is not None and self._owner(client_id) == session.key

    def _with_headers(self, send: Send, scope: Scope, nonce: str) -> Send:
        async def add(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = _CSP.format(nonce=nonce)
                headers["X-Content-Type-Options"] = "nosniff"
                headers["X-Frame-Options"] = "DENY"
                headers["Referrer-Policy"] = "same-origin"
                headers["Cross-Origin-Opener-Policy"] = "same-origin"
                headers["Cross-Origin-Resource-Policy"] = "same-origin"
                headers["Permissions-Policy"] = "geolocation=(), microphone=()"
                if self.secure:
                    headers["Strict-Transport-Security"] = "max-age=31536000"
                if not scope["path"].startswith(("/_nicegui/", "/static/")):
                    headers["Cache-Control"] = "no-store"
            await send(message)

        return add

    # -- websocket -------------------------------------------------------------------------------------

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        if not self._is_host(headers) or not self._is_origin(headers):
            await receive()
            await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
            return
        client_id = parse_qs(scope["query_string"].decode("latin-1")).get("client_id", [""])[0]
        try:
            session = self._accounts.session(self.token(headers))
        except NotLoggedIn:
            await _have_page_load_again(receive, send)
            return
        if not self._owns(session, client_id):
            await _have_page_load_again(receive, send)
            return

        async def checked() -> Message:
            """A person who clicks must still be logged in; watching alone keeps nobody logged in."""
            message = await receive()
            if message["type"] == "websocket.receive":
                acts = (message.get("text") or "").startswith(_USER_EVENT)
                try:
                    self._accounts.session_of(session.key, touch=acts)
                except NotLoggedIn:
                    await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
                    return {"type": "websocket.disconnect", "code": _POLICY_VIOLATION}
            return message

        await self._app(scope, checked, send)


def _plain(origin: str) -> str:
    """An origin as browsers write it: in small letters, without its scheme's own port (RFC 6454, 6.1)."""
    scheme, _, host = origin.lower().partition("://")
    return f"{scheme}://{host.removesuffix(_PORTS.get(scheme, ':'))}"


def _is_public(path: str) -> bool:
    if path.startswith("/_nicegui/"):
        return _client_of(path) is None
    return path == "/api" or path.startswith(_PUBLIC)


def _client_of(path: str) -> str | None:
    """The page that a request of NiceGUI's is for: an upload, for example."""
    if not path.startswith("/_nicegui/client/"):
        return None
    return path.removeprefix("/_nicegui/client/").partition("/")[0]


def _limit_bytes(path: str) -> int:
    """Most bytes of a request's body: everybody may send one to the login."""
    if path in ("/login", "/login/link", "/logout"):
        return MAX_LOGIN_BODY_BYTES
    return MAX_API_BODY_BYTES if path.startswith("/api/") and path != _WITH_PHOTOS else MAX_BODY_BYTES


async def _have_page_load_again(receive: Receive, send: Send) -> None:
    """Tell a page of ours that its session or this process's memory of it is over.

    It loads again and finds the login, or itself anew. After a plain refusal it would retry indefinitely.
    """
    opened = {"sid": "", "upgrades": [], "pingInterval": 25000, "pingTimeout": 20000, "maxPayload": 0}
    await receive()
    await send({"type": "websocket.accept"})
    await send({"type": "websocket.send", "text": "0" + json.dumps(opened)})
    await receive()
    await send({"type": "websocket.send", "text": '44{"message":"Implicit handshake failed"}'})
    await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
