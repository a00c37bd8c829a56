from __future__ import annotations

import os
from hashlib import sha256
from pathlib import Path

import fsspec
import pytest

from rodeo.evidence.errors import (
    ProofHashMismatch,
    ProofNotFound,
    ProofTooLarge,
    ProofUriNotAllowed,
    StoreUnavailable,
)
from rodeo.evidence.store import Store
from rodeo.site.config import Site
from tests.support.site import LAB

DATA = b"a proof" * 1000
HASH = "0x" + sha256(DATA).hexdigest()


def site(tmp_path: Path, **store: object) -> Site:
    loaded = Site.load(LAB)
    return loaded.model_copy(
        update={"data_dir": tmp_path / "data", "store": loaded.store.model_copy(update=store)}
    )


@pytest.fixture(params=["file", "memory"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    url = None if request.param == "file" else f"memory://proofs-{tmp_path.name}"
    return Store(site(tmp_path, url=url))


@pytest.fixture
def proof(tmp_path: Path) -> Path:
    path = tmp_path / "recording.mcap"
    path.write_bytes(DATA)
    return path


def test_what_is_put_is_fetched_by_its_hash(store: Store, proof: Path, tmp_path: Path) -> None:
    uri = store.put(proof)
    assert uri.endswith(f"/{HASH[2:]}.mcap")
    assert Store.hash_of(uri) == HASH
    assert store.uri_of(HASH, ".mcap") == uri
    assert store.fetch(uri, HASH, folder=tmp_path / "fetched").read_bytes() == DATA


def test_putting_twice_is_putting_once(store: Store, proof: Path) -> None:
    assert store.put(proof) == store.put(proof)


def test_other_bytes_than_the_submitted_are_refused(store: Store, proof: Path, tmp_path: Path) -> None:
    uri = store.put(proof)
    with pytest.raises(ProofHashMismatch) as caught:
        store.fetch(uri, "0x" + "00" * 32, folder=tmp_path / "fetched")
    assert caught.value.details["found"] == HASH
    assert list((tmp_path / "fetched").iterdir()) == []


def test_a_file_that_was_changed_in_the_store_is_refused(tmp_path: Path, proof: Path) -> None:
    store = Store(site(tmp_path))
    uri = store.put(proof)
    filesystem, path = fsspec.core.url_to_fs(uri)
    filesystem.pipe_file(path, b"something else")
    with pytest.raises(ProofHashMismatch):
        store.fetch(uri, HASH, folder=tmp_path / "fetched")


def test_a_missing_file_is_not_found(store: Store, proof: Path, tmp_path: Path) -> None:
    uri = store.put(proof).replace(HASH[2:], "ab" * 32)
    with pytest.raises(ProofNotFound):
        store.fetch(uri, HASH, folder=tmp_path / "fetched")


def test_a_folder_that_is_not_there_is_no_store(store: Store, proof: Path, tmp_path: Path) -> None:
    store.require_folder(store.put(proof))
    with pytest.raises(StoreUnavailable, match="folder is not there"):
        store.require_folder(f"file://{tmp_path}/not-mounted/{HASH[2:]}.mcap")


def test_a_large_file_is_neither_put_nor_fetched(tmp_path: Path, proof: Path) -> None:
    uri = Store(site(tmp_path)).put(proof)
    small = Store(site(tmp_path, max_bytes=100))
    with pytest.raises(ProofTooLarge):
        small.put(proof)
    with pytest.raises(ProofTooLarge):
        small.fetch(uri, HASH, folder=tmp_path / "fetched")


def test_a_pipe_in_the_store_is_not_waited_for(tmp_path: Path, proof: Path) -> None:
    store = Store(site(tmp_path))
    uri = store.put(proof).replace(HASH[2:], "cd" * 32)
    os.mkfifo(tmp_path / "data" / "store" / ("cd" * 32 + ".mcap"))
    with pytest.raises(ProofNotFound):
        store.fetch(uri, HASH, folder=tmp_path / "fetched")


@pytest.mark.parametrize(
    "uri",
    [
        "/etc/passwd",
        "file:///etc/passwd",
        "{base}/../../etc/passwd",
        "{base}/../store/{name}",
        "{base}/x/{name}",
        "{base}//{name}",
        "{base}/%2e%2e/{name}",
        "{base}/{name}?x=1",
        "{base}/{name}#x",
        "{base}/{name}/",
        "{base}/{short}.mcap",
        "{base}/{hash}.sh",
        "{base}",
        "",
        "http://127.0.0.1:8545/{name}",
        "http://localhost/{name}",
        "simplecache::{base}/{name}",
        "s3://elsewhere/{name}",
        "memory://{name}",
    ],
)
def test_uris_outside_the_stores_are_refused_before_anything_is_opened(tmp_path: Path, uri: str) -> None:
    loaded = site(tmp_path)
    filled = uri.format(base=loaded.store_url, name=f"{HASH[2:]}.mcap", hash=HASH[2:], short=HASH[2:10])
    with pytest.raises(ProofUriNotAllowed):
        Store(loaded).check(filled)
    with pytest.raises(ProofUriNotAllowed):
        Store(loaded).fetch(filled, HASH)
    assert Store(loaded).whereabouts(filled, HASH, ".mcap") == Store(loaded).uri_of(HASH, ".mcap")


def test_further_stores_may_be_read(tmp_path: Path, proof: Path) -> None:
    other = site(tmp_path, url=f"memory://friends-{tmp_path.name}")
    uri = Store(other).put(proof)
    ours = site(tmp_path)
    with pytest.raises(ProofUriNotAllowed):
        Store(ours).fetch(uri, HASH)
    reader = Store(site(tmp_path, allowed=[f"memory://friends-{tmp_path.name}/"]))
    assert reader.fetch(uri, HASH, folder=tmp_path / "fetched").read_bytes() == DATA


def test_a_broken_upload_leaves_nothing_behind(
    tmp_path: Path, proof: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(site(tmp_path))

    def fail(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(Exception, match="the store failed"):
        store.put(proof)
    assert list((tmp_path / "data" / "store").iterdir()) == []
