"""The organization at a glance: the lab, who does what, the queue, the money, the health of every process."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus.messages import Task
from rodeo.bus.queries import Wallet
from rodeo.display.formatting import iec, moment, party, process, share, span
from rodeo.judging.verdicts import WORDS, is_peoples_verdict, standing_words, verdict_words
from rodeo.text.strict_json import Json
from services.console.heartbeats import ProcessState
from services.console.lab_map import LabViews
from services.console.pages.frame import Console, follow, frame, page_head, problem_section, user
from services.console.pages.widgets import (
    Section,
    Text,
    badge,
    card,
    empty,
    progress_bar,
    table,
    task_list,
    tile,
)

_WORKERS = ("robot_agent", "charger", "itrash", "oracle")
"""Processes that do something which people want to follow."""


def register(console: Console) -> None:
    @ui.page("/")
    def overview() -> None:
        with frame(console, "Overview", "/", heading=False):
            with ui.element("div").classes("page-head"):
                page_head("Overview")
                ui.element("span").classes("grow")
                if user().has(Role.OPERATOR):
                    ui.button("Post a task", icon="add").props('unelevated href="/tasks/new"')
            problem = problem_section()
            with card("Lab"):
                lab_map = LabViews(console.lab, "robots and items").map
                seen = Section(_draw_seen)
            with ui.element("div").classes("grid tiles"):
                open_, working, settled, supply = (
                    tile(name, "–") for name in ("waiting", "being done", "paid so far", "IEC in circulation")
                )
            with ui.element("div").classes("grid"):
                with ui.element("div").classes("stack span-7"):
                    with card("Queue"):
                        queue = Section(_draw_queue).waiting()
                    with card("Last verdicts"):
                        verdicts = Section(_draw_verdicts).waiting().live()
                with ui.element("div").classes("stack span-5"):
                    with card("Now"):
                        now = Section(_draw_now)
                    with card("Wallets"):
                        wallets = Section(_draw_wallets).waiting()
                    with card("Processes"):
                        health = Section(_draw_processes)

            def show_map() -> None:
                state = console.live.map
                lab_map.show(state)
                seen.show([(name, one) for name, one in _seen(state).items()])

            def show_processes() -> None:
                health.show(console.live.heartbeats.processes)
                now.show([one for one in console.live.heartbeats.processes if one.name.startswith(_WORKERS)])

            def show_organization() -> None:
                summary = console.live.summary
                problem.show(f"This page is not current. {summary.problem}" if summary.problem else "")
                counts = summary.counts
                open_.set_text(_count(counts, "open"))
                working.set_text(_count(counts, "assigned", "submitted", "ruled"))
                settled.set_text(_count(counts, "settled"))
                supply.set_text(iec(summary.supply_iec).removesuffix(" IEC"))
                if counts:
                    queue.show(summary.queue)
                    verdicts.show(summary.verdicts)
                    wallets.show(summary.wallets)

            follow(console, "map", show_map)
            follow(console, "processes", show_processes)
            follow(console, "organization", show_organization)


def _count(counts: dict[str, int], *states: str) -> str:
    return f"{sum(counts.get(state, 0) for state in states):,}" if counts else "–"


def _seen(state: Json) -> dict[str, str]:
    """Where each robot's position comes from, in words that change rarely."""
    words = {}
    for name, one in state["robots"].items():
        if "x" not in one:
            words[name] = f"{name} has not reported its position yet."
        elif not one["fresh"]:
            words[name] = f"{name} is silent. The map shows its last known position."
        elif one["source"] != "motion capture":
            words[name] = f"The position of {name} comes from its {one['source']}, which drifts."
    return words


def _draw_seen(words: list[tuple[str, str]]) -> None:
    for _, text in words:
        Text("p", text, "soft")


def _draw_now(processes: list[ProcessState]) -> None:
    if not processes:
        empty("No robot is working.")
        return
    with ui.element("ul").classes("list"):
        for one in processes:
            with ui.element("li"):
                Text("span", process(one.name), "title")
                if one.state != "ready":
                    badge(one.state)
                else:
                    Text("span", share(one.soc) if one.soc is not None else "", "soft end")
                doing = one.doing or one.job
                left = f", about {span(one.eta_s)} left" if one.eta_s is not None else ""
                Text("span", doing + left, "soft")
                if one.progress is not None:
                    progress_bar(one.progress, one.name)


def _draw_processes(processes: list[ProcessState]) -> None:
    table(
        "Processes of this site",
        [("Process", ""), ("State", ""), ("Status", "wrap")],
        [
            (
                one.name,
                partial(badge, one.state),
                ". ".join([one.doing if one.state != "silent" else one.job, *one.warnings]),
            )
            for one in processes
        ],
    )


def _draw_queue(tasks: list[Task]) -> None:
    def draw(task: Task) -> None:
        badge(task.state)
        who = f" · {party(task.executor_name, task.executor)}" if task.executor else ""
        amount = task.reward_iec if task.price_iec is None else task.price_iec
        stands = ""
        if (said := task.standing) is not None:
            stands = f" · {standing_words(task, iec(said.amount_iec), moment(said.until))}"
        Text("span", f"{iec(amount)}{who}{stands}", "soft")

    task_list(tasks, draw, "No task is waiting or being done.")


def _draw_verdicts(tasks: list[Task]) -> None:
    def draw(task: Task) -> None:
        verdict = task.verdict or ""
        badge(WORDS.get(verdict, verdict))
        by_people = is_peoples_verdict(task)
        paid = f"{iec(task.paid_iec)} to {party(task.executor_name, task.executor)} · "
        said = f"{verdict_words(verdict, task.reason, None, by_people, task.fault)} · "
        when = moment(task.settled or task.proof_submitted)
        Text("span", (paid if task.state == "settled" else "") + said + when, "soft")

    task_list(tasks, draw, "No verdict yet.")


def _draw_wallets(wallets: list[Wallet]) -> None:
    if not wallets:
        empty("No wallets known yet.")
        return
    table(
        "Balances",
        [("Wallet", ""), ("IEC", "number")],
        [(wallet.name, iec(wallet.balance_iec).removesuffix(" IEC")) for wallet in wallets],
    )
