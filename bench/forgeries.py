"""What the oracle refuses, over many forged proofs.

`forgeries_accepted` of `forgeries`: the catalogue of tests/forgeries; `forgeries_misnamed` were refused for
another reason than theirs.
`hostile_proof_cpu_s`: what the worst proofs cost, see `bench.hostile`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from rich.console import Console

from bench.hostile import hostile_proof_cpu_s
from rodeo.config import Site
from tests.forgeries import CATALOGUE, Workshop

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"


def run() -> dict[str, float]:
    console = Console()
    accepted = misnamed = 0
    with tempfile.TemporaryDirectory() as folder:
        shop = Workshop(Site.load(SITE), Path(folder))
        for name, forgery in CATALOGUE.items():
            report = shop.judged(forgery.make(shop))
            accepted += report.accepted
            misnamed += not report.reason.startswith(forgery.check)
            if not report.reason.startswith(forgery.check):
                console.print(f"{name}: {report.reason}", markup=False)
    return hostile_proof_cpu_s() | {
        "forgeries": len(CATALOGUE),
        "forgeries_accepted": accepted,
        "forgeries_misnamed": misnamed,
    }
