"""Requests are repeated until they are answered; meanwhile the process reports why it is not ready."""

from __future__ import annotations

from collections.abc import Callable

from rodeo.errors import NoResponder, QueryTimeout, RemoteError, RodeoError
from rodeo.evidence.errors import StoreUnavailable
from rodeo.host.clocked import ClockedEvent
from rodeo.runtime.process import Process, Result, repeated

RETRY_S = 1.0
"""Wall time before something that is away is asked again."""
_REFUSED_S = 10.0
"""Simulated time until what the organization refused is tried again."""


class Retries:
    """Waits and repeats for one process; `silence` is why the dock's readings are missing, if they are."""

    def __init__(self, process: Process, wake: ClockedEvent, silence: Callable[[], str]) -> None:
        self._process, self._wake = process, wake
        self._silence = silence

    def persist(self, attempt: Callable[[], Result]) -> Result | None:
        """Try until it works; None when the process is asked to stop before. What is away comes back."""
        result = repeated(attempt, self._wait, self._process.stop)
        if not self._process.stop.is_set():
            self.update_readiness()
        return result

    def pause(self, wall_s: float) -> None:
        self._wake.pause(self._process.stop, wall_s=wall_s)

    def update_readiness(self) -> None:
        silence = self._silence()
        if silence:
            self._process.not_ready(silence)
        else:
            self._process.ready()

    def _wait(self, error: RodeoError) -> None:
        if isinstance(error, RemoteError):
            # The bridge answers with the chain's own errors while that is away or being deployed. The bridge
            # itself reports why it is not ready, and once is enough.
            away = error.code == "bridge_not_ready"
            self._process.not_ready("waiting for the bridge" if away else f"{error.code}: {error}")
            if not (error.passes or self._process.site.clock.keeps_wall_time):
                self._wait_refused()
                return
        elif isinstance(error, NoResponder | QueryTimeout | StoreUnavailable):
            self._process.not_ready(str(error))
        else:
            raise error
        self.pause(RETRY_S)

    def _wait_refused(self) -> None:
        """Simulated time passes, or is jumped over: the time of the retry does not depend on the machine."""
        until_s = self._process.clock.now_s() + _REFUSED_S
        self._wake.pause(self._process.stop, until_s=until_s, resting=True)
