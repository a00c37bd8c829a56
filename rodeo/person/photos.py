"""A photo of what a task is about: a picture in the site's store, which the task's parameters name."""

from __future__ import annotations

import tempfile
from pathlib import Path

from rodeo.evidence.errors import ProofNotFound
from rodeo.evidence.store import Store
from rodeo.person.statement import MAX_PHOTO_BYTES, check_photo, photo_format
from rodeo.site.config import Site

SUFFIXES = {"jpeg": ".jpg", "png": ".png"}


def keep(site: Site, photo: bytes) -> str:
    """Put a photo into the site's store; its name there. Raises BadPhoto, StoreUnavailable, DiskFull."""
    check_photo(photo)
    suffix = SUFFIXES[photo_format(photo)]
    _, sha256 = Store(site).put_bytes(photo, suffix)
    return sha256.removeprefix("0x") + suffix


def kept(site: Site, name: str) -> bytes:
    """The photo of this name. Raises EvidenceError, BadPhoto for what is none."""
    digest, dot, suffix = name.partition(".")
    if dot + suffix not in SUFFIXES.values():
        raise ProofNotFound("this is no name of a photo", name=name[:100])
    store = Store(site)
    with tempfile.TemporaryDirectory(prefix="rodeo-photo-") as folder:
        uri = store.uri_of(digest, dot + suffix)
        photo = store.fetch(uri, "0x" + digest, MAX_PHOTO_BYTES, Path(folder)).read_bytes()
    photo_format(photo)
    return photo
