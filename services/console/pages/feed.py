"""Events and alarms as a card of a page, with what somebody has not read marked."""

from __future__ import annotations

import time

from nicegui import ui

from rodeo.site.names import robot_process
from services.console.feed import Entry, entries
from services.console.pages import frame, widgets
from services.console.pages.frame import Console

SHOWN = 12
_ANY = ""


class FeedCard:
    def __init__(self, console: Console) -> None:
        self._console = console
        self._mark = console.accounts.mark(frame.user().name)
        names = [one.name for one in console.site.robots]
        self._robots = {robot_process(console.site, name): name for name in names}
        with widgets.card("Events and alarms") as head:
            with head:
                self._unread = widgets.Text("span", "", "soft").props('role="status"')
                self._read = ui.button("Mark as read", on_click=self._mark_read).props("flat dense")
            with ui.element("search").classes("filters").props('aria-label="Filter events"'):
                options = {_ANY: "Any robot", **{name: name for name in names}}
                self._robot = ui.select(options, value=_ANY, label="Robot", on_change=self._show)
                self._task = ui.input("Task", on_change=self._show).props("clearable debounce=300")
                self._alarms = ui.checkbox("Alarms only", on_change=self._show)
                for one in (self._robot, self._task):
                    one.props("outlined dense")
            self._rows = widgets.Section(_draw).live()
        frame.follow(console, "feed", self._show)

    def _all(self) -> list[Entry]:
        live = self._console.live
        return entries(live.events, live.notes.all, live.summary.names, self._robots, self._mark)

    def _show(self) -> None:
        found = self._all()
        unread = sum(one.unread for one in found)
        self._unread.set_text(f"{unread:,} new" if unread else "")
        self._read.visible = bool(unread)
        robot, task = self._robot.value, (self._task.value or "").strip().removeprefix("#")
        wanted = [
            one
            for one in found
            if robot in (_ANY, one.robot)
            and task in ("", str(one.task_id))
            and (one.alarm or not self._alarms.value)
        ]
        self._rows.show(wanted[:SHOWN], len(wanted))

    @widgets.on_page
    async def _mark_read(self) -> None:
        live = self._console.live
        newest = live.events[-1] if live.events else None
        chain, seq = ("", 0) if newest is None else (newest.chain, newest.seq)
        request = {"chain": chain, "seq": seq, "heard_s": time.time()}
        if await frame.act(self._console, "mark_read", request) is not None:
            self._mark = await frame.ask(self._console.accounts.mark, frame.user().name)
            self._show()


def _draw(shown: list[Entry], total: int) -> None:
    if not shown:
        widgets.empty("Nothing of this kind happened yet.")
        return
    with ui.element("ul").classes("list"):
        for one in shown:
            with ui.element("li"):
                widgets.Link(one.text, one.href, "title")
                with ui.element("span").classes("line tight"):
                    if one.unread:
                        widgets.badge("new", "info")
                    if one.alarm:
                        widgets.badge("alarm", "bad")
                widgets.Text("span", frame.when(one.time_s), "soft")
    if total > len(shown):
        widgets.Text("p", f"The newest {len(shown)} of {total:,}.", "soft")
