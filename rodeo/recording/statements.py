"""The recorder's door for what devices state: who may be heard, in which order, and what was missed.

To check a signature costs ten times what everything else costs. So a message is looked at first: whose key it
came on, its form, its addresses, its signer's name and its number. A statement counts on its device's own key
only, which the access rules of a closed bus let nobody else publish on. Of each key only so many signatures
are checked in a second. On an open bus anybody can publish on a device's key, and yet not silence it: what
was not checked is asked again from the device's journal, where nobody else speaks in between.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from typing import Any, NamedTuple

from pydantic import ValidationError

from rodeo.bus.session import Bus, decode_json
from rodeo.errors import BusError, MalformedJson, RemoteError, RodeoError
from rodeo.evidence.attestation import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation, BadStatement
from rodeo.host.budget import Bucket
from rodeo.host.clock import Clock
from rodeo.recording.door import Refusal, Refusals
from rodeo.signing.keystores import SiteDevice
from rodeo.site import topics
from rodeo.witness.devices import Device, DeviceTable
from rodeo.witness.statement import Scope, Statement, parse, payload_digest

log = logging.getLogger(__name__)

MAX_STATEMENT_BYTES = 256 << 10
"""A second of a whole lab's motion is a hundredth of it."""
_CHECKS_PER_WALL_S = 100.0
"""Signatures checked of what comes on one key: five times what motion capture states in a lab that runs 20
times as fast as the wall's clock, and a hundredth of a core."""
_STATED_PER_S = 5.0
"""Statements of one device that are written per second of site time: it makes about one."""
_STATED_AT_ONCE = 200.0
"""What was missed while the bus was away is written all at once."""
_BYTES_PER_S, _BYTES_AT_ONCE = 2_000.0, 1e6
"""What the statements of a device that watches no motion may hold, per second of site time and at once: many
times what it has to say, and all of a site's devices together less than a proof may hold."""
_MOTION_BYTES_PER_S, _MOTION_BYTES_AT_ONCE = 20_000.0, 1e7
"""The same of motion capture: a kilobyte and a half for each body that moves."""
_MOST_MISSED = 10_000
"""More statements than any device makes during one recording."""
_KEPT = 20_000
"""Numbers remembered of one device."""


class Heard(NamedTuple):
    """A statement that may be written."""

    device: Device
    attestation: dict[str, Any]
    statement: Statement


class _Chain:
    """What was heard of one device's chain."""

    def __init__(self) -> None:
        self.budget = Bucket(_STATED_PER_S, _STATED_AT_ONCE)
        self._bytes = {
            True: Bucket(_MOTION_BYTES_PER_S, _MOTION_BYTES_AT_ONCE),
            False: Bucket(_BYTES_PER_S, _BYTES_AT_ONCE),
        }
        """By whether the device watches motion."""
        self.known: dict[int, set[str]] = {}
        """`seq` -> digests of what was let in under it: two are for the oracle to see."""
        self.through = 0
        """All that was stated up to this number was let in, or will never be."""
        self.newest = 0
        self.overheard = False
        """Whether something may have been stated that was not looked at."""
        self.fruitless = 0
        """Times in a row that the journal did not tell what is missing."""

    def afford(self, heard: Heard, now_s: float, size_bytes: int) -> bool:
        """Whether the budget of its device covers another statement of `size_bytes`."""
        return self.budget.take(now_s) and self._bytes[heard.device.role == "mocap"].take(now_s, size_bytes)

    @property
    def incomplete(self) -> bool:
        return self.overheard or self.through < self.newest

    def let_in(self, seq: int, digest: str) -> None:
        if not self.known and not self.through:
            self.through = seq - 1
        self.known.setdefault(seq, set()).add(digest)
        self.newest = max(self.newest, seq)
        self._advance()

    def give_up(self) -> None:
        """Nobody can tell what was stated between `through` and the next that is known."""
        self.through = min((seq for seq in self.known if seq > self.through), default=self.newest + 1) - 1
        self.fruitless = 0
        self._advance()

    def _advance(self) -> None:
        while self.through + 1 in self.known:
            self.through += 1
        while len(self.known) > _KEPT:
            del self.known[next(iter(self.known))]


