"""The organization at a glance: what needs a person, robots, the lab, what happened, the queue, the money,
the processes."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from functools import partial

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus.messages import Task
from rodeo.bus.queries import Wallet
from rodeo.display.formatting import brief, count, iec, party, share, span
from rodeo.judging.verdicts import WORDS, is_peoples_verdict, standing_words, verdict_words
from rodeo.text.strict_json import Json
from services.console.attention import Need, RobotState, Seen, needs, robots
from services.console.heartbeats import ProcessState
from services.console.lab_map import LabViews
from services.console.pages import frame, widgets
from services.console.pages.feed import FeedCard
from services.console.pages.frame import Console
from services.console.pages.seen import SeenCard


def draw(console: Console) -> None:
    with frame.page_head("Overview"):
        if frame.user().has(Role.OPERATOR):
            ui.button("Post a task", icon="add").props('unelevated href="/tasks/new"')
    problem = frame.problem_section()
    _draw_what_waits(console)
    with widgets.card("Lab"):
        lab_map = LabViews(console.lab, "robots and items").map
        seen = widgets.Section(_draw_seen)
    found = SeenCard(console)
    with widgets.card("Robots"):
        working = widgets.Section(partial(widgets.table, "Robots", _ROBOTS, none="This site has no robots."))
    with ui.element("div").classes("grid"):
        with ui.element("div").classes("stack span-7"):
            FeedCard(console)
        with ui.element("div").classes("stack span-5"):
            Work(console, problem)
    ui.link_target("processes").classes("visually-hidden")
    with widgets.card("Processes"):
        health = widgets.Section(partial(widgets.table, "Processes of this site", _PROCESSES))

    def show_robots() -> None:
        live = console.live
        working.show(robots(console.site, console.lab, live.heartbeats.processes, live.map["robots"]))

    def show_map() -> None:
        state = console.live.map
        lab_map.show(state)
        seen.show([*_seen(state)])
        show_robots()

    def show_processes() -> None:
        health.show(console.live.heartbeats.processes)
        show_robots()

    def show_found() -> None:
        things = console.live.summary.seen
        lab_map.show_things(things)
        found.show(things)

    frame.follow(console, "map", show_map)
    frame.follow(console, "organization", show_found)
    frame.follow(console, "processes", show_processes)


def _draw_what_waits(console: Console) -> None:
    """What the overview begins with: what waits for a person."""
    energy = console.kinds.providing("energy")
    charging = None if energy is None else energy.name
    with widgets.card("Needs a person"):
        found = widgets.Section(_draw_needs).waiting().live()

    def show() -> None:
        live = console.live
        processes = live.heartbeats.processes
        found.show(needs(Seen(console.site, live.summary, processes, frame.user(), charging, frame.when)))

    for what in ("processes", "organization"):
        frame.follow(console, what, show)


class Work:
    """What the organization does; `problem` says why that is not current."""

    def __init__(self, console: Console, problem: widgets.Section) -> None:
        self._live, self._problem = console.live, problem
        with ui.element("div").classes("grid tiles"):
            names = ("waiting", "being done", "paid so far")
            self._open, self._assigned, self._settled = (widgets.tile(name, "–", 4) for name in names)
        with widgets.card("Queue"):
            self._queue = widgets.Section(_draw_queue).waiting()
        with widgets.card("Last verdicts"):
            self._verdicts = widgets.Section(_draw_verdicts).waiting().live()
        with widgets.card("Wallets"):
            self._wallets = widgets.Section(_draw_wallets).waiting()
        frame.follow(console, "organization", self._show)

    def _show(self) -> None:
        summary = self._live.summary
        self._problem.show(f"This page is not current. {summary.problem}" if summary.problem else "")
        counts = summary.counts
        self._open.set_text(_count(counts, "open"))
        self._assigned.set_text(_count(counts, "assigned", "submitted", "ruled"))
        self._settled.set_text(_count(counts, "settled"))
        if counts:
            self._queue.show(summary.queue)
            self._verdicts.show(summary.verdicts)
            self._wallets.show(summary.wallets, summary.supply_iec)


def _count(counts: dict[str, int], *states: str) -> str:
    return f"{sum(counts.get(state, 0) for state in states):,}" if counts else "–"


def _seen(state: Json) -> Iterator[str]:
    """Where each robot's position comes from, in words that change rarely."""
    for name, one in state["robots"].items():
        if "x" not in one:
            yield f"{name} has not reported its position yet."
        elif not one["fresh"]:
            yield f"{name} is silent. The map shows its last known position."
        elif one["source"] != "motion capture":
            yield f"The position of {name} comes from its {one['source']}, which drifts."


