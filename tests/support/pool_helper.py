"""The helper of a worker that misbehaves."""

import os
import sys
from pathlib import Path

from rodeo.jobs.local import Local
from rodeo_pool.helper import serve
from tests.support.pool import Misdeed

if __name__ == "__main__":
    scratch = Path(sys.argv[-1])
    scratch.mkdir(exist_ok=True)
    with os.fdopen(os.dup(1), "wb") as answers:
        serve(Local([Misdeed()]), sys.stdin.buffer, answers, scratch)
