"""An executor keeps its own copy of what it submitted: what the store loses, it puts there again.

Whoever is asked answers for what it recorded itself, and only with bytes that still have the hash. Whoever
asks believes the hash and nobody's word, so it does not matter who answers.
"""

from __future__ import annotations

import base64
import logging
import os
import re
import threading
import time
from collections.abc import Callable
from hashlib import file_digest
from pathlib import Path
from typing import IO

from pydantic import ValidationError

from rodeo.bus.messages import ProofCopy
from rodeo.bus.session import Bus, Request
from rodeo.errors import InvalidRequest
from rodeo.evidence.errors import NoCopy
from rodeo.evidence.store import Store
from rodeo.site import topics

log = logging.getLogger(__name__)

_HASH = re.compile("0x[0-9a-f]{64}")

PART_BYTES = 512 << 10
"""Bytes of a copy in one answer."""
PUT_WALL_S = 60.0
"""How long a device may take to put its copy into a slow store."""
_PART_WALL_S = 10.0
_WHOLE_WALL_S = 300.0
"""How long a device may take to send a whole copy, which are megabytes: then another one is asked."""
_MOST_ANSWERS = 16


class Copies:
    """Serves a device's own copies on the bus. `find` gives the path of the copy with a hash (0x hex), if
    there is one; it is called from the bus's threads. Close it before the bus."""

    def __init__(
        self, bus: Bus, org: str, device: str, store: Store, find: Callable[[str], Path | None]
    ) -> None:
        self._device = device
        self._store = store
        self._find = find
        self._putting = threading.Lock()
        self._queryable = bus.serve(topics.PROOF_COPY.name(org=org, device=device), self._answer)

    def close(self) -> None:
        self._queryable.undeclare()

    def _answer(self, request: Request) -> dict[str, object]:
        """Raises NoCopy, InvalidRequest, StoreError."""
        wanted = request.parameters.get("sha256", "").lower()
        if not _HASH.fullmatch(wanted):
            raise InvalidRequest("sha256 is 32 bytes as 0x hex", sha256=wanted[:100])
        try:
            offset = int(request.parameters.get("offset", "0"))
        except ValueError as error:
            raise InvalidRequest("the offset is not a number", offset=request.parameters["offset"]) from error
        if offset < 0:
            raise InvalidRequest("the offset is below 0", offset=offset)
        path = self._find(wanted)
        try:
            if path is None:
                raise NoCopy("there is no copy of this proof here", sha256=wanted)
            asked_to_put = "put" in request.parameters
            answer = self._put(wanted, path) if asked_to_put else self._part(wanted, path, offset)
        except OSError as error:
            raise NoCopy("the copy here cannot be read", path=str(path), cause=str(error)) from error
        return answer.model_dump(mode="json")

    def _part(self, wanted: str, path: Path, offset: int) -> ProofCopy:
        with path.open("rb") as file:
            size_bytes = file.seek(0, os.SEEK_END)
            file.seek(offset)
            data = base64.b64encode(file.read(PART_BYTES))
        return ProofCopy(device=self._device, sha256=wanted, size_bytes=size_bytes, offset=offset, data=data)

    def _put(self, wanted: str, path: Path) -> ProofCopy:
        with self._putting:  # whoever asks twice at once does not have it uploaded twice
            found = _hash(path)
            if found != wanted:
                raise NoCopy("the copy here is damaged, too", sha256=wanted, found=found)
            uri = self._store.put(path)
        log.info("restored the proof %s to the store on request", wanted)
        return ProofCopy(device=self._device, sha256=wanted, size_bytes=path.stat().st_size, uri=uri)


def ask_to_put(bus: Bus, org: str, sha256: str) -> str:
    """Ask whoever has a copy to put it into the store again; where it is now by the first answer, "" if
    nobody says that it is. Raises BusError."""
    answers = _asked(
        bus, topics.PROOF_COPY.pattern(org=org), {"sha256": sha256, "put": 1}, PUT_WALL_S, most=1
    )
    return next((one.uri for one in answers), "")


def hand_over(bus: Bus, org: str, wanted: str, path: Path, max_bytes: int) -> bool:
    """Fetch the proof with this hash over the bus, from whoever has a whole copy, to `path`; whether it is
    there now. Raises BusError, and OSError where it cannot be written."""
    everybody = topics.PROOF_COPY.pattern(org=org)
    for holder in _asked(bus, everybody, {"sha256": wanted, "offset": 0}, _PART_WALL_S, _MOST_ANSWERS):
        key = topics.PROOF_COPY.name(org=org, device=holder.device)
        with path.open("wb") as file:
            _read_parts(bus, key, wanted, min(holder.size_bytes, max_bytes), file)
        if _hash(path) == wanted:
            return True
        log.warning("%s sent other bytes than the proof %s", holder.device, wanted)
        path.unlink()
    return False


def _read_parts(bus: Bus, key: str, wanted: str, size_bytes: int, file: IO[bytes]) -> None:
    end_s = time.monotonic() + _WHOLE_WALL_S
    while (offset := file.tell()) < size_bytes and time.monotonic() < end_s:
        for part in _asked(bus, key, {"sha256": wanted, "offset": offset}, _PART_WALL_S, most=1):
            file.write(part.data)
        # Whoever sends less holds up those who have it all.
        if file.tell() < min(offset + PART_BYTES, size_bytes):
            return


def _asked(bus: Bus, key: str, parameters: dict[str, object], timeout_s: float, most: int) -> list[ProofCopy]:
    """What fits of what is answered. Raises BusError."""
    copies = []
    for answer in bus.query_all(key, parameters=parameters, timeout_s=timeout_s, most=most, most_each=1):
        try:
            copies.append(ProofCopy.model_validate(answer))
        except ValidationError as error:
            log.info("ignored an invalid answer on %s: %s", key, error)
    return copies


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return "0x" + file_digest(file, "sha256").hexdigest()
