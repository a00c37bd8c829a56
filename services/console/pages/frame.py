"""What every page has around it, and how pages ask, act and stay current."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ParamSpec, TypeVar

from fastapi import Depends
from nicegui import background_tasks, context, run, ui
from pydantic import BaseModel

from rodeo.access.accounts import Accounts, Session, User
from rodeo.access.roles import Role
from rodeo.display.formatting import explain, moment, zone
from rodeo.errors import RodeoError
from rodeo.kinds import Kinds
from rodeo.person import pace
from rodeo.site.config import Site
from rodeo.site.tls import openness
from rodeo.text.strict_json import Json
from services.console.actions import ACTIONS, Actions
from services.console.live import Live
from services.console.pages import widgets
from services.console.queries import Queries

log = logging.getLogger(__name__)

P = ParamSpec("P")
T = TypeVar("T")

THEME_COOKIE = "theme"
_LEFT_S = 3.0
"""Wall time between two looks at how much time is left."""


@dataclass(frozen=True)
class Console:
    """What the pages work with."""

    site: Site
    accounts: Accounts
    actions: Actions
    queries: Queries
    live: Live
    lab: Json
    kinds: Kinds


class _Clock(ui.element, component="clock.js"):
    """The site's clock and how fast it goes. It continues by itself between what `show` says."""

    def __init__(self, zone: str) -> None:
        super().__init__()
        self._props["zone"] = zone

    def show(self, now: pace.Pace | None) -> None:
        self.run_method("show", None if now is None else [now.now_s, now.speed])


@dataclass(frozen=True)
class Place:
    title: str
    path: str
    icon: str
    roles: frozenset[Role] = frozenset()
    """Roles that see it in the menu; empty: everybody."""
    heading: bool = True
    """Whether its title stands above it; others draw their own."""


PLACES = (
    Place("Overview", "/", "dashboard", heading=False),
    Place("Tasks", "/tasks", "checklist"),
    Place("Replay", "/replay", "replay"),
    Place("Services", "/services", "handyman"),
    Place("Treasury", "/treasury", "account_balance", heading=False),
    Place("Proposals", "/proposals", "how_to_vote"),
    Place("My work", "/work", "assignment_ind", frozenset({Role.EXECUTOR, Role.AUDITOR})),
    Place("Operator", "/operator", "sports_esports", frozenset({Role.OPERATOR}), heading=False),
    Place("Accounts", "/accounts", "manage_accounts"),
)


def session() -> Session:
    """The user of this page."""
    found: Session = context.client.request.state.session
    return found


def user() -> User:
    return session().user


@contextmanager
def page(console: Console, title: str, path: str, *, heading: bool = True) -> Iterator[None]:
    """Header, menu and the main region that the page fills."""
    context.client.request.state.zone = zone(console.site)
    ui.page_title(f"{title} · RODEO")
    ui.add_head_html('<link rel="stylesheet" href="/static/console.css">')
    dark = {"dark": True, "light": False}.get(context.client.request.cookies.get(THEME_COOKIE, ""))
    mode = ui.dark_mode(dark)
    person = user()
    drawer = ui.left_drawer(value=False).classes("app-drawer").props("width=220 show-if-above")
    with drawer, ui.element("nav").classes("app-nav").props('aria-label="Pages"'):
        for place in PLACES:
            if place.roles and not person.has(*place.roles):
                continue
            link = ui.element("a").props(f'href="{place.path}"')
            if place.path == path:
                link.props('aria-current="page"')
            with link:
                ui.icon(place.icon).props('aria-hidden="true"')
                widgets.Text("span", place.title)
    with ui.header().classes("app-header"):
        ui.button(icon="menu", on_click=drawer.toggle).props('flat round dense aria-label="Menu"')
        with ui.element("a").classes("brand").props('href="/" aria-label="RODEO, overview"'):
            ui.element("img").props('src="/static/icon.svg" alt=""')
            widgets.Text("span", "RODEO")
        widgets.Text("span", console.site.org, "organization")
        ui.element("span").classes("grow")
        clock = _Clock(zone(console.site))
        ui.button(icon="contrast", on_click=lambda: _switch(mode)).props(
            'flat round dense aria-label="Light or dark"'
        )
        with (
            ui.button(person.name, icon="person").props("flat dense"),
            ui.menu(),
            ui.element("div").style("padding: 12px 16px; min-width: 200px"),
        ):
            widgets.Text("p", person.name, "title")
            widgets.Text("p", ", ".join(sorted(person.roles)) or "read-only", "soft")
            # A plain form: it works when nothing else does.
            with ui.element("form").props('method="post" action="/logout"').style("margin-top: 12px"):
                ui.button("Log out").props("outline dense type=submit")
    follow(console, "clock", lambda: clock.show(console.live.heartbeats.pace))
    with ui.element("div").classes("page") as main:
        if warning := openness(console.site):
            widgets.notice(f"{warning[0].upper()}{warning[1:]}.", bad=True)
        if heading:
            page_head(title)
        yield
    ui.skip_link(target=main)


def at(console: Console, path: str) -> ui.page:
    """Decorator of what draws the page at `path`, once what all pages show is current."""
    return ui.page(path, dependencies=[Depends(console.live.glance.current)])


