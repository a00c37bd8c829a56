"""The step that puts the contracts on chain, and tells the organization what the site file says."""

from __future__ import annotations

import logging
from dataclasses import fields
from pathlib import Path

import pytest

from deploy.contracts import _told
from rodeo.chain.contracts.abi import Windows
from rodeo.signing import keystores, wallets
from rodeo.site.config import Site
from rodeo.site.sections import KindConfig
from tests.support.organization import KIND, founded
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


@pytest.mark.long
def test_a_judge_that_was_named_on_chain_stays_unless_it_is_a_machine_for_people(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    people = "tidying"
    kinds = [*Site.load(write_site(tmp_path)).kinds, KindConfig(name=people, judge="auditor")]
    with founded(tmp_path, kinds=kinds) as organization:
        client = organization.client
        calls, address = client.organization_calls, client.deployment.address
        judges = {KIND: address("AuditorJudge"), people: address("OracleJudge")}
        for kind, judge in judges.items():
            organization.send(organization.operator, calls.allow_kind(kind, judge, bytes(32)))
        before = {kind: client.rules.kind(kind).number for kind in judges}
        now = {one.name: getattr(client.rules.kind(KIND), one.name) for one in fields(Windows)}
        audited = calls.set_windows(
            KIND, Windows(**now | {"audit_window": 3600}), client.rules.reference_price(KIND)
        )
        organization.send(organization.operator, audited)
        organization.deploy()
        assert client.rules.kind(KIND).number == before[KIND] and client.rules.kind(KIND).audit_window == 3600
        assert f"judges {KIND} on chain" in caplog.text
        # The oracle has no checks for what people do.
        assert client.rules.kind(people).number > before[people]
        assert client.judges.numbered(client.rules.kind(people).number) == address("AuditorJudge")
        block = client.w3.eth.block_number
        organization.deploy()
        assert client.w3.eth.block_number == block  # nothing is left to say
