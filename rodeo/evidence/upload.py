"""Uploading one file to an fsspec store so that it is there whole or not at all.

An upload that was cut off continues if the store can: S3 keeps the parts; folders and HTTP servers start
again.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from functools import partial
from hashlib import md5
from pathlib import Path
from typing import IO, Any

from fsspec.asyn import sync

from rodeo.host.files import replacing

BLOCK_BYTES = 1 << 20
_PATIENCE_S, _SLOWEST_BYTES_S = 100.0, 32 << 10
"""Wall time that a store may take for any file, and bytes a second that it must take or give besides."""
PART_BYTES = 8 << 20
"""Size of a part of a multipart upload; S3 takes no less than 5 MiB but for the last."""


def upload(filesystem: Any, path: Path, target: str) -> None:
    """Copy the file at `path` to `target` of an fsspec filesystem. Raises what the filesystem raises."""
    protocol = filesystem.protocol if isinstance(filesystem.protocol, str) else filesystem.protocol[0]
    _UPLOADS.get(protocol, _whole)(filesystem, path, target)


def blocks(stream: IO[bytes]) -> Iterator[bytes]:
    while block := stream.read(BLOCK_BYTES):
        yield block


def _whole(filesystem: Any, path: Path, target: str) -> None:
    """Object stores show an object only once it is complete."""
    filesystem.put_file(str(path), target)


def _folder(_filesystem: Any, path: Path, target: str) -> None:
    """Written beside, flushed to the disk, then renamed."""
    final = Path(target)
    final.parent.mkdir(parents=True, exist_ok=True)
    # Several processes may upload the same file at once.
    part = final.with_name(f".part-{secrets.token_hex(8)}")
    with replacing(final, mode=0o600, part=part) as file, path.open("rb") as source:
        for block in blocks(source):
            file.write(block)


def longest_s(size: int) -> float:
    """Wall time that a store may take for so many bytes: what is slower holds others up."""
    return _PATIENCE_S + size / _SLOWEST_BYTES_S


def _http(filesystem: Any, path: Path, target: str) -> None:
    """PUT, as WebDAV and most object gateways take it. They may be silent until they have stored it all."""
    from aiohttp import ClientTimeout

    timeout = ClientTimeout(total=longest_s(path.stat().st_size), sock_connect=_PATIENCE_S)
    # `put_file` itself would stop waiting, and go on uploading.
    sync(filesystem.loop, partial(filesystem._put_file, str(path), target, method="put", timeout=timeout))


def _s3(filesystem: Any, path: Path, target: str) -> None:
    """In parts; those that an interrupted upload of the same file left there are not sent again."""
    if path.stat().st_size <= PART_BYTES:
        _whole(filesystem, path, target)
        return
    bucket, key, _ = filesystem.split_path(target)
    where = {"Bucket": bucket, "Key": key}
    unfinished = filesystem.call_s3("list_multipart_uploads", Bucket=bucket, Prefix=key).get("Uploads", [])
    if unfinished:
        where["UploadId"] = unfinished[-1]["UploadId"]
        there = {
            p["PartNumber"]: p["ETag"] for p in filesystem.call_s3("list_parts", **where).get("Parts", [])
        }
    else:
        where["UploadId"] = filesystem.call_s3("create_multipart_upload", **where)["UploadId"]
        there = {}
    parts = []
    with path.open("rb") as source:
        for number, part in enumerate(iter(lambda: source.read(PART_BYTES), b""), start=1):
            # An ETag is the part's MD5, except where the bucket encrypts with a key of its own: there, parts
            # are sent again.
            tag = there.get(number, "")
            if tag.strip('"') != md5(part, usedforsecurity=False).hexdigest():
                tag = filesystem.call_s3("upload_part", **where, PartNumber=number, Body=part)["ETag"]
            parts.append({"PartNumber": number, "ETag": tag})
    filesystem.call_s3("complete_multipart_upload", **where, MultipartUpload={"Parts": parts})


_UPLOADS: dict[str, Callable[[Any, Path, str], None]] = {
    "file": _folder,
    "http": _http,
    "https": _http,
    "s3": _s3,
    "s3a": _s3,
}
