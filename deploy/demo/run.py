"""`make demo`: the whole organization once. A robot cleans and is paid; then it buys a charge and pays.

Starts every process on free ports in a fresh folder, shows what each is doing, writes
`out/demo/summary.json` and stops everything. Exit status 0 only if both tasks settled as expected.
"""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from operator import itemgetter
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table

from deploy.launcher import Launcher
from rodeo.bus import Bus, DaoEvents
from rodeo.cli.organization import iec
from rodeo.cli.site import StatusWatcher, bar, launcher_rows, status_table, stop_on_signals
from rodeo.config import Site
from rodeo.errors import BusError, RemoteError, RodeoError
from rodeo.messages import DaoEvent, Status

CLEANING, CHARGING = "waste_disposal", "battery_charging"
OVER = {"settled", "cancelled", "failed"}

DEMO_SOC_ABOVE = 0.005
"""The battery starts this share above the robot's charging threshold: starting the processes and one
cleaning task bring it below (measured: 0.2 % and 0.4 %)."""

log = logging.getLogger(__name__)


class DemoFailed(RodeoError):
    """The demo did not reach its end."""


@dataclass
class Demo:
    """The run so far, as the terminal and the summary see it."""

    launcher: Launcher
    console: Console
    watcher: StatusWatcher
    limit_s: float
    started_s: float = field(default_factory=time.monotonic)
    headline: str = "starting"
    tasks: dict[int, dict[str, Any]] = field(default_factory=dict)
    changed: threading.Event = field(default_factory=threading.Event)

    @property
    def site(self) -> Site:
        return self.launcher.site

    def say(self, text: str) -> None:
        self.console.print(f"[dim]{time.monotonic() - self.started_s:6.1f} s[/]  {text}", highlight=False)

    def wait_for(self, what: str, condition: Callable[[], bool], live: Live) -> None:
        """Keep the site running and the terminal alive until `condition()`. Raises DemoFailed."""
        self.headline = what
        while not condition():
            if time.monotonic() - self.started_s > self.limit_s:
                raise DemoFailed(
                    f"gave up while {what}", limit_s=self.limit_s, problems=self.launcher.problems()
                )
            self.launcher.poll()
            if given_up := self.launcher.given_up():
                raise DemoFailed(f"gave up while {what}", problems=given_up)
            live.update(self.view())
            self.changed.wait(0.2)
            self.changed.clear()

    def view(self) -> Group:
        statuses = self.watcher.statuses()
        rows = Table.grid(padding=(0, 2))
        for task in self.tasks.values():
            rows.add_row(
                f"task {task['id']}", task["kind"], task["state"], bar(_progress(task, statuses), 24)
            )
        return Group(
            Panel(Group(f"[bold]{self.headline}[/]", rows), expand=False),
            status_table(launcher_rows(self.launcher, self.watcher)),
        )


def main() -> int:
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    parser.add_argument("--site", type=Path, default=Path("deploy/sites/lab.toml"))
    parser.add_argument("--chain", choices=("eth-tester", "anvil"), default="eth-tester")
    parser.add_argument("--out", type=Path, default=Path("out/demo"))
    parser.add_argument("--limit", type=float, default=170.0, help="give up after this many seconds")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    console = Console()
    try:
        stop_on_signals()
        site_path = write_site(arguments.site, arguments.chain, arguments.out)
        return _run(site_path, arguments.out, arguments.limit, console)
    except KeyboardInterrupt:
        console.print("stopped")
        return 130
    except RodeoError as error:
        console.print(f"[bold red]{error.code}[/]: {escape(str(error))}", highlight=False)
        return 1


def write_site(base: Path, chain: str, out: Path) -> Path:
    """A fresh site on free ports under `out`, so that a demo disturbs nothing that runs."""
    site = Site.load(base)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    robot = site.robots[0]
    soc = site.agent.charge_below + DEMO_SOC_ABOVE
    path = out / "site.toml"
    path.write_text(
        f"""# Written by `make demo`: the lab on free ports.
extends = {json.dumps(str(base.resolve()))}
data_dir = {json.dumps(str((out / "data").resolve()))}
chain.url = "http://127.0.0.1:{_free_port()}"
chain.backend = "{chain}"
itrash.http_port = 0
console.port = 0
agent.explore_when_idle = false

[[robots]]
name = "{robot.name}"
pose = {{ x_m = {robot.pose.x_m}, y_m = {robot.pose.y_m}, yaw_rad = {robot.pose.yaw_rad} }}
battery = {{ soc = {soc} }}
"""
    )
    return path


