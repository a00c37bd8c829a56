"""An executor that keeps a copy of what it submitted, as the oracle hears it over the bus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rodeo.bus.messages import ProofCopy
from rodeo.evidence.store import Store
from rodeo.recording.copies import PART_BYTES


class CopyBus:
    """One executor, that keeps `copy` and puts it where `store` says when it is asked."""

    def __init__(self) -> None:
        self.connected = True
        self.copy = b""
        self.store: Store | None = None
        self.folder = Path()

    def query_all(self, _key: str, *, parameters: dict[str, Any], **_: Any) -> list[dict[str, Any]]:
        if not self.copy:
            return []
        said: dict[str, Any] = {"device": "panther1", "sha256": parameters["sha256"]}
        if "put" in parameters:
            if self.store is None:
                return []
            path = self.folder / "copy.mcap"
            path.write_bytes(self.copy)
            said["uri"] = self.store.put(path)
        offset = int(parameters.get("offset", 0))
        made = ProofCopy(size_bytes=len(self.copy), offset=offset, **said)
        part = self.copy[offset : offset + PART_BYTES]
        return [made.model_copy(update={"data": part}).model_dump(mode="json")]
