"""`make lab`: the lab without the simulator, on loopback, until its work is paid. Its data: `out/lab`."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from tests.support.reallab import run

if __name__ == "__main__":
    folder = Path("out/lab").absolute()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    run(folder)
    sys.exit(0)
