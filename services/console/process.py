"""The console as a process: accounts, guard, pages and programs' interface on one port."""

from __future__ import annotations

import asyncio
import logging
import re
import threading
from collections.abc import Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import jinja2
import nicegui.client
from fastapi import FastAPI
from nicegui import Client, ui
from nicegui import app as nicegui_app
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from rodeo.access.accounts import Accounts, accounts_path
from rodeo.errors import RodeoError
from rodeo.host.http import Limits, Server, configuration, health, listen
from rodeo.kinds import kinds_of
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site
from services.console import api_page, files, login, rest, scene
from services.console.actions import Actions
from services.console.guard import MAX_BODY_BYTES, Guard, origins_of
from services.console.live import Live
from services.console.pages import frame, missing, operator, overview, replay, task, tasks, work
from services.console.pages.accounts import AccountsPage
from services.console.pages.frame import Console
from services.console.pages.proposals import ProposalsPage
from services.console.pages.services import ServicesPage
from services.console.pages.treasury import TreasuryPage
from services.console.queries import Queries

MENU: dict[str, Callable[[Console], object]] = {
    "/": overview.draw,
    "/services": ServicesPage,
    "/treasury": TreasuryPage,
    "/proposals": ProposalsPage,
    "/work": work.desks,
    "/operator": operator.draw,
    "/accounts": AccountsPage,
}
"""Path of a page of the menu -> what fills it; the other pages have addresses with a part that varies."""

log = logging.getLogger(__name__)

STATIC = Path(__file__).parent / "static"
_WS_MAX_BYTES = 1 << 20
LIMITS = Limits(body_bytes=MAX_BODY_BYTES, connections=256, request_s=300.0)
"""A browser opens six connections for each page, and a proof may be large and the link slow."""
_ICON = STATIC / "icon.svg"


def build(console: Console, origins: set[str], lifespan: Callable[[FastAPI], Any]) -> ASGIApp:
    """The application: guard around login, REST interface and pages."""
    api = FastAPI(lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    guard = Guard(api, console.accounts, origins, _owner)
    api.include_router(login.router(console.accounts, guard, console.site.org))
    api.include_router(files.router(console))
    api.add_exception_handler(RodeoError, _refuse)
    api.router.routes.extend(health(lambda: ""))  # it serves pages from the moment when it is ready
    programs = rest.make_api(console)
    api.mount("/api", programs)
    api.router.routes.append(api_page.route(programs))
    api.mount("/static", StaticFiles(directory=STATIC))
    for path, draw in MENU.items():
        frame.register(console, path, draw)
    for module in (tasks, task, replay, missing):
        module.register(console)
    nicegui_app.colors(
        primary="#0f6d5f", positive="#1a7f4b", negative="#b3261e", warning="#8a5a00", info="#1f5fa8"
    )
    _give_scripts_their_nonce()
    ui.run_with(
        api,
        title="RODEO",
        favicon=_ICON,
        dark=None,
        language="en-US",
        tailwind=False,
        reconnect_timeout=10.0,
        binding_refresh_interval=None,
        show_welcome_message=False,
    )
    # No polling: the guard checks sessions on the websocket.
    nicegui_app.config.socket_io_js_transports = ["websocket"]
    return guard


async def _refuse(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RodeoError)
    return JSONResponse(error.to_json(), rest.status_of(error))


def _owner(client_id: str) -> str | None:
    """The session that a page was made for."""
    client = Client.instances.get(client_id)
    session = None if client is None else client.request.state.session
    return None if session is None else session.key


def _give_scripts_their_nonce() -> None:
    """Put the nonce of the content-security policy on the scripts of NiceGUI's own template."""
    environment = nicegui.client.templates.env
    inner = environment.loader
    assert inner is not None

    def load(name: str) -> tuple[str, str | None, Callable[[], bool] | None]:
        source, filename, current = inner.get_source(environment, name)
        return (
            re.sub(r"<script(?=[\s>])", '<script nonce="{{ request.state.csp_nonce }}"', source),
            filename,
            current,
        )

    environment.loader = jinja2.FunctionLoader(load)


async def serve(process: Process) -> None:
    """Until the process is asked to stop."""
    site, config = process.site, process.site.console
    listener = listen(config.host, config.port, "the console (console.port)")
    port = listener.getsockname()[1]
    queries = Queries(process.bus, site)
    accounts = Accounts(accounts_path(site), config)
    live = Live(process.bus, site, queries)
    kinds = kinds_of(site)
    actions = Actions(process.bus, site, kinds, accounts, process.clock)
    console = Console(site, accounts, actions, queries, live, scene.lab(site), kinds)

    @asynccontextmanager
    async def lifespan(_api: FastAPI) -> Any:
        url = config.origin or f"http://{config.host}:{port}"
        process.activity(f"serving {url}", http=url)
        process.ready()
        log.info("on %s", url)
        yield

    application = build(console, origins_of(config, port), lifespan)
    server = Server(
        configuration(
            application,
            LIMITS,
            ws_max_size=_WS_MAX_BYTES,
            proxy_headers=bool(config.trusted_proxies),
            forwarded_allow_ips=config.trusted_proxies,
        )
    )
    following = asyncio.create_task(live.run())
    running = asyncio.create_task(server.serve(sockets=[listener]))
    stopped = asyncio.create_task(asyncio.to_thread(process.stop.wait))
    await asyncio.wait({following, running, stopped}, return_when=asyncio.FIRST_COMPLETED)
    server.end()
    process.stop.set()
    await running
    following.cancel()
    accounts.close()
    # Pages that do not follow any more would look as if nothing happened: better end, and be restarted.
    with suppress(asyncio.CancelledError):
        await following


def run(site: Site, stop: threading.Event) -> None:
    """The process, until `stop`."""
    with Process("console", site, stop) as process:
        process.serve_alone(served_by(site, "console"))
        asyncio.run(serve(process))
