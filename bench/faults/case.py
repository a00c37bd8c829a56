"""What a case of a fault is: what it breaks, how it begins and ends, and what must be true afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

BASE = ("router", "chain", "bridge")
"""Enough to post, prove, judge and pay a task, where the case itself speaks for executor and oracle."""

Script = Callable[[Any], Iterator[None]]
"""Gets the `Lab`. Causes the fault; yields while it stands; ends it; yields until the site works again; then
asserts."""


@dataclass(frozen=True)
class Case:
    name: str
    area: str
    breaks: str
    """What is broken, in one sentence."""
    script: Script
    said: str = ""
    """Regular expression for the reason, which a process's state, its log or the launcher says while the
    fault stands. Case is ignored. Empty where nothing has to be said, for nobody can see it."""
    processes: tuple[str, ...] = BASE
    backend: str = "eth-tester"
    extra: str = ""
    """TOML of the site: dotted keys first, then tables."""
    small_disk: str = ""
    """Folder of the data directory that lies on a disk of its own, which the case fills."""
    held_s: float = 0.0
    """Wall time for which the fault stands at least."""
    asks: bool = True
    """A task is posted while the fault stands, again and again with one request_id, until it is answered."""
    works: bool = True
    """The site is up before the script begins; else the script calls `Lab.start`."""
    workers: bool = True
    """Others than the robot offer to work, too, so that there is work beside a task that hangs."""
    waits: bool = False
    """It spends its time waiting: it runs beside the others."""


CASES: dict[str, Case] = {}


def case(breaks: str, **fields: object) -> Callable[[Script], Script]:
    """Enter a script into the table, under its own name and its file's."""

    def enter(script: Script) -> Script:
        area = script.__module__.rpartition(".")[2]
        add(Case(script.__name__, area, breaks, script, **fields))  # type: ignore[arg-type]
        return script

    return enter


def add(one: Case) -> None:
    assert one.name not in CASES, f"two cases are called {one.name}"
    CASES[one.name] = one
