"""What an oracle is doing, for the terminal and the console."""

from __future__ import annotations

import threading

from rodeo.runtime.process import Process
from services.oracle.away import MissingProofs
from services.oracle.rules import Judging
from services.oracle.turns import Key
from services.oracle.votes import Votes


class Status:
    """Publishes what is verified, looked for and open. Thread-safe."""

    def __init__(self, process: Process, missing: MissingProofs, judging: Judging) -> None:
        self._process, self._missing, self._judging = process, missing, judging
        self.votes: Votes | None = None
        self.decided = 0
        self.for_auditors: set[Key] = set()
        """Submissions that were left to auditors since the start."""
        self._running: dict[Key, str] = {}
        self._published: list[str] = []
        """What was open when the status was last published."""
        self._publishing = threading.Lock()
        """Serializes status updates, so that an older one never overwrites a newer one."""

    def publish(self, key: Key | None = None, activity: str | None = None) -> None:
        """Publish what is done about the submission `key` now; without `activity` nothing is."""
        with self._publishing:
            if key is not None:
                self._running.pop(key, None)
                if activity is not None:
                    self._running[key] = activity
            self._published = self._open()
            said = [*self._running.values(), *self._published]
            if self.votes is not None:
                said += self.votes.summary()
            self._process.activity(
                ", ".join(said) or "idle",
                None,
                decided=self.decided,
                for_auditors=len(self.for_auditors),
                rules=self._judging.open_tasks(),
                **({} if self.votes is None else {"votes": self.votes.held()}),
            )

    def update(self) -> None:
        """Publish whether the store can be read, as far as a proof waits for it, which proofs are looked for,
        and how many tasks need which rules."""
        if unreadable := self._missing.unreadable:
            self._process.not_ready(f"the store cannot be read: {unreadable}")
        else:
            self._process.ready()
        self._process.notices.concern("rules", self._judging.lacking())
        if self._open() != self._published:
            self.publish()

    def _open(self) -> list[str]:
        """A sentence for each proof that is looked for, and for the open tasks of each of the rules."""
        return [*self._missing.summary(), *self._judging.summary()]
