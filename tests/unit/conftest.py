"""One honest cleaning and one honest charge, filmed once; tests change the film or what the chain says."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path
from weakref import WeakKeyDictionary

import pytest
from eth_account.signers.local import LocalAccount

from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Check, Report
from rodeo.checks.verify import verify_proof
from rodeo.evidence.proof import Proof
from rodeo.evidence.seal import Binding
from rodeo.site.config import Site
from rodeo_kinds.battery_charging.harness.film import film_charging
from rodeo_kinds.waste_disposal.harness.film import film_cleaning
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, Witnesses, open_sealed
from tests.support.engines import computed_once
from tests.support.site import LAB


@pytest.fixture(scope="session")
def site() -> Site:
    """Not simulated: a simulated clock, faster than real time, needs wider limits."""
    site = Site.load(LAB)
    return site.model_copy(update={"clock": site.clock.model_copy(update={"source": "wall"})})


def kept(take: Take) -> Take:
    """A film that stays: the garbage collector need not walk through its messages again and again."""
    gc.collect()
    gc.freeze()
    return take


@pytest.fixture(scope="session")
def cleaning(site: Site) -> Take:
    return kept(film_cleaning(site, "item1"))


@pytest.fixture(scope="session")
def charge(site: Site) -> Take:
    return kept(film_charging(site, soc=0.86))


Judge = Callable[..., Report]


@pytest.fixture(scope="session")
def prepared() -> WeakKeyDictionary[Take, dict[tuple[object, ...], Proof]]:
    """The open proofs of each take, by who sealed and witnessed it."""
    return WeakKeyDictionary()


@pytest.fixture
def judge(
    site: Site, tmp_path: Path, prepared: WeakKeyDictionary[Take, dict[tuple[object, ...], Proof]]
) -> Judge:
    """Seals a take as the executor would and has it verified. A take that is judged again, with another
    record of the chain or for another site, is not sealed and read again."""

    def verdict(
        take: Take,
        chain: ChainRecord | None,
        *,
        binding: Binding = BINDING,
        device: LocalAccount = ROBOT,
        witnesses: Witnesses | None = None,
        at: Site | None = None,
    ) -> Report:
        proofs, who = prepared.setdefault(take, {}), (binding, device, witnesses)
        if who not in proofs:
            proofs[who] = open_sealed(take, tmp_path / "proof.mcap", binding, device, witnesses)
        with computed_once():
            return verify_proof(proofs[who], at or site, chain)

    return verdict


def finding(report: Report, name: str) -> Check:
    """The check of this name."""
    return next(check for check in report.checks if check.name == name)


def failed(report: Report) -> str:
    """Name of the check that the verdict's reason names."""
    assert not report.accepted, report.rows()
    return report.reason.split(":")[0]