class StatementDoor:
    """Decides which statements are let in. One thread at a time.

    Args:
        find: the registered device with an address; must not wait.
        members: whose statements count, by role and name.
        scope: for which organization they must be made; None while that is not known.
        slack_s: how far the time of a live statement may be off the site's clock.
        after: address -> `seq` of the last statement of that device which is known already.
    """

    def __init__(
        self,
        find: Callable[[str], Device | None],
        members: Collection[SiteDevice],
        scope: Callable[[], Scope | None],
        clock: Clock,
        slack_s: float,
        refusals: Refusals,
        after: Mapping[str, int] | None = None,
        wall_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._find = find
        self._members = frozenset(members)
        self._checks = {
            name: Bucket(_CHECKS_PER_WALL_S, _CHECKS_PER_WALL_S) for name in {one.name for one in members}
        }
        """By the key on which signatures come: the name of a device."""
        self._scope = scope
        self._clock = clock
        self._slack_s = slack_s
        self._refusals = refusals
        self._wall_s = wall_s
        self.answered: Callable[[], bool] = lambda: True
        """Whether it is known which devices there are; until then nobody is a stranger."""
        self._unasked: dict[tuple[str, str], int] = {}
        """Key and address -> first number of what was claimed to be its before that was known."""
        self._chains: dict[str, _Chain] = {}
        self._names: dict[str, str] = {}
        """Address -> name of the device."""
        for address, seq in (after or {}).items():
            chain = self._chain(address)
            chain.through = chain.newest = seq
            chain.overheard = True

    def speaks(self, name: str) -> bool:
        """Whether what comes on the key of device `name` is looked at; what is not is counted."""
        if name not in self._checks:
            self._refusals.count("statement", Refusal.STRANGER)
        return name in self._checks

    def hear(self, name: str, payload: bytes) -> Heard | None:
        """What came over the bus on the key of device `name`; None when it is not let in."""
        try:
            if not self.speaks(name):
                return None
            if len(payload) > MAX_STATEMENT_BYTES:
                raise _Refused(Refusal.MALFORMED)
            attestation = _attestation(payload)
            if attestation.payload.get("device") != name:
                raise _Refused(Refusal.MISADDRESSED)
            if not self.answered():
                self._remember(name, attestation)
                raise _Refused(Refusal.UNASKED)
            heard = self._examine(name, attestation)
            if abs(heard.statement.time_s - self._clock.now_s()) > self._slack_s:
                raise _Refused(Refusal.ABSURD_TIME)
            digest = self._new_digest(heard, attestation)
            if not self._checks[name].take(self._wall_s()):
                self._chain(heard.device.address).overheard = True
                raise _Refused(Refusal.UNVERIFIED)
            self._let_in(heard, attestation, digest)
        except _Refused as refused:
            self._refusals.count("statement", refused.reason)
            return None
        return heard

    def missed(self, name: str) -> None:
        """More came on the key of device `name` than could wait: its journal is to be asked."""
        for address, chain in self._chains.items():
            chain.overheard = chain.overheard or self._name(address) == name

    def read(self, name: str, answer: Any, *, older: bool = False) -> list[Heard]:
        """What of a journal's answer was not heard before, up to the first that is wrong in it.

        `older` takes also what was stated before all that is asked for.
        """
        found: list[Heard] = []
        statements = answer.get("statements") if isinstance(answer, dict) else None
        if not isinstance(statements, list):
            self._refusals.count("statement", Refusal.MALFORMED)
            return found
        for one in statements:
            try:
                attestation = _validated(one)
                heard = self._examine(name, attestation)
                if not older and heard.statement.seq <= self._chain(heard.device.address).through:
                    raise _Refused(Refusal.DOUBLED)
                if heard.statement.time_s > self._clock.now_s() + self._slack_s:
                    raise _Refused(Refusal.ABSURD_TIME)
                self._let_in(heard, attestation, self._new_digest(heard, attestation))
            except _Refused as refused:
                if refused.reason is Refusal.DOUBLED:
                    continue  # of an answer that is the rule
                self._refusals.count("statement", refused.reason)
                break
            found.append(heard)
        return found

    def wanted(self) -> list[tuple[str, str, int]]:
        """Devices of which something is missing: address, name, and the number after which to ask."""
        if self._unasked and self.answered():
            self._take_up_unasked()
        return [
            (address, name, chain.through)
            for address, chain in self._chains.items()
            if chain.incomplete and (name := self._name(address)) is not None
        ]

    def known(self) -> list[tuple[str, str, int]]:
        """(address, name, last number) of every device that was heard."""
        return [
            (address, name, chain.through)
            for address, chain in self._chains.items()
            if (name := self._name(address)) is not None
        ]

    def asked(self, address: str, through: int) -> bool:
        """The journal was asked for what came after number `through`; whether to ask for more at once."""
        chain = self._chain(address)
        progress = chain.through > through
        chain.overheard = chain.overheard and progress
        chain.fruitless = 0 if progress or not chain.incomplete else chain.fruitless + 1
        if chain.fruitless >= _FRUITLESS and chain.incomplete:
            log.warning("%s does not answer with its statements after %d", self._name(address), chain.through)
            chain.give_up()
        return progress and chain.incomplete

    # -- inside ----------------------------------------------------------------------------------------

    def _remember(self, name: str, attestation: Attestation) -> None:
        """From which number on the journal of the device is to be asked that speaks on key `name`."""
        key, seq = (name, attestation.signer.lower()), attestation.payload.get("seq")
        known = self._unasked.get(key)
        room = sum(one == name for one, _ in self._unasked) < _MOST_UNASKED
        if type(seq) is int and seq > 0 and (known is not None or room):
            self._unasked[key] = seq if known is None else max(min(seq, known), known - _MOST_MISSED)

    def _take_up_unasked(self) -> None:
        unasked, self._unasked = self._unasked, {}
        for (name, address), seq in unasked.items():
            device = self._find(address)
            if device is None or device.name != name or not self._is_member(device):
                continue
            chain = self._chain(address)
            if not chain.known and not chain.through:
                chain.through = chain.newest = seq - 1
                chain.overheard = True

    def _is_member(self, device: Device) -> bool:
        return SiteDevice(device.role, device.name) in self._members

    def _chain(self, address: str) -> _Chain:
        return self._chains.setdefault(address.lower(), _Chain())

    def _name(self, address: str) -> str | None:
        device = self._find(address)
        return None if device is None else device.name

    def _examine(self, name: str, attestation: Attestation) -> Heard:
        """Everything about a statement but its signature."""
        device = self._find(attestation.signer)
        if device is None or not self._is_member(device):
            raise _Refused(Refusal.STRANGER)
        if name != device.name:
            raise _Refused(Refusal.MISADDRESSED)
        try:
            statement = parse(attestation.payload)
        except BadStatement as error:
            log.debug("%s", error)
            raise _Refused(Refusal.MALFORMED) from error
        if statement.device != device.name or statement.type.partition(".")[0] != device.role:
            raise _Refused(Refusal.MISADDRESSED)
        scope = self._scope()
        if scope is not None and _of(statement) != _of(scope):
            raise _Refused(Refusal.MISADDRESSED)
        return Heard(device, attestation.model_dump(), statement)

    def _new_digest(self, heard: Heard, attestation: Attestation) -> str:
        """The digest of a statement that was not let in before, by what it says."""
        chain, seq = self._chain(heard.device.address), heard.statement.seq
        known = chain.known.get(seq, set())
        try:
            digest = payload_digest(attestation.payload)
        except BadAttestation as error:
            log.debug("%s", error)
            raise _Refused(Refusal.BAD_SIGNATURE) from error
        if digest in known or len(known) >= _SIGNED_TWICE:
            raise _Refused(Refusal.DOUBLED)
        if chain.newest and seq > chain.newest + _MOST_MISSED:
            raise _Refused(Refusal.ABSURD_NUMBER)
        return digest

    def _let_in(self, heard: Heard, attestation: Attestation, digest: str) -> None:
        chain, seq = self._chain(heard.device.address), heard.statement.seq
        try:
            verify_attestation(attestation)
        except BadAttestation as error:
            log.debug("%s", error)
            raise _Refused(Refusal.BAD_SIGNATURE) from error
        if not chain.afford(heard, self._clock.now_s(), len(attestation.model_dump_json())):
            chain.overheard = True
            raise _Refused(Refusal.OVER_BUDGET)
        if seq in chain.known:
            log.error("%s signed number %d twice", heard.device.name, seq)
        chain.let_in(seq, digest)


_MOST_UNASKED = 10
"""Claimed signers on one key that are remembered while nobody can be asked who they are."""
_FRUITLESS = 5
"""After this many requests without success, the journal does not have the missing statements."""
_SIGNED_TWICE = 2
"""Statements under one number show that a device contradicts itself; more show nothing else."""


class _Refused(Exception):
    def __init__(self, reason: Refusal) -> None:
        super().__init__(reason)
        self.reason = reason


def _attestation(payload: bytes) -> Attestation:
    try:
        return _validated(decode_json(payload))
    except MalformedJson as error:
        raise _Refused(Refusal.MALFORMED) from error


def _validated(data: Any) -> Attestation:
    try:
        return Attestation.model_validate(data)
    except ValidationError as error:
        raise _Refused(Refusal.MALFORMED) from error


def _of(scope: Scope) -> tuple[int, str, str]:
    return scope.chain_id, scope.task_manager.lower(), scope.organization.lower()


_LOOK_WALL_S = 0.5
"""How often it is looked whether something is missing."""
_ANSWER_WALL_S = 2.0
_MOST_WAITING = 500
"""Messages on one key that wait for a look: more than come while a busy machine stalls."""
_ANSWERS = 4
"""Most answers to one question: the device's own is among them, whoever else answers on an open bus."""


class StatementListener:
    """Hears what the site's devices state on the bus and asks their journals for what it missed.

    `deliver` gets each statement that is let in, one at a time, from threads of the listener. Close it before
    the bus.

    Args:
        only: name of the one device that is listened to; all by default.
        hold: entered from when a statement arrives until it was looked at, for a clock that waits for it.
    """

    def __init__(
        self,
        bus: Bus,
        org: str,
        door: Callable[[DeviceTable], StatementDoor],
        deliver: Callable[[Heard], None],
        only: str = "*",
        hold: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._hold = hold
        self._bus = bus
        self._org = org
        self.devices = DeviceTable(bus, org)
        self._door = door(self.devices)
        self._door.answered = lambda: self.devices.answered
        self._deliver = deliver
        self._lock = threading.RLock()
        self._wake = threading.Event()
        self._closed = threading.Event()
        self._arriving = threading.Lock()
        """So that nothing arrives after the end: it would hold the clock indefinitely."""
        self._arrived: queue.Queue[tuple[str, bytes, ExitStack] | None] = queue.Queue()
        self._waiting: Counter[str] = Counter()
        """By device, whose key it came on: what has arrived and was not looked at."""
        self._missed: set[str] = set()
        """Devices of which more came than may wait."""
        # Until it is known who is a device nobody can be heard: no site time passes for that.
        asking = ExitStack()
        asking.enter_context(hold())
        self._subscriber = bus.subscribe_bytes(
            topics.WITNESS_STATEMENT.name(org=org, device=only), self._on_statement, inline=True
        )
        self._threads = [
            threading.Thread(target=self._hear, name="heard", daemon=True),
            threading.Thread(target=self._look_after, name="statements", daemon=True),
            threading.Thread(
                target=self.devices.look_after, args=(self._closed, asking), name="devices", daemon=True
            ),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def answered(self) -> bool:
        """Whether it is known which devices there are: without, nobody can be heard."""
        return self.devices.answered

    def close(self) -> None:
        with self._arriving:
            self._closed.set()
            self._arrived.put(None)
        self._wake.set()
        self._subscriber.undeclare()
        for thread in self._threads:
            thread.join(2 * _ANSWER_WALL_S)

    def catch_up(self) -> None:
        """Ask everybody who was heard for what they stated since. Waits for the answers."""
        self.settle()
        with self._lock:
            known = self._door.known()
        self._ask(known)

    def settle(self) -> None:
        """Return when all that arrived was looked at."""
        if not self._closed.is_set():
            self._arrived.join()

    def read(self, name: str, answer: Any) -> None:
        """Take what device `name` answered elsewhere: {"statements": [...]}, its last ones for example."""
        with self._lock:
            for heard in self._door.read(name, answer, older=True):
                self._deliver(heard)

    # -- inside ----------------------------------------------------------------------------------------

    def _on_statement(self, key: str, payload: bytes) -> None:
        name = (topics.WITNESS_STATEMENT.parts(key) or {}).get("device", "")
        with self._arriving:
            if self._closed.is_set() or not self._door.speaks(name):
                return
            if self._waiting[name] >= _MOST_WAITING:
                self._missed.add(name)
                return
            self._waiting[name] += 1
            arrived = ExitStack()
            arrived.enter_context(self._hold())
            self._arrived.put((name, payload, arrived))

    def _hear(self) -> None:
        while (one := self._arrived.get()) is not None:
            name, payload, arrived = one
            with arrived, self._lock:
                try:
                    heard = self._door.hear(name, payload)
                    if heard is not None:
                        self._deliver(heard)
                except RodeoError as error:
                    log.warning("ignored a statement of %s: %s", name, error)
                except Exception:
                    # The next one must be heard whatever happened to this one.
                    log.exception("the handler of a statement of %s failed", name)
            with self._arriving:
                self._waiting[name] -= 1
            self._arrived.task_done()
        self._arrived.task_done()

    def _look_after(self) -> None:
        while not self._closed.is_set():
            with self._arriving:
                missed, self._missed = self._missed, set()
            with self._lock:
                for name in missed:
                    self._door.missed(name)
                wanted = self._door.wanted()
            self._ask(wanted)
            self._wake.wait(_LOOK_WALL_S)
            self._wake.clear()

    def _ask(self, wanted: Iterable[tuple[str, str, int]]) -> None:
        for address, name, after in wanted:
            key = topics.WITNESS_STATEMENTS.name(org=self._org, device=name)
            try:
                answers = self._bus.query_all(
                    key, parameters={"after": after}, timeout_s=_ANSWER_WALL_S, most=_ANSWERS
                )
            except (BusError, RemoteError) as error:
                log.debug("the journal of %s does not answer: %s", name, error)
                continue
            with self._lock:
                for answer in answers:
                    for one in self._door.read(name, answer):
                        self._deliver(one)
                # Nobody answers while the device is away, or the router: then it is asked again.
                if answers and self._door.asked(address, after):
                    self._wake.set()
