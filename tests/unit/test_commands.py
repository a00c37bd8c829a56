"""A command of the organization is declared once, and named in at most one other file."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from importlib.metadata import version
from pathlib import Path

import typer
from typer.testing import CliRunner

from rodeo.commands import COMMANDS, Command
from rodeo_cli import app
from rodeo_cli.commands import COMMANDS as TYPED
from rodeo_testing.waiting import HANG_S

ROOT = Path(__file__).parents[2]
DECLARED_IN, CONTRACT = "rodeo/commands/", "rodeo/chain/"
APART = ("tests/", "bench/", "training/", "rodeo_testing/", "examples/", "rodeo_ros1/", DECLARED_IN, CONTRACT)
"""Tests, programs that import nothing of ours, and the declarations themselves with the contracts, whose
functions have the same names."""
MEANS_ANOTHER = {
    "transfer": (
        "services/bridge/projection/tokens.py",
        "services/console/money.py",
        "services/console/pages/treasury.py",
    ),
    "deposit": (
        *(
            "services/bridge/projection/tokens.py",
            "services/console/money.py",
            "services/console/pages/treasury.py",
        ),
        "rodeo_experiments/results.py",
    ),
    "withdraw": ("rodeo_cli/services.py",),
    "propose": ("rodeo_cli/organization.py",),
}
"""Word -> files in which it is the reason of a transfer, or a word of the command line."""
IN_SEVERAL = {
    "abandon_task": 2,
    "agree": 2,
    "conclude": 3,
    "pay_budget_share": 2,
    "match_task": 2,
    "post_votes": 2,
    "register_service": 3,
    # Goals of ROS 2 are this command, with fields and answers of their own; a bridge posts what robots see.
    "register_task": 11,
    "rule": 2,
    "update_service": 7,
}
"""Command -> how many files name it beside its declaration, where they are several: more than one process
sends it in a way of its own. The numbers only shrink."""


def files_that_name() -> dict[str, set[str]]:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    models = {model.__name__: name for name, model in COMMANDS.items()}
    found: dict[str, set[str]] = defaultdict(set)
    for path in listed.stdout.split():
        if path.startswith(APART):
            continue
        source = ast.parse((ROOT / path).read_text())
        declared = {
            one.name
            for node in ast.walk(source)
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rodeo.commands")
            for one in node.names
        }
        for node in ast.walk(source):
            match node:
                case ast.Constant(value=str(name)) if name in COMMANDS:
                    if path not in MEANS_ANOTHER.get(name, ()):
                        found[name].add(path)
                case ast.Name(id=name) if name in models and name in declared:
                    found[models[name]].add(path)
    return found


def test_a_command_is_named_in_at_most_one_file_beside_its_declaration() -> None:
    several = {name: len(files) for name, files in files_that_name().items() if len(files) > 1}
    assert several == IN_SEVERAL, "declare what is made from a command, instead of naming it once more"
    assert len(COMMANDS) - len(IN_SEVERAL) >= 55


def test_every_command_says_what_it_is_for() -> None:
    assert [name for name, model in COMMANDS.items() if not model.__dict__.get("__doc__")] == []


def test_every_option_that_is_made_from_a_field_has_its_help() -> None:
    for model in COMMANDS.values():
        own = [one for name, one in model.model_fields.items() if name not in Command.model_fields]
        assert not model.declared.line or all(one.description for one in own), model


def test_help_imports_no_command() -> None:
    code = (
        "import sys\n"
        "from rodeo_cli import app\n"
        "try:\n    app(['--help'])\nexcept SystemExit:\n    pass\n"
        "print({'rodeo.commands', 'rodeo_cli.common', 'rodeo.site.config', 'pydantic'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANG_S, cwd=ROOT
    )
    assert done.stdout.splitlines()[-1] == "set()"


def test_help_shows_the_beginning_of_each_commands_own_help() -> None:
    shown = typer.main.get_command(app)
    context = typer.Context(shown)
    for name in shown.list_commands(context):
        own = shown.get_command(context, name)
        assert own.name == name
        assert " ".join(own.help.split("\n\n")[0].split()) == TYPED[name][1], name


def test_version_is_that_of_the_package() -> None:
    done = CliRunner().invoke(app, ["--version"])
    assert (done.exit_code, done.output) == (0, f"rodeo {version('rodeo-dao')}\n")


def test_the_example_for_who_adds_a_command_is_one() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text()
    example = page.partition("```python\n")[2].partition("```")[0].strip()
    assert example and example in (ROOT / DECLARED_IN / "services.py").read_text()
