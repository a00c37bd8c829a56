"""A lab without the simulator, also while a device is unplugged, lies, or has a wrong clock.

`lab_cases`, `lab_right`: the table `tests/reallab/cases.toml`, and the cases that end as it says.
`lab_wall_s`: from nothing to two robots' cleanings and a charge that are paid, as `make lab` has it.
`lab_<driver>_delay_p50_ms`, `_p99_ms`: from the device's own stamp to the signed statement about it; for the
meter, which signs several readings at once, that of the newest, and `lab_modbus_oldest_...` of the oldest.
`lab_<driver>_cpu`: share of a core that the driver's process takes.
`lab_<driver>_lost_s_per_s`: the longest time of which nothing is signed, for each second without the device.
`lab_offset_error_p50_ms`, `_p99_ms`: by how much the offset of a clock is wrong under 50 ms of jitter.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from tests.support.jitter import errors_ms
from tests.support.lab_cases import CASES, UNPLUGGED_S, outcomes
from tests.support.lab_figures import MODBUS, NATNET, Listener
from tests.support.reallab import RealLab, work

JITTER_MS = 50.0
_NICE = "-10"
"""Nice value of a session's autogroup (sched(7)); 0 is usual."""
LOSES = {"motion capture": NATNET, "meter": MODBUS}
"""Devices whose every second is signed, and their drivers."""


def run() -> dict[str, float]:
    console, right = Console(), 0
    found_ms = errors_ms(JITTER_MS, runs=1000)
    figures = {
        f"lab_offset_error_p{share}_ms": round(float(np.percentile(found_ms, share)), 2) for share in (50, 99)
    }
    with tempfile.TemporaryDirectory() as folder:
        begun_s = time.monotonic()
        with RealLab(Path(folder)) as lab, Listener(lab) as listener:
            console.print(f"the lab runs ({time.monotonic() - begun_s:.0f} s)")
            if problem := _put_first(lab):
                console.print(f"the lab has no priority over other work: {problem}", markup=False)
            for task in work(lab):
                console.print(f"task {task['id']} is paid ({time.monotonic() - begun_s:.0f} s)")
            figures["lab_wall_s"] = round(time.monotonic() - begun_s, 1)
            figures |= listener.figures()
            since_s = time.time()
            for case, wrong in outcomes(lab):
                right += not wrong
                console.print(f"{case.id}: {wrong or 'right'} ({time.time() - since_s:.0f} s)", markup=False)
                if case.fault == "unplugged" and (driver := LOSES.get(case.device)):
                    lost_s = listener.lost_s(driver, since_s)
                    figures[f"lab_{driver}_lost_s_per_s"] = round(lost_s / UNPLUGGED_S, 2)
                since_s = time.time()
                _put_first(lab)  # some were started again
    return figures | {"lab_cases": len(CASES), "lab_right": right}


def _put_first(lab: RealLab) -> OSError | None:
    """Let other work on this machine wait for the lab, whose devices keep wall time. Returns what does not
    permit it."""
    for pid in lab.pids:
        try:
            Path(f"/proc/{pid}/autogroup").write_text(_NICE)
        except OSError as error:
            return error
    return None
