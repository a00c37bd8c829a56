"""A device on the bus that signs what it saw: hears heads of others, publishes and answers with its chain.

To check a signature costs five times what everything else costs, so it comes last. A message counts only on
its device's own key, which the access rules of a closed bus let nobody else publish on; then it has to name a
registered device and this organization, and to be newer than what was heard of its device. Only then one of
the key's `CheckBudget` is spent. On an open bus anybody can publish on a device's key: a flood of bad
signatures cannot silence a device that was heard before, unless it forges the session of the device, too.
"""

from __future__ import annotations

import hashlib
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import zenoh
from pydantic import ValidationError

from rodeo.bus import queries
from rodeo.bus.session import Bus, Request, decode_json
from rodeo.errors import BusError, ClockUnavailable, InvalidRequest, MalformedJson, RemoteError
from rodeo.evidence.attestation import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation, BadStatement
from rodeo.evidence.seal import SealHead
from rodeo.host.budget import CheckBudget
from rodeo.host.metrics import HEADS_REFUSED
from rodeo.signing.keys import Signer
from rodeo.site import topics
from rodeo.witness.chain import Inputs, WitnessChain
from rodeo.witness.days import Days, Unposted
from rodeo.witness.devices import Device, DeviceTable
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Head, Header, Scope, Statement, parse, payload_digest

log = logging.getLogger(__name__)

_CHECKS_PER_WALL_S = 100.0
"""Signatures checked of what comes on one key: several times what a lab states that runs 20 times as fast as
the wall's clock, and a hundredth of a core."""
_REPEATS_PER_WALL_S = 10.0
"""Times that the newest statement on one key is handed on again: a robot repeats it every second."""
AHEAD_S = 15.0
"""A seal whose time is this far ahead of the site's clock is ignored: it would exclude all seals until that
time. A seal is never ahead of a simulated clock, which reaches the witness before it."""
_MOST_BAD = 1000
"""Forgeries that are remembered, so that a repeated one costs no check."""
_MOST_SEAL_BYTES = 4096
"""A seal has less than a kilobyte."""
_MOST_STATEMENT_BYTES = 256 << 10
"""A second of a whole lab's motion is a hundredth of it."""
_RETRY_WALL_S = 1.0
_ANSWER_WALL_S = 2.0
_LOOK_WALL_S = 10.0
"""How often it is asked for which organization to sign: a site may get another chain while it runs."""
Listener = Callable[[Device, Statement], None]
MAX_STATEMENTS = 200
"""In one answer."""


class SignatureChecks:
    """Checks signatures of other devices, as many as each of them may cost. Seals and statements come in
    threads of their own.
    """

    def __init__(self) -> None:
        self.budget, self.repeats = CheckBudget(_CHECKS_PER_WALL_S), CheckBudget(_REPEATS_PER_WALL_S)
        self.newest: dict[str, Head] = {}
        """Registered address -> its newest statement that was heard."""
        self._bad: dict[tuple[str, str], None] = {}
        """Digest and signature of what was found forged last, the newest last."""
        self._lock = threading.Lock()

    def genuine(self, spoken: Spoken, name: str, source: str) -> bool:
        """Whether its signature is genuine; False also where its key has used up its checks.

        Raises BadAttestation.
        """
        claim = spoken.head.digest, spoken.attestation.signature
        with self._lock:
            if claim in self._bad or not self.budget.take(name, source):
                HEADS_REFUSED.inc()
                return False
            try:
                verify_attestation(spoken.attestation)
            except BadAttestation:
                self._bad[claim] = None
                if len(self._bad) > _MOST_BAD:
                    del self._bad[next(iter(self._bad))]
                self.budget.checked(name, source, genuine=False)
                raise
            self.budget.checked(name, source, genuine=True)
            return True


