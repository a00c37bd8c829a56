"""A device on the bus that signs what it saw: hears heads of others, publishes and answers with its chain."""

from __future__ import annotations

import hashlib
import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import zenoh
from pydantic import ValidationError

from rodeo import queries, topics
from rodeo.budget import Bucket
from rodeo.bus import Bus, Request, decode_json
from rodeo.errors import BusError, InvalidRequest, MalformedJson, RemoteError
from rodeo.evidence.attestation import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation, BadStatement
from rodeo.evidence.seal import SealHead
from rodeo.keys import Signer
from rodeo.metrics import HEADS_REFUSED
from rodeo.witness.chain import Inputs, WitnessChain
from rodeo.witness.days import Days, Unposted
from rodeo.witness.devices import Device, DeviceTable
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Head, Header, Scope, Statement, parse, payload_digest

log = logging.getLogger(__name__)

_CHECKS_PER_WALL_S = 100.0
"""Signatures checked of one claimed signer: several times what a lab states that runs 20 times as fast as the
wall's clock, and less than a tenth of a core."""
_RETRY_WALL_S = 1.0
_ANSWER_WALL_S = 2.0
_LOOK_WALL_S = 10.0
"""How often it is asked for which organization to sign: a site may get another chain while it runs."""
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
        account: Signer,
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
        self.days = Days(folder / "days", self._journal)
        self._chain: WitnessChain | None = None
        self._devices = DeviceTable(bus, org)
        self._checks: dict[str, Bucket] = {}
        """Registered address -> signatures that may be checked now."""
        self._newest: dict[str, int] = {}
        """Registered address -> number of its newest statement that was heard."""
        self._closed = threading.Event()
        self._endpoints: list[zenoh.Subscriber[None] | zenoh.Queryable[None]] = [
            # In the receiving thread: a robot lets the time go on when its recording's first head is told. It
            # must have been heard then, for the next statement to list it however busy the machine is.
            bus.subscribe_bytes(topics.SEAL.pattern(org=org), self._on_seal, inline=True),
            bus.subscribe_bytes(topics.WITNESS_STATEMENT.pattern(org=org), self._on_statement),
            bus.serve(topics.WITNESS_STATEMENTS.name(org=org, device=device), self._serve),
        ]
        for name, target, arguments in (
            ("witness", self._find_scope, ()),
            ("devices", self._devices.look_after, (self._closed,)),
        ):
            threading.Thread(target=target, args=arguments, name=f"{name} {device}", daemon=True).start()

    @property
    def chain(self) -> WitnessChain | None:
        """None until it is known for which organization the device signs."""
        return self._chain

    def day_log(self, one: Unposted) -> Attestation | None:
        """The signed log of a day; None until it is known for which organization.

        Raises what `Days.signed` raises.
        """
        if self._chain is None:
            return None
        return self.days.signed(one, self.device, self._chain.scope, self._account)

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
        while not self._closed.is_set():
            try:
                chain = queries.ask(self._bus, self._org, queries.CHAIN, timeout_s=_ANSWER_WALL_S)
                scope = Scope(
                    chain_id=chain.chain_id,
                    task_manager=chain.contracts.task_manager,
                    organization=chain.contracts.organization,
                )
            except (BusError, RemoteError, ValidationError) as error:
                log.debug("%s does not know yet for which organization it signs: %s", self.device, error)
                self._closed.wait(_RETRY_WALL_S)
                continue
            if self._chain is None:
                log.info("%s signs for the organization %s", self.device, scope.organization)
                self._chain = WitnessChain(
                    self.device, self._account, scope, self._inputs, self._journal, self.heads, self.days
                )
            elif self._chain.scope != scope:
                log.warning(
                    "%s signs for another organization from now on: %s on chain %d",
                    self.device,
                    scope.organization,
                    scope.chain_id,
                )
                self._chain.sign_for(scope)
            self._closed.wait(_LOOK_WALL_S)

    def _on_seal(self, _key: str, payload: bytes) -> None:
        try:
            self._on_head(unverified_seal(payload))
        except (BadAttestation, BadStatement) as error:
            # A line in the log for each would be what a flood is after.
            HEADS_REFUSED.inc()
            log.debug("ignored a seal: %s", error)

    def _on_statement(self, _key: str, payload: bytes) -> None:
        try:
            spoken = unverified_statement(decode_json(payload))
            address, seq = spoken.attestation.signer.lower(), spoken.head.index
            if seq < self._newest.get(address, 0):
                return  # anybody may say it again; what its device stated since stands
            device = self._on_head(spoken)
            if device is not None:
                self._newest[address] = seq
            if device is not None and self._listener is not None:
                self._listener(device, parse(spoken.attestation.payload))
        except (MalformedJson, BadAttestation, BadStatement) as error:
            HEADS_REFUSED.inc()
            log.debug("ignored a statement: %s", error)

    def _on_head(self, spoken: Spoken) -> Device | None:
        """Take what another registered device of the organization signed; None for what is not.

        A signature is checked last, and of each claimed signer only so many in a second: on an open bus
        anybody may claim a device's name as often as he likes.
        """
        address = spoken.attestation.signer.lower()
        if address == self._account.address.lower():
            return None
        device = self._devices.known(address)
        if device is None or device.name != spoken.head.device:
            return None
        chain = self._chain
        if chain is not None and not spoken.made_for(chain.scope):
            raise BadStatement("it names another organization", device=device.name)
        checks = self._checks.setdefault(address, Bucket(_CHECKS_PER_WALL_S, _CHECKS_PER_WALL_S))
        if not checks.take(time.monotonic()):
            return None
        verify_attestation(spoken.attestation)
        self.heads.hear(spoken.head)
        return device

    def _serve(self, request: Request) -> dict[str, Any]:
        after, limit = (_count(request.parameters, name) for name in ("after", "limit"))
        chain = self._chain
        statements = [] if chain is None else chain.after(after, min(limit or MAX_STATEMENTS, MAX_STATEMENTS))
        return {"device": self.device, "statements": [one.model_dump() for one in statements]}


