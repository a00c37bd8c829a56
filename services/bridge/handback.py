"""Gives back at once what a participant of this bridge was assigned and cannot do.

The bridge lets nobody offer that, but the contracts do: somebody may have used the key elsewhere, or the site
file may have changed. The service is paused, and the task abandoned, so that the next one who offers the kind
gets it without waiting for the end of a window in which nobody works. In the grace period the attempt does
not count, and for a task that nobody accepted it costs no penalty. A provider that is not proven rests after
it."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from typing import Any

from rodeo.errors import RodeoError
from services.bridge.chain import Chain
from services.bridge.names import Names
from services.bridge.wallet import Wallet

log = logging.getLogger(__name__)

Row = Mapping[str, Any]


class HandBack:
    """`participants` are those whose keys this bridge has."""

    def __init__(self, chain: Chain, names: Names, participants: Collection[str]) -> None:
        self._index = chain.index
        self._names = names
        self._participants = participants

    def can_do(self, name: str, kind: str) -> bool:
        """Whether the participant can do such work."""
        return not self._names.cannot_do(name, kind)

    def due(self) -> list[tuple[str, str, Row]]:
        """(participant, why it cannot do it, task) of what is assigned to somebody who cannot do it."""
        found: list[tuple[str, str, Row]] = []
        for task in self._index.tasks.in_state("assigned"):
            name = self._names.name(task["executor"])
            if name is not None and name in self._participants:
                reason = self._names.cannot_do(name, task["kind"])
                if reason:
                    found.append((name, reason, task))
        return found

    def perform(self, wallet: Wallet, reason: str, task: Row) -> None:
        """Pause the service and abandon the task, in the participant's own thread. What fails is retried."""
        try:
            self._perform(wallet, reason, task)
        except (RodeoError, OSError) as error:
            log.warning("cannot return the task: %s", error, extra={"task": task["id"]})

    def _perform(self, wallet: Wallet, reason: str, task: Row) -> None:
        log.error("returning the task: %s", reason, extra={"task": task["id"]})
        service = self._index.services.get(task["service_id"])
        if service is not None and service["state"] == "active":
            _done(wallet, "update_service", {"service_id": service["id"], "state": "paused"})
        attempt = {"task_id": task["id"], "attempt": task["attempt"]}
        request_id = f"given-back-{task['id']}-{task['attempt']}-{task['nonce']}"
        _done(wallet, "abandon_task", {"request_id": request_id, **attempt})


def _done(wallet: Wallet, command: str, request: dict[str, Any]) -> None:
    """Carry out a command and wait until it is mined. Raises RodeoError."""
    reply = wallet.execute(command, request)
    if not isinstance(reply, dict):
        reply.result()
