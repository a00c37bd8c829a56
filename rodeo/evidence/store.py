"""Content-addressed files in any fsspec store: `<store url>/<sha256>.<suffix>`.

The name is the SHA-256 of the bytes, so a file can neither be replaced nor confused, and putting it twice
is putting it once.
"""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import file_digest, sha256
from http import HTTPStatus
from pathlib import Path
from typing import IO, Any

import fsspec
from fsspec.implementations.local import LocalFileSystem
from fsspec.registry import known_implementations

from rodeo.errors import DiskFull
from rodeo.evidence.errors import (
    EvidenceError,
    ProofHashMismatch,
    ProofNotFound,
    ProofTooLarge,
    ProofUriNotAllowed,
    StoreUnavailable,
)
from rodeo.evidence.upload import blocks, longest_s, upload
from rodeo.host.files import writing
from rodeo.host.proxies import proxy_of
from rodeo.site.config import Site

_CONNECT_S, _SILENCE_S, _REQUEST_S = 15.0, 120.0, 300.0
"""How long HTTP stores may take to be reached, to continue an answer, and to give what one request asks for,
which is a part of a file."""
_NAME = re.compile(r"^(?P<sha256>[0-9a-f]{64})\.(?P<suffix>mcap|bag|json|jpg|png)$")


