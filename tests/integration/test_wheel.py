"""Wheels in an environment of their own, in an empty folder: the demo runs without a checkout.

The kind `waste_disposal` is a wheel of its own there, as a third party builds it from its folder alone.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.support.site import LAB

pytestmark = pytest.mark.long

ROOT = LAB.parents[2]
BUILT_FROM = ("pyproject.toml", "README.md", "LICENSE", "rodeo*", "services", "deploy")
KIND = "waste_disposal"
KIND_PROJECT = f"""
[project]
name = "their-{KIND.replace("_", "-")}"
version = "1.0"
dependencies = ["rodeo-dao"]

[project.entry-points."rodeo.kinds"]
{KIND} = "rodeo_kinds.{KIND}:KIND"

[tool.setuptools.packages.find]
include = ["rodeo_kinds.{KIND}*"]
"""
LIMIT_S = 3_000.0
"""Wall time after which a command hangs."""


class Environment:
    """A virtual environment with both wheels and RODEO's extra `site`, and an empty folder to work in.

    pip installs the wheel and checks that the extra's requirements are met. They are not downloaded again,
    which takes four minutes: a .pth file leads to a folder with links to those distributions of the running
    environment that the extra names, directly or not, and to no others. So what only tests need is missing,
    and so is the editable installation that leads to the checkout.
    """

    def __init__(self, folder: Path) -> None:
        self.work = folder / "empty"
        self.work.mkdir()
        self.home = folder / "home"
        self.home.mkdir()
        self.bin = folder / "venv" / "bin"
        wheel, kind = _build(folder)
        _run([sys.executable, "-m", "venv", str(folder / "venv")], folder)
        needed = folder / "needed"
        needed.mkdir()
        (own,) = distributions(path=[str(wheel)])
        for one in _requirements(own, {"site"}).values():
            _link(one, needed)
        self.packages = Path(self.python("import sysconfig; print(sysconfig.get_path('purelib'))"))
        (self.packages / "needed.pth").write_text(f"{needed}\n")
        constraints = str(ROOT / "constraints.txt")
        _run(
            [str(self.bin / "pip"), "install", "-q", "-c", constraints, f"{wheel}[site]", str(kind)],
            self.work,
        )

    def python(self, program: str) -> str:
        return _run([str(self.bin / "python"), "-c", program], self.work, self.env).strip()

    def rodeo(self, *words: str, limit_s: float = LIMIT_S) -> str:
        return _run([str(self.bin / "rodeo"), *words], self.work, self.env, limit_s)

    @property
    def env(self) -> dict[str, str]:
        kept = {name: text for name, text in os.environ.items() if not name.startswith(("PYTHON", "RODEO"))}
        return kept | {"HOME": str(self.home)}


def _run(
    command: list[str], folder: Path, env: dict[str, str] | None = None, limit_s: float = LIMIT_S
) -> str:
    done = subprocess.run(
        command, cwd=folder, env=env, capture_output=True, text=True, timeout=limit_s, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def _build(folder: Path) -> tuple[Path, Path]:
    """RODEO's wheel, and the kind's. From copies: setuptools packs what an earlier build left in a folder."""
    source, kind = folder / "source", folder / "kind"
    source.mkdir()
    for path in (found for pattern in BUILT_FROM for found in ROOT.glob(pattern)):
        if path.is_dir():
            shutil.copytree(
                path, source / path.name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
            )
        else:
            shutil.copy(path, source)
    (kind / "rodeo_kinds").mkdir(parents=True)
    shutil.move(source / "rodeo_kinds" / KIND, kind / "rodeo_kinds")
    (kind / "pyproject.toml").write_text(KIND_PROJECT)
    declared = (source / "pyproject.toml").read_text()
    (source / "pyproject.toml").write_text(declared.replace(f'{KIND} = "rodeo_kinds.{KIND}:KIND"\n', ""))
    projects = [str(source), str(kind)]
    _run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), *projects], folder)
    shutil.rmtree(source)
    (wheel,) = folder.glob("rodeo_dao-*-py3-none-any.whl")
    (theirs,) = folder.glob("their_*-py3-none-any.whl")
    return wheel, theirs


def _requirements(own: Distribution, extras: set[str]) -> dict[str, Distribution]:
    """By name every distribution of the running environment that `own[extras]` needs, itself left out."""
    waiting, seen = [(own, extra) for extra in ("", *extras)], set()
    found: dict[str, Distribution] = {}
    while waiting:
        needing, extra = waiting.pop()
        for requirement in map(Requirement, needing.requires or []):
            marker = requirement.marker
            if marker is not None and not marker.evaluate({"extra": extra}):
                continue
            name = requirement.name
            needed = own if name == own.name else found.setdefault(name, distribution(name))
            new = {(name, more) for more in ("", *requirement.extras)} - seen
            waiting += [(needed, more) for _, more in new]
            seen |= new
    return found


def _link(one: Distribution, folder: Path) -> None:
    """Link each top folder and file of a distribution, its metadata among them."""
    for top in {file.parts[0] for file in one.files or [] if file.parts[0] not in ("..", "__pycache__")}:
        if not (folder / top).exists():
            (folder / top).symlink_to(Path(str(one.locate_file(top))))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    return Environment(tmp_path_factory.mktemp("wheel"))


def test_nothing_is_imported_from_the_checkout(installed: Environment) -> None:
    program = (
        "import json, sys, rodeo, rodeo_cli, services, deploy\n"
        "print(json.dumps([[m.__file__ for m in (rodeo, rodeo_cli, services, deploy)], sys.path]))"
    )
    files, path = json.loads(installed.python(program))
    assert all(Path(file).is_relative_to(installed.packages) for file in files), files
    assert [folder for folder in path if folder and Path(folder).resolve().is_relative_to(ROOT)] == []
    program = (
        "import json\nfrom importlib.metadata import entry_points as found\n"
        "print(json.dumps({one.name: one.dist.name for one in found(group='rodeo.kinds')}))"
    )
    kinds = json.loads(installed.python(program))
    assert kinds == {"battery_charging": "rodeo-dao", KIND: "their-waste-disposal"}
    left_out = ("bench", "tests", "training", "pytest")
    missing = f"import importlib.util as u; print([m for m in {left_out} if u.find_spec(m)])"
    assert installed.python(missing) == "[]"


def test_the_demo_pays_for_a_task_of_a_third_partys_kind_without_a_checkout(installed: Environment) -> None:
    installed.rodeo("demo", "--limit", str(LIMIT_S - 30))
    summary = json.loads((installed.work / "out" / "demo" / "summary.json").read_text())
    assert {task["kind"]: task["state"] for task in summary["tasks"]} == {
        KIND: "settled",
        "battery_charging": "settled",
    }
    assert summary["supply_iec"]["before"] == summary["supply_iec"]["after"]


def test_the_default_site_is_the_installed_lab_with_its_data_at_home(installed: Environment) -> None:
    data = installed.home / ".local" / "share" / "rodeo" / "lab"
    try:
        said = installed.rodeo("up", "--detach", "router")
    finally:
        stopped = installed.rodeo("down")
    assert str(data) in said and (data / "logs" / "router.log").exists()
    assert stopped.startswith("stopped: ") and "router" in stopped
    checked = json.loads(installed.rodeo("site", "check", "--json"))
    assert checked["site_file"] == str(installed.packages / "deploy" / "sites" / "installed.toml")
