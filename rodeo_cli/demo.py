"""`rodeo demo`: the whole organization once. A robot cleans and is paid; then it buys a charge and pays.

It starts every process on free ports in a fresh folder, shows what each is doing, writes
`out/demo/summary.json` and stops everything, or leaves the site running with `--keep`. Exit status 0 only if
both tasks settled as expected.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Group
from rich.live import Live
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table

import deploy
from deploy.launcher import Launcher, LaunchFailed
from rodeo.bus import queries
from rodeo.bus.holding import Holder
from rodeo.bus.messages import DaoEvent, Status, Task
from rodeo.bus.session import Bus, DaoEvents
from rodeo.errors import AlreadyRunning, BusError, RemoteError, RodeoError
from rodeo.host.files import begin_folder, replace_file
from rodeo.host.instance import LAUNCHER, lock_holder
from rodeo.judging.verdicts import NO_REPORT, WORDS
from rodeo.kinds import Kind, kinds_of, providing_energy
from rodeo.runtime.process import is_transient
from rodeo.site.config import Site, read_tables
from rodeo.site.endpoint import free_port
from rodeo.text.site_problems import toml
from rodeo_cli import demo_end
from rodeo_cli.accounts import login_link
from rodeo_cli.background import Background
from rodeo_cli.common import console, reports_errors, say, send_command
from rodeo_cli.formatting import iec
from rodeo_cli.progress import LIMIT_S, NoProgress, Patience, TooSlow
from rodeo_cli.site import (
    Row,
    StatusWatcher,
    attend,
    bar,
    launcher_rows,
    moves,
    starting_step,
    status_table,
    stop_on_signals,
    what_hangs,
)

LAB = Path(deploy.__file__).parent / "sites" / "lab.toml"
_WRITTEN = "# Written by `rodeo demo`: the lab on free ports."
OVER = {"settled", "cancelled", "failed"}
_LOOK_S = 0.2

DEMO_SOC_ABOVE = 0.002
"""The battery starts this share above the robot's charging threshold. One cleaning takes 0.4 %, so that the
robot buys a charge after it. Before, the site's clock stands."""

_POSTER = "arrivals"
"""Name in `clock.holders` of the process that posts tasks."""
_NEED_SENSORS = ("robot_agent", "itrash", "charger")
"""Jobs whose processes get ready when they read sensors, for which the site's clock has to run."""


class DemoFailed(RodeoError):
    """The demo did not reach its end."""


