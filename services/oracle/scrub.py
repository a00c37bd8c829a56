"""The slow sweep over the store: what was judged must still be there, byte for byte, for whoever asks later.

The chain says what must be there: each proof that got a verdict, and each verdict's report. One file after
the other is hashed, all of them within `store.scrub_days`. A missing or damaged file is restored from its
executor's own copy, a report from the oracle's. A file that nobody has any more is reported until it is there
again.
"""

from __future__ import annotations

import logging
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from pydantic import BaseModel, ValidationError

from rodeo.bus.session import Bus
from rodeo.checks.acts import Judged
from rodeo.errors import BusError, DiskFull
from rodeo.evidence.errors import EvidenceError, ProofUriNotAllowed, StoreUnavailable
from rodeo.evidence.store import Store
from rodeo.host.files import replace_file
from rodeo.recording.copies import ask_to_put, hand_over
from rodeo.site.config import Site

log = logging.getLogger(__name__)

_DAY_S = 24 * 3600.0
_LOOK_S = (0.05, 60.0)
"""Shortest and longest wall time between two looks whether something is due."""
_MISSING_SHARE = 0.01
"""Share of a pass: missing files are looked and asked for that often."""
_MISSING_S = 3600.0
"""And at least this often."""
_SAID = 5
"""Number of missing files that the status names."""


class _Progress(BaseModel):
    """What survives a restart: without it the files at the end would never have their turn."""

    last_s: float
    """Wall time of the last look at any file."""
    looked_s: dict[str, float] = {}
    """SHA-256 -> wall time of the last look at it."""


class Scrub:
    """Hashes what the store has, in a thread of its own.

    Args:
        folder: where its progress is kept.
        reports: the oracle's own copies of reports, by their hash.
        files: what the store must have by now.
        warn: gets what is wrong now, in a sentence; "" when nothing is.
    """

    def __init__(
        self,
        site: Site,
        bus: Bus,
        folder: Path,
        reports: Path,
        files: Callable[[], list[Judged]],
        warn: Callable[[str], None],
    ) -> None:
        self._site, self._bus = site, bus
        self._store = Store(site)
        self._folder, self._reports = folder, reports
        self._files, self._warn = files, warn
        self._pass_s = site.store.scrub_days * _DAY_S
        self._path = folder / "scrub.json"
        self._progress = self._load()
        self._gone: dict[str, Judged] = {}
        self._gone_s = 0.0
        """Wall time of the last look at missing files."""
        self.checked = 0
        """Files since the start."""

    def run(self, stop: threading.Event) -> None:
        """Until `stop`."""
        while not stop.wait(self._pause_s()):
            try:
                self.look()
            except (StoreUnavailable, BusError, DiskFull, OSError) as error:
                log.warning("cannot scan the store now: %s", error)
                self._warn(f"cannot scan the store: {error}")
                stop.wait(_LOOK_S[1])

    def look(self) -> None:
        """Look at the file whose turn it is, if one is due, and at missing ones.

        Raises StoreUnavailable, BusError, DiskFull, OSError.
        """
        # A wall clock that people set back must not stop it for as long.
        now_s = max(time.time(), 0.0)
        files = {one.sha256: one for one in self._files() if self._is_ours(one)}
        if self._gone and now_s - self._gone_s >= min(_MISSING_S, _MISSING_SHARE * self._pass_s):
            self._gone_s = now_s
            for one in list(self._gone.values()):
                if one.sha256 not in files or self._is_whole(one) or self._restore(one):
                    del self._gone[one.sha256]
            self._update_warning()
        if not files or abs(now_s - self._progress.last_s) < self._pass_s / len(files):
            return
        looked_s = self._progress.looked_s
        one = min(files.values(), key=lambda file: looked_s.get(file.sha256, 0.0))
        # First, so that an unreadable file does not keep the others from their turn.
        kept = {sha256: time_s for sha256, time_s in looked_s.items() if sha256 in files}
        self._progress = _Progress(last_s=now_s, looked_s={**kept, one.sha256: now_s})
        replace_file(self._path, self._progress.model_dump_json())
        if self._is_whole(one):
            self._gone.pop(one.sha256, None)
        else:
            log.error("the store has lost or damaged %s, %s", one.what, one.uri)
            if not self._restore(one):
                self._gone[one.sha256] = one
        self.checked += 1
        self._update_warning()

    def _pause_s(self) -> float:
        least_s, most_s = _LOOK_S
        return min(max(self._pass_s / (10 * max(len(self._files()), 1)), least_s), most_s)

    def _is_ours(self, one: Judged) -> bool:
        try:
            self._store.check(one.uri)
        except ProofUriNotAllowed:
            return False
        return Store.names(one.uri, one.sha256)

    def _is_whole(self, one: Judged) -> bool:
        return self._store.stored(one.uri) == one.sha256

    def _restore(self, one: Judged) -> bool:
        """Have the file restored; returns whether it is there."""
        own = self._reports / f"{one.sha256.removeprefix('0x')}.json"
        try:
            if own.is_file():
                self._store.put(own)
            elif not ask_to_put(self._bus, self._site.org, one.sha256) or not self._is_whole(one):
                self._put_what_is_handed_over(one)
        except EvidenceError as error:
            log.warning("cannot restore %s to the store: %s", one.what, error)
        whole = self._is_whole(one)
        if whole:
            log.warning("restored %s to the store", one.what)
        return whole

    def _put_what_is_handed_over(self, one: Judged) -> None:
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            path = Path(folder, one.uri.rpartition("/")[2])
            if hand_over(self._bus, self._site.org, one.sha256, path, self._site.store.max_bytes):
                self._store.put(path)

    def _update_warning(self) -> None:
        if not self._gone:
            self._warn("")
            return
        named = ", ".join(one.what for one in list(self._gone.values())[:_SAID])
        more = len(self._gone) - _SAID
        self._warn(
            f"the store has lost or damaged {named}{f' and {more} more' if more > 0 else ''}: nobody on the "
            "bus has a copy; restore the store from a backup, or start the executor that has one"
        )

    def _load(self) -> _Progress:
        try:
            return _Progress.model_validate_json(self._path.read_bytes())
        except FileNotFoundError:
            pass
        except (OSError, ValidationError) as error:
            log.warning("cannot read %s; scanning the store from the start: %s", self._path, error)
        return _Progress(last_s=time.time())
