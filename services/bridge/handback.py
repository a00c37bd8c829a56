"""Gives back at once what a participant of this bridge was assigned and cannot do.

The bridge lets nobody offer that, but the contracts do: somebody may have used the key elsewhere, or the site
file may have changed. They know no way to decline. So the service is paused, and a sealed statement that says
why is handed in as the proof. Whoever judges the kind ends the attempt, and the task goes to the next one
who offers it, instead of waiting for the end of a window in which nobody works. One attempt is lost.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo.clock import Clock
from rodeo.errors import RodeoError
from rodeo.evidence import Binding, Recorder, Store
from rodeo.topics import EVENT_CHANNEL
from services.bridge.chain import Chain
from services.bridge.commands import Wallet
from services.bridge.names import Names

log = logging.getLogger(__name__)

Row = Mapping[str, Any]


class HandBack:
    """`accounts` are the keys that this bridge has; `folder` keeps a statement until it is in the store."""

    def __init__(
        self,
        chain: Chain,
        names: Names,
        store: Store,
        clock: Clock,
        accounts: Mapping[str, LocalAccount],
        folder: Path,
    ) -> None:
        self._index = chain.index
        self._names = names
        self._deployment = chain.deployment
        self._store = store
        self._clock = clock
        self._accounts = accounts
        self._folder = folder

    def due(self) -> list[tuple[str, str, Row]]:
        """(participant, why it cannot do it, task) of what is assigned to somebody who cannot do it."""
        found: list[tuple[str, str, Row]] = []
        for task in self._index.assigned():
            name = self._names.name(task["executor"])
            if name is not None and name in self._accounts:
                reason = self._names.cannot_do(name, task["kind"])
                if reason:
                    found.append((name, reason, task))
        return found

    def perform(self, wallet: Wallet, reason: str, task: Row) -> None:
        """Pause the service and hand in why; in the participant's own thread. What fails is tried again."""
        try:
            self._perform(wallet, reason, task)
        except (RodeoError, OSError) as error:
            log.warning("cannot return the task: %s", error, extra={"task": task["id"]})

    def _perform(self, wallet: Wallet, reason: str, task: Row) -> None:
        log.error("returning the task: %s", reason, extra={"task": task["id"]})
        service = self._index.service(task["service_id"])
        if service is not None and service["state"] == "active":
            _done(wallet, "update_service", {"service_id": service["id"], "state": "paused"})
        uri, sha256 = self._statement(wallet.participant, reason, task)
        proof = {
            "request_id": f"given-back-{task['id']}-{task['attempt']}-{task['nonce']}",
            "task_id": task["id"],
            "attempt": task["attempt"],
            "proof_sha256": sha256,
            "proof_uri": uri,
        }
        _done(wallet, "submit_proof", proof)

    def _statement(self, participant: str, reason: str, task: Row) -> tuple[str, str]:
        """URI and SHA-256 of the sealed statement in the store."""
        account = self._accounts[participant]
        binding = Binding(
            chain_id=self._deployment.chain_id,
            task_manager=self._deployment.contracts["TaskManager"],
            organization=self._deployment.contracts["Organization"],
            device=participant,
            task_id=task["id"],
            attempt=task["attempt"],
            executor=task["executor"],
            nonce=task["nonce"],
        )
        path = self._folder / f"{task['id']}-{task['attempt']}.mcap"
        path.unlink(missing_ok=True)  # half a one, of a process that was killed
        note = f"Returned unfinished: {reason}."
        recorder = Recorder(path, binding, account, self._clock)
        recorder.write_json(EVENT_CHANNEL, {"event": "execution_failed", "message": reason})
        recorder.write_json(EVENT_CHANNEL, {"event": "statement", "note": note, "photos_sha256": []})
        sealed = recorder.close()
        uri = self._store.put(path)
        path.unlink()
        return uri, sealed.sha256


def _done(wallet: Wallet, command: str, request: dict[str, Any]) -> None:
    """Carry out a command and wait until it is mined. Raises RodeoError."""
    reply = wallet.execute(command, request)
    if not isinstance(reply, dict):
        reply.result()
