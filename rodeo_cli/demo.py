"""`rodeo demo`: the whole organization once. A robot cleans and is paid; then it buys a charge and pays.

Starts every process on free ports in a fresh folder, shows what each is doing, writes
`out/demo/summary.json` and stops everything. Exit status 0 only if both tasks settled as expected.
"""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Group
from rich.live import Live
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table

import deploy
from deploy.launcher import Launcher
from rodeo import queries, topics
from rodeo.bus import Bus, DaoEvents
from rodeo.config import Site, read_tables
from rodeo.errors import BusError, RemoteError, RodeoError
from rodeo.files import begin_folder
from rodeo.kinds import Kind, kinds_of, providing_energy
from rodeo.messages import DaoEvent, Status, Task
from rodeo.site_problems import toml
from rodeo_cli.common import console, print_table, reports_errors
from rodeo_cli.formatting import iec
from rodeo_cli.layout import Row
from rodeo_cli.site import StatusWatcher, bar, launcher_rows, status_table, stop_on_signals

LAB = Path(deploy.__file__).parent / "sites" / "lab.toml"
_WRITTEN = "# Written by `rodeo demo`: the lab on free ports."
OVER = {"settled", "cancelled", "failed"}

DEMO_SOC_ABOVE = 0.005
"""The battery starts this share above the robot's charging threshold: starting the processes and one
cleaning task bring it below (measured: 0.2 % and 0.4 %)."""


class DemoFailed(RodeoError):
    """The demo did not reach its end."""


@dataclass
class Demo:
    """The run so far, as the terminal and the summary see it."""

    launcher: Launcher
    watcher: StatusWatcher
    limit_s: float
    started_s: float = field(default_factory=time.monotonic)
    headline: str = "starting"
    tasks: dict[int, Task] = field(default_factory=dict)
    changed: threading.Event = field(default_factory=threading.Event)

    @property
    def site(self) -> Site:
        return self.launcher.site

    @cached_property
    def work(self) -> Kind:
        """What the organization has done."""
        if self.site.demo is None:
            raise DemoFailed("the site file has no [demo] table that sets the work to do")
        return kinds_of(self.site)[self.site.demo.kind]

    @cached_property
    def energy(self) -> Kind:
        """What the robot buys afterwards."""
        return providing_energy(self.site)

    def say(self, text: str) -> None:
        console.print(f"[dim]{time.monotonic() - self.started_s:6.1f} s[/]  {text}", highlight=False)

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
                f"task {task.id}",
                task.kind,
                task.state,
                f"[cyan]{bar(_progress(task, self.energy.name, statuses), 24)}[/]",
            )
        return Group(
            Panel(Group(f"[bold]{self.headline}[/]", rows), expand=False),
            status_table(launcher_rows(self.launcher, self.watcher)),
        )


@reports_errors
def demo(
    site: Annotated[Path, typer.Option("--site", help="Site file.", show_default="the installed lab")] = LAB,
    chain: Annotated[Literal["eth-tester", "anvil"], typer.Option(help="The local chain.")] = "eth-tester",
    out: Annotated[Path, typer.Option(help="Folder for the demo's site and summary.")] = Path("out/demo"),
    limit: Annotated[float, typer.Option(help="Give up after this many seconds.")] = 170.0,
) -> None:
    """Run one cleaning task and one charging session from start to end, on free ports in a fresh folder."""
    try:
        stop_on_signals()
        raise typer.Exit(_run(write_site(site, chain, out), out, limit))
    except KeyboardInterrupt:
        console.print("stopped")
        raise typer.Exit(130) from None


