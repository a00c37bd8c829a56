"""What the processes of a site cost: CPU time and memory of each, with all its children."""

from __future__ import annotations

import time
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bench.cpu import cpu_s
from deploy.launcher import Launcher


@dataclass(frozen=True)
class Cost:
    """A process and its children, at one moment."""

    cpu_s: float
    """User and system time since they began."""
    resident_mb: float
    """Sum of their resident sizes, MB of 2^20 bytes: a page that several share counts for each of them."""
    share_mb: float
    """Sum of their shares: of a page that n processes share, an nth (`Pss` in proc_pid_smaps(5))."""


def costs(launcher: Launcher) -> dict[str, Cost]:
    """Costs of all running processes of the site, by name."""
    children = _children()
    return {name: _cost(_tree(pid, children)) for name, pid in launcher.running().items()}


@dataclass(frozen=True)
class Spent:
    """What a site's processes needed for a while."""

    cpu_s: dict[str, float]
    """By process."""
    wall_s: float

    @property
    def cores(self) -> float:
        return sum(self.cpu_s.values()) / self.wall_s


class Meter:
    """Measures from when it is made."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher, self._begun_s, self._before = launcher, time.perf_counter(), costs(launcher)

    def spent(self) -> Spent:
        """Until now."""
        after, before = costs(self._launcher), self._before
        spent_s = {name: after[name].cpu_s - before[name].cpu_s for name in after.keys() & before.keys()}
        return Spent(spent_s, time.perf_counter() - self._begun_s)


def table(spent: Spent, now: dict[str, Cost]) -> str:
    """One line for each process, the costliest first."""
    lines = [f"  {'process':<14}{'% of a core':>12}{'resident MB':>13}{'share MB':>10}"]
    for name, used_s in sorted(spent.cpu_s.items(), key=lambda one: -one[1]):
        cost, percent = now[name], 100 * used_s / spent.wall_s
        lines.append(f"  {name:<14}{percent:>12.1f}{cost.resident_mb:>13.0f}{cost.share_mb:>10.0f}")
    return "\n".join(lines)


def _children() -> dict[int, list[int]]:
    """Process -> its children, of the whole machine."""
    found: dict[int, list[int]] = defaultdict(list)
    for entry in Path("/proc").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # it has ended
            if entry.name.isdigit():
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                found[int(fields[1])].append(int(entry.name))
    return found


def _tree(pid: int, children: dict[int, list[int]]) -> list[int]:
    return [pid, *(one for child in children.get(pid, []) for one in _tree(child, children))]


def _cost(pids: list[int]) -> Cost:
    used_s = resident_mb = share_mb = 0.0
    for pid in pids:
        with suppress(FileNotFoundError, ProcessLookupError):
            used_s += cpu_s(pid, with_ended=True)
            rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
            sizes = {name: value for name, _, value in (line.partition(":") for line in rollup.splitlines())}
            resident_mb += int(sizes["Rss"].split()[0]) / 1024
            share_mb += int(sizes["Pss"].split()[0]) / 1024
    return Cost(used_s, resident_mb, share_mb)
