"""A lab without the simulator, also while a device is unplugged, lies, or has a wrong clock.

`lab_cases`, `lab_right`: the table `tests/reallab/cases.toml`, and the cases that end as it says.
`lab_wall_s`: from nothing to two cleanings and a charge that are paid, as `make lab` has it.
`lab_<driver>_delay_p50_ms`, `_p99_ms`: from the device's own stamp to the signed statement about it.
`lab_<driver>_cpu`: share of a core that the driver's process takes.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from rich.console import Console

from tests.support.lab_cases import CASES, ends_as_it_must
from tests.support.lab_figures import Delays
from tests.support.reallab import RealLab


def run() -> dict[str, float]:
    console, figures, right = Console(), dict[str, float](), 0
    with tempfile.TemporaryDirectory() as folder:
        begun_s = time.monotonic()
        with RealLab(Path(folder)) as lab:
            with Delays(lab) as delays:
                for task in [lab.clean(item.id) for item in lab.site.items]:
                    lab.paid(task)
                lab.paid(lab.charge())
            figures["lab_wall_s"] = time.monotonic() - begun_s
            figures |= delays.figures()
            for case in CASES:
                found = ends_as_it_must(lab, case)
                right += not found
                console.print(f"{case.device}, {case.fault}: {found or 'right'}", markup=False)
    return figures | {"lab_cases": len(CASES), "lab_right": right}
