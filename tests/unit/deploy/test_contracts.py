"""The step that puts the contracts on chain, as far as it needs no chain."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from deploy.contracts import _told
from rodeo import keystores, wallets
from rodeo.config import Site
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