@dataclass
class Demo:
    """The run so far, as the terminal and the summary see it."""

    launcher: Launcher
    watcher: StatusWatcher
    limit_s: float
    stopped: threading.Event
    live: Live
    started_s: float = field(default_factory=time.monotonic)
    headline: str = "starting"
    link: str = ""
    """Opens the console, logged in."""
    tasks: dict[int, Task] = field(default_factory=dict)
    events: int = 0
    """Number of events that have come from the chain."""
    changed: threading.Event = field(default_factory=threading.Event)

    @property
    def site(self) -> Site:
        return self.launcher.site

    @cached_property
    def work(self) -> Kind:
        """Kind of the work that the organization orders."""
        if self.site.demo is None:
            raise DemoFailed("the site file has no [demo] table that sets the work to do")
        return kinds_of(self.site)[self.site.demo.kind]

    @cached_property
    def energy(self) -> Kind:
        """Kind of the charge that the robot buys afterwards."""
        return providing_energy(self.site)

    def say(self, text: str) -> None:
        console.print(
            f"[dim]{time.monotonic() - self.started_s:6.1f} s[/]  {text}", highlight=False, soft_wrap=True
        )

    def wait_for(
        self, what: str, condition: Callable[[], bool], step: Callable[[list[Row]], str] = lambda _rows: ""
    ) -> None:
        """Keep the site running and the terminal alive until `condition()`. `step` names what happens now.

        Raises DemoFailed when a process cannot be started again, or when nothing moves any more.
        """
        patience = Patience(limit_s=self.limit_s)
        said = ""
        while not condition():
            if self.stopped.is_set():
                raise KeyboardInterrupt
            rows = launcher_rows(self.launcher, self.watcher)
            try:
                self.launcher.poll()
            except LaunchFailed as error:
                raise DemoFailed(f"{what} failed: {error.message}") from error
            if given_up := self.launcher.given_up():
                ended = "; ".join(f"{name}: {reason}" for name, reason in given_up.items())
                raise DemoFailed(
                    f"{what} failed. These processes have ended, and starting them again would not help: "
                    f"{ended}. See the logs in {self.launcher.logs}"
                )
            self.headline = step(rows) or what
            if self.headline != said and not console.is_terminal:
                self.say(self.headline)
            said = self.headline
            self._look(patience, what, rows)
            self.live.update(self.view(rows))
            self.changed.wait(_LOOK_S)
            self.changed.clear()

    def _look(self, patience: Patience, what: str, rows: list[Row]) -> None:
        told: dict[str, Hashable] = moves(self.site, rows, os.getpid())
        told["events"] = self.events
        try:
            patience.look(told)
        except NoProgress as error:
            raise DemoFailed(
                f"{what}: {error.message}. It waits for {what_hangs(self.site, rows, patience)}"
            ) from error
        except TooSlow as error:
            raise DemoFailed(
                f"{what}: {error.message}, although the site still moves. The machine is too slow, or busy "
                "with something else: end other programs and run the demo again, or give it more time with "
                f"--limit. It waits for {what_hangs(self.site, rows, patience)}"
            ) from error

    def ready(self, but: tuple[str, ...] = ()) -> bool:
        """Whether every process is ready, except those with a job in `but`. Prints the console's link,
        too."""
        statuses = self.watcher.statuses()
        console_status = statuses.get("console")
        if not self.link and console_status is not None and console_status.ready:
            self.link = login_link(self.site, console_status.details["http"])
            self.say(f"watch it in a browser; this link logs you in, once:\n{self.link}")
        return all(
            name in statuses and statuses[name].ready
            for name in self.launcher.children
            if name.partition(".")[0] not in but
        )

    def step(self, rows: list[Row]) -> str:
        """State of the site's start."""
        return starting_step(self.site, rows)

    def view(self, rows: list[Row]) -> Group:
        statuses = self.watcher.statuses()
        shown = Table.grid(padding=(0, 2))
        for task in self.tasks.values():
            shown.add_row(
                f"task {task.id}",
                task.kind,
                task.state,
                f"[cyan]{bar(_progress(task, self.energy.name, statuses), 24)}[/]",
            )
        return Group(
            Panel(Group(f"[bold]{escape(self.headline)}[/]", shown), expand=False),
            status_table(rows),
        )


@reports_errors
def demo(
    site: Annotated[Path, typer.Option("--site", help="Site file.", show_default="the installed lab")] = LAB,
    chain: Annotated[Literal["eth-tester", "anvil"], typer.Option(help="The local chain.")] = "eth-tester",
    out: Annotated[Path, typer.Option(help="Folder for the demo's site and summary.")] = Path("out/demo"),
    limit: Annotated[
        float,
        typer.Option(
            help="Give up on a phase after this many seconds. Without it, after an hour. In any case after "
            "3 minutes in which nothing moves."
        ),
    ] = LIMIT_S,
    keep: Annotated[
        bool, typer.Option("--keep", help="Leave the site running in the background at the end.")
    ] = False,
) -> None:
    """Run one cleaning task and one charging session from start to end, on free ports in a fresh folder."""
    try:
        stopped = stop_on_signals()
        path = write_site(site, chain, out)
        background = Background() if keep else None
        run = partial(_run, path, out, limit, stopped, background)
        raise typer.Exit(run() if background is None else background.run(run))
    except KeyboardInterrupt:
        console.print("stopped")
        raise typer.Exit(130) from None


