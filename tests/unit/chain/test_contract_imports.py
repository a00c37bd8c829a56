"""The contracts' files import in one direction: services do not know who gives them their work."""

from __future__ import annotations

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "contracts" / "src"
IMPORT = re.compile(r'^import\s+(?:[^";]*\sfrom\s+)?"(\.[^"]+)";', re.MULTILINE)


def imports(root: Path) -> dict[str, set[str]]:
    """File -> the files of the same tree that it imports."""
    return {
        str(path.relative_to(root)): {
            str((path.parent / name).resolve().relative_to(root.resolve()))
            for name in IMPORT.findall(path.read_text())
        }
        for path in root.rglob("*.sol")
    }


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Files of which each imports the next one, the first again at the end; empty if there are none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found: list[str] = error.args[1]
        return found
    return []


def reached(graph: dict[str, set[str]], start: str) -> set[str]:
    """What a file imports, and what that imports, and so on."""
    found: set[str] = set()
    ahead = {start}
    while ahead:
        ahead = {name for file in ahead for name in graph[file]} - found
        found |= ahead
    return found


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = imports(SOURCES)
    assert "interfaces/IServiceManager.sol" in graph["TaskManager.sol"], "the imports are read"
    assert circle(graph) == []


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"A.sol": "", "i/B.sol": 'import {A} from "../A.sol";'}, set()),
        (
            {"A.sol": 'import {\n    B,\n    C\n} from "./i/B.sol";', "i/B.sol": 'import "../A.sol";'},
            {"A.sol", "i/B.sol"},
        ),
        ({"A.sol": 'import {E} from "@openzeppelin/E.sol";'}, set()),
    ],
    ids=["one way", "a circle", "a package"],
)
def test_a_circle_is_found(tmp_path: Path, files: dict[str, str], expected: set[str]) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert set(circle(imports(tmp_path))) == expected


def test_services_do_not_know_tasks() -> None:
    graph = imports(SOURCES)
    assert not graph["ServiceManager.sol"] & {"TaskManager.sol", "interfaces/ITaskManager.sol"}
    for interface in ("IServiceManager", "IServiceListener", "IMatchingPolicy"):
        known = reached(graph, f"interfaces/{interface}.sol")
        assert not known & {"interfaces/ITaskManager.sol", "interfaces/IOrganization.sol"}, interface
