"""Which statements of a recording count: those of the device's own chain, whatever stands beside them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.checks.signed import statements as module
from rodeo.checks.signed.statements import MAX_BAD_SIGNATURES, Recorded
from rodeo.evidence.attestation import Attestation, attest
from rodeo.witness.statement import Removal, Scope, payload_digest

MOCAP = Account.from_key("0x" + "11" * 32)
STRANGER = Account.from_key("0x" + "22" * 32)
SCOPE = Scope(chain_id=31337, task_manager="0x" + "12" * 20, organization="0x" + "34" * 20)
OWN = 40


def said(number: int, previous: Attestation | None, weight_n: float = 0.4) -> Removal:
    return Removal(
        **SCOPE.model_dump(),
        device="mocap",
        seq=number,
        previous=None if previous is None else payload_digest(previous.payload),
        time_s=100.0 + number,
        inputs="sensor",
        compartment="blue",
        weight_n=weight_n,
        after_s=98.0 + number,
        settled_s=99.0 + number,
    )


def signed(statement: Removal, signer: LocalAccount = MOCAP) -> Attestation:
    """In the device's name, whoever signs it."""
    made = attest(statement.model_dump(mode="json"), signer)
    return made.model_copy(update={"signer": MOCAP.address})


def chain(
    count: int, after: Attestation | None = None, signer: LocalAccount = MOCAP, **more: float
) -> list[Attestation]:
    first = 1 if after is None else int(after.payload["seq"]) + 1
    links: list[Attestation] = []
    for number in range(first, first + count):
        after = signed(said(number, after, **more), signer)
        links.append(after)
    return links


def read(attestations: Iterable[Attestation]) -> module.Testimony:
    recorded = [Recorded(one, 500.0, one.model_dump_json().encode()) for one in attestations]
    return module.testimonies(recorded)[MOCAP.address.lower()]


def numbers(testimony: module.Testimony) -> list[int]:
    return [one.statement.seq for one in testimony.said]


forged = partial(chain, signer=STRANGER)
FORGERIES = {
    "later numbers that hang on nothing": lambda own: [
        signed(said(1000 + number, None), STRANGER) for number in range(300)
    ],
    "a chain of their own that is longer": lambda own: forged(300),
    "a chain that continues the device's": lambda own: forged(300, after=own[-1]),
    "many that go on with its last statement": lambda own: [
        link for number in range(300) for link in forged(1, after=own[-1], weight_n=1.0 + number)
    ],
    "another one beside each of its statements": lambda own: [
        link
        for before in own
        for number in range(8)
        for link in forged(1, after=before, weight_n=1.0 + number)
    ],
    "many that go on with a longer chain of their own": lambda own: [
        *(trunk := forged(OWN + 5)),
        *(link for number in range(300) for link in forged(1, after=trunk[-1], weight_n=1.0 + number)),
    ],
    "copies of its statements with another signature": lambda own: [
        one.model_copy(update={"signature": "0x" + f"{number:02x}" * 65})
        for one in own
        for number in range(4)
    ],
}


@pytest.mark.long
@pytest.mark.parametrize("forgery", FORGERIES)
@pytest.mark.parametrize("behind", [False, True])
def test_statements_in_a_devices_name_drop_none_of_its_own(forgery: str, behind: bool) -> None:
    own = chain(OWN)
    others = FORGERIES[forgery](own)
    testimony = read([*own, *others] if behind else [*others, *own])
    assert numbers(testimony) == list(range(1, OWN + 1))
    assert testimony.twice is None


def test_parts_of_a_chain_count_where_statements_between_them_were_left_out() -> None:
    own = chain(OWN)
    kept = [*own[:10], *own[20:]]
    testimony = read([*(signed(said(1000 + number, None), STRANGER) for number in range(300)), *kept])
    assert numbers(testimony) == [*range(1, 11), *range(21, OWN + 1)]


def test_one_number_signed_twice_is_found() -> None:
    own = chain(OWN)
    testimony = read([*own, *chain(1, after=own[18], weight_n=2.0)])
    assert testimony.twice == 20
    assert numbers(testimony) == list(range(1, OWN + 1))
    # The other chain continues behind it, and the first one's statement is not there.
    fork = chain(OWN - 20, after=chain(1, after=own[18], weight_n=2.0)[0])
    assert read([*own[:20], *fork]).twice == 20


def test_a_genuine_signature_vouches_for_those_before_it_only() -> None:
    own = chain(5)
    broken = [one.model_copy(update={"signature": "0x" + "ab" * 65}) for one in own]
    assert numbers(read([*broken[:4], own[4]])) == [1, 2, 3, 4, 5]
    assert numbers(read([*own[:3], *broken[3:]])) == [1, 2, 3]


def test_signatures_that_are_no_good_are_looked_at_so_often_only(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at: list[bytes] = []

    def count(link: module._Link, genuine: object = module._genuine) -> bool:
        looked_at.append(link.data)
        return bool(genuine(link))  # type: ignore[operator]

    monkeypatch.setattr(module, "_genuine", count)
    alone = [signed(said(1000 + 2 * number, None), STRANGER) for number in range(600)]
    copies = [signed(said(1, None, 1.0 + number), STRANGER) for number in range(600)]
    read([*chain(OWN), *alone, *copies])
    assert len(looked_at) <= MAX_BAD_SIGNATURES + OWN
