"""Content-addressed files in any fsspec store: `<store url>/<sha256>.<suffix>`.

The name is the SHA-256 of the bytes, so a file can neither be replaced nor confused, and putting it twice
is putting it once.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from hashlib import file_digest, sha256
from pathlib import Path
from typing import IO

import fsspec
from fsspec.implementations.local import LocalFileSystem

from rodeo.config import Site
from rodeo.evidence.errors import (
    ProofHashMismatch,
    ProofNotFound,
    ProofTooLarge,
    ProofUriNotAllowed,
    StoreUnavailable,
)

_NAME = re.compile(r"^(?P<sha256>[0-9a-f]{64})\.(?P<suffix>mcap|json)$")
_BLOCK_BYTES = 1 << 20


class Store:
    """The site's store for proofs (.mcap) and reports (.json).

    Writes go to `site.store.url`; reads come from there and from `site.store.allowed`.
    """

    def __init__(self, site: Site) -> None:
        self._url = site.store_url.rstrip("/")
        self._allowed = [self._url, *(url.rstrip("/") for url in site.store.allowed)]
        self._max_bytes = site.store.max_bytes

    def put(self, path: Path) -> str:
        """Upload a file and read it back; the URI that names it.

        Raises StoreUnavailable, ProofHashMismatch when the store gives back other bytes, ProofTooLarge.
        """
        size = path.stat().st_size
        if size > self._max_bytes:
            raise ProofTooLarge(
                "the file is larger than the store takes",
                limit="file_bytes",
                value=size,
                allowed=self._max_bytes,
            )
        with path.open("rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
        uri = f"{self._url}/{digest}{path.suffix}"
        filesystem, target = fsspec.core.url_to_fs(uri)
        try:
            if isinstance(filesystem, LocalFileSystem):
                _put_local(path, Path(target))
            else:  # object stores show an object only once it is complete
                filesystem.put_file(str(path), target)
            with filesystem.open(target, "rb") as stored:
                found = _digest(stored, self._max_bytes)
        except OSError as error:
            raise StoreUnavailable("the store did not take the file", uri=uri, cause=str(error)) from error
        if found != digest:
            raise ProofHashMismatch("the store gave back other bytes", uri=uri, found="0x" + found)
        return uri

    def put_bytes(self, data: bytes, suffix: str) -> tuple[str, str]:
        """Upload `data`; (uri, sha256 as 0x hex). Raises like `put`."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "data" + suffix)
            path.write_bytes(data)
            return self.put(path), "0x" + sha256(data).hexdigest()

    def check(self, uri: str) -> str:
        """`uri` if it names a content-addressed file directly inside a configured store.

        Raises ProofUriNotAllowed. Nothing is fetched and no name is resolved before this passed.
        """
        base, _, name = uri.rpartition("/")
        if base not in self._allowed or not _NAME.match(name):
            raise ProofUriNotAllowed(
                "the URI is not a file of an allowed store", uri=uri[:200], allowed=self._allowed
            )
        return uri

    def fetch(self, uri: str, sha256: str, max_bytes: int | None = None, folder: Path | None = None) -> Path:
        """Copy the file to `folder` (default: a new temporary one, which the caller removes) and hash it.

        Raises ProofUriNotAllowed, ProofNotFound, StoreUnavailable, ProofTooLarge, or ProofHashMismatch when
        the bytes are not those that `sha256` (0x hex) names.
        """
        self.check(uri)
        limit = self._max_bytes if max_bytes is None else max_bytes
        filesystem, source = fsspec.core.url_to_fs(uri)
        if isinstance(filesystem, LocalFileSystem) and Path(source).exists() and not Path(source).is_file():
            raise ProofNotFound("the URI does not name a regular file", uri=uri)
        folder = folder or Path(tempfile.mkdtemp(prefix="rodeo-proof-"))
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / uri.rpartition("/")[2]
        try:
            with filesystem.open(source, "rb") as remote, path.open("wb") as local:
                found = _digest(remote, limit, copy=local)
        except FileNotFoundError as error:
            path.unlink(missing_ok=True)
            raise ProofNotFound("the store has no such file", uri=uri) from error
        except OSError as error:
            path.unlink(missing_ok=True)
            raise StoreUnavailable("the store did not give the file", uri=uri, cause=str(error)) from error
        if "0x" + found != sha256.lower():
            path.unlink()
            raise ProofHashMismatch(
                "the bytes are not those that were submitted", uri=uri, found="0x" + found, expected=sha256
            )
        return path


def _put_local(path: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    descriptor, part = tempfile.mkstemp(dir=target.parent, prefix=".part-")
    try:
        with open(descriptor, "wb") as file, path.open("rb") as source:
            for block in _blocks(source):
                file.write(block)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, target)
    except BaseException:
        os.unlink(part)
        raise


def _blocks(stream: IO[bytes]) -> Iterator[bytes]:
    while block := stream.read(_BLOCK_BYTES):
        yield block


def _digest(stream: IO[bytes], max_bytes: int, copy: IO[bytes] | None = None) -> str:
    """SHA-256 hex of a stream of at most `max_bytes`, written to `copy` on the way."""
    digest, size = sha256(), 0
    for block in _blocks(stream):
        size += len(block)
        if size > max_bytes:
            raise ProofTooLarge(
                "the file is larger than allowed", limit="file_bytes", value=size, allowed=max_bytes
            )
        digest.update(block)
        if copy is not None:
            copy.write(block)
    return digest.hexdigest()
