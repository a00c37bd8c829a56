"""What architecture.md, one-task.md and extend.md say of files, names, processes and rooms is so."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from functools import cache
from itertools import pairwise

import pytest
from markdown_it import MarkdownIt
from markdown_it.token import Token

from rodeo import kinds
from rodeo.site.minds import AGENT
from rodeo.site.processes import PROCESSES
from rodeo.site.topics import BODY, DRIVER, NODE, RECORDER, TOPICS, Form
from tests.docs.text import ROOT

ARCHITECTURE, ONE_TASK = "docs/explanation/architecture.md", "docs/explanation/one-task.md"
PAGES = [ARCHITECTURE, ONE_TASK, "docs/how-to/extend.md"]
TOP = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.is_symlink()} - {"out"}
ROOT_FILE = re.compile(r"Makefile|LICENSE|[\w.-]+\.(md|toml|json|txt|cff)")
NAME = re.compile(r"_?[A-Za-z]\w*")
ARROW = re.compile(r"\s+(.+?) (-->|-\.->)\|(.+)\| (.+)")
KIND_FREE = ("rodeo", "services", "deploy", "rodeo_cli", "rodeo_experiments")
"""Rooms in which no file names a kind of work."""
ABOVE = ("rodeo_kinds", "services", "deploy", "rodeo_cli")
BESIDE = {"people", "nodes", "cli", "store"}
"""Nodes in the picture of processes that are none."""

LAYERS: list[str] = next(
    contract["layers"]
    for contract in tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    if contract["name"] == "Imports between rooms run down only"
)


@cache
def tokens(page: str) -> list[Token]:
    return MarkdownIt("commonmark").enable("table").parse((ROOT / page).read_text())


def codes(token: Token) -> list[str]:
    return [child.content for child in token.children or [] if child.type == "code_inline"]


def words(page: str) -> set[str]:
    """All words that stand in code, inline or in blocks."""
    texts = [text for token in tokens(page) for text in codes(token)]
    texts += [token.content for token in tokens(page) if token.type == "code_block"]
    return {word for text in texts for word in text.split()}


def rows(page: str) -> Iterator[list[Token]]:
    """The cells of each row of each table, without the heads."""
    cells: list[Token] = []
    inside = False
    for before, token in pairwise(tokens(page)):
        if before.type == "td_open":
            inside = True
            cells.append(token)
        elif token.type == "tr_close" and inside:
            yield cells
            cells, inside = [], False


def pictures() -> list[str]:
    return [token.content for token in tokens(ARCHITECTURE) if token.info == "mermaid"]


# -- files -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES)
def test_every_file_that_a_page_names_exists(page: str) -> None:
    named = {word.partition("::")[0] for word in words(page) if "{" not in word}
    within = {word for word in named if "/" in word and word.split("/")[0] in TOP}
    paths = within | {word for word in named if ROOT_FILE.fullmatch(word)}
    assert len(paths) > 40
    assert [path for path in sorted(paths) if not (ROOT / path).exists()] == []


@pytest.mark.parametrize("page", PAGES)
def test_a_name_beside_a_file_stands_in_that_file(page: str) -> None:
    missing = []
    for first, *others in rows(page):
        path = ROOT / next(iter(codes(first)), "")
        if path.suffix not in (".py", ".sol"):
            continue
        source = path.read_text()
        for name in (code for cell in others for code in codes(cell) if NAME.fullmatch(code)):
            if not re.search(rf"\b{name}\b", source):
                missing.append(f"{codes(first)[0]}: {name}")
    assert missing == []


def test_no_file_outside_the_kinds_folders_names_a_kind() -> None:
    names = sorted(kinds.installed())
    assert names == ["battery_charging", "waste_disposal"]
    sources = [path for room in KIND_FREE for path in (ROOT / room).rglob("*.py")]
    naming = [path for path in sources if any(name in path.read_text() for name in names)]
    assert {str(path.relative_to(ROOT)) for path in naming} == set()


# -- processes ---------------------------------------------------------------------------------------------


def arrows() -> list[tuple[list[str], str, str, list[str]]]:
    """(from, `-->` on the bus or `-.->` beside it, label, to) of the picture of processes."""
    found = [ARROW.fullmatch(line) for line in pictures()[0].splitlines()]
    return [(one[1].split(" & "), one[2], one[3], one[4].split(" & ")) for one in found if one]


def flows() -> dict[str, list[str]]:
    """Label of an arrow -> keys of the bus."""
    return {
        cells[0].content: codes(cells[1])
        for cells in rows(ARCHITECTURE)
        if not codes(cells[0])  # the other tables begin with a file
    }


def test_the_picture_of_processes_is_the_table_of_processes() -> None:
    within = pictures()[0].partition("subgraph router")[2].partition("\n    end")[0].splitlines()[1:]
    assert {"router", *map(str.strip, within)} == {process.name for process in PROCESSES}
    ends = {end for sources, _, _, targets in arrows() for end in (*sources, *targets)}
    assert ends == {process.name for process in PROCESSES} - {"router"} | BESIDE


def test_every_arrow_on_the_bus_starts_or_ends_at_the_keys_writer() -> None:
    table = {topic.key: topic for topic in TOPICS}
    drawn = [(sources, label, targets) for sources, line, label, targets in arrows() if line == "-->"]
    assert {label for _, label, _ in drawn} == set(flows())
    for sources, label, targets in drawn:
        for topic in (table[key] for key in flows()[label]):
            writers = sources if topic.form is Form.TOPIC else targets
            # The only bodies in the picture are those that the simulator speaks for.
            writer = {BODY: "robot_sim", DRIVER: "robot_sim", NODE: "nodes"}.get(topic.writer, topic.writer)
            # A mind of ours has a recorder's part in it.
            part = {AGENT, RECORDER} if writer == RECORDER else {writer}
            assert writer == "every process" or set(writers) <= part, (label, topic.key)


def test_every_key_on_the_page_is_in_the_table_of_keys() -> None:
    keys = {word for word in words(ARCHITECTURE) if "{" in word}
    assert keys <= {topic.key for topic in TOPICS}


# -- rooms -------------------------------------------------------------------------------------------------


def test_the_picture_of_rooms_is_what_the_linter_enforces() -> None:
    drawn: set[tuple[str, str]] = set()
    for line in pictures()[1].splitlines()[1:]:
        ranks = [rank.strip().split(" & ") for rank in line.split("-->")]
        drawn |= {(above, below) for upper, lower in pairwise(ranks) for above in upper for below in lower}
    while further := {(a, d) for a, b in drawn for c, d in drawn if b == c} - drawn:
        drawn |= further
    layers = [layer.split(" | ") for layer in LAYERS]
    assert drawn == {
        (above, below)
        for number, upper in enumerate(layers)
        for lower in layers[number + 1 :]
        for above in upper
        for below in lower
    }


def test_every_package_of_the_rooms_is_on_the_page() -> None:
    rooms = [room for layer in LAYERS for room in layer.split(" | ")]
    packages = {init.parent for room in rooms for init in (ROOT / room).rglob("__init__.py")}
    named = {word.rstrip("/") for word in words(ARCHITECTURE) if word.endswith("/")}
    assert {str(package.relative_to(ROOT)) for package in packages} <= named
