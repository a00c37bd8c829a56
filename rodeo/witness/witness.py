"""A device on the bus that signs what it saw: hears heads of others, publishes and answers with its chain."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh
from eth_account.signers.local import LocalAccount
from pydantic import ValidationError

from rodeo import topics
from rodeo.bus import Bus, Request
from rodeo.errors import BusError, InvalidRequest, RemoteError
from rodeo.evidence.attestation import Attestation, verify_attestation
from rodeo.evidence.errors import BadStatement
from rodeo.evidence.seal import SealHead
from rodeo.witness.chain import Inputs, WitnessChain
from rodeo.witness.devices import Device, DeviceTable
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Head, Header, Scope, Statement, parse, payload_digest

log = logging.getLogger(__name__)

_RETRY_WALL_S = 1.0
_ANSWER_WALL_S = 2.0
Listener = Callable[[Device, Statement], None]
MAX_STATEMENTS = 200
"""In one answer."""


class Witness:
    """Make it, then sign with `chain` and `publish` what it returned. Thread-safe.

    Args:
        folder: where the journal is kept.
        inputs: where the device's readings come from.
        listener: gets what other registered devices of the organization state: who, and the statement.
    """

    def __init__(
        self,
        bus: Bus,
        org: str,
        device: str,
        account: LocalAccount,
        folder: Path,
        inputs: Inputs,
        listener: Listener | None = None,
    ) -> None:
        self.device = device
        self.heads = HeadBook()
        self._bus = bus
        self._org = org
        self._account = account
        self._inputs = inputs
        self._listener = listener
        self._journal = Journal(folder / "statements.jsonl")
        self._chain: WitnessChain | None = None
        self._devices = DeviceTable(bus, org)
        self._closed = threading.Event()
        self._endpoints: list[zenoh.Subscriber[None] | zenoh.Queryable[None]] = [
            bus.subscribe_bytes(topics.SEAL.name(org=org, device="*"), self._on_seal),
            bus.subscribe_json(topics.WITNESS_STATEMENT.name(org=org, device="*"), self._on_statement),
            bus.serve(topics.WITNESS_STATEMENTS.name(org=org, device=device), self._serve),
        ]
        self._asking = threading.Thread(target=self._find_scope, name=f"witness {device}", daemon=True)
        self._asking.start()

    @property
    def chain(self) -> WitnessChain | None:
        """None until it is known for which organization the device signs."""
        return self._chain

    def publish(self, attestation: Attestation) -> None:
        """Tell everybody what was signed."""
        self._bus.put_json(topics.WITNESS_STATEMENT.name(org=self._org, device=self.device), attestation)

    def close(self) -> None:
        """Stop listening and answering; the bus stays open."""
        self._closed.set()
        for endpoint in self._endpoints:
            endpoint.undeclare()
        self._journal.close()

    # -- inside ----------------------------------------------------------------------------------------

    def _find_scope(self) -> None:
        key = topics.STATE.name(org=self._org, what="chain")
        while not self._closed.is_set():
            try:
                answer = self._bus.query(key, timeout_s=_ANSWER_WALL_S)
                contracts = answer["contracts"]
                scope = Scope(
                    chain_id=answer["chain_id"],
                    task_manager=contracts["TaskManager"],
                    organization=contracts["Organization"],
                )
            except (BusError, RemoteError, KeyError, TypeError, ValidationError) as error:
                log.debug("%s does not know yet for whom it signs: %s", self.device, error)
                self._closed.wait(_RETRY_WALL_S)
                continue
            self._chain = WitnessChain(
                self.device, self._account, scope, self._inputs, self._journal, self.heads
            )
            log.info("%s signs for the organization %s", self.device, scope.organization)
            return

    def _on_seal(self, _key: str, payload: bytes) -> None:
        head = seal_head(payload)
        if self._registered(head) is not None:
            self.heads.hear(head)

    def _on_statement(self, _key: str, data: dict[str, Any]) -> None:
        head = statement_head(data)
        device = self._registered(head)
        if device is None:
            return
        self.heads.hear(head)
        if self._listener is not None:
            self._listener(device, parse(data["payload"]))

    def _registered(self, head: Head) -> Device | None:
        """The other device of the organization that the head is of; None for a stranger's."""
        if head.address.lower() == self._account.address.lower():
            return None
        found = self._devices.find(head.address)
        return found if found is not None and found.name == head.device else None

    def _serve(self, request: Request) -> dict[str, Any]:
        after, limit = (_count(request.parameters, name) for name in ("after", "limit"))
        chain = self._chain
        statements = [] if chain is None else chain.after(after, min(limit or MAX_STATEMENTS, MAX_STATEMENTS))
        return {"device": self.device, "statements": [one.model_dump() for one in statements]}


def _count(parameters: dict[str, str], name: str) -> int:
    text = parameters.get(name, "0")
    if not text.isdecimal():
        raise InvalidRequest("a parameter is no count", parameter=name, value=text[:64])
    return int(text)


def seal_head(data: bytes) -> Head:
    """The head that the bytes of a seal message are, its signature checked.

    Raises BadAttestation, BadStatement.
    """
    try:
        attestation = Attestation.model_validate_json(data)
        seal = SealHead.model_validate(attestation.payload)
    except ValidationError as error:
        raise BadStatement("what was heard is no seal", cause=str(error)[:200]) from error
    address = verify_attestation(attestation)
    own = "0x" + hashlib.sha256(data).hexdigest()
    return Head(
        device=seal.device,
        address=address,
        chain=own if seal.recording is None else "0x" + seal.recording,
        index=seal.index,
        digest=own,
    )


def statement_head(data: dict[str, Any]) -> Head:
    """The head that a witness's statement is, its signature checked. Raises BadAttestation, BadStatement."""
    try:
        attestation = Attestation.model_validate(data)
        # Of a kind that this process may not know yet: its header is enough.
        header = Header.model_validate(
            {
                name: attestation.payload.get(name)
                for name in Header.model_fields
                if name in attestation.payload
            }
        )
    except ValidationError as error:
        raise BadStatement("what was heard is no statement", cause=str(error)[:200]) from error
    address = verify_attestation(attestation)
    return Head(
        device=header.device,
        address=address,
        chain=None,
        index=header.seq,
        digest=payload_digest(attestation.payload),
    )
