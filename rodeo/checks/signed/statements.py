"""What the devices of the site signed, as far as a recording holds it: one chain per device.

A statement counts if its device signed it: it, or a later one that names its digest as the one before. So of
a whole chain one signature is checked.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from pydantic import ValidationError

from rodeo.evidence.attestation import Attestation, verify_attestation
from rodeo.evidence.errors import BadAttestation, BadStatement
from rodeo.evidence.proof import Proof
from rodeo.site.topics import ATTESTATION_CHANNEL
from rodeo.text.strict_json import read_json
from rodeo.witness.statement import Statement, parse, payload_digest

MAX_BAD_SIGNATURES = 200
"""Chains of one device in one recording: a recorder that writes only what it verified has none. What follows
is not looked at, so that nobody makes the oracle compute."""


class Recorded(NamedTuple):
    """An attestation as it is in the recording, its signature not checked."""

    attestation: Attestation
    log_s: float
    data: bytes
    """Its JSON."""


class Said(NamedTuple):
    """A statement that its device signed."""

    statement: Statement
    digest: str
    log_s: float


@dataclass(frozen=True)
class Testimony:
    """What one device signed, in the order of its chain."""

    address: str
    """Lower-case."""
    said: list[Said] = field(default_factory=list)
    twice: int | None = None
    """A number under which it signed two different statements."""
    addresses: tuple[str, ...] = ()
    """`keys`, where there are several."""
    apart: str | None = None
    """Why what it signed under several keys is no one chain."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Lower-case addresses of all keys that it signed with, the oldest first."""
        return self.addresses or (self.address,)


def joined(parts: Iterable[Testimony]) -> Testimony | None:
    """What a device said under all of its keys, in the order of its chain; None if nothing.

    A device that gets another key continues its chain under that one. Where the chains of two keys
    overlap, or the later does not go on with the numbers of the earlier, the longest is left and `apart`
    says so.
    """
    spoken = sorted((one for one in parts if one.said), key=lambda one: one.said[0].statement.time_s)
    if not spoken:
        return None
    apart = next((why for pair in pairwise(spoken) if (why := _apart(*pair)) is not None), None)
    twice = next((one.twice for one in spoken if one.twice is not None), None)
    longest = max(spoken, key=lambda one: len(one.said))
    said = longest.said if apart else [said for one in spoken for said in one.said]
    return Testimony(longest.address, said, twice, tuple(one.address for one in spoken), apart)


def _apart(before: Testimony, after: Testimony) -> str | None:
    """Why the statements under a key do not go on with those under the key before; None if they do."""
    last, first = before.said[-1], after.said[0]
    keys = f"{before.address} and {after.address}"
    if last.statement.time_s > first.statement.time_s or last.statement.seq >= first.statement.seq:
        return f"the chains under its keys {keys} overlap"
    if first.statement.seq == last.statement.seq + 1 and first.statement.previous != last.digest:
        return f"its chain under the key {after.address} does not continue its chain under {before.address}"
    return None


def recorded(proof: Proof, signers: Collection[str] | None) -> Iterator[Recorded]:
    """The statements said to be by one of `signers` (lower-case addresses; None: by anybody), in file order.

    What is no statement, or by somebody else, is passed over: anybody may have put it there.
    """
    column = proof.topics.get(ATTESTATION_CHANNEL)
    if column is None:
        return
    wanted = None if signers is None else [address.encode() for address in signers]
    for data, log_ns in zip(column.data, column.log_ns, strict=True):
        if wanted is not None:
            lowered = data.lower()
            if not any(address in lowered for address in wanted):
                continue
        try:
            attestation = Attestation.model_validate(read_json(data))
        except ValueError:
            continue
        if signers is None or attestation.signer.lower() in signers:
            yield Recorded(attestation, log_ns * 1e-9, data)


def testimonies(statements: Iterable[Recorded]) -> dict[str, Testimony]:
    """What each device said, by lower-case address."""
    by_signer: dict[str, list[_Link]] = defaultdict(list)
    for one in statements:
        link = _link(one)
        if link is not None:
            by_signer[one.attestation.signer.lower()].append(link)
    return {address: _testimony(address, links) for address, links in by_signer.items()}


class _Link(NamedTuple):
    seq: int
    previous: str | None
    digest: str
    log_s: float
    data: bytes
    """Not the statement: as objects what anybody says in a device's name would take a gigabyte."""


def _link(one: Recorded) -> _Link | None:
    payload = one.attestation.payload
    seq, previous = payload.get("seq"), payload.get("previous")
    if type(seq) is not int or not isinstance(previous, str | None):
        return None
    try:
        return _Link(seq, previous, payload_digest(payload), one.log_s, one.data)
    except BadAttestation:
        return None


def _said(link: _Link) -> Said | None:
    try:
        return Said(parse(_attestation(link).payload), link.digest, link.log_s)
    except (BadStatement, ValidationError):
        return None


def _testimony(address: str, links: list[_Link]) -> Testimony:
    by_number: dict[int, list[Said]] = defaultdict(list)
    for one in map(_said, _signed(links)):
        if one is not None:
            by_number[one.statement.seq].append(one)
    said: list[Said] = []
    twice: int | None = None
    for number in sorted(by_number, reverse=True):
        named = said[-1].statement.previous if said and said[-1].statement.seq == number + 1 else None
        one = max(by_number[number], key=lambda found: found.digest == named)
        if len(by_number[number]) > 1 or named not in (None, one.digest):
            twice = number
        said.append(one)
    said.reverse()
    return Testimony(address, said, twice)


_Place = tuple[int, str]
"""Number and digest of a statement."""


def _signed(links: list[_Link]) -> list[_Link]:
    """Those of one address that it signed, each once.

    Anybody may have put statements in a device's name into the recording: behind its own, beside them, or
    copies of them with another signature. So its chain is followed before anything is counted. The longest
    chains come first, and of a chain everything up to some statement is signed, which bisection finds. Chains
    without a signed statement come last, because anybody can add any number of them.
    """
    copies: dict[_Place, list[_Link]] = defaultdict(list)
    lengths: dict[_Place, int] = {}
    for link in sorted(links, key=lambda one: one.seq):
        place = link.seq, link.digest
        copies[place].append(link)
        lengths[place] = 1 + lengths.get(_before(link), 0)
    signed: dict[_Place, _Link] = {}
    looked_at: set[_Place] = set()
    bad = 0
    ends = deque(sorted(lengths, key=lambda one: lengths[one], reverse=True))
    last = len(ends)
    while ends and bad < MAX_BAD_SIGNATURES:
        end, last = ends.popleft(), last - 1
        chain: list[_Place] = []
        place = end
        while place in lengths and place not in looked_at:
            chain.append(place)
            place = _before(copies[place][0])
        if last >= 0 and chain and place in looked_at and place not in signed:
            ends.append(end)
            continue
        looked_at.update(chain)
        first, until, at = 0, len(chain), 0
        while first < until:
            genuine = False
            for copy in copies[chain[at]][: max(MAX_BAD_SIGNATURES - bad, 1)]:
                genuine = _genuine(copy)
                bad += not genuine
                if genuine:
                    break
            first, until = (first, at) if genuine else (at + 1, until)
            at = (first + until) // 2
        signed |= {one: copies[one][0] for one in chain[first:]}
    return list(signed.values())


def _before(link: _Link) -> _Place:
    return link.seq - 1, link.previous or ""


def _genuine(link: _Link) -> bool:
    try:
        verify_attestation(_attestation(link))
    except BadAttestation:
        return False
    return True


def _attestation(link: _Link) -> Attestation:
    return Attestation.model_validate(read_json(link.data))