def _draw_seen(words: list[str]) -> None:
    for text in words:
        widgets.Text("p", text, "soft")


def _draw_needs(found: list[Need]) -> None:
    if not found:
        widgets.empty("Nothing waits for a person.")
        return
    with ui.element("ul").classes("list"):
        for one in found:
            with ui.element("li"):
                widgets.Link(brief(one.text), one.href, "title")
                widgets.badge("alarm" if one.alarm else "waits", "bad" if one.alarm else "warn")


_ROBOTS: widgets.Columns[RobotState] = (
    widgets.Column("Robot", lambda one: widgets.Link(one.name, "/operator")),
    widgets.Column("State", lambda one: widgets.badge(one.mind.state)),
    widgets.Column("Battery", lambda one: share(one.soc), "number"),
    widgets.Column("Task", lambda one: _draw_task(one.mind.task_id), "wide-only"),
    widgets.Column("Place", lambda one: one.place, "wide-only"),
    widgets.Column("Last word", lambda one: _draw_word(one.mind), "wrap"),
)


def _draw_task(task_id: int | None) -> object:
    return "–" if task_id is None else widgets.Link(f"task {task_id}", f"/tasks/{task_id}")


def _draw_word(one: ProcessState) -> None:
    left = f", about {span(one.eta_s)} left" if one.eta_s is not None else ""
    widgets.Text("span", brief(one.doing or "–") + left)
    if one.progress is not None:
        widgets.progress_bar(one.progress, one.name)


def _said(process: ProcessState) -> str:
    """What it does, how far its clock is off where clocks may be off, and its warnings."""
    doing = process.job if process.state == "silent" else process.doing
    clock = [] if process.clock_off_s is None else [f"Clock {process.clock_off_s:+.2f} s"]
    return brief(". ".join([doing, *clock, *process.warnings]))


_PROCESSES: widgets.Columns[ProcessState] = (
    widgets.Column("Process", lambda one: one.name),
    widgets.Column("State", lambda one: widgets.badge(one.state)),
    widgets.Column("Status", _said, "wrap"),
)
_BALANCES: widgets.Columns[Wallet] = (
    widgets.Column("Wallet", lambda one: one.name),
    widgets.Column("IEC", lambda one: iec(one.balance_iec).removesuffix(" IEC"), "number"),
)


def _draw_queue(tasks: list[Task]) -> None:
    def draw(task: Task) -> None:
        widgets.badge(task.state)
        who = f" · {party(task.executor_name, task.executor)}" if task.executor else ""
        amount = task.reward_iec if task.price_iec is None else task.price_iec
        stands = ""
        if (said := task.standing) is not None:
            stands = f" · {standing_words(task, iec(said.amount_iec), frame.when(said.until))}"
        widgets.Text("span", f"{iec(amount)}{who}{stands}", "soft")

    widgets.task_list(tasks, draw, "No task is waiting or being done.")


def _draw_verdicts(tasks: list[Task]) -> None:
    def draw(task: Task) -> None:
        verdict = task.verdict or ""
        widgets.badge(WORDS.get(verdict, verdict))
        by_people = is_peoples_verdict(task)
        paid = f"{iec(task.paid_iec)} to {party(task.executor_name, task.executor)} · "
        said = f"{verdict_words(verdict, task.reason, None, by_people, task.fault)} · "
        ended = frame.when(task.settled or task.proof_submitted)
        widgets.Text("span", (paid if task.state == "settled" else "") + said + ended, "soft")

    widgets.task_list(tasks, draw, "No verdict yet.")


def _draw_wallets(wallets: list[Wallet], supply_iec: Decimal) -> None:
    full = [one for one in wallets if one.balance_iec]
    widgets.table("Balances", _BALANCES, full, "No wallet has IEC yet.")
    without = f"{count(len(wallets) - len(full), 'wallet')} without IEC. " if len(full) < len(wallets) else ""
    widgets.Text("p", f"{without}{iec(supply_iec)} are in circulation.", "soft")