def register(console: Console, path: str, draw: Callable[[Console], object]) -> None:
    """Have `draw` fill the page of the menu at this path."""
    place = next(one for one in PLACES if one.path == path)

    @at(console, path)
    def show() -> None:
        with page(console, place.title, path, heading=place.heading):
            draw(console)


def page_head(title: str, subtitle: str = "", state: str = "") -> ui.element:
    """The page's heading; what is made `with` it stands at its end."""
    with ui.element("div").classes("page-head") as head:
        widgets.Text("h1", title)
        if state:
            widgets.badge(state)
        if subtitle:
            widgets.Text("p", subtitle)
        ui.element("span").classes("grow")
    return head


def when(time_s: float | None) -> str:
    """Site time with its zone: that of a simulated site is not the wall's. Its hyphens break no line."""
    if time_s is None:
        return "–"
    return f"{moment(time_s)} {context.client.request.state.zone}".replace("-", "\N{NON-BREAKING HYPHEN}")


async def _switch(mode: ui.dark_mode) -> None:
    """Toggle light and dark and remember it in this browser."""
    is_dark = await ui.run_javascript("document.body.classList.contains('body--dark')")
    mode.value = not is_dark
    theme = "light" if is_dark else "dark"
    ui.run_javascript(f"document.cookie='{THEME_COOKIE}={theme};path=/;max-age=31536000;samesite=strict'")


def follow(console: Console, what: str, update: Callable[[], None]) -> None:
    """Call `update` now and whenever `what` changes (see `Live.listen`), while this page is open."""
    client = context.client
    slot = context.slot

    def changed() -> None:
        if client.has_socket_connection:
            with slot:
                update()

    client.on_delete(console.live.listen(what, changed))
    # Changes while the page was away are shown when it comes back.
    client.on_connect(changed)
    update()


def follow_async(console: Console, what: str, update: Callable[[], Awaitable[None]]) -> Callable[[], None]:
    """`follow` for an `update` that queries, later: one at a time, and once more if `what` changed meanwhile.
    Where it fails, a text that is put here says that the page is not current.

    Returns a function that calls it from elsewhere, for example from a filter.
    """
    problem = problem_section()
    client, slot = context.client, context.slot
    state = {"running": False, "again": False}

    async def work() -> None:
        state["running"] = True
        try:
            while True:
                state["again"] = False
                with slot:
                    try:
                        await update()
                        problem.show("")
                    except RodeoError as error:
                        problem.show(stale(error))
                if not state["again"]:
                    return
        finally:
            state["running"] = False

    def changed() -> None:
        if state["running"]:
            state["again"] = True
        elif client.has_socket_connection:
            # A page that was left is kept for a while in case it comes back; meanwhile it queries nothing.
            background_tasks.create(work())

    client.on_delete(console.live.listen(what, changed))
    client.on_connect(changed)
    return changed


async def ask(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Result of a blocking function. Raises what it raises."""
    return await run.io_bound(function, *args, **kwargs)  # type: ignore[return-value]


async def asked(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
    """`ask` for what a person waits for. None where it failed, which is shown."""
    try:
        return await ask(function, *args, **kwargs)
    except RodeoError as error:
        fail(error)
        return None


async def act(console: Console, name: str, request: BaseModel | Json, done: str = "") -> Json | None:
    """Perform an action and show how it went. None when it was refused or failed."""
    reply = await asked(console.actions.perform, user(), name, request)
    if done and reply is not None:
        ui.notify(done, type="positive")
    return reply


def may(action: str) -> bool:
    """Whether the person's roles allow it, so that a page offers it. It is checked again when it is done."""
    return user().has(*ACTIONS[action].roles)


def require(what: str, *roles: Role) -> bool:
    """Whether the person has one of the roles that it takes to do this; a text says so where not."""
    if is_allowed := user().has(*roles):
        return is_allowed
    widgets.notice(
        f"You need the role {' or '.join(roles)} to {what}. Ask an administrator for it.", bad=True
    )
    return False


def fail(error: RodeoError) -> None:
    """Show what went wrong and what to do; it stays until it is closed."""
    log.info("%s: %s", error.code, error)
    # At the top, and one at a time: below it would cover the button that tries again.
    ui.notify(
        explain(error),
        type="negative",
        timeout=0,
        close_button="Close",
        multi_line=True,
        position="top",
        group="problem",
        badgeStyle="display: none",
    )


def stale(error: RodeoError) -> str:
    """Why the page is not current."""
    return f"This page is not current. {explain(error)}"


def problem_section() -> widgets.Section:
    """Section for why a page is not current; hidden with an empty text."""
    return widgets.Section(lambda text: widgets.notice(text, bad=True) if text else None).live()


def time_left(console: Console, deadline_s: float) -> None:
    """A text with the time left until then, by the site's clock and by the wall's."""

    def words() -> str:
        return pace.time_left(console.live.heartbeats.pace, deadline_s)

    # A screen reader reads it where it stands, and not at each change.
    shown = widgets.Text("span", words(), "soft").props('aria-live="off"')
    ui.timer(_LEFT_S, lambda: shown.set_text(words()))