class Witness:
    """Make it, then sign with `chain` and `publish` what it returned. Thread-safe.

    Args:
        folder: where the journal is kept.
        inputs: where the device's readings come from.
        now_ns: the site's time.
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
        now_ns: Callable[[], int],
        listener: Listener | None = None,
    ) -> None:
        self.device = device
        self.heads = HeadBook()
        self._bus = bus
        self._org = org
        self._account = account
        self._inputs = inputs
        self._now_ns = now_ns
        self._listener = listener
        self._journal = Journal(folder / "statements.jsonl")
        self.days = Days(folder / "days", self._journal)
        self._chain: WitnessChain | None = None
        self.devices = DeviceTable(bus, org)
        self.checks = SignatureChecks()
        self._closed = threading.Event()
        self._endpoints: list[zenoh.Subscriber[None] | zenoh.Queryable[None]] = [
            # In the receiving thread: a robot lets the time continue when its recording's first head is
            # published. It must have been heard then, for the next statement to list it however busy the
            # machine is.
            bus.subscribe_with_source(topics.SEAL.pattern(org=org), self._on_seal, inline=True),
            bus.subscribe_with_source(topics.WITNESS_STATEMENT.pattern(org=org), self._on_statement),
            bus.serve(topics.WITNESS_STATEMENTS.name(org=org, device=device), self._serve),
        ]
        for name, target, arguments in (
            ("witness", self._find_scope, ()),
            ("devices", self.devices.look_after, (self._closed,)),
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

    def _on_seal(self, key: str, payload: bytes, source: str = "") -> None:
        try:
            name = self._speaker(topics.SEAL, key, payload, _MOST_SEAL_BYTES)
            if name is None:
                return
            seal = unverified_seal(payload)
            device = self._sender(name, seal.spoken)
            latest_ns = self._now_ns() + round(AHEAD_S * 1e9)
            if seal.time_ns > latest_ns:
                raise BadStatement("it was sealed at a time to come", device=name, time_ns=seal.time_ns)
            self.heads.forget_after(device.address, latest_ns)
            head = seal.spoken.head
            if self.heads.is_news(head, seal.time_ns) and self.checks.genuine(seal.spoken, name, source):
                self.heads.hear(head, seal.time_ns)
        except (BadAttestation, BadStatement, ClockUnavailable) as error:
            # A line in the log for each would be what a flood is after.
            HEADS_REFUSED.inc()
            log.debug("ignored a seal on %s: %s", key, error)

    def _on_statement(self, key: str, payload: bytes, source: str = "") -> None:
        try:
            name = self._speaker(topics.WITNESS_STATEMENT, key, payload, _MOST_STATEMENT_BYTES)
            if name is None:
                return
            spoken = unverified_statement(decode_json(payload))
            device, head = self._sender(name, spoken), spoken.head
            newest = self.checks.newest.get(device.address)
            if newest is not None and head.index < newest.index:
                return  # anybody may say it again; what its device stated since stands
            if newest is not None and (head.index, head.digest) == (newest.index, newest.digest):
                # Said again: it was checked before, and its device may say it every second.
                if not self.checks.repeats.take(name, source):
                    return
            elif self.checks.genuine(spoken, name, source):
                self.checks.newest[device.address] = head
                self.heads.hear(head)
            else:
                return
            if self._listener is not None:
                self._listener(device, parse(spoken.attestation.payload))
        except (MalformedJson, BadAttestation, BadStatement) as error:
            HEADS_REFUSED.inc()
            log.debug("ignored a statement on %s: %s", key, error)

    def _speaker(self, topic: topics.Topic, key: str, payload: bytes, most_bytes: int) -> str | None:
        """The owner of the key; None for the witness's own, and for that of no registered device.

        Raises BadStatement for more bytes than anything on such a key has.
        """
        name = (topic.parts(key) or {}).get("device")
        if name is None or name == self.device or not self.devices.has(name):
            return None
        if len(payload) > most_bytes:
            raise BadStatement("the message is too large", bytes=len(payload), limit=most_bytes)
        return name

    def _sender(self, name: str, spoken: Spoken) -> Device:
        """The registered device that is named as signer of what came on the key of device `name`.

        Raises BadStatement for a device that has another key, for a stranger and another organization.
        """
        if spoken.head.device != name:
            raise BadStatement("it is on another device's key", device=spoken.head.device, key=name)
        device = self.devices.known(spoken.attestation.signer)
        if device is None or device.name != name:
            raise BadStatement("its signer is not that registered device", device=name)
        chain = self._chain
        if chain is not None and not spoken.made_for(chain.scope):
            raise BadStatement("it names another organization", device=name)
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


class Seal(NamedTuple):
    """A seal of a running recording, its signature not checked."""

    spoken: Spoken
    time_ns: int
    """Site time up to which it seals."""


def unverified_seal(data: bytes) -> Seal:
    """What the bytes of a seal message say. Raises BadStatement."""
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
        time_ns = _time_ns(seal.time_ns)
    except ValidationError as error:
        raise BadStatement("the message is not a seal", cause=str(error)[:200]) from error
    return Seal(Spoken(attestation, head), time_ns)


def _time_ns(text: str) -> int:
    """Raises BadStatement for what is not a time in nanoseconds."""
    if not (text.isascii() and text.isdigit() and len(text) <= _TIME_DIGITS):
        raise BadStatement("the seal's time is not a number of nanoseconds", time_ns=text[:64])
    return int(text)


_TIME_DIGITS = 19
"""Digits of the largest time in nanoseconds that fits into 63 bits."""


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