def write_site(base: Path, chain: str, out: Path) -> Path:
    """A fresh site on free ports under `out`: a demo disturbs nothing that runs. Raises FolderTaken."""
    site = Site.load(base)
    begin_folder(out, _WRITTEN)
    robot = site.robots[0]
    soc = site.agent.charge_below + DEMO_SOC_ABOVE
    bins = [one | {"http_port": 0} for one in read_tables(base).get("bins", [])]
    path = out / "site.toml"
    path.write_text(
        f"""{_WRITTEN}
extends = {json.dumps(str(base.resolve()))}
data_dir = {json.dumps(str((out / "data").resolve()))}
chain.url = "http://127.0.0.1:{_free_port()}"
chain.backend = "{chain}"
bins = {toml(bins)}
console.port = 0
agent.explore_when_idle = false

[[robots]]
name = "{robot.name}"
pose = {{ x_m = {robot.pose.x_m}, y_m = {robot.pose.y_m}, yaw_rad = {robot.pose.yaw_rad} }}
battery = {{ soc = {soc} }}
"""
    )
    return path


def _run(site_path: Path, out: Path, limit_s: float) -> int:
    console.print(f"[bold]RODEO[/]  one cleaning task and one charging session on site {site_path}")
    with Launcher(site_path) as launcher, StatusWatcher(launcher.site) as watcher:
        demo = Demo(launcher, watcher, limit_s)
        with Live(demo.view(), console=console, refresh_per_second=5, transient=True) as live:
            summary = _play(demo, live)
    path = out / "summary.json"
    path.write_text(json.dumps(summary, indent=2) + "\n")
    _print_ledger(summary)
    problems = shortcomings(summary, demo.work.name, demo.energy.name)
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
    site, work, energy = demo.site, demo.work, demo.energy
    demo.wait_for(
        "waiting for the services on offer", lambda: _offered(bus, site.org) >= {work.name, energy.name}, live
    )
    before, supply_before = _wallets(bus, site.org)
    with DaoEvents(bus, site.org, lambda event: _on_event(demo, bus, event)):
        assert site.demo is not None  # `demo.work` is of it
        reply = bus.query(
            topics.COMMAND.name(org=site.org, participant="organization", command="register_task"),
            {
                "kind": work.name,
                "reward_iec": str(work.price_iec),
                "params": work.complete(site, site.demo.params),
                "description": work.title,
            },
            timeout_s=30.0,
        )
        demo.say(f"the organization posted task {reply['task_id']}")
        demo.wait_for(work.title.lower(), lambda: _over(demo, work.name), live)
        demo.wait_for(energy.title.lower(), lambda: _over(demo, energy.name), live)
        robot = site.robots[0].name
        demo.wait_for(f"{robot} leaves the dock", lambda: _away(demo), live)
    after, supply_after = _wallets(bus, site.org)
    tasks = queries.ask(bus, site.org, queries.TASKS, limit=100, order="oldest").tasks
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


def shortcomings(summary: dict[str, Any], work: str, energy: str) -> list[str]:
    """What is not as it should be at the end; empty when all is."""
    problems = []
    kinds = [task["kind"] for task in summary["tasks"]]
    if sorted(kinds) != sorted((work, energy)):
        problems.append(f"found tasks of kinds {kinds} instead of one {work} and one {energy}")
    for task in summary["tasks"]:
        if task["state"] != "settled" or task["verdict"] != "accepted":
            problems.append(f"task {task['id']} ({task['kind']}) ended {task['state']}: {task['reason']}")
    paid = {kind: sum(t["paid_iec"] for t in summary["tasks"] if t["kind"] == kind) for kind in kinds}
    gain = paid.get(work, 0) - paid.get(energy, 0)
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


def _offered(bus: Bus, org: str) -> set[str]:
    try:
        services = queries.ask(bus, org, queries.SERVICES).services
    except (BusError, RemoteError):
        return set()
    return {service.kind for service in services if service.state == "active"}


def _wallets(bus: Bus, org: str) -> tuple[dict[str, Decimal], Decimal]:
    told = queries.ask(bus, org, queries.WALLETS)
    return {one.name: one.balance_iec for one in told.wallets}, told.supply_iec


def _on_event(demo: Demo, bus: Bus, event: DaoEvent) -> None:
    if event.task_id is None:
        return
    task = queries.ask(bus, demo.site.org, queries.TASK, id=event.task_id)
    demo.tasks[event.task_id] = task
    if sentence := _sentence(event, task):
        demo.say(f"task {event.task_id} [bold]{escape(sentence)}[/]")
    demo.changed.set()