def write_site(base: Path, chain: str, out: Path) -> Path:
    """A fresh site on free ports under `out`: a demo disturbs nothing that runs. Raises FolderTaken, and
    AlreadyRunning while an earlier demo runs there."""
    site = Site.load(base)
    path = out / "site.toml"
    if (pid := lock_holder(out / "data" / LAUNCHER)) is not None:
        raise AlreadyRunning(
            f"a demo still runs in {out} as process {pid}: stop it with `{demo_end.command('down', path)}`"
        )
    begin_folder(out, _WRITTEN)
    robot = site.robots[0]
    soc = site.agent.charge_below + DEMO_SOC_ABOVE
    bins = [one | {"http_port": 0} for one in read_tables(base).get("bins", [])]
    replace_file(
        path,
        f"""{_WRITTEN}
extends = {json.dumps(str(base.resolve()))}
data_dir = {json.dumps(str((out / "data").resolve()))}
chain.url = "http://127.0.0.1:{free_port()}"
chain.backend = "{chain}"
bins = {toml(bins)}
console.port = 0
agent.explore_when_idle = false

[[robots]]
name = "{robot.name}"
pose = {{ x_m = {robot.pose.x_m}, y_m = {robot.pose.y_m}, yaw_rad = {robot.pose.yaw_rad} }}
battery = {{ soc = {soc} }}
""",
    )
    return path


def _run(
    site_path: Path, out: Path, limit_s: float, stopped: threading.Event, background: Background | None
) -> int:
    """The demo; its exit status. With `background` the site keeps running there when all is well."""
    say(f"RODEO demo: a robot cleans and is paid, then buys a charge. Its site is {site_path}")
    launcher = Launcher(site_path)
    holders = json.dumps([*launcher.site.clock.holders, _POSTER])
    launcher.environment["RODEO__CLOCK__HOLDERS"] = holders
    with launcher, StatusWatcher(launcher.site) as watcher:
        with Live(console=console, refresh_per_second=5, transient=True) as live:
            demo = Demo(launcher, watcher, limit_s, stopped, live)
            summary = _play(demo)
        path = out / "summary.json"
        replace_file(path, json.dumps(summary, indent=2) + "\n")
        demo_end.print_ledger(summary)
        problems = shortcomings(summary, demo.work.name, demo.energy.name)
        for problem in problems:
            console.print(f"[bold red]not as expected[/]: {escape(problem)}")
        if not problems:
            link = (
                login_link(demo.site, watcher.statuses()["console"].details["http"])
                if background is not None
                else None
            )
            demo_end.print_end(demo.site, site_path, summary, link)
        if background is not None and not problems:
            background.go_on(launcher.logs / f"{LAUNCHER}.log")
            with suppress(KeyboardInterrupt):
                attend(launcher)
            return 0
    say(f"Everything is stopped. The summary is {path}")
    return 1 if problems else 0


# -- the story -----------------------------------------------------------------------------------------


def _play(demo: Demo) -> dict[str, Any]:
    """Start the site, post the task, watch both tasks to their end; returns the summary."""
    demo.wait_for("starting the site", lambda: demo.watcher.bus is not None, demo.step)
    bus = demo.watcher.bus
    assert bus is not None
    site, work, energy = demo.site, demo.work, demo.energy
    offers = {work.name, energy.name}
    with ExitStack() as stack:
        # As the process that posts the tasks, it holds the site's clock, which stands until it is there.
        with closing(Holder(bus.session, site.org, _POSTER, threading.Condition(), lambda: None)) as clock:
            with clock.hold():
                demo.wait_for("starting the site", lambda: demo.ready(but=_NEED_SENSORS), demo.step)
            demo.wait_for("starting the site", demo.ready, demo.step)
            demo.say("every process is ready")
            # A simulator that is started again does not wait for one who posts tasks.
            demo.launcher.environment.clear()
            demo.wait_for(
                "waiting for offers of work and charging", lambda: _offered(bus, site.org) >= offers
            )
            before, supply_before = _wallets(bus, site.org)
            stack.enter_context(DaoEvents(bus, site.org, lambda event: on_event(demo, bus, event)))
            with clock.hold():
                soc = _soc(demo)
                _post(demo, bus)
        demo.wait_for(f"waiting until {work.name} is paid", lambda: _over(demo, work.name))
        demo.wait_for(f"waiting until {energy.name} is paid", lambda: _over(demo, energy.name))
        robot = site.robots[0].name
        demo.wait_for(f"waiting until {robot} leaves the dock", lambda: _away(demo))
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
        "soc_when_posted": soc,
        "wall_s": round(time.monotonic() - demo.started_s, 1),
    }


