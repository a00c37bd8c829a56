"""A pool is not used where its workers could read the site's keys, unless it is trusted."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from rodeo.errors import ConfigError
from rodeo.site.config import Site
from rodeo_cli.commands import app
from rodeo_cli.pooling import engine
from tests.support.site import write_site

ADDRESS = "tls://127.0.0.1:1"


@pytest.fixture
def site_path(tmp_path: Path) -> Path:
    """A site file; this user can read the keys of the site."""
    (tmp_path / "data" / "keys").mkdir(parents=True)
    return write_site(tmp_path)


def test_keys_within_reach_refuse_a_pool(site_path: Path) -> None:
    with pytest.raises(ConfigError, match="can read the site's keys") as refused:
        engine(ADDRESS, Site.load(site_path), [])
    assert refused.value.details["keys"] == str(site_path.parent / "data" / "keys")


def test_a_trusted_pool_is_asked(site_path: Path, tmp_path: Path) -> None:
    from rodeo_pool.errors import PoolFilesMissing  # dask takes its time

    with pytest.raises(PoolFilesMissing):
        engine(ADDRESS, Site.load(site_path), [], tmp_path, trust=True)


def test_verify_refuses_before_it_reads_anything(site_path: Path, tmp_path: Path) -> None:
    (proof := tmp_path / "proof.mcap").write_bytes(b"none")
    words = ("verify", "--offline", "--site", site_path, "--pool", ADDRESS, proof)
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 1
    assert "--trust-pool" in done.output