class Store:
    """The site's store for proofs (.mcap, or .bag where bags are accepted), reports (.json) and
    photos of what tasks are about (.jpg, .png).

    Writes go to `site.store.url`; reads come from there and from `site.store.allowed`.
    """

    def __init__(self, site: Site) -> None:
        self._url = site.store_url.rstrip("/")
        self._allowed = [self._url, *(url.rstrip("/") for url in site.store.allowed)]
        self._options = site.store.options
        own = _scheme(self._url)
        self._configured = {own} if own != "file" else {_scheme(url) for url in self._allowed}
        self._max_bytes = site.store.max_bytes

    def uri_of(self, sha256: str, suffix: str) -> str:
        """The URI in this store of the file with this content (0x hex) and suffix."""
        return f"{self._url}/{sha256.removeprefix('0x')}{suffix}"

    def put(self, path: Path) -> str:
        """Upload a file and read it back; the URI that names it.

        Raises StoreUnavailable, ProofHashMismatch when the store gives back other bytes, ProofTooLarge.
        """
        _check_size(path.stat().st_size, self._max_bytes)
        with path.open("rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
        uri = self.uri_of(digest, path.suffix)
        with _reached(uri):
            filesystem, target = self._open(uri)
            try:
                there = self._stored(filesystem, target)
            except ProofTooLarge:  # whatever it is, it is not this file
                there = None
            if there != digest:
                try:
                    upload(filesystem, path, target)
                except FileNotFoundError as error:
                    raise StoreUnavailable("the store has no such folder", uri=uri) from error
            found = self._stored(filesystem, target)
        if found is None:
            raise StoreUnavailable("the store does not have the file that it accepted", uri=uri)
        if found != digest:
            raise ProofHashMismatch("the store returned other bytes", uri=uri, found="0x" + found)
        return uri

    def _open(self, uri: str) -> tuple[Any, str]:
        """The filesystem of `uri`, and its path there."""
        options = self._options if _scheme(uri) in self._configured else {}
        filesystem, path = fsspec.core.url_to_fs(uri, **_with_defaults(uri, options))
        filesystem.invalidate_cache()  # what another process put there meanwhile counts
        return filesystem, path

    def _stored(self, filesystem: Any, target: str) -> str | None:
        """SHA-256 hex of what is stored at `target`, None when nothing is."""
        try:
            with filesystem.open(target, "rb") as stored:
                return _digest(stored, self._max_bytes)
        except FileNotFoundError as error:
            if not _is_missing(error, target):
                raise
            return None

    def stored(self, uri: str) -> str | None:
        """SHA-256 (0x hex) of what is stored at `uri`; None when that is nothing, or larger than allowed.

        Raises ProofUriNotAllowed, StoreUnavailable.
        """
        self.check(uri)
        with _reached(uri):
            filesystem, target = self._open(uri)
            if (
                isinstance(filesystem, LocalFileSystem)
                and Path(target).exists()
                and not Path(target).is_file()
            ):
                return None
            try:
                digest = self._stored(filesystem, target)
            except ProofTooLarge:
                return None
        return None if digest is None else "0x" + digest

    def put_bytes(self, data: bytes, suffix: str) -> tuple[str, str]:
        """Upload `data`; (uri, sha256 as 0x hex). Raises like `put`, and DiskFull."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "data" + suffix)
            with writing(path):
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

    def whereabouts(self, uri: str, sha256: str, suffix: str) -> str:
        """`uri` where it may be fetched from; else that of the same content in this store. The name is the
        content: a file that others keep elsewhere may be here, too."""
        try:
            return self.check(uri)
        except ProofUriNotAllowed:
            return self.uri_of(sha256, suffix)

    def file(self, uri: str) -> Path | None:
        """The path of what `uri` names, if it is a file of this machine. Raises
        ProofUriNotAllowed."""
        if _scheme(self.check(uri)) != "file":
            return None
        path = Path(LocalFileSystem._strip_protocol(uri))
        return path if path.is_file() else None

    @property
    def clients(self) -> set[str]:
        """Modules that speak to the stores; importing one may take a second."""
        schemes = {_scheme(url) for url in self._allowed} & known_implementations.keys()
        return {known_implementations[scheme]["class"].rpartition(".")[0] for scheme in schemes}

    @property
    def urls(self) -> list[str]:
        """Prefixes of the URIs that may be fetched from."""
        return list(self._allowed)

    @staticmethod
    def hash_of(uri: str) -> str:
        """SHA-256 (0x hex) of the file that `uri` names, in whichever store; "" for any other URI."""
        found = _NAME.match(uri.rpartition("/")[2])
        return "" if found is None else "0x" + found["sha256"]

    @classmethod
    def names(cls, uri: str, sha256: str) -> bool:
        """Whether `uri` is that of a file with this content (0x hex), in whichever store."""
        return cls.hash_of(uri) == sha256.lower() != ""

    @staticmethod
    def require_folder(uri: str) -> None:
        """Raises StoreUnavailable where `uri` names a file in a folder that is not there: from such a store
        each file seems to be missing."""
        if _scheme(uri) == "file" and not Path(LocalFileSystem._strip_protocol(uri)).parent.is_dir():
            raise StoreUnavailable("the store's folder is not there", uri=uri)

    def fetch(self, uri: str, sha256: str, max_bytes: int | None = None, folder: Path | None = None) -> Path:
        """Copy the file to `folder` (default: a new temporary one, which the caller removes) and hash it.

        Raises ProofUriNotAllowed, ProofNotFound, StoreUnavailable, ProofTooLarge, ProofHashMismatch when
        the bytes are not those that `sha256` (0x hex) names, or DiskFull where the copy has no room.
        """
        self.check(uri)
        limit = self._max_bytes if max_bytes is None else max_bytes
        with _reached(uri):
            filesystem, source = self._open(uri)
            if isinstance(filesystem, LocalFileSystem) and Path(source).exists():
                if not Path(source).is_file():
                    raise ProofNotFound("the URI does not name a regular file", uri=uri)
                _check_size(Path(source).stat().st_size, limit)
        folder = folder or Path(tempfile.mkdtemp(prefix="rodeo-proof-"))
        path = folder / uri.rpartition("/")[2]
        try:
            with _reached(uri), filesystem.open(source, "rb") as remote, writing(path):
                folder.mkdir(parents=True, exist_ok=True)
                with path.open("wb") as local:
                    found = _digest(remote, limit, copy=local)
        except (EvidenceError, DiskFull):
            path.unlink(missing_ok=True)
            raise
        if "0x" + found != sha256.lower():
            path.unlink()
            raise ProofHashMismatch(
                "the bytes do not match the submitted hash", uri=uri, found="0x" + found, expected=sha256
            )
        return path


def _scheme(uri: str) -> str:
    return str(fsspec.utils.get_protocol(uri))


def _with_defaults(uri: str, options: dict[str, Any]) -> dict[str, Any]:
    """Others than HTTP's clients have time-outs, and look for proxies in the environment, by themselves."""
    if not uri.startswith(("http:", "https:")):
        return options
    from aiohttp import ClientTimeout  # fsspec's client: only who has such a store needs it

    timeout = ClientTimeout(total=_REQUEST_S, sock_connect=_CONNECT_S, sock_read=_SILENCE_S)
    defaults = {"timeout": timeout, "trust_env": proxy_of(uri) is not None}
    return {**options, "client_kwargs": defaults | options.get("client_kwargs", {})}


def _check_size(size: int, max_bytes: int) -> None:
    if size > max_bytes:
        raise ProofTooLarge(
            "the file is larger than allowed", limit="file_bytes", value=size, allowed=max_bytes
        )


@contextmanager
def _reached(uri: str) -> Iterator[None]:
    """Whatever a store's client raises becomes ProofNotFound or StoreUnavailable."""
    try:
        yield
    except (EvidenceError, DiskFull, MemoryError):  # what is full here is not the store's
        raise
    except Exception as error:  # botocore, aiohttp and others have no root in common
        if isinstance(error, FileNotFoundError) and _is_missing(error, uri):
            raise ProofNotFound("the store has no such file", uri=uri) from error
        first = error.__cause__ if isinstance(error, FileNotFoundError) else error
        cause = f"{type(first).__name__}: {first}"[:500]
        raise StoreUnavailable("the store failed", uri=uri, cause=cause) from error


def _is_missing(error: FileNotFoundError, uri: str) -> bool:
    """Whether the store says that it has no such file: fsspec's client for HTTP raises the same error for
    every failure, also of a server that does not answer."""
    cause = error.__cause__
    if cause is None or not uri.startswith(("http:", "https:")):
        return True
    return getattr(cause, "status", None) in (HTTPStatus.NOT_FOUND, HTTPStatus.GONE)


def _digest(stream: IO[bytes], max_bytes: int, copy: IO[bytes] | None = None) -> str:
    """SHA-256 hex of a stream of at most `max_bytes`, written to `copy` on the way."""
    digest, size, begun_s = sha256(), 0, time.monotonic()
    for block in blocks(stream):
        size += len(block)
        _check_size(size, max_bytes)
        taken_s = time.monotonic() - begun_s
        if taken_s > longest_s(size):
            raise StoreUnavailable("the store is too slow", bytes=size, after_s=round(taken_s))
        digest.update(block)
        if copy is not None:
            copy.write(block)
    return digest.hexdigest()
