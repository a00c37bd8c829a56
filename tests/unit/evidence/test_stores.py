"""The same store over a folder, HTTP and S3: real servers on loopback."""

from __future__ import annotations

import http.server
import os
import threading
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import fsspec
import pytest

from rodeo.evidence import store as stores
from rodeo.evidence import upload
from rodeo.evidence.errors import ProofHashMismatch, ProofNotFound, ProofTooLarge, StoreUnavailable
from rodeo.evidence.store import Store
from rodeo.site.config import Site
from tests.support.s3 import serving
from tests.support.site import LAB, free_port

DATA = os.urandom(3 << 20)
HASH = "0x" + sha256(DATA).hexdigest()


class Shelf(http.server.BaseHTTPRequestHandler):
    """A WebDAV-like folder in memory: PUT, GET and HEAD."""

    files: dict[str, bytes]

    def do_PUT(self) -> None:
        if self.headers.get("Transfer-Encoding") == "chunked":
            body = b""
            while size := int(self.rfile.readline(), 16):
                body += self.rfile.read(size)
                self.rfile.readline()
            self.rfile.readline()
        else:
            body = self.rfile.read(int(self.headers["Content-Length"]))
        self.files[self.path] = body
        self.send_response(201)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def do_GET(self) -> None:
        data = self.files.get(self.path)
        self.send_response(404 if data is None else 200)
        self.send_header("Content-Length", str(len(data or b"")))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(data or b"")

    do_HEAD = do_GET  # noqa: N815

    def log_message(self, *_args: Any) -> None:
        """Quiet."""


def serve(port: int, files: dict[str, bytes]) -> http.server.ThreadingHTTPServer:
    server = http.server.ThreadingHTTPServer(("127.0.0.1", port), type("Shelf", (Shelf,), {"files": files}))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


@pytest.fixture
def shelf() -> Iterator[tuple[str, dict[str, bytes]]]:
    files: dict[str, bytes] = {}
    server = serve(0, files)
    yield f"http://127.0.0.1:{server.server_address[1]}/proofs", files
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def s3_endpoint() -> Iterator[str]:
    with serving() as url:
        yield url


