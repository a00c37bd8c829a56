"""The helper of a worker that misbehaves, and verifies proofs as others do."""

import os
import sys
from pathlib import Path

from rodeo.jobs.local import Local
from rodeo.jobs.proofs import Verify
from rodeo.site.config import Site
from rodeo_pool.helper import serve
from tests.support.pool import Misdeed

if __name__ == "__main__":
    site, scratch = Path(sys.argv[-3]), Path(sys.argv[-1])
    scratch.mkdir(exist_ok=True)
    with os.fdopen(os.dup(1), "wb") as answers:
        serve(Local([Misdeed(), Verify(Site.load(site), scratch)]), sys.stdin.buffer, answers, scratch)
