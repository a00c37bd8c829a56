"""The step that puts the contracts on chain, and tells the organization what the site file says."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from deploy.contracts import _told
from rodeo import keystores, wallets
from rodeo.chain.abi import Review, Silence
from rodeo.config import Site
from rodeo.kinds import kinds_of
from tests.support.organization import KIND, Organization, founded
from tests.support.site import write_site


def test_a_keystore_that_cannot_be_read_is_passed_over(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    site = Site.load(write_site(tmp_path))
    wallets.ensure_wallets(site)
    assert _told(site, "panther1") == keystores.address(site, "panther1")
    path = keystores.keystore_path(site, "panther1")
    path.write_text(path.read_text()[:100])
    with caplog.at_level(logging.ERROR):
        assert _told(site, "panther1") is None
    assert "panther1" in caplog.text and str(path) in caplog.text
    path.write_text('["no keystore"]')
    assert _told(site, "panther1") is None


def silences(organization: Organization) -> dict[str, tuple[Silence, int]]:
    """What the chain says: kind that oracles judge -> who wins at silence, auditors' window."""
    rules = {kind: organization.client.kind(kind) for kind in kinds_of(organization.site)}
    return {
        kind: (one.silence, one.audit_window) for kind, one in rules.items() if one.review is Review.ORACLE
    }


def test_silence_pays_nobody_on_a_new_chain_nor_on_one_that_says_otherwise(tmp_path: Path) -> None:
    with founded(tmp_path) as organization:
        before = silences(organization)
        assert {winner for winner, _ in before.values()} == {Silence.CREATOR} and len(before) == 2
        # As earlier releases have set it, with a window that somebody chose.
        calls = organization.client.organization_calls
        organization.send(organization.operator, calls.set_audit(KIND, 3600, Silence.EXECUTOR))
        organization.deploy()
        assert silences(organization) == before | {KIND: (Silence.CREATOR, 3600)}
        block = organization.client.w3.eth.block_number
        organization.deploy()
        assert organization.client.w3.eth.block_number == block  # nothing is left to say


def test_a_site_file_that_pays_the_executor_at_silence_leaves_the_chain_so(tmp_path: Path) -> None:
    with founded(tmp_path) as organization:
        calls = organization.client.organization_calls
        organization.send(organization.operator, calls.set_audit(KIND, 3600, Silence.EXECUTOR))
        pays = [
            one.model_copy(update={"at_silence": "executor"}) if one.name == KIND else one
            for one in organization.site.kinds
        ]
        Organization(organization.site.model_copy(update={"kinds": pays})).deploy()
        assert silences(organization)[KIND] == (Silence.EXECUTOR, 3600)