def _run(site_path: Path, out: Path, limit_s: float, console: Console) -> int:
    console.print(f"[bold]RODEO[/]  one cleaning task and one charging session on site {site_path}")
    with Launcher(site_path) as launcher, StatusWatcher(launcher.site) as watcher:
        demo = Demo(launcher, console, watcher, limit_s)
        with Live(demo.view(), console=console, refresh_per_second=5, transient=True) as live:
            summary = _play(demo, live)
    path = out / "summary.json"
    path.write_text(json.dumps(summary, indent=2) + "\n")
    _print_ledger(console, summary)
    problems = shortcomings(summary)
    for problem in problems:
        console.print(f"[bold red]not as expected[/]: {escape(problem)}")
    console.print(f"everything stopped; summary in {path}")
    return 1 if problems else 0


def _play(demo: Demo, live: Live) -> dict[str, Any]:
    """Post the task, watch both to their end; returns the summary."""
    demo.wait_for("starting the processes and deploying the contracts", lambda: _all_ready(demo), live)
    demo.say("every process is ready")
    with Bus.open(demo.site.bus.router, timeout_s=30.0) as bus:
        return _follow(demo, bus, live)


def _follow(demo: Demo, bus: Bus, live: Live) -> dict[str, Any]:
    site = demo.site
    state = f"rodeo/{site.org}/state"
    demo.wait_for(
        "waiting for the services on offer", lambda: _offered(bus, state) >= {CLEANING, CHARGING}, live
    )
    before, supply_before = _wallets(bus, state)
    with DaoEvents(bus, site.org, lambda event: _on_event(demo, bus, state, event)):
        item = site.items[0]
        reply = bus.query(
            f"rodeo/{site.org}/wallet/organization/register_task",
            {
                "kind": CLEANING,
                "reward_iec": str(site.economy.cleaning_reward_iec),
                "params": {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m},
                "description": f"Dispose of {item.id}",
            },
            timeout_s=30.0,
        )
        demo.say(f"the organization posted task {reply['task_id']}")
        demo.wait_for("cleaning", lambda: _over(demo, CLEANING), live)
        demo.wait_for("charging", lambda: _over(demo, CHARGING), live)
        robot = site.robots[0].name
        demo.wait_for(f"{robot} leaves the dock", lambda: _away(demo), live)
    after, supply_after = _wallets(bus, state)
    tasks = sorted(bus.query(f"{state}/tasks", parameters={"limit": 100})["tasks"], key=itemgetter("id"))
    return {
        "site": site.org,
        "chain": site.chain.backend,
        "tasks": [_task_summary(task) for task in tasks],
        "wallets": {
            name: {"before_iec": _number(before[name]), "after_iec": _number(after[name])}
            for name in ("organization", robot)
        },
        "supply_iec": {"before": _number(supply_before), "after": _number(supply_after)},
        "wall_s": round(time.monotonic() - demo.started_s, 1),
    }


def shortcomings(summary: dict[str, Any]) -> list[str]:
    """What is not as it should be at the end; empty when all is."""
    problems = []
    kinds = [task["kind"] for task in summary["tasks"]]
    if sorted(kinds) != sorted((CLEANING, CHARGING)):
        problems.append(f"tasks of kinds {kinds} instead of one {CLEANING} and one {CHARGING}")
    for task in summary["tasks"]:
        if task["state"] != "settled" or task["verdict"] != "accepted":
            problems.append(f"task {task['id']} ({task['kind']}) ended {task['state']}: {task['reason']}")
    paid = {kind: sum(t["paid_iec"] for t in summary["tasks"] if t["kind"] == kind) for kind in kinds}
    gain = paid.get(CLEANING, 0) - paid.get(CHARGING, 0)
    for name, wallet in summary["wallets"].items():
        expected = wallet["before_iec"] + (-gain if name == "organization" else gain)
        if wallet["after_iec"] != expected:
            problems.append(f"{name} has {wallet['after_iec']} IEC instead of {expected}")
    if summary["supply_iec"]["before"] != summary["supply_iec"]["after"]:
        problems.append(f"the supply changed: {summary['supply_iec']}")
    return problems


# -- what the bus says ---------------------------------------------------------------------------------


def _all_ready(demo: Demo) -> bool:
    statuses = demo.watcher.statuses()
    return all(name in statuses and statuses[name].ready for name in demo.launcher.children)


def _offered(bus: Bus, state: str) -> set[str]:
    try:
        services = bus.query(f"{state}/services")["services"]
    except (BusError, RemoteError):
        return set()
    return {service["kind"] for service in services if service["state"] == "active"}


