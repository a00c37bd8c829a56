"""A pool is not used where its workers could read the site's keys, unless it is trusted, nor without TLS."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rodeo.site.config import Site
from rodeo_cli.commands import app
from rodeo_cli.pooling import engine
from rodeo_pool.errors import KeysWithinReach
from tests.support.site import write_site

ADDRESS = "tls://127.0.0.1:1"


@pytest.fixture
def site_path(tmp_path: Path) -> Path:
    """A site file; this user can read the keys of the site."""
    (tmp_path / "data" / "keys").mkdir(parents=True)
    return write_site(tmp_path)


def test_keys_within_reach_refuse_a_pool(site_path: Path) -> None:
    with pytest.raises(KeysWithinReach, match="can read the site's keys") as refused:
        engine(ADDRESS, Site.load(site_path), [])
    assert refused.value.details["keys"] == str(site_path.parent / "data" / "keys")


def test_a_study_asks_no_pool_where_the_keys_of_the_usual_site_can_be_read(
    site_path: Path, tmp_path: Path
) -> None:
    words = ["experiment", "paper", "--seeds", "2", "--pool", ADDRESS, "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words, env={"RODEO_SITE": str(site_path)})
    assert done.exit_code == 1 and done.output.startswith("keys_within_reach"), done.output


def test_a_trusted_pool_is_asked(site_path: Path, tmp_path: Path) -> None:
    from rodeo_pool.errors import PoolFilesMissing  # dask takes its time

    with pytest.raises(PoolFilesMissing):
        engine(ADDRESS, Site.load(site_path), [], tmp_path, trust=True)


def test_certificates_that_are_none_are_named(site_path: Path, tmp_path: Path) -> None:
    words = ("pool", "start", "--port", "0", "--site", str(site_path), "--pool-tls")
    (tls := tmp_path / "tls").touch()
    done = CliRunner().invoke(app, [*words, str(tls)])
    assert done.output.startswith("pool_files_damaged")
    tls.unlink()
    tls.mkdir()
    for name in ("ca.pem", "scheduler.pem", "scheduler.key"):
        (tls / name).write_text("no certificate")
    done = CliRunner().invoke(app, [*words, str(tls)])
    assert done.output.startswith("pool_files_damaged")


def test_a_workers_failure_arrives_whatever_its_details_are_called() -> None:
    from rodeo_pool.wire import Failure

    error = Failure(name="JobFailed", message="no", details={"log": "a", "self": "b", "message": "c"}).error
    assert error.details == {"log": "a", "self": "b", "message": "c"}


def test_verify_refuses_before_it_reads_anything(site_path: Path, tmp_path: Path) -> None:
    (proof := tmp_path / "proof.mcap").write_bytes(b"none")
    words = ("verify", "--offline", "--site", site_path, "--pool", ADDRESS, proof)
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 1
    assert "--trust-pool" in done.output
    assert "--site" not in done.output


@pytest.mark.parametrize(
    "words", [("pool", "worker", "127.0.0.1:1"), ("audit", "--pool", "tcp://127.0.0.1:1")]
)
def test_an_address_without_tls_is_refused(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2
    assert "tls://HOST:PORT" in done.output


def test_a_worker_without_a_site_does_not_join(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["pool", "worker", ADDRESS, "--site", str(tmp_path / "none.toml")])
    assert done.exit_code == 1
    assert "config_error" in done.output


def test_a_pool_whose_port_is_taken_says_so(site_path: Path, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        words = (
            "--workers",
            "0",
            "--port",
            port,
            "--pool-tls",
            str(tmp_path / "tls"),
            "--site",
            str(site_path),
        )
        done = CliRunner().invoke(app, ["pool", "start", *words])
    assert done.exit_code == 1
    assert "pool_unavailable" in done.output and "already in use" in done.output
