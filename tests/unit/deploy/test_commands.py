"""A certificate may send the commands that its process's code sends, and no others. The code is read here."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import zenoh

from deploy.access import access_control, commands_of, everybody
from rodeo.commands import COMMANDS
from rodeo.interfaces import package
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.site.config import Site
from rodeo.site.sections import JudgeConfig, OtherBridgeConfig, ParticipantConfig
from services.bridge.wallet import KNOWN
from tests.support.site import LAB

ROOT = Path(__file__).parents[3]

CODE = {
    "robot_agent": ("services/robot_agent", "rodeo_kinds"),
    "charger": ("services/charger",),
    "ros_dao": ("services/ros_dao",),
    "itrash": ("services/itrash",),
    "robot_sim": ("services/robot_sim",),
    "mocap": ("services/mocap",),
    "oracle": ("services/oracle",),
    "console": ("services/console",),
    "operator": ("rodeo_cli", "rodeo_experiments"),
    "router": ("deploy",),
}
"""Process -> folders of its own code. The bridge carries commands out, and `rodeo` is everybody's."""


@cache
def parsed(folder: str) -> list[ast.Module]:
    """The files below `folder`, without what only forges evidence."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return [ast.parse(path.read_text()) for path in paths if "harness" not in path.parts]


SIGNS_ITSELF = {"prepare", "broadcast", "sign"}
"""What `Participant` sends where its `account` signs; no process of the table has one."""


NOUNS = ("count", "widgets.pager")
"""Functions whose text is no command."""


def literals(tree: ast.AST) -> set[str]:
    """Names of commands that `tree` makes, passes to any function, or assigns to a variable."""
    decorators = {id(one) for node in ast.walk(tree) for one in getattr(node, "decorator_list", ())}
    values: list[ast.expr] = []
    for node in ast.walk(tree):
        # They write numbers and nouns, transfers among them.
        if isinstance(node, ast.Call) and id(node) not in decorators and ast.unparse(node.func) not in NOUNS:
            values += [*node.args, *(one.value for one in node.keywords)]
        elif isinstance(node, ast.Assign):
            values.append(node.value)
    chosen = [one for value in values for one in _chosen(value)]
    calls = [
        node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    ]
    made = {
        ast.unparse(node.args[0] if node.args and node.func.id == "validate" else node.func) for node in calls
    }
    names = {str(one.value) for one in chosen if isinstance(one, ast.Constant) and one.value in KNOWN}
    return names | {name for name, model in COMMANDS.items() if model.__name__ in made}


def _chosen(value: ast.expr) -> Iterator[ast.expr]:
    if isinstance(value, ast.IfExp):
        yield from (*_chosen(value.body), *_chosen(value.orelse))
    else:
        yield value


def used(tree: ast.AST) -> set[str]:
    """Names that `tree` imports from the shared package, and `.name` for each method that it uses."""
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    found = {one.name for node in imports for one in node.names if (node.module or "").startswith("rodeo")}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            found.add(f".{node.attr}")
            if ast.unparse(node.value) in found:
                found.add(node.attr)
    return found


@cache
def shared() -> dict[str, set[str]]:
    """Functions and classes of the shared package, methods of `Participant` -> the commands they send."""
    sends: dict[str, set[str]] = {}
    uses: dict[str, set[str]] = {}
    for path in sorted((ROOT / "rodeo").rglob("*.py")):
        if path.parent.name in ("chain", "commands") or path.name == "payloads.py":
            continue  # what a contract is called with, declarations, and documentation
        units: dict[str, ast.AST] = {}
        module = ast.parse(path.read_text())
        for node in module.body:
            if isinstance(node, ast.ClassDef) and node.name == "Participant":
                methods = {one.name: one for one in node.body if isinstance(one, ast.FunctionDef)}
                assert literals(methods.pop("command")) | literals(methods.pop("sign")) == SIGNS_ITSELF
                units |= {f".{name}": method for name, method in methods.items()}
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                units[node.name] = node
        known = units.keys() | used(
            ast.Module([one for one in module.body if isinstance(one, ast.ImportFrom)])
        )
        for name, unit in units.items():
            beside = {one.id for one in ast.walk(unit) if isinstance(one, ast.Name)} & known
            sends[name], uses[name] = literals(unit), used(unit) | beside
    while True:
        more = {
            name: own.union(*(sends[one] for one in uses[name] & sends.keys())) for name, own in sends.items()
        }
        if more == sends:
            return {name: found for name, found in sends.items() if found}
        sends = more


def sent_by(process: str) -> set[str]:
    found: set[str] = set()
    for folder in CODE[process]:
        for tree in parsed(folder):
            found |= literals(tree).union(*(shared()[one] for one in used(tree) & shared().keys()))
    return found


def made_for(process: str) -> set[str]:
    """Commands whose line, action or service is made from their declaration."""
    if process == "ros_dao":
        return {one.name for one in package.commands().values()}
    made = {"operator": "line", "console": "console"}.get(process, "")
    return {name for name, model in COMMANDS.items() if made and getattr(model.declared, made)}


@pytest.mark.parametrize("process", CODE)
def test_a_process_may_send_the_commands_that_its_code_sends_and_no_others(process: str) -> None:
    assert sent_by(process) | made_for(process) == commands_of(process)


def test_the_shared_package_sends_commands_where_it_is_known_to() -> None:
    assert shared().keys() == {
        *(".offer_service", ".accept_task", ".abandon_task", ".raise_reward", ".submit_proof"),
        ".set_payout",
        *(
            ".conclude_rulings",
            "acceptance",
            "abandonment",
            "cancellation",
            "Executor",
            "judge",
            "DailyRoots",
            "MotionCapture",
            "Rulings",
        ),
    }


def test_commands_are_addressed_in_three_places_only() -> None:
    folders = ("rodeo", "services", "rodeo_cli", "rodeo_experiments", "rodeo_kinds", "deploy")
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    addressed = {str(path.relative_to(ROOT)) for path in paths if "COMMAND.name(" in path.read_text()}
    assert addressed == {
        *("rodeo/dao.py", "services/console/actions.py", "rodeo_cli/common.py"),
        "deploy/access.py",
    }


def test_no_process_signs_for_itself() -> None:
    """Else it would have to be allowed what `Participant` sends with an account."""
    for folder in itertools.chain.from_iterable(CODE.values()):
        for node in itertools.chain.from_iterable(map(ast.walk, parsed(folder))):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Participant"):
                assert len(node.args) <= 3 and not node.keywords, ast.unparse(node)


@pytest.fixture(scope="module")
def site() -> Site:
    """Several of everything, and a participant who signs for itself."""
    plural = Site.load(LAB.with_name("plural.toml"))
    robots = [RobotConfig(name=name, pose=Pose2(x_m=1, y_m=1)) for name in ("panther1", "panther2")]
    outside = ParticipantConfig(name="outside", address="0x" + "1" * 40)
    return plural.model_copy(
        update={
            "robots": robots,
            "oracles": [JudgeConfig(name=name) for name in ("anna", "bert", "carl")],
            "bridges": [OtherBridgeConfig(name="judges")],
            "participants": [*plural.participants, outside],
        }
    )


def own_wallets(site: Site, process: str) -> list[str]:
    """The wallets that a process works for; all of the site for those who speak for people."""
    job, _, name = process.partition(".")
    if job in ("robot_agent", "oracle"):
        return [name]
    if job in ("console", "operator"):
        return site_wallets(site)
    return ["organization"]


def site_wallets(site: Site) -> list[str]:
    robots, others = [one.name for one in site.robots], [one.name for one in site.participants]
    return ["organization", *robots, *others, "anna", "bert", "carl"]


def test_every_other_command_of_every_wallet_is_refused(site: Site) -> None:
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(site)["rules"]}
    names = everybody(site)
    assert {"robot_agent", "charger", "itrash", "oracle", "body"} <= {
        name.partition(".")[0] for name in names if "." in name
    }
    for name in names:
        allowed = [zenoh.KeyExpr(key) for key in rules[f"{name} asks"] if key.startswith("rodeo/")]

        def may(wallet: str, command: str, allowed: list[zenoh.KeyExpr] = allowed) -> bool:
            key = zenoh.KeyExpr(f"rodeo/{site.org}/wallet/{wallet}/{command}")
            return any(one.includes(key) for one in allowed)

        commands = commands_of(name.partition(".")[0])
        for wallet, command in itertools.product(site_wallets(site), sorted(KNOWN)):
            expected = command in commands and wallet in own_wallets(site, name)
            expected |= name == "operator" and wallet == "outside" and command in SIGNS_ITSELF
            assert may(wallet, command) is expected, (name, wallet, command)
        for wallet in (*site_wallets(site), "*"):
            assert not may(wallet, "*") and not may(wallet, "**"), (name, wallet)
