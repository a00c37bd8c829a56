"""Honest work under the noise, the losses and the clocks that a site may have is accepted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rodeo.checks.motion.poses import clock_ahead_s
from rodeo.checks.motion.replay import replay_of
from rodeo.checks.verify import case_of
from rodeo.evidence.proof import open_proof
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.noise import HEAVY, Noise, noisy
from rodeo_testing.recordings import Take, seal
from tests.unit.conftest import Judge

pytestmark = pytest.mark.long


@pytest.mark.parametrize("draw", range(4))
def test_a_cleaning_under_heavy_noise_is_accepted(cleaning: Take, judge: Judge, draw: int) -> None:
    take, witnesses = noisy(cleaning, HEAVY, np.random.default_rng(draw))
    report = judge(take, cleaning_chain_record(cleaning), witnesses=witnesses)
    assert report.accepted, report.reason


@pytest.mark.parametrize("ahead_s", [-0.2, 0.2])
def test_a_motion_capture_whose_clock_is_off_is_understood(
    cleaning: Take, site: Site, tmp_path: Path, ahead_s: float
) -> None:
    take, witnesses = noisy(cleaning, Noise(), np.random.default_rng(5), clock_s=ahead_s)
    proof = open_proof(seal(take, tmp_path / "proof.mcap", BINDING, ROBOT, witnesses).path)
    case = case_of(proof, site, cleaning_chain_record(cleaning))
    assert clock_ahead_s(case) == pytest.approx(ahead_s, abs=0.05)


def test_noise_shakes_no_hand(cleaning: Take, site: Site, tmp_path: Path) -> None:
    """It shook with 15 m/s2 when each pose was believed, and the item fell."""
    take, witnesses = noisy(cleaning, HEAVY, np.random.default_rng(6))
    proof = open_proof(seal(take, tmp_path / "proof.mcap", BINDING, ROBOT, witnesses).path)
    case = case_of(proof, site, cleaning_chain_record(cleaning))
    motion = replay_of(case).motion
    shakes_m_s2 = np.linalg.norm(np.diff(motion.hand.position_m, 2, axis=0), axis=1) / 0.002**2
    assert np.median(shakes_m_s2) < 1.0
