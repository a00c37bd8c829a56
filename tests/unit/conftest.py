"""One honest cleaning and one honest charge, filmed once; tests change the film or what the chain says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from eth_account.signers.local import LocalAccount

from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Check, Report
from rodeo.checks.verify import verify_file
from rodeo.config import Site
from rodeo.evidence.seal import Binding
from rodeo_kinds.battery_charging.harness.film import film_charging
from rodeo_kinds.waste_disposal.harness.film import film_cleaning
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, Witnesses, seal
from tests.support.site import LAB


@pytest.fixture(scope="session")
def site() -> Site:
    """Not simulated: a simulated clock, faster than real time, needs wider limits."""
    site = Site.load(LAB)
    return site.model_copy(update={"clock": site.clock.model_copy(update={"source": "wall"})})


@pytest.fixture(scope="session")
def cleaning(site: Site) -> Take:
    return film_cleaning(site, "item1")


@pytest.fixture(scope="session")
def charge(site: Site) -> Take:
    return film_charging(site, soc=0.86)


Judge = Callable[..., Report]


@pytest.fixture
def judge(site: Site, tmp_path: Path) -> Judge:
    """Seals a take as the executor would and has it verified."""

    def verdict(
        take: Take,
        chain: ChainRecord | None,
        *,
        binding: Binding = BINDING,
        device: LocalAccount = ROBOT,
        witnesses: Witnesses | None = None,
        at: Site | None = None,
    ) -> Report:
        path = seal(take, tmp_path / "proof.mcap", binding, device, witnesses).path
        return verify_file(path, at or site, chain)

    return verdict


def finding(report: Report, name: str) -> Check:
    """The check of this name."""
    return next(check for check in report.checks if check.name == name)


def failed(report: Report) -> str:
    """Name of the check that the verdict's reason names."""
    assert not report.accepted, report.rows()
    return report.reason.split(":")[0]
