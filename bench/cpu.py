"""How much CPU time a process has used."""

from __future__ import annotations

import os
from pathlib import Path


def cpu_s(pid: int, *, with_ended: bool = False) -> float:
    """User and system time of a process (proc(5), fields 14 and 15), and of its children that have ended (16
    and 17)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11 : 15 if with_ended else 13])) / os.sysconf("SC_CLK_TCK")