@pytest.fixture
def s3(s3_endpoint: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    options = {"endpoint_url": s3_endpoint}
    filesystem = fsspec.filesystem("s3", **options)
    if not filesystem.exists("proofs"):
        filesystem.mkdir("proofs")
    return options


def store_at(url: str, tmp_path: Path, **settings: Any) -> Store:
    site = Site.load(LAB)
    config = site.store.model_copy(update={"url": url, **settings})
    return Store(site.model_copy(update={"data_dir": tmp_path / "data", "store": config}))


@pytest.fixture
def proof(tmp_path: Path) -> Path:
    path = tmp_path / "recording.mcap"
    path.write_bytes(DATA)
    return path


@pytest.fixture(params=["http", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    if request.param == "http":
        return store_at(request.getfixturevalue("shelf")[0], tmp_path)
    return store_at("s3://proofs", tmp_path, options=request.getfixturevalue("s3"))


def test_what_is_put_is_fetched_by_its_hash(store: Store, proof: Path, tmp_path: Path) -> None:
    uri = store.put(proof)
    assert uri.endswith(f"/{HASH[2:]}.mcap")
    assert store.put(proof) == uri
    assert store.fetch(uri, HASH, folder=tmp_path / "fetched").read_bytes() == DATA


def test_what_is_too_large_at_a_files_place_is_replaced(proof: Path, tmp_path: Path) -> None:
    store = store_at(f"file://{tmp_path}/shelf", tmp_path, max_bytes=4 << 20)
    squatter = tmp_path / "shelf" / f"{HASH[2:]}.mcap"
    squatter.parent.mkdir()
    squatter.write_bytes(bytes(5 << 20))
    store.put(proof)
    assert squatter.read_bytes() == DATA


def test_options_of_the_site_s_store_are_not_those_of_another_allowed_one(
    shelf: tuple[str, dict[str, bytes]], s3: dict[str, Any], proof: Path, tmp_path: Path
) -> None:
    url, files = shelf
    files[urlsplit(f"{url}/{HASH[2:]}.mcap").path] = DATA
    both = store_at("s3://proofs", tmp_path, options=s3, allowed=[url])
    assert both.fetch(f"{url}/{HASH[2:]}.mcap", HASH, folder=tmp_path / "fetched").read_bytes() == DATA
    assert both.clients >= {"s3fs", "fsspec.implementations.http"}


def test_what_is_not_there_is_told(store: Store, proof: Path, tmp_path: Path) -> None:
    uri = store.put(proof).replace(HASH[2:], "ab" * 32)
    with pytest.raises(ProofNotFound):
        store.fetch(uri, "0x" + "ab" * 32, folder=tmp_path / "fetched")


def test_more_than_allowed_is_not_fetched(store: Store, proof: Path, tmp_path: Path) -> None:
    uri = store.put(proof)
    with pytest.raises(ProofTooLarge):
        store.fetch(uri, HASH, max_bytes=1 << 20, folder=tmp_path / "fetched")
    assert list((tmp_path / "fetched").iterdir()) == []


def test_a_store_that_was_tampered_with_is_noticed(shelf: Any, proof: Path, tmp_path: Path) -> None:
    url, files = shelf
    store = store_at(url, tmp_path)
    uri = store.put(proof)
    files[urlsplit(uri).path] = DATA[:-1] + b"x"
    with pytest.raises(ProofHashMismatch):
        store.fetch(uri, HASH, folder=tmp_path / "fetched")


def test_a_dead_store_delays_and_loses_nothing(proof: Path, tmp_path: Path) -> None:
    port, files = free_port(), dict[str, bytes]()
    store = store_at(f"http://127.0.0.1:{port}/proofs", tmp_path)
    with pytest.raises(StoreUnavailable):
        store.put(proof)
    assert proof.read_bytes() == DATA
    server = serve(port, files)
    try:
        uri = store.put(proof)
    finally:
        server.shutdown()
        server.server_close()
    assert files[urlsplit(uri).path] == DATA
    with pytest.raises(StoreUnavailable, match="Cannot connect"):
        store.fetch(uri, HASH, folder=tmp_path / "fetched")


@pytest.mark.parametrize(
    ("status", "error"),
    [(404, ProofNotFound), (410, ProofNotFound)]
    + [(status, StoreUnavailable) for status in (302, 401, 403, 429, 500, 503)],
)
def test_a_server_that_fails_does_not_say_that_a_file_is_missing(
    shelf: tuple[str, dict[str, bytes]],
    proof: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    status: int,
    error: type[Exception],
) -> None:
    """A store in trouble is not one without the proof, which its executor has an hour to hand over again."""

    def fail(self: Shelf) -> None:
        self.send_response(status)
        self.send_header("Location", self.path)
        self.send_header("Content-Length", "0")
        self.end_headers()

    store = store_at(shelf[0], tmp_path)
    uri = store.put(proof)
    for method in ("do_GET", "do_HEAD", "do_PUT"):
        monkeypatch.setattr(Shelf, method, fail)
    with pytest.raises(StoreUnavailable):
        store.put(proof)
    with pytest.raises(error):
        store.fetch(uri, HASH, folder=tmp_path / "fetched")
    if error is StoreUnavailable:
        with pytest.raises(error):
            store.stored(uri)
    else:
        assert store.stored(uri) is None


def test_an_upload_to_s3_that_was_cut_off_goes_on(
    s3: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(upload, "PART_BYTES", 5 << 20)
    data = os.urandom(12 << 20)
    path = tmp_path / "long.mcap"
    path.write_bytes(data)
    store = store_at("s3://proofs", tmp_path, options=s3)
    filesystem = fsspec.filesystem("s3", **s3)
    sent: list[int] = []
    call = type(filesystem).call_s3

    def cut_off(self: Any, method: str, *args: Any, **kwargs: Any) -> Any:
        if method == "upload_part":
            if len(sent) == 2:
                raise ConnectionResetError("the line is cut")
            sent.append(kwargs["PartNumber"])
        return call(self, method, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(type(filesystem), "call_s3", cut_off)
        with pytest.raises(StoreUnavailable):
            store.put(path)
    assert sent == [1, 2]

    def counted(self: Any, method: str, *args: Any, **kwargs: Any) -> Any:
        if method == "upload_part":
            sent.append(kwargs["PartNumber"])
        return call(self, method, *args, **kwargs)

    monkeypatch.setattr(type(filesystem), "call_s3", counted)
    uri = store.put(path)
    assert sent == [1, 2, 3]
    assert store.fetch(uri, "0x" + sha256(data).hexdigest(), folder=tmp_path / "fetched").read_bytes() == data


def test_parts_are_named_as_the_bucket_names_them(
    s3: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that encrypts with a key of its own names no MD5."""
    path = tmp_path / "long.mcap"
    path.write_bytes(data := os.urandom(12 << 20))
    filesystem = fsspec.filesystem("s3", **s3)
    call, names = type(filesystem).call_s3, dict[str, str]()

    def encrypted(self: Any, method: str, *args: Any, **kwargs: Any) -> Any:
        if method == "complete_multipart_upload":
            for part in kwargs["MultipartUpload"]["Parts"]:
                part["ETag"] = names[part["ETag"]]
        answer = call(self, method, *args, **kwargs)
        if method == "upload_part":
            names[f'"key-{len(names)}"'] = answer["ETag"]
            answer["ETag"] = list(names)[-1]
        return answer

    monkeypatch.setattr(type(filesystem), "call_s3", encrypted)
    store = store_at("s3://proofs", tmp_path, options=s3)
    uri = store.put(path)
    assert store.fetch(uri, "0x" + sha256(data).hexdigest(), folder=tmp_path / "fetched").read_bytes() == data


def test_a_server_that_falls_silent_holds_nobody_up(
    shelf: tuple[str, dict[str, bytes]], proof: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stores, "_SILENCE_S", 0.2)
    store, over = store_at(shelf[0], tmp_path), threading.Event()
    uri = store.put(proof)

    def half(self: Shelf) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(DATA)))
        self.end_headers()
        self.wfile.write(DATA[:1000])
        over.wait()

    monkeypatch.setattr(Shelf, "do_GET", half)
    try:
        with pytest.raises(StoreUnavailable, match=r"(?i)timeout"):
            store.fetch(uri, HASH, folder=tmp_path / "fetched")
    finally:
        over.set()
    assert list((tmp_path / "fetched").iterdir()) == []


def test_a_server_that_trickles_or_takes_nothing_holds_nobody_up(
    shelf: tuple[str, dict[str, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(upload, "_PATIENCE_S", 0.5)
    monkeypatch.setattr(upload, "_SLOWEST_BYTES_S", 1 << 30)
    large = tmp_path / "large.mcap"
    large.write_bytes(data := bytes(40 << 20))
    hash_ = "0x" + sha256(data).hexdigest()
    store, over = store_at(shelf[0], tmp_path), threading.Event()

    def trickle(self: Shelf) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(40 << 20))
        self.end_headers()
        while not over.wait(0.05):
            self.wfile.write(bytes(1 << 16))

    monkeypatch.setattr(Shelf, "do_PUT", lambda self: over.wait())
    monkeypatch.setattr(Shelf, "do_HEAD", lambda self: self.send_error(404))
    try:
        with pytest.raises(StoreUnavailable, match=r"(?i)timeout"):
            store.put(large)
        monkeypatch.setattr(Shelf, "do_HEAD", trickle)
        monkeypatch.setattr(Shelf, "do_GET", trickle)
        with pytest.raises(StoreUnavailable, match="too slow"):
            store.fetch(store.uri_of(hash_, ".mcap"), hash_, folder=tmp_path / "fetched")
    finally:
        over.set()


def test_a_full_disk_delays_and_leaves_nothing_behind(
    proof: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "store"
    store = store_at(folder.as_uri(), tmp_path)

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(StoreUnavailable):
            store.put(proof)
    assert list(folder.iterdir()) == []
    assert store.put(proof).endswith(f"/{HASH[2:]}.mcap")
