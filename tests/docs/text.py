"""Queries the documentation as a reader would: its blocks, the commands in them, what each is for."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LAST = DOCS / "tutorials" / "bin.md"
"""Replaces the bin's key, so its commands come after those of all other pages."""
PROGRAMS = (
    "apt-get",
    "git",
    "rodeo",
    "make",
    "python",
    "python3",
    "sudo",
    "docker",
    "/opt/rodeo/bin/rodeo",
    "pip",
    "npm",
    "ros2",
    "source",
    "export",
    "roslaunch",
    "rosservice",
    "cp",
    "cast",
    "curl",
)
"""First words of a block that is typed into a shell."""


@dataclass(frozen=True)
class Block:
    page: str
    """Relative to the repository."""
    line: int
    kind: str
    """shell, toml, python, json, mermaid, or diagram for what is only to be looked at; {literalinclude}
    with the file's text."""
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


@dataclass(frozen=True)
class Command:
    page: str
    line: int
    text: str
    """As it is written, without the comment behind it and joined where it continues below."""

    @property
    def words(self) -> list[str]:
        return shlex.split(self.text)

    def __str__(self) -> str:
        return f"{self.page}:{self.line} {self.text}"


@cache
def pages() -> list[Path]:
    """README, the pages in the order in which docs/index.md lists them, and CONTRIBUTING."""
    index = DOCS / "index.md"
    listed = list(dict.fromkeys(DOCS / target for target in _targets(index) if "decisions/" not in target))
    read = [page for page in listed if page != LAST]
    return [
        ROOT / "README.md",
        index,
        *read,
        *(page for page in listed if page == LAST),
        ROOT / "CONTRIBUTING.md",
    ]


@cache
def blocks() -> list[Block]:
    """Every fenced or indented block of these pages, in order."""
    return [block for page in pages() for block in _blocks(page)]


def _blocks(page: Path) -> Iterator[Block]:
    for token in MarkdownIt("commonmark").parse(page.read_text()):
        if token.type in ("fence", "code_block") and token.map is not None:
            first = token.map[0] + (2 if token.type == "fence" else 1)
            directive, _, argument = token.info.partition(" ")
            kind, text = directive or _kind(token.content), token.content
            if kind == "{literalinclude}":
                text = (page.parent / argument).read_text()
            yield Block(str(page.relative_to(ROOT)), first, kind, text)


def _kind(text: str) -> str:
    if text.split()[0] in PROGRAMS:
        return "shell"
    try:
        return "toml" if tomllib.loads(text) else "diagram"
    except tomllib.TOMLDecodeError:
        return "question" if text.startswith("rodeo/") else "diagram"


def commands() -> list[Command]:
    """Every command of every shell block, in the order in which a reader meets it."""
    found = []
    for block in blocks():
        if block.kind != "shell":
            continue
        begun = ""
        for number, line in enumerate(block.text.splitlines()):
            begun += line.removesuffix("\\")
            if not line.endswith("\\") and begun.strip():
                found.append(Command(block.page, block.line + number, _without_comment(begun)))
                begun = ""
    return found


def mentioned() -> list[Command]:
    """Commands within sentences: `rodeo down`, `make test-long`."""
    found = []
    for page in pages():
        for token in MarkdownIt("commonmark").enable("table").parse(page.read_text()):
            for child in token.children or []:
                if child.type == "code_inline" and child.content.startswith(
                    ("rodeo ", "make ", "python -m ", "npm run ")
                ):
                    line = token.map[0] + 1 if token.map else 0
                    found.append(Command(str(page.relative_to(ROOT)), line, child.content))
    return found


def _targets(page: Path) -> list[str]:
    """Where the links and pictures of a page lead, if into the repository."""
    tokens = MarkdownIt("commonmark").enable("table").parse(page.read_text())
    children = (child for token in tokens for child in token.children or [])
    found = (str(child.attrs.get("href") or child.attrs.get("src") or "") for child in children)
    return [target for target in found if target and "://" not in target]


def linked_pages(page: Path) -> set[Path]:
    """The pages that a page links to."""
    paths = {(page.parent / target.partition("#")[0]).resolve() for target in _targets(page)}
    return {path for path in paths if path.suffix == ".md"}


def headings(page: Path) -> list[str]:
    """The anchors of a page's headings."""
    tokens = MarkdownIt("commonmark").parse(page.read_text())
    return [slug(text.content) for head, text in pairwise(tokens) if head.type == "heading_open"]


def broken_links_of(page: Path) -> list[str]:
    """Links of a page that lead to no file or no heading."""
    found = []
    for target in _targets(page):
        file, _, heading = target.partition("#")
        path = (page.parent / file).resolve() if file else page
        if not path.exists():
            found.append(f"{page}: {target}: there is no such file")
        elif heading and heading not in headings(path):
            found.append(f"{page}: {target}: there are {sorted(headings(path))}")
    return found


def broken_links() -> list[str]:
    """Those of every page, and pages that docs/index.md does not list."""
    every = {*pages(), *DOCS.rglob("*.md"), *ROOT.glob("*.md"), *(ROOT / ".github").rglob("*.md")}
    every |= {*(ROOT / "training").rglob("*.md"), *(ROOT / "examples").rglob("*.md")}
    found = [broken for page in sorted(every) for broken in broken_links_of(page)]
    listed = {*pages(), *(DOCS / "decisions").glob("*.md")}
    return found + [
        f"docs/index.md does not list {page}" for page in DOCS.rglob("*.md") if page not in listed
    ]


def slug(title: str) -> str:
    """The anchor of a heading, as GitHub makes it."""
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")


def _without_comment(line: str) -> str:
    """Up to the first # that stands alone outside quotes."""
    quote = ""
    for at, character in enumerate(line):
        if quote:
            quote = "" if character == quote else quote
        elif character in "'\"":
            quote = character
        elif character == "#" and (at == 0 or line[at - 1] == " "):
            return line[:at].strip()
    return line.strip()
