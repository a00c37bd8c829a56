"""The bus for commands that people type: they wait for the bridge as long as it works."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from typing import Any

from pydantic import BaseModel

from rodeo import queries, topics
from rodeo.bus import Bus
from rodeo.config import BRIDGE
from rodeo.errors import QueryTimeout, RemoteError
from rodeo.messages import COMMANDS, Status
from rodeo_cli.progress import NoProgress, Patience, TooSlow, told_by

_BRIDGES = ("wallet", "state")
"""Third word of the keys that the bridge answers."""
_LATE = "transaction_timeout"
"""Code of the bridge's answer when a transaction is not mined yet: the same request may be made again."""


class PatientBus(Bus):
    """Asks the bridge again when it has not answered in time, and has done something since.

    A command that sends a transaction gets a `request_id`, so that it is sent once, however often it is
    asked for. `patience` makes what counts; `waits(doing)` hears that it takes longer.
    """

    patience: Callable[[], Patience] = Patience
    waits: Callable[[str], object] = staticmethod(lambda _reason: None)

    def query(
        self,
        key: str,
        payload: BaseModel | dict[str, Any] | bytes | None = None,
        *,
        parameters: dict[str, Any] | None = None,
        timeout_s: float = 10.0,
    ) -> dict[str, Any]:
        """As Bus.query. Raises QueryTimeout only when the bridge does nothing any more."""
        _, org, what, *names = [*key.split("/"), "", ""]
        if what not in _BRIDGES:
            return super().query(key, payload, parameters=parameters, timeout_s=timeout_s)
        if not COMMANDS.keys().isdisjoint(names) and isinstance(payload, dict):
            payload = {"request_id": str(uuid.uuid4()), **payload}
        patience = self.patience()
        while True:
            try:
                return super().query(key, payload, parameters=parameters, timeout_s=timeout_s)
            except (QueryTimeout, RemoteError) as error:
                if isinstance(error, RemoteError) and error.code != _LATE:
                    raise
                status = self._bridge(org)
                if status is None:
                    raise
                try:
                    patience.look({BRIDGE: told_by(status)})
                except (NoProgress, TooSlow):
                    raise error from None
                self.waits(status.reason or status.activity)

    def _bridge(self, org: str) -> Status | None:
        """What the bridge says of itself; None when it says nothing."""
        key = topics.STATUS.name(org=org, process=BRIDGE)
        try:
            return queries.fitting(Status, super().query(key), key)
        except (QueryTimeout, RemoteError):
            return None