def _wallets(bus: Bus, state: str) -> tuple[dict[str, str], str]:
    wallets = bus.query(f"{state}/wallets")
    return {entry["name"]: entry["balance_iec"] for entry in wallets["wallets"]}, wallets["supply_iec"]


def _on_event(demo: Demo, bus: Bus, state: str, event: DaoEvent) -> None:
    if event.task_id is None:
        return
    task = bus.query(f"{state}/task/{event.task_id}")
    demo.tasks[event.task_id] = task
    if sentence := _sentence(event, task):
        demo.say(f"task {event.task_id} [bold]{escape(sentence)}[/]")
    demo.changed.set()


def _sentence(event: DaoEvent, task: dict[str, Any]) -> str:
    match event.name:
        case "TaskRegistered":
            return f"registered by {task['creator_name']}: {task['kind']} for {iec(task['reward_iec'])}"
        case "TaskAssigned":
            return f"assigned to {task['executor_name']}, attempt {task['attempt']}"
        case "ProofSubmitted":
            return f"proof submitted: {event.args['uri'].rsplit('/', 1)[-1][:16]}…"
        case "VerdictPosted":
            verdict, amount = event.args["verdict"], iec(event.args["amount_iec"])
            return f"accepted for {amount}" if verdict == "accepted" else f"{verdict}: {event.args['reason']}"
        case "TaskSettled":
            return f"settled, {iec(task['paid_iec'])} paid to {task['executor_name']}"
        case "TaskRequeued" | "TaskFailed" | "TaskCancelled":
            return event.name.removeprefix("Task").lower()
    return ""


def _over(demo: Demo, kind: str) -> bool:
    return any(task["kind"] == kind and task["state"] in OVER for task in demo.tasks.values())


def _away(demo: Demo) -> bool:
    details = demo.watcher.statuses()["robot_agent"].details
    return not details.get("docked", True) and details.get("soc", 0.0) > demo.site.agent.charge_below


def _progress(task: dict[str, Any], statuses: dict[str, Status]) -> float | None:
    """Share of a task done: the executor tells how far its work is, the chain the rest."""
    if task["state"] == "assigned":
        executor = statuses.get("charger" if task["kind"] == CHARGING else "robot_agent")
        return 0.9 * ((executor.progress if executor else None) or 0.0)
    return {"open": 0.0, "submitted": 0.95, "undecided": 0.95}.get(task["state"], 1.0)


# -- the summary ---------------------------------------------------------------------------------------


def _task_summary(task: dict[str, Any]) -> dict[str, Any]:
    return {
        "id": task["id"],
        "kind": task["kind"],
        "state": task["state"],
        "attempts": task["attempt"],
        "creator": task["creator_name"] or task["creator"],
        "executor": task["executor_name"] or task["executor"],
        "reward_iec": _number(task["reward_iec"]),
        "paid_iec": _number(task["paid_iec"]),
        "proof_sha256": task["proof_sha256"],
        "proof_uri": task["proof_uri"],
        "verdict": task["verdict"],
        "reason": task["reason"],
        "registered": task["registered"],
        "assigned": task["assigned"],
        "proof_submitted": task["proof_submitted"],
        "settled": task["settled"],
    }


def _number(amount: str) -> float | int:
    value = Decimal(amount)
    return int(value) if value == value.to_integral_value() else float(value)


def _print_ledger(console: Console, summary: dict[str, Any]) -> None:
    tasks = Table("task", "from → to", "state", "work", "verdict", "paid", box=None)
    for task in summary["tasks"]:
        tasks.add_row(
            f"{task['id']} {task['kind']}",
            f"{task['creator']} → {task['executor'] or 'nobody'}",
            task["state"],
            _span(task["assigned"], task["proof_submitted"]),
            _span(task["proof_submitted"], task["settled"]),
            f"{task['paid_iec']:g}",
        )
    wallets = Table("wallet", "before", "after", "change", box=None)
    for name, wallet in summary["wallets"].items():
        change = wallet["after_iec"] - wallet["before_iec"]
        wallets.add_row(
            name, iec(str(wallet["before_iec"])), iec(str(wallet["after_iec"])), f"{change:+g} IEC"
        )
    console.print(Panel(tasks, title="tasks (min:s of the site's clock, IEC)", expand=False))
    console.print(Panel(wallets, title="ledger", expand=False))


def _span(start_s: float | None, end_s: float | None) -> str:
    if start_s is None or end_s is None:
        return ""
    minutes, seconds = divmod(round(end_s - start_s), 60)
    return f"{minutes}:{seconds:02d}"


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
