"""How much memory a process has needed."""

from __future__ import annotations

from pathlib import Path


def peak_mb() -> float:
    """The largest resident size of this process so far, MB of 2^20 bytes.

    Not getrusage: its largest size is also that of the process from which this one was started.
    """
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status["VmHWM"].split()[0]) / 1024
