"""Orders to robots: wait, continue, charge, give up, stop."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus.queries import SERVICES, Offer
from rodeo.display.formatting import known_in_words, share, span
from rodeo.errors import RodeoError
from rodeo.text.strict_json import Json
from services.console.errors import RobotUnavailable
from services.console.lab_map import LabMap
from services.console.pages import frame, widgets
from services.console.pages.frame import Console

_ORDERS = (
    ("Pause", "pause_robot", "pause", "finishes its attempt, then waits"),
    ("Resume", "resume_robot", "play_arrow", "takes work again"),
    ("Charge", "charge_robot", "bolt", "buys a charge now"),
)
_ELSEWHERE = ("robot", "paused", "stopped", "charge_ordered", "progress")
"""Shown in the card's title, as a badge or as a bar."""
_HELD = {"stopped": "bad", "paused": "warn"}
_WORDS: dict[str, tuple[str, Callable[[float], str]]] = {
    "soc": ("Battery", share),
    "eta_s": ("Finished in", lambda left_s: f"about {span(left_s)}"),
}
_UNITS = {"km": "km", "m": "m", "w": "W", "wh": "Wh", "s": "s"}


def draw(console: Console) -> None:
    with frame.page_head("Operator"):
        if frame.user().has(Role.OPERATOR):
            stop = ui.button("Stop everything", icon="front_hand", color="negative")
            stop.props("unelevated").on_click(partial(_stop_all, console))
    if not frame.require("give orders to robots", Role.OPERATOR):
        return
    with ui.element("div").classes("grid"):
        with widgets.card("Lab", "span-7"):
            lab_map = LabMap(console.lab, "Map of the lab with robots and items")
            frame.follow(console, "map", lambda: lab_map.show(console.live.map))
        with ui.element("div").classes("stack span-5"):
            if not console.site.robots:
                widgets.empty("This site has no robots.")
            for robot in console.site.robots:
                RobotCard(console, robot.name)


class RobotCard:
    """One robot: its own report, and the orders that it takes."""

    def __init__(self, console: Console, robot: str) -> None:
        self._console = console
        self._robot = robot
        with widgets.card(robot):
            self._refresh = frame.follow_async(console, "processes", self._load)
            self._state = widgets.Section(self._draw).live()
            with ui.element("div").classes("line tight"):
                for word, action, icon, effect in _ORDERS:
                    ui.button(
                        word, icon=icon, on_click=partial(self._order, action, f"{robot} {effect}")
                    ).props(f'outline aria-label="{word} {robot}"')
                ui.button("Give up", icon="undo", on_click=self._cancel).props(
                    f'outline aria-label="Have {robot} give up its attempt"'
                )
                ui.button("Stop", icon="front_hand", color="negative", on_click=self._stop).props(
                    f'unelevated aria-label="Stop {robot}"'
                )

    async def _load(self) -> None:
        try:
            state = await frame.ask(self._console.queries.robot, self._robot)
        except RodeoError as error:
            if error.code in ("no_responder", "query_timeout"):
                raise RobotUnavailable("the robot's agent does not answer", robot=self._robot) from error
            raise
        offers = (await frame.ask(self._console.queries.ask, SERVICES, provider=self._robot)).services
        self._state.show(state, offers)

    def _draw(self, state: Json, offers: list[Offer]) -> None:
        with ui.element("div").classes("line tight"):
            held = next((one for one in _HELD if state.get(one)), "working")
            widgets.badge(held, _HELD.get(held, "good"))
            if state.get("charge_ordered"):
                widgets.badge("will charge", "info")
        with widgets.facts():
            if offers:
                pace = self._console.live.heartbeats.pace
                widgets.fact(
                    "Known as",
                    known_in_words(offers[0], frame.when, None if pace is None else pace.now_s),
                    "wrap",
                )
            if back := ", ".join(str(one.id) for one in offers if one.stood_back):
                widgets.fact("Services that stand back", back)
            for name, value in state.items():
                if name not in _ELSEWHERE and value not in (None, ""):
                    label, words = _said(name, value)
                    widgets.fact(label, words[:300], "wrap")
        if isinstance(state.get("progress"), int | float):
            widgets.progress_bar(float(state["progress"]), f"Progress of {self._robot}")

    async def _order(self, action: str, done: str) -> None:
        if await frame.act(self._console, action, {"robot": self._robot}, done) is not None:
            self._refresh()

    async def _cancel(self) -> None:
        lines = [("Robot", self._robot), ("Its attempt", "fails on chain; others may take the task")]
        if await widgets.confirm("Give up the attempt?", lines, "Give it up", danger=True):
            await self._order("cancel_robot", f"{self._robot} gives up its attempt")

    async def _stop(self) -> None:
        # No confirmation: a person who stops a robot has no time to answer.
        await self._order("stop_robot", f"{self._robot} stands still until it is resumed")


async def _stop_all(console: Console) -> None:
    reply = await frame.act(console, "stop_all", {})
    if reply is None:
        return
    if reply["silent"]:
        names = ", ".join(reply["silent"])
        ui.notify(f"No answer from {names}. Use the emergency stop on the robot.", type="negative", timeout=0,
                  close_button="Close")  # fmt: skip
    if reply["stopped"]:
        ui.notify(f"Stopped: {', '.join(reply['stopped'])}", type="positive")


def _said(name: str, value: Any) -> tuple[str, str]:
    """A field of an agent's report, as people read it: units are in the names."""
    if name in _WORDS and isinstance(value, int | float):
        label, words = _WORDS[name]
        return label, words(value)
    plain, _, unit = name.rpartition("_")
    label = (plain if unit in _UNITS else name).replace("_", " ").capitalize()
    if isinstance(value, bool):
        return label, "yes" if value else "no"
    text = f"{value:.3g}" if isinstance(value, float) else str(value)
    return label, f"{text} {_UNITS[unit]}" if unit in _UNITS else text
