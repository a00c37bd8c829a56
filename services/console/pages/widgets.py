"""What pages are made of: cards, tables, badges, facts, dialogs; all text is escaped by the framework."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial, wraps
from typing import Any, Generic, ParamSpec, TypeVar

from nicegui import context, ui
from nicegui.elements.mixins.text_element import TextElement
from nicegui.events import UploadEventArguments

from rodeo.bus.messages import Task
from rodeo.display.formatting import STATE_COLOURS, count, kind, short
from rodeo.text.strict_json import Json

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")


class Text(TextElement):
    """A text in an element of the given tag."""

    def __init__(self, tag: str, text: str, classes: str = "") -> None:
        super().__init__(tag=tag, text=text)
        self.classes(classes)


class Link(TextElement):
    def __init__(self, text: str, href: str, classes: str = "") -> None:
        super().__init__(tag="a", text=text)
        self.classes(classes)
        self._props["href"] = href


def badge(word: str, colour: str | None = None) -> Text:
    """A state in a word, coloured by what it means."""
    return Text("span", word, f"badge {STATE_COLOURS.get(word, '') if colour is None else colour}")


Button = tuple[str, str, Callable[[], Any]]
"""Words, icon, and what a click does."""


@contextmanager
def card(title: str, classes: str = "", button: Button | None = None) -> Iterator[ui.element]:
    """A titled region; the returned element is its head, for more than a button."""
    with ui.element("section").classes(f"card {classes}") as section:
        with ui.element("div").classes("card-head") as head:
            heading = Text("h2", title)
            ui.element("span").classes("grow")
            if button is not None:
                words, icon, on_click = button
                ui.button(words, icon=icon, on_click=on_click).props("flat dense")
        section.props(f'aria-labelledby="{heading.html_id}"')
        yield head


def cards(noun: str, some: Iterable[Any], draw: Callable[[Any], object]) -> None:
    """A card for each, with its number and its state."""
    with ui.element("div").classes("stack"):
        for one in some:
            with card(f"{noun} {one.number}") as head:
                with head:
                    badge(one.state)
                draw(one)


def retitle(head: ui.element, title: str) -> None:
    """Give the card with this head another title."""
    heading = head.default_slot.children[0]
    assert isinstance(heading, Text)
    heading.set_text(title)


def tile(name: str, value: str, span: int = 3) -> Text:
    """A number that matters; returns its text."""
    with ui.element("div").classes(f"tile span-{span}"):
        shown = Text("div", value, "value")
        Text("div", name, "name")
    return shown


def empty(text: str) -> None:
    Text("p", text, "empty")


def task_list(tasks: Sequence[Task], draw: Callable[[Task], object], none: str) -> None:
    """Links to tasks, each with what `draw` shows of it; `none` where there are none."""
    if not tasks:
        empty(none)
        return
    with ui.element("ul").classes("list"):
        for task in tasks:
            with ui.element("li"):
                Link(f"{task.id} · {kind(task.kind)}", f"/tasks/{task.id}", "title")
                draw(task)


def notice(text: str, bad: bool = False) -> None:
    Text("p", text, "notice bad" if bad else "notice").props('role="status"')


@contextmanager
def facts() -> Iterator[None]:
    with ui.element("dl").classes("facts"):
        yield


def fact(name: str, value: str | Callable[[], Any], classes: str = "") -> None:
    """One line of `facts`; `value` may be a function that builds elements."""
    Text("dt", name)
    if isinstance(value, str):
        Text("dd", value, classes)
    else:
        with ui.element("dd").classes(classes):
            value()


def hash_text(value: str) -> ui.element:
    """A hash or address with its ends shown, the whole as a tooltip and for copying."""
    with ui.element("span").classes("line hash") as shown:
        Text("span", short(value), "mono").props(f'title="{value}"')
        copy = ui.button(icon="content_copy", on_click=lambda: _copy(value))
        copy.props(f'flat dense round size=sm aria-label="Copy {short(value)}"')
    return shown


async def _copy(value: str) -> None:
    ui.clipboard.write(value)
    ui.notify("Copied")


@dataclass(frozen=True)
class Column(Generic[R]):
    """`cell` returns the text of a row's cell, or builds its elements."""

    title: str
    cell: Callable[[R], object]
    classes: str = ""


Columns = Sequence[Column[R]]


