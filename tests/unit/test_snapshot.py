"""A site that is given a snapshot is as one whose organization was founded on its own chain."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.chain.deployment import Deployment
from rodeo.signing import wallets
from rodeo.signing.keystores import address
from rodeo.site.config import Site
from tests.support import snapshot
from tests.support.organization import CHAIN_ID, Organization, founded
from tests.support.site import write_site


def site_in(folder: Path, extra: str = "") -> Site:
    folder.mkdir()
    site = Site.load(write_site(folder, extra=extra))
    snapshot.give_wallets(site)
    return site


def test_the_organization_is_on_the_chain_and_the_deployment_step_finds_nothing_to_do(tmp_path: Path) -> None:
    with founded(tmp_path) as organization:
        before = organization.client.w3.eth.block_number
        Deployment.load(organization.site.data_dir, CHAIN_ID).verify(organization.client.w3)
        assert len(organization.post()) == 1
        Organization(organization.site).deploy()
        assert organization.client.w3.eth.block_number == before + 1


def test_sites_that_differ_in_folder_and_ports_alone_have_one_snapshot(tmp_path: Path) -> None:
    one, same = site_in(tmp_path / "one"), site_in(tmp_path / "same")
    other = site_in(tmp_path / "other", "governance.delay_s = 60\n")
    assert one.data_dir != same.data_dir and one.chain.url != same.chain.url
    assert snapshot.key(one) == snapshot.key(same) != snapshot.key(other)


def test_keys_are_the_organizations_own(tmp_path: Path) -> None:
    one, other = site_in(tmp_path / "one"), site_in(tmp_path / "other", 'org = "annex"\n')
    assert wallets.load(one, "panther1").address == address(one, "panther1")
    assert address(one, "panther1") != address(other, "panther1")
    assert snapshot.key(one) != snapshot.key(other)


@pytest.mark.parametrize(
    ("backend", "extra", "has"),
    [("eth-tester", "", True), ("anvil", "", False), ("eth-tester", 'clock.source = "wall"\n', False)],
)
def test_a_chain_on_wall_time_or_of_anvil_is_founded_anew(
    tmp_path: Path, backend: str, extra: str, has: bool
) -> None:
    assert snapshot.has_snapshot(Site.load(write_site(tmp_path, backend, extra))) is has


def test_a_snapshot_is_made_once_and_those_of_the_last_two_versions_of_the_code_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, made = tmp_path / "kept", list[str]()

    def make(_site: Site, folder: Path) -> None:
        made.append(folder.parent.name)
        folder.mkdir()

    monkeypatch.setattr(snapshot, "_FOLDER", kept)
    monkeypatch.setattr(snapshot, "_make", make)
    site = site_in(tmp_path / "site")
    for version in ("first", "second", "third", "third"):
        monkeypatch.setattr(snapshot, "_code", lambda version=version: version)
        snapshot.found(site)
    assert made == ["first", "second", "third"]
    assert {one.name for one in kept.iterdir()} == {"second", "third"}