def shortcomings(summary: dict[str, Any], work: str, energy: str) -> list[str]:
    """Problems at the end; empty if there are none."""
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


def _post(demo: Demo, bus: Bus) -> None:
    """The organization posts the task; the site stays alive meanwhile."""
    site, work = demo.site, demo.work
    assert site.demo is not None  # `demo.work` is of it
    request = {
        "request_id": "demo",
        "kind": work.name,
        "reward_iec": str(work.price_iec),
        "params": work.complete(site, site.demo.params),
        "description": work.title,
    }
    done: Future[dict[str, Any]] = Future()

    def post() -> None:
        try:
            done.set_result(send_command(site, bus, "organization", "register_task", **request))
        except RodeoError as error:
            done.set_exception(error)

    threading.Thread(target=post, name="post", daemon=True).start()
    demo.wait_for("posting the first task", done.done)
    demo.say(f"the organization posted task {done.result()['task_id']}")


# -- messages of the bus -------------------------------------------------------------------------------


def _offered(bus: Bus, org: str) -> set[str]:
    try:
        services = queries.ask(bus, org, queries.SERVICES).services
    except (BusError, RemoteError):
        return set()
    return {service.kind for service in services if service.state == "active"}


def _wallets(bus: Bus, org: str) -> tuple[dict[str, Decimal], Decimal]:
    told = queries.ask(bus, org, queries.WALLETS)
    return {one.name: one.balance_iec for one in told.wallets}, told.supply_iec


def on_event(demo: Demo, bus: Bus, event: DaoEvent) -> None:
    """Read the task of an event again, and say what happened to it."""
    if event.task_id is None:
        return
    demo.events += 1
    # An event comes once: where the bridge is started again meanwhile, its task is asked for again.
    while True:
        try:
            task = queries.ask(bus, demo.site.org, queries.TASK, id=event.task_id)
            break
        except (BusError, RemoteError) as error:
            if not is_transient(error) or demo.stopped.wait(_LOOK_S):
                raise
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
        case "Ruled":
            ruling, amount = event.args["ruling"], iec(event.args["amount_iec"])
            if ruling == "accepted":
                return f"accepted for {amount}"
            return f"{WORDS.get(ruling, ruling)}: {task.reason or NO_REPORT}"
        case "TaskSettled":
            return f"settled, {iec(task.paid_iec)} paid to {task.executor_name}"
        case "TaskRequeued" | "TaskFailed" | "TaskCancelled":
            return event.name.removeprefix("Task").lower()
    return ""


def _over(demo: Demo, kind: str) -> bool:
    return any(task.kind == kind and task.state in OVER for task in demo.tasks.values())


def _soc(demo: Demo) -> float | None:
    """The robot's state of charge, as its mind last reported it."""
    return demo.watcher.statuses()["robot_agent"].details.get("soc")


def _away(demo: Demo) -> bool:
    details = demo.watcher.statuses()["robot_agent"].details
    return not details.get("docked", True) and details.get("soc", 0.0) > demo.site.agent.charge_below


def _progress(task: Task, energy: str, statuses: dict[str, Status]) -> float | None:
    """Share of a task that is done: the executor reports its work, the chain the rest."""
    if task.state == "assigned":
        job = "charger" if task.kind == energy else "robot_agent"
        told = [status.progress or 0.0 for name, status in statuses.items() if name.partition(".")[0] == job]
        return 0.9 * max(told, default=0.0)
    return {"open": 0.0, "submitted": 0.95, "ruled": 0.95}.get(task.state, 1.0)


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