def table(caption: str, columns: Columns[R], rows: Iterable[R], none: str = "") -> None:
    """`none` is shown where there are no rows."""
    if not (rows := list(rows)) and none:
        empty(none)
        return
    with ui.element("div").classes("table-scroll"), ui.element("table").classes("data"):
        Text("caption", caption, "visually-hidden")
        with ui.element("thead"), ui.element("tr"):
            for one in columns:
                # A header without a word would be read as one.
                head = Text("th" if one.title else "td", one.title, one.classes)
                head.props('scope="col"' if one.title else "")
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for one in columns:
                        with Text("td", "", one.classes) as cell:
                            if isinstance(said := one.cell(row), str):
                                cell.set_text(said)


def pager(page: int, rows: int, total: int, noun: str, turn: Callable[[int], None]) -> None:
    """Which rows of a list this page shows, and the way to the others; `turn` is called with a page."""
    pages = max(1, -(-total // rows))
    with ui.element("nav").classes("line").props('aria-label="Pages of the list"'):
        first, last = (page - 1) * rows + 1, min(total, page * rows)
        shown = count(total, noun) if pages == 1 else f"{first:,} to {last:,} of {total:,}"
        Text("span", shown, "soft").props('aria-live="polite"')
        ui.element("span").classes("grow")
        if pages > 1:
            ui.pagination(
                1, pages, value=page, direction_links=True, on_change=lambda event: turn(int(event.value))
            ).props("max-pages=7 boundary-numbers")


def progress_bar(value: float, label: str) -> None:
    percent = round(100 * min(max(value, 0.0), 1.0))
    bar = ui.element("div").classes("bar")
    bar.props(f'role="progressbar" aria-label="{label}"')
    bar.props(f'aria-valuemin="0" aria-valuemax="100" aria-valuenow="{percent}"')
    with bar:
        ui.element("div").style(f"width: {percent}%")


_ARRIVES_S = 60.0
"""Wall time for which a click waits for a file that is still on its way."""


class FileDrop(ui.upload):
    """Takes files that are dropped on it, or chosen with its button. `words` follow those of the button."""

    def __init__(
        self, words: str, accept: str, take: Callable[[UploadEventArguments], Awaitable[None]], **how: Any
    ) -> None:
        super().__init__(auto_upload=True, on_upload=self._take, **how)
        self.ignores_events_when_hidden = False  # an upload that has begun ends
        self._handler, self._on_their_way = take, 0
        # The browser says these two in order with what else is done on the page, unlike the upload itself.
        self.on("start", partial(self._count, 1), args=[])
        self.on("finish", partial(self._count, -1), args=[])
        self._all_taken = asyncio.Event()
        self._count(0)
        self.props(f'flat bordered accept="{accept}"').classes("file-drop")
        # Quasar's own head has a button and an entry without names, one inside the other.
        self.add_slot(
            "header",
            f"""<q-btn flat dense icon="add" label="Choose a file" @click="props.pickFiles" />
            <span>{words}</span><q-uploader-add-trigger />""",
        )

    @property
    def is_waiting(self) -> bool:
        """Whether files are still on their way."""
        return not self._all_taken.is_set()

    async def all_taken(self, button: ui.button) -> bool:
        """Wait for files that are still on their way; so does the button with which the person continues.
        False, which is said, where they take too long."""
        if self.is_waiting:
            button.disable()
            try:
                await asyncio.wait_for(self._all_taken.wait(), _ARRIVES_S)
            except TimeoutError:
                if not button.is_deleted:
                    ui.notify(
                        "A file has not arrived yet: wait for it, or load the page again", type="warning"
                    )
            finally:
                button.enable()
        return not self.is_waiting

    async def _take(self, event: UploadEventArguments) -> None:
        self._count(1)
        try:
            await self._handler(event)
        finally:
            self._count(-1)

    def _count(self, more: int) -> None:
        self._on_their_way += more
        (self._all_taken.clear if self._on_their_way else self._all_taken.set)()


def picture(source: str, alt: str) -> ui.element:
    """A photo, as large as its place."""
    image = ui.element("img")
    image.props["src"], image.props["alt"] = source, alt
    return image.style("max-width: 100%; max-height: 320px; border-radius: 8px")


def pictures(shown: list[Json]) -> None:
    """The pictures of a recording side by side, as `replay.pictures` has them."""
    with ui.element("div").classes("lab-pictures"):
        for one in shown:
            with ui.element("figure"):
                picture(one["src"], f"Picture from {one['from']}")
                Text("figcaption", f"{one['from']}, {one['t']:.0f} s")


class _Redrawn(ui.element, component="section.js"):
    """Keeps the keyboard's focus when its content is replaced."""


class Section:
    """A part of a page that is redrawn only when its content has changed."""

    def __init__(self, draw: Callable[..., None]) -> None:
        self._element = _Redrawn().classes("section")
        self._draw = draw
        self._shown: Any = None

    def live(self) -> Section:
        """Have screen readers announce changes."""
        self._element.props('aria-live="polite"')
        return self

    def waiting(self) -> Section:
        """Say that the answer has not come yet."""
        with self._element:
            empty("Loading …")
        return self

    def show(self, *data: Any) -> None:
        if self._shown == data:
            return
        self._shown = data
        self._element.clear()
        with self._element:
            self._draw(*data)


def on_page(handler: Callable[P, Awaitable[T]]) -> Callable[P, Awaitable[T]]:
    """Run a click's handler on the page itself: the section that was clicked on may be redrawn, and take its
    dialogs with it, before the handler has finished.
    """

    @wraps(handler)
    async def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with context.client:
            return await handler(*args, **kwargs)

    return run


@contextmanager
def modal(title: str, classes: str = "") -> Iterator[ui.dialog]:
    """A dialog to be awaited. It is removed once it has closed: on closing, the browser gives the focus back
    to what opened it.
    """
    with ui.dialog() as dialog, ui.card().classes(classes):
        heading = Text("h2", title)
        dialog.props(f'aria-labelledby="{heading.html_id}"')
        yield dialog
    dialog.on("hide", dialog.delete)


def dialog_buttons(
    dialog: ui.dialog, action: str, on_click: Callable[[], Any], danger: bool = False
) -> ui.button:
    """The way back, and the returned button, which does it."""
    with ui.element("div").classes("dialog-buttons"):
        ui.button("Back", on_click=lambda: dialog.submit(None)).props("flat")
        color = "negative" if danger else "primary"
        return ui.button(action, on_click=on_click, color=color).props("unelevated")


async def confirm(title: str, lines: Sequence[tuple[str, str]], action: str, danger: bool = False) -> bool:
    """Ask before money moves or something stops; `lines` say what will happen."""
    with modal(title) as dialog:
        with facts():
            for name, value in lines:
                fact(name, value, "wrap")
        button = dialog_buttons(dialog, action, lambda: dialog.submit(True), danger)
        button.props("autofocus")
    return bool(await dialog)


@dataclass(frozen=True)
class Field:
    """One entry of a form; `choices` are {value: words}."""

    label: str
    start: str = ""
    choices: dict[str, str] | None = None
    several: bool = False
    """Any number of the choices; the answer has commas in between."""
    secret: str = ""
    """What a browser may fill in: current-password or new-password."""
    hint: str = ""
    """A sentence below it."""

    def draw(self) -> Any:
        """The entry, with its hint."""
        entry = self._entry()
        return entry.props(f"hint={json.dumps(self.hint)}") if self.hint else entry

    def _entry(self) -> Any:
        if self.choices is None:
            entry: Any = ui.input(self.label, value=self.start, password=bool(self.secret))
            return entry.props(f"autocomplete={self.secret}") if self.secret else entry
        if self.several:
            chosen = [one for one in self.start.split(",") if one in self.choices]
            return ui.select(self.choices, label=self.label, value=chosen, multiple=True).props("use-chips")
        start = self.start if self.start in self.choices else next(iter(self.choices), None)
        return ui.select(self.choices, label=self.label, value=start)


async def ask_form(
    title: str, fields: dict[str, Field], action: str, perform: Callable[[dict[str, str]], Awaitable[bool]]
) -> None:
    """Ask for a few texts and `perform` with them; the form stays until that succeeds or it is closed."""
    entries: dict[str, Any] = {}

    async def attempt() -> None:
        button.props("loading")
        try:
            if await perform({name: _entered(entry) for name, entry in entries.items()}):
                dialog.submit(True)
        finally:
            button.props(remove="loading")

    with modal(title) as dialog:
        dialog.props("no-backdrop-dismiss")
        with ui.element("div").classes("form").style("width: 100%"):
            for name, field in fields.items():
                entries[name] = field.draw().props("outlined dense").classes("whole")
        next(iter(entries.values())).props("autofocus")
        button = dialog_buttons(dialog, action, attempt)
    await dialog


def _entered(entry: Any) -> str:
    if isinstance(entry.value, list):
        return ",".join(entry.value)
    text = str(entry.value or "")
    return text if entry.props.get("type") == "password" else text.strip()
