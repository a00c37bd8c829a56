"""What is prepared once for many tests is what each of them would make."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from mujoco import rollout

from rodeo.checks.verify import verify_proof
from rodeo.evidence.proof import Proof, open_proof
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.assignments import BINDING, CHARGE_BINDING, METER, ROBOT
from rodeo_testing.recordings import Take, Witnesses, open_sealed, seal
from tests.support.engines import computed_once

pytestmark = pytest.mark.long


def content(proof: Proof) -> dict[str, Any]:
    """All but what only a file has."""
    found = {one.name: getattr(proof, one.name) for one in fields(proof)}
    columns = ("topic", "ros_type", "log_ns", "publish_ns", "sequence")
    found["topics"] = [
        *((*(getattr(one, name) for name in columns), list(one.data)) for one in proof.topics.values())
    ]
    return {name: one for name, one in found.items() if name not in ("path", "sha256", "size_bytes")}


def test_a_proof_that_was_never_a_file_is_the_one_that_is_read(
    cleaning: Take, charge: Take, tmp_path: Path
) -> None:
    off_s = (cleaning.start_s + 10, cleaning.start_s + 20)
    for take, binding, device, witnesses in (
        (cleaning, BINDING, ROBOT, Witnesses(mocap_off_s=off_s)),
        (charge, CHARGE_BINDING, METER, None),
    ):
        read = open_proof(seal(take, tmp_path / "proof.mcap", binding, device, witnesses).path)
        assert content(open_sealed(take, tmp_path / "open", binding, device, witnesses)) == content(read)


def test_what_was_computed_before_gives_the_same_report(
    site: Site, cleaning: Take, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proof, chain = open_sealed(cleaning, tmp_path / "open", BINDING, ROBOT), cleaning_chain_record(cleaning)
    anew = verify_proof(proof, site, chain)
    with computed_once():
        assert verify_proof(proof, site, chain) == anew

        def computed(*_: object, **__: object) -> None:
            raise AssertionError("this was computed before")

        monkeypatch.setattr(rollout, "rollout", computed)
        assert verify_proof(proof, site, chain) == anew
        # Another lab is another question.
        heavier = site.items[0].model_copy(update={"mass_kg": 2 * site.items[0].mass_kg})
        another = site.model_copy(update={"items": [heavier, *site.items[1:]]})
        report = verify_proof(proof, another, chain)
        assert any("this was computed before" in one.detail for one in report.checks)
