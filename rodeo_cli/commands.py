"""The commands of `rodeo`, each imported when it is given: `rodeo --help` imports none."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

COMMANDS = {
    "init": (
        "init:init",
        "Write a commented site file for a site of your own, with free ports, and print what to do next.",
    ),
    "up": (
        "site:up",
        "Start the site's processes and keep them running until Ctrl-C, or in the background with --detach.",
    ),
    "down": ("site:down", "Stop every process of the site on this machine."),
    "status": (
        "site:status",
        "Show whether each process runs and is ready, and why not. Exit status 1 unless all are ready.",
    ),
    "demo": (
        "demo:demo",
        "Run one cleaning task and one charging session from start to end, on free ports in a fresh folder.",
    ),
    "wallet": ("services:wallet", "Show balances."),
    "report": ("report:report", "Show what each participant earned and spent, by kind of work and week."),
    "verify": (
        "verify:verify",
        "Run the oracle's checks on proofs here and now, several side by side. Exit status 1 when one fails.",
    ),
    "audit": (
        "audit:audit",
        "Judge an organization's verdicts again, as an outsider could: from chain, store and lab alone.",
    ),
    "proof": (
        "proofs:proofs",
        "Export a proof for other people's tools, and draw it. The proof itself is only read.",
    ),
    "classify": (
        "classify:classify",
        "Say what waste each photo shows, and which compartment of a bin of the site takes it.",
    ),
    "task": ("tasks:tasks", "Post, list, show and cancel tasks."),
    "service": ("services:services", "List and change the services that participants offer."),
    "organization": (
        "organization:organization",
        "Show and change the organization's rules, members, devices and treasury.",
    ),
    "robot": ("robot:robots", "Give orders to robots and show their state."),
    "ros2": ("ros2:ros2", "Connect a participant's ROS 2 nodes to the site."),
    "mocap": ("mocap:mocap", "Commission motion capture."),
    "bin": ("bins:bins", "Tell a bin what items really were."),
    "seen": ("seen:seen", "List what robots have seen on the floor, and say what it is."),
    "console": ("accounts:accounts", "Manage the accounts of people who may use the console."),
    "site": (
        "sites:sites",
        "Check a site file, prepare a site for its processes, and remove its data.",
    ),
    "deploy": (
        "deploying:deploying",
        "Write what starts the site's processes in place of `rodeo up`: systemd units, or containers.",
    ),
    "kind": ("kinds:kinds", "List, show, check and create kinds of work."),
    "pool": ("pool:pool", "Run a pool of machines for audits and studies."),
    "experiment": ("experiment:experiments", "Run and measure whole days of a site."),
}
"""Name -> module of this package with its function or group, and the beginning of its help."""


class _Imported(MutableMapping[str, Any]):
    """The commands by name, each imported when it is looked up."""

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            self._made[name] = _command(name)
        return self._made[name]

    def __setitem__(self, name: str, command: Any) -> None:
        raise TypeError(f"declare {name} in COMMANDS")

    def __delitem__(self, name: str) -> None:
        raise TypeError(f"{name} is declared in COMMANDS")

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


class _Rodeo(TyperGroup):
    """All commands; its help shows their names and the beginnings of theirs without an import."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings | {"commands": {}})
        self.commands = _Imported()
        self._lists = False

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if self._lists:
            return TyperCommand(cmd_name, help=COMMANDS[cmd_name][1], callback=None)
        return self.commands.get(cmd_name)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        with self._listing():
            super().format_help(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        with self._listing():
            return super().shell_complete(ctx, incomplete)

    @contextmanager
    def _listing(self) -> Iterator[None]:
        self._lists = True
        try:
            yield
        finally:
            self._lists = False


def _command(name: str) -> Any:
    module, _, attribute = COMMANDS[name][0].partition(":")
    found = getattr(import_module(f"rodeo_cli.{module}"), attribute)
    rodeo = typer.Typer()
    if not isinstance(found, typer.Typer):
        rodeo.command(name)(found)
    elif name in ("task", "service"):
        _complete()
        rodeo.add_typer(found, name=name, cls=import_module("rodeo_cli.forms").group(name))
    else:
        rodeo.add_typer(found, name=name)
    rodeo.callback()(lambda: None)  # else Typer makes one command of a group of one
    return typer.main.get_group(rodeo).commands[name]


@cache
def _complete() -> None:
    """Commands that other modules add to the groups of tasks and services."""
    from rodeo_cli import disputes, forms, people, services, tasks

    for command in (people.accept, people.abandon, people.submit, people.review, people.judge):
        tasks.tasks.command()(command)
    services.services.command()(people.offer)
    tasks.tasks.add_typer(disputes.disputes, name="dispute", cls=forms.group("task dispute"))


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"rodeo {version('rodeo-dao')}")
        raise typer.Exit


app = typer.Typer(
    name="rodeo",
    cls=_Rodeo,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


@app.callback()
def rodeo(
    show_version: Annotated[
        bool,
        typer.Option("--version", help="Show the version and exit.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Robots join an organization, do physical work, prove it and get paid."""
