"""Queries the documentation as a reader would: its blocks, the commands in them, what each is for."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "CONTRIBUTING.md"]
PROGRAMS = ("rodeo", "make", "python", "pip", "npm", "ros2", "source", "export", "cast", "curl")
"""First words of a block that is typed into a shell."""


@dataclass(frozen=True)
class Block:
    page: str
    """Relative to the repository."""
    line: int
    kind: str
    """shell, toml, python, json, mermaid, or diagram for what is only to be looked at."""
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


@dataclass(frozen=True)
class Command:
    page: str
    line: int
    text: str
    """As it is written, without the comment behind it and joined where it goes on below."""

    @property
    def words(self) -> list[str]:
        return shlex.split(self.text)

    def __str__(self) -> str:
        return f"{self.page}:{self.line} {self.text}"


@cache
def blocks() -> list[Block]:
    """Every fenced or indented block of README, docs and CONTRIBUTING, in order."""
    return [block for page in PAGES for block in _blocks(page)]


def _blocks(page: Path) -> Iterator[Block]:
    for token in MarkdownIt("commonmark").parse(page.read_text()):
        if token.type in ("fence", "code_block") and token.map is not None:
            first = token.map[0] + (2 if token.type == "fence" else 1)
            yield Block(str(page.relative_to(ROOT)), first, token.info or _kind(token.content), token.content)


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
    for page in PAGES:
        for token in MarkdownIt("commonmark").enable("table").parse(page.read_text()):
            for child in token.children or []:
                if child.type == "code_inline" and child.content.startswith(
                    ("rodeo ", "make ", "python -m ", "npm run ")
                ):
                    line = token.map[0] + 1 if token.map else 0
                    found.append(Command(str(page.relative_to(ROOT)), line, child.content))
    return found


def links() -> list[tuple[str, str]]:
    """(page, target) of every link and picture that leads into the repository."""
    found = []
    for page in PAGES:
        for token in MarkdownIt("commonmark").enable("table").parse(page.read_text()):
            for child in token.children or []:
                target = str(child.attrs.get("href") or child.attrs.get("src") or "")
                if target and "://" not in target:
                    found.append((str(page.relative_to(ROOT)), target))
    return found


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
