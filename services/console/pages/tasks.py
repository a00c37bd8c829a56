"""The list of tasks, and the form that posts one."""

from __future__ import annotations

import asyncio
import math
import uuid
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.bus.session import validate
from rodeo.commands.tasks import RegisterTask
from rodeo.display.formatting import exact, explain, iec, kind, party, span
from rodeo.errors import InvalidRequest, MalformedJson, QueryTimeout, RodeoError
from rodeo.person.pace import runs_fast
from rodeo.text.strict_json import Json
from services.console.lab_map import LabMap
from services.console.pages import frame, widgets
from services.console.pages.frame import Console
from services.console.pages.parameters import Parameters
from services.console.posting import hireable, hired, problems
from services.console.scene import in_bins

PAGE_ROWS = 25
MAX_PAGES = 10**6
MAX_SEARCH = 200
"""Characters, as many as the bridge takes."""
_MAX_DIGITS = 18
_BESIDE_M = 0.3
"""A click so near to an item is about the item."""
_STATES = ("open", "assigned", "submitted", "ruled", "settled", "failed", "cancelled")
_ANY = ""
_ANY_SERVICE = "any service"


def register(console: Console) -> None:
    @frame.at(console, "/tasks")
    def tasks(page: int = 1, state: str = _ANY, kind_: str = _ANY, text: str = "") -> None:
        with frame.page(console, "Tasks", "/tasks", heading=False):
            page = min(max(1, page), MAX_PAGES)
            _list(console, page, state if state in _STATES else _ANY, kind_, text[:MAX_SEARCH])

    @frame.at(console, "/tasks/new")
    def new(like: int | None = None, seen: int | None = None) -> None:
        with frame.page(console, "Post a task", "/tasks", heading=False):
            frame.page_head("Post a task", "Its reward goes into escrow until the work is proven.")
            if frame.require("post tasks", Role.OPERATOR):
                PostForm(console, like, seen)