def _sentence(event: DaoEvent, task: Task) -> str:
    match event.name:
        case "TaskRegistered":
            return f"registered by {task.creator_name}: {task.kind} for {iec(task.reward_iec)}"
        case "TaskAssigned":
            return f"assigned to {task.executor_name}, attempt {task.attempt}"
        case "ProofSubmitted":
            return f"proof submitted: {event.args['uri'].rsplit('/', 1)[-1][:16]}…"
        case "VerdictPosted":
            verdict, amount = event.args["verdict"], iec(event.args["amount_iec"])
            return f"accepted for {amount}" if verdict == "accepted" else f"{verdict}: {event.args['reason']}"
        case "TaskSettled":
            return f"settled, {iec(task.paid_iec)} paid to {task.executor_name}"
        case "TaskRequeued" | "TaskFailed" | "TaskCancelled":
            return event.name.removeprefix("Task").lower()
    return ""


def _over(demo: Demo, kind: str) -> bool:
    return any(task.kind == kind and task.state in OVER for task in demo.tasks.values())


def _away(demo: Demo) -> bool:
    details = demo.watcher.statuses()["robot_agent"].details
    return not details.get("docked", True) and details.get("soc", 0.0) > demo.site.agent.charge_below


def _progress(task: Task, energy: str, statuses: dict[str, Status]) -> float | None:
    """Share of a task done: the executor tells how far its work is, the chain the rest."""
    if task.state == "assigned":
        job = "charger" if task.kind == energy else "robot_agent"
        told = [status.progress or 0.0 for name, status in statuses.items() if name.partition(".")[0] == job]
        return 0.9 * max(told, default=0.0)
    return {"open": 0.0, "submitted": 0.95, "undecided": 0.95}.get(task.state, 1.0)


# -- the summary ---------------------------------------------------------------------------------------


def _task_summary(task: Task) -> dict[str, Any]:
    return {
        "id": task.id,
        "kind": task.kind,
        "state": task.state,
        "attempts": task.attempt,
        "creator": task.creator_name or task.creator,
        "executor": task.executor_name or task.executor,
        "reward_iec": _number(task.reward_iec),
        "paid_iec": _number(task.paid_iec),
        "proof_sha256": task.proof_sha256,
        "proof_uri": task.proof_uri,
        "verdict": task.verdict,
        "reason": task.reason,
        "registered": task.registered,
        "assigned": task.assigned,
        "proof_submitted": task.proof_submitted,
        "settled": task.settled,
    }


def _number(value: Decimal) -> float | int:
    return int(value) if value == value.to_integral_value() else float(value)


def _print_ledger(summary: dict[str, Any]) -> None:
    tasks = (
        Row(
            (
                f"{task['id']} {task['kind']}",
                f"{task['creator']} → {task['executor'] or 'nobody'}",
                task["state"],
                _span(task["assigned"], task["proof_submitted"]),
                _span(task["proof_submitted"], task["settled"]),
                f"{task['paid_iec']:g}",
            )
        )
        for task in summary["tasks"]
    )
    wallets = (
        Row((name, iec(str(before)), iec(str(after)), f"{after - before:+g} IEC"))
        for name, wallet in summary["wallets"].items()
        for before, after in [(wallet["before_iec"], wallet["after_iec"])]
    )
    console.print("\n[bold]tasks[/] (min:s of the site's clock, IEC)", highlight=False)
    print_table(("task", "from → to", "state", "work", "verdict", "paid"), tasks, folds=(0, 1))
    console.print("\n[bold]ledger[/]")
    print_table(("wallet", "before", "after", "change"), wallets)


def _span(start_s: float | None, end_s: float | None) -> str:
    if start_s is None or end_s is None:
        return ""
    minutes, seconds = divmod(round(end_s - start_s), 60)
    return f"{minutes}:{seconds:02d}"


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