def _count(parameters: dict[str, str], name: str) -> int:
    text = parameters.get(name, "0")
    if not text.isdecimal():
        raise InvalidRequest("a parameter is not a count", parameter=name, value=text[:64])
    return int(text)


class Spoken(NamedTuple):
    """What was heard of another device's chain, its signature not checked."""

    attestation: Attestation
    head: Head

    def made_for(self, scope: Scope) -> bool:
        """Whether it names this organization on this chain."""
        payload = self.attestation.payload
        return all(
            str(payload.get(name)).lower() == str(value).lower() for name, value in scope.model_dump().items()
        )


def unverified_seal(data: bytes) -> Spoken:
    """The head that the bytes of a seal message are. Raises BadStatement."""
    try:
        attestation = Attestation.model_validate_json(data)
        seal = SealHead.model_validate(attestation.payload)
        own = "0x" + hashlib.sha256(data).hexdigest()
        head = Head(
            device=seal.device,
            address=attestation.signer,
            chain=own if seal.recording is None else "0x" + seal.recording,
            index=seal.index,
            digest=own,
        )
    except ValidationError as error:
        raise BadStatement("the message is not a seal", cause=str(error)[:200]) from error
    return Spoken(attestation, head)


def unverified_statement(data: dict[str, Any]) -> Spoken:
    """The head that a witness's statement is. Raises BadAttestation, BadStatement."""
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
        head = Head(
            device=header.device,
            address=attestation.signer,
            chain=None,
            index=header.seq,
            digest=payload_digest(attestation.payload),
        )
    except ValidationError as error:
        raise BadStatement("the message is not a statement", cause=str(error)[:200]) from error
    return Spoken(attestation, head)