def _list(console: Console, page: int, state: str, kind_: str, text: str) -> None:
    with frame.page_head("Tasks"):
        if frame.user().has(Role.OPERATOR):
            ui.button("Post a task", icon="add").props('unelevated href="/tasks/new"')
    wanted: Json = {"page": page, "state": state, "kind": kind_, "text": text}

    def choose(**values: Any) -> None:
        wanted.update({"page": 1, **values})
        known = {"kind_" if name == "kind" else name: value for name, value in wanted.items()}
        query = urlencode({name: value for name, value in known.items() if value not in ("", 1)})
        ui.navigate.history.replace(f"/tasks?{query}" if query else "/tasks")
        refresh()

    with ui.element("search").classes("filters").props('aria-label="Filter tasks"'):
        states = {_ANY: "Any state", **{name: name for name in _STATES}}
        ui.select(states, value=state, label="State", on_change=lambda e: choose(state=e.value)).props(
            "outlined dense"
        )
        kinds = {_ANY: "Any kind", **({kind_: kind(kind_)} if kind_ else {})}
        kind_select = ui.select(kinds, value=kind_, label="Kind", on_change=lambda e: choose(kind=e.value))
        kind_select.props("outlined dense")
        search = ui.input("Number or words", value=text, on_change=lambda e: choose(text=e.value or ""))
        search.props(f"outlined dense clearable debounce=300 maxlength={MAX_SEARCH}").style(
            "flex: 1; max-width: 320px"
        )

    async def load() -> None:
        (found, total), chain = await asyncio.gather(
            frame.ask(_find, console, wanted), frame.ask(console.queries.ask, queries.CHAIN)
        )
        last = max(1, -(-total // PAGE_ROWS))
        if wanted["page"] > last:
            wanted["page"] = last
            found, total = await frame.ask(_find, console, wanted)
        kind_select.set_options({_ANY: "Any kind", **{name: kind(name) for name in chain.kinds}})
        rows.show(found, bool(wanted["state"] or wanted["kind"] or wanted["text"]))
        pager.show(total, wanted["page"])

    refresh = frame.follow_async(console, "events", load)
    with ui.element("section").classes("card").props('aria-label="Tasks"'):
        rows = widgets.Section(_draw_rows).waiting()
        pager = widgets.Section(
            lambda total, at: widgets.pager(at, PAGE_ROWS, total, "task", lambda to: choose(page=to))
        )


def _find(console: Console, wanted: Json) -> tuple[list[Task], int]:
    text = wanted["text"].strip().removeprefix("#")
    if text.isdecimal() and len(text) <= _MAX_DIGITS:
        try:
            return [console.queries.task(int(text))], 1
        except RodeoError as error:
            if error.code != "unknown_task":
                raise
            return [], 0
    return console.queries.tasks(
        PAGE_ROWS,
        (wanted["page"] - 1) * PAGE_ROWS,
        state=wanted["state"] or None,
        kind=wanted["kind"] or None,
        text=text or None,
    )


_TASKS: widgets.Columns[Task] = (
    widgets.Column("Task", lambda one: _name(one)),
    widgets.Column("State", lambda one: widgets.badge(one.state)),
    widgets.Column("Reward", lambda one: iec(one.reward_iec), "number"),
    widgets.Column("Executor", lambda one: party(one.executor_name, one.executor), "wide-only"),
    widgets.Column("Attempt", lambda one: f"{one.attempt}/{one.max_attempts}", "number wide-only"),
    widgets.Column("Posted", lambda one: frame.when(one.registered), "plain wide-only"),
)


def _draw_rows(tasks: list[Task], filtered: bool) -> None:
    none = "No task fits this filter." if filtered else "No task was posted yet."
    widgets.table("Tasks, newest first", _TASKS, tasks, none)


def _name(task: Task) -> None:
    widgets.Link(f"{task.id} · {kind(task.kind)}", f"/tasks/{task.id}")
    if task.description:
        widgets.Text("div", task.description[:120], "soft wrap")


_OTHER = ""
"""A kind that is not installed here."""


@dataclass(frozen=True)
class _Sending:
    """A request, which is carried out once."""

    request_id: str = field(default_factory=lambda: f"console-{uuid.uuid4()}")
    seen: int | None = None
    """The seen thing that it confirms."""


class PostForm:
    """The form for a new task, checked while it is filled in and again before anything is sent."""

    def __init__(self, console: Console, like: int | None, seen: int | None) -> None:
        """Filled in like the task `like`, or about the seen thing `seen`."""
        self._console = console
        site = console.site
        self._sending = _Sending()
        with ui.element("div").classes("grid"):
            with ui.element("div").classes("stack span-5"), widgets.card("Task"):
                with ui.element("div").classes("form"):
                    known = {name: kind(name) for name in console.kinds}
                    self.kind = ui.select(known, value=next(iter(known), None), label="Kind")
                    self.kind.on_value_change(self._kind_chosen)
                    self._parameters = {
                        name: Parameters(site, one, self._changed)
                        for name, one in (*console.kinds.items(), (_OTHER, None))
                    }
                    for params in self._parameters.values():
                        if (item := params.field("item")) is not None:
                            item.on_value_change(self._item_chosen)
                        for place in (params.field("map-x"), params.field("map-y")):
                            if place is not None:
                                place.on_value_change(self._typed)
                    # Proposed at once: an input that is given its text later says so once the page listens,
                    # over what was typed until then.
                    self.reward = ui.input(
                        "Reward (IEC)", value=self._usual_reward(), on_change=self._changed
                    )
                    self.window = ui.number("Time to do it (min)", min=1, max=10080, on_change=self._changed)
                    self.attempts = ui.number("Attempts", min=1, max=20, precision=0, on_change=self._changed)
                    self.attempts.value = site.economy.max_attempts
                    if runs_fast(site):
                        self.window.props('hint="of site time, which runs faster"')
                    # Shown where there is a choice.
                    self.rules = ui.select({_ANY: "the newest"}, value=_ANY, label="Judged by the rules")
                    self.service = ui.select(
                        {_ANY: _ANY_SERVICE}, value=_ANY, label="Service", on_change=self._changed
                    ).classes("whole")
                    self.description = ui.input("Note for people").classes("whole")
                    self.wait = ui.checkbox(
                        "Queue it if every service costs more", on_change=self._changed
                    ).classes("whole")
                for field in (
                    self.kind, self.reward, self.window, self.attempts, self.rules, self.service,
                    self.description,
                ):  # fmt: skip
                    field.props("outlined dense")
                self.description.props("maxlength=2000")
                self._hints = widgets.Section(_draw_hints).live()
                self.post = ui.button("Review and post", on_click=self._review).props("unelevated")
            with ui.element("div").classes("stack span-7 pickable"), widgets.card("Place") as head:
                with head:
                    self._where = widgets.Text("span", "", "soft")
                self.map = LabMap(console.lab, "Map of the lab: click on the place", self._picked)
        self._summary_changed()
        self._begin(like, seen)
        frame.follow(console, "map", self._map_changed)
        frame.follow(console, "organization", self._summary_changed)
        self._changed()

    def _begin(self, like: int | None, seen: int | None) -> None:
        if like is not None:
            ui.timer(0, lambda: self._copy(like), once=True)
            return
        self._kind_chosen()
        if seen is not None:
            ui.timer(0, lambda: self._confirm(seen), once=True)

    # -- filling in ------------------------------------------------------------------------------------

    async def _copy(self, task_id: int) -> None:
        """Fill in what another task asked for."""
        if (task := await frame.asked(self._console.queries.task, task_id)) is None:
            return
        self.kind.set_options({**dict(self.kind.options), task.kind: kind(task.kind)}, value=task.kind)
        self._shown().fill(task.params)
        if (item := self._shown().field("item")) is not None and item.value != task.params.get("item_id"):
            self._item_chosen()  # that of the other task lies in a bin now
        self.reward.value = exact(task.reward_iec).removesuffix(" IEC").replace(",", "")
        self.window.value = task.execution_window_s / 60
        self.attempts.value = task.max_attempts
        self.description.value = task.description
        self._offer_services()
        for named in (str(task.requested_service_id), task.requested_provider):
            if named in self.service.options:
                self.service.value = named
        self._changed()

    async def _confirm(self, number: int) -> None:
        """Fill in what a task about a seen thing asks for."""
        if (found := await frame.asked(self._console.queries.ask, queries.SEEN)) is None:
            return
        one = next((one for one in found.things if (one.id, one.state) == (number, "open")), None)
        if one is None:
            ui.notify("A task is about this thing already, or it is gone", type="warning")
            return
        # Two people who confirm it at the same time get one task.
        self._sending = _Sending(one.request_id, one.id)
        self.kind.value = one.kind
        item = self._shown().field("item")
        if item is not None and "" in item.options:
            item.value = ""
        for form, value in (("map-x", one.x_m), ("map-y", one.y_m), ("photo", one.photo)):
            if (field := self._shown().field(form)) is not None:
                field.value = value
        self._changed()

    def _map_changed(self) -> None:
        state = self._console.live.map
        self.map.show(state)
        inside = in_bins(self._console.site, state["items"])
        for params in self._parameters.values():
            params.offer_items(inside)
        item = self._shown().field("item")
        proposed = self._shown().proposed
        if item is None or not state["items"].get(item.value, {}).get("fresh"):
            return
        if self._place() == proposed != self._whereabouts(item.value):
            self._item_chosen()  # nobody has typed another place

    def _shown(self) -> Parameters:
        """The fields of the kind that is chosen."""
        return self._parameters.get(self.kind.value, self._parameters[_OTHER])

    def _usual_reward(self) -> str:
        """What the kind usually costs; empty where that is not known."""
        chosen = self._console.kinds.get(self.kind.value)
        return str(chosen.price_iec) if chosen is not None and chosen.price_iec else ""

    def _kind_chosen(self) -> None:
        """Propose what the kind usually costs and takes."""
        chosen = self._console.kinds.get(self.kind.value)
        if chosen is not None:
            self.window.value = chosen.execution_window_s / 60
            self.reward.value = self._usual_reward() or self.reward.value
        self._offer_rules()
        self._offer_services()
        self._item_chosen()

    def _offer_rules(self) -> None:
        """Let one of the kind's current rules be chosen, where there are several."""
        current = self._console.live.summary.rules.get(self.kind.value, [])
        offered = {_ANY: "the newest", **{one: f"{one[:18]}…" for one in reversed(current)}}
        if offered != self.rules.options:
            self.rules.set_options(offered, value=self.rules.value if self.rules.value in offered else _ANY)
        self.rules.visible = len(current) > 1

    def _offer_services(self) -> None:
        """Let one of the kind's services be named, or a provider of several."""
        offered = {_ANY: _ANY_SERVICE, **hireable(self._console.live.summary.services, self.kind.value)}
        if offered != self.service.options:
            chosen = self.service.value
            self.service.set_options(offered, value=chosen if chosen in offered else _ANY)

    def _item_chosen(self) -> None:
        """Propose where the item is seen now, or where the site file put it."""
        params = self._shown()
        item, x, y = params.field("item"), params.field("map-x"), params.field("map-y")
        if item is not None and item.value and x is not None and y is not None:
            x.value, y.value = params.proposed = self._whereabouts(item.value)
        self._typed()

    def _whereabouts(self, item_id: str) -> tuple[float, float]:
        """Where the item is seen now, or where the site file put it."""
        seen = self._console.live.map["items"].get(item_id)
        if seen is not None and seen["fresh"]:
            return round(seen["x"], 2), round(seen["y"], 2)
        pose = next(one.pose for one in self._console.site.items if one.id == item_id)
        return round(pose.x_m, 2), round(pose.y_m, 2)

    def _place(self) -> tuple[float, float] | None:
        x, y = self._shown().field("map-x"), self._shown().field("map-y")
        chosen = x is not None and y is not None and x.value is not None and y.value is not None
        return (x.value, y.value) if chosen else None

    def _picked(self, x_m: float, y_m: float) -> None:
        """A click beside an item is about it; elsewhere about whatever lies there, where that can be done."""
        item, x, y = (self._shown().field(form) for form in ("item", "map-x", "map-y"))
        if x is None or y is None:
            return
        if item is not None and "" in item.options:
            near = {one: math.dist(self._whereabouts(one), (x_m, y_m)) for one in item.options if one}
            nearest = min(near, key=lambda one: near[one], default="")
            item.value = nearest if near.get(nearest, math.inf) <= _BESIDE_M else ""
        x.value, y.value = x_m, y_m

    def _typed(self) -> None:
        if hasattr(self, "map"):
            self.map.mark_place(self._place())
        self._changed()

    def _summary_changed(self) -> None:
        kinds = {service.kind for service in self._console.live.summary.services}
        known = {name: kind(name) for name in sorted({*kinds, *self.kind.options})}
        if known != self.kind.options:
            self.kind.set_options(known)
        self._offer_rules()
        self._offer_services()
        self._changed()

    def _changed(self) -> None:
        if not hasattr(self, "map"):
            return
        for params in self._parameters.values():
            params.show(params is self._shown())
        place = self._place()
        self._where.set_text("" if place is None else f"{place[0]:.2f} m east, {place[1]:.2f} m north")
        self._hints.show(tuple(self._problems()))

    # -- checking --------------------------------------------------------------------------------------

    def _request(self) -> RegisterTask:
        """What the form says. Raises InvalidRequest, MalformedJson."""
        try:
            reward = Decimal(str(self.reward.value).replace(",", "").strip())
        except InvalidOperation:
            raise InvalidRequest(
                "the reward is not a number", fields={"reward_iec": "a number of IEC"}
            ) from None
        params, chosen = self._shown().values(), self._console.kinds.get(self.kind.value)
        if chosen is not None:
            params = chosen.complete(self._console.site, params)
        request: Json = {
            "request_id": self._sending.request_id,
            "kind": self.kind.value,
            "reward_iec": reward,
            "params": params,
            "description": self.description.value or "",
            "allow_wait": self.wait.value,
            "execution_window_s": round(self.window.value * 60) if self.window.value else None,
            "max_attempts": int(self.attempts.value) if self.attempts.value else None,
            "rules_sha256": self.rules.value or None,
            **(hired(self.service.value) if self.service.value else {}),
        }
        request = {name: value for name, value in request.items() if value is not None}
        return validate(RegisterTask, request)

    def _problems(self) -> list[str]:
        """What keeps the task from being posted."""
        try:
            request = self._request()
        except (InvalidRequest, MalformedJson) as error:
            return [explain(error)]
        summary = self._console.live.summary
        wrong = [
            text[:1].upper() + text[1:]
            for text in problems(self._console.site, self._console.kinds, request).values()
        ]
        if summary.problem:
            return [*wrong, summary.problem]
        prices = [
            one.price_iec
            for one in summary.services
            if one.id == request.service_id
            or (one.kind == request.kind and one.state == "active" and request.service_id is None
                and request.provider in (None, one.provider))
        ]  # fmt: skip
        if not request.allow_wait and prices and min(prices) > request.reward_iec:
            of = "kind" if request.provider is None else "provider"
            which = f"The cheapest service of this {of}" if request.service_id is None else "This service"
            wrong.append(f"{which} costs {iec(min(prices))}")
        balance = self._balance()
        if balance is not None and balance < request.reward_iec:
            wrong.append(f"The organization has only {iec(balance)}")
        return wrong

    def _balance(self) -> Decimal | None:
        wallets = self._console.live.summary.wallets
        return next((one.balance_iec for one in wallets if one.name == "organization"), None)

    # -- posting ---------------------------------------------------------------------------------------

    async def _review(self) -> None:
        if not await self._shown().photos_taken(self.post):
            return
        if self._problems():
            self._changed()
            ui.notify("Correct the marked fields first", type="warning")
            return
        request = self._request()
        reward = exact(request.reward_iec)
        service = self.service.options[self.service.value]
        lines = [
            ("Kind", kind(request.kind)), ("Reward", reward), ("Service", service), *self._shown().told()
        ]  # fmt: skip
        if request.execution_window_s is not None:
            lines.append(("Time to do it", f"{span(request.execution_window_s)} of site time"))
        if request.rules_sha256 is not None:
            lines.append(("Rules", request.rules_sha256))
        balance = self._balance()
        if balance is not None:
            lines.append(("Organization after", iec(balance - request.reward_iec)))
        if (doubt := await frame.asked(self._console.actions.doubt, request)) is None:
            return
        lines += [("Mind", doubt)] if doubt else []
        if not await widgets.confirm("Post this task?", lines, f"Pay {reward} into escrow"):
            return
        self.post.disable()
        try:
            reply = await frame.ask(self._console.actions.perform, frame.user(), "post_task", request)
        except RodeoError as error:
            if self._sending.seen is None and not isinstance(error, QueryTimeout):
                # After a time-out the same request may be sent again and is carried out once.
                self._sending = _Sending()
            frame.fail(error)
        else:
            if self._sending.seen is not None:
                said = {"id": self._sending.seen, "what": "confirmed"}
                await frame.act(self._console, "say_of_seen", said)
            ui.navigate.to(f"/tasks/{reply['task_id']}")
        finally:
            self.post.enable()


def _draw_hints(hints: tuple[str, ...]) -> None:
    for hint in hints:
        widgets.Text("p", hint, "notice")
