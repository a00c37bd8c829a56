"""How long the clock has stood still, and for whom."""

from __future__ import annotations

import logging
import time
from collections import defaultdict
from collections.abc import Callable, Set
from typing import Any

from services.robot_sim.roster import Roster, Session

log = logging.getLogger(__name__)

LONG_S = 5.0
"""Wall time after which a process that holds the clock is named."""


class Standstill:
    """Counts the wall time for which the clock waits for the holders of `roster`.

    `warn` is called with who holds the clock for longer than LONG_S, and with an empty text afterwards.
    """

    def __init__(self, roster: Roster, warn: Callable[[str], None]) -> None:
        self._roster = roster
        self._warn = warn
        self._warned = ""
        self._since_s: float | None = None
        self._late_since_s: dict[Session, float] = {}
        """Holders of the clock now, and since when (monotonic)."""
        self.waited_s = 0.0
        """Wall time for which the clock stood still for holders."""
        self.waited_for_s = defaultdict[str, float](float)
        """The same for each process; several may hold the clock at the same time."""

    @property
    def figures(self) -> dict[str, Any]:
        """`waited_s` and `waited_for_s`, for the process's status."""
        each = {process: round(waited_s, 3) for process, waited_s in self.waited_for_s.items()}
        return {"waited_s": round(self.waited_s, 3), "waited_for_s": each}

    def count(self, passes: bool, missing: Set[str]) -> None:
        """After a look at whether the time may continue. `missing` processes have not come yet."""
        now_s = time.monotonic()
        late: dict[Session, str] = {}
        if not passes:
            self._since_s = self._since_s or now_s
            late = self._roster.late()
        elif self._since_s is not None:
            self.waited_s += now_s - self._since_s
            self._since_s = None
        for who in self._late_since_s.keys() - late.keys():
            self.waited_for_s[who.process] += now_s - self._late_since_s[who]
        self._late_since_s = {who: self._late_since_s.get(who, now_s) for who in late}
        text = ""
        if self._since_s is not None and now_s - self._since_s > LONG_S:
            # Those who have only just been given something to do hold it up least.
            since_s = min(self._late_since_s.values(), default=now_s)
            longest = {who.process for who in late if self._late_since_s[who] - since_s < LONG_S}
            text = f"the clock waits for {', '.join(sorted(longest | missing))}"
        if text != self._warned:
            how = [f"{who.process} {why} (session {who.id})" for who, why in sorted(late.items())]
            log.warning("%s", f"{text}: {', '.join(how)}" if text else "the clock runs again")
            self._warn(text)
            self._warned = text
