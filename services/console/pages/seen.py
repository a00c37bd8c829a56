"""What robots have seen on the floor: a list whose entries people confirm, dismiss or correct."""

from __future__ import annotations

from functools import partial
from typing import get_args

from nicegui import ui

from rodeo.bus.queries import SeenThing, Word
from services.console.pages import frame, widgets
from services.console.pages.frame import Console

_CLASSES = {word: word for word in get_args(Word) if word not in ("confirmed", "dismissed")}
_WIDE = 'padding="4px 12px"'


class SeenCard:
    """Is not shown while nothing lies there."""

    def __init__(self, console: Console) -> None:
        self._console = console
        ui.link_target("seen").classes("visually-hidden")
        with ui.element("div") as self._whole, widgets.card("Seen on the floor"):
            self._list = widgets.Section(self._draw).live()

    def show(self, things: list[SeenThing]) -> None:
        self._whole.set_visibility(bool(things))
        self._list.show(things)

    def _draw(self, things: list[SeenThing]) -> None:
        with ui.element("ul").classes("list seen"):
            for one in things:
                with ui.element("li").props(f'aria-label="Thing {one.id}"'):
                    widgets.picture(f"/files/photo/{one.photo}", f"Thing {one.id}, as {one.robot} saw it")
                    with ui.element("div"):
                        self._draw_words(one)
                    with ui.element("div").classes("line"):
                        self._draw_choices(one)

    def _draw_words(self, one: SeenThing) -> None:
        widgets.Text("div", f"{one.id} · {one.x_m:.2f} m east, {one.y_m:.2f} m north", "title")
        size = " × ".join(f"{100 * extent:.0f}" for extent in one.size_m)
        widgets.Text("div", f"{size} cm · {one.robot} · seen {frame.when(one.first_s)}", "soft end")
        if one.said:
            said = "; ".join(f"{word.who}: {word.what}" for word in one.said)
            widgets.Text("div", said, "soft end")

    def _draw_choices(self, one: SeenThing) -> None:
        if one.task_id is not None:
            widgets.badge(one.state)
            widgets.Link(f"task {one.task_id}", f"/tasks/{one.task_id}")
        if not frame.may("say_of_seen"):
            return
        if one.state == "open":
            ui.button("Confirm").props(f'unelevated {_WIDE} href="/tasks/new?seen={one.id}"')
            ui.button("Dismiss", on_click=partial(self._say, one, "dismissed")).props(f"outline {_WIDE}")
        ui.button("Correct", on_click=partial(self._correct, one)).props(f"flat {_WIDE}")

    async def _say(self, one: SeenThing, what: str) -> bool:
        request = {"id": one.id, "what": what}
        return await frame.act(self._console, "say_of_seen", request, f"Kept: {what}") is not None

    @widgets.on_page
    async def _correct(self, one: SeenThing) -> None:
        async def say(answer: dict[str, str]) -> bool:
            return await self._say(one, answer["what"])

        field = widgets.Field("Class", choices=_CLASSES)
        await widgets.ask_form(f"What is thing {one.id}?", {"what": field}, "Keep", say)
