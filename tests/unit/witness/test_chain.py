"""A device's one chain: contiguous, journaled, listing the heads of others."""

from __future__ import annotations

from pathlib import Path

import pytest
from eth_account import Account

from rodeo.evidence.attestation import verify_attestation
from rodeo.evidence.errors import BadStatement, BrokenJournal
from rodeo.witness.chain import WitnessChain
from rodeo.witness.heads import TOLD, HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import MAX_HEADS, Head, Removal, Scope, parse, payload_digest

KEY = Account.create()
SCOPE = Scope(chain_id=31337, task_manager="0x" + "12" * 20, organization="0x" + "34" * 20)


def chain(path: Path) -> WitnessChain:
    return WitnessChain("itrash", KEY, SCOPE, "closed_bus", Journal(path), HeadBook())


def removal(witness: WitnessChain, time_s: float = 5.0):  # type: ignore[no-untyped-def]
    return witness.sign(Removal, time_s, compartment="blue", weight_n=0.4, after_s=1.0, settled_s=2.0)


def head(index: int, chain: str | None = None, device: str = "panther1") -> Head:
    return Head(device=device, address="0x" + "aa" * 20, chain=chain, index=index, digest="0x" + "bb" * 32)


def test_each_statement_names_the_one_before(tmp_path: Path) -> None:
    witness = chain(tmp_path / "journal")
    first, second = removal(witness), removal(witness)
    assert (first.payload["seq"], first.payload["previous"]) == (1, None)
    assert (second.payload["seq"], second.payload["previous"]) == (2, payload_digest(first.payload))
    assert verify_attestation(second) == KEY.address
    assert parse(second.payload).device == "itrash"


def test_a_chain_goes_on_after_a_restart(tmp_path: Path) -> None:
    first = removal(chain(tmp_path / "journal"))
    second = removal(chain(tmp_path / "journal"))
    assert second.payload["seq"] == 2
    assert second.payload["previous"] == payload_digest(first.payload)


def test_what_was_signed_is_given_again_byte_for_byte(tmp_path: Path) -> None:
    witness = chain(tmp_path / "journal")
    said = [removal(witness, float(number)) for number in range(5)]
    again = chain(tmp_path / "journal")
    assert again.after(2, 2) == said[2:4]
    assert again.after(0, 100) == said
    assert again.after(5, 100) == []


def test_a_line_that_a_power_cut_left_half_written_was_never_told(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    witness = chain(path)
    said = [removal(witness) for _ in range(3)]
    data = path.read_bytes()
    path.write_bytes(data[:-20])
    again = chain(path)
    assert again.after(0, 100) == said[:2]
    assert removal(again).payload["previous"] == payload_digest(said[1].payload)


def test_a_damaged_journal_is_not_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    removal(chain(path))
    path.write_bytes(b"nonsense\n")
    with pytest.raises(BrokenJournal):
        chain(path)


def test_a_statement_lists_the_newest_head_of_each_chain_once(tmp_path: Path) -> None:
    witness = chain(tmp_path / "journal")
    for one in (head(3), head(4), head(2), head(7, chain="0x" + "cc" * 32)):
        witness.heads.hear(one)
    heads = parse(removal(witness).payload).heads
    assert sorted((one.chain, one.index) for one in heads if one.chain is None) == [(None, 4)]
    assert [one.index for one in heads if one.chain is not None] == [7]
    assert [one.index for one in parse(removal(witness).payload).heads] == [4], "of a witness also afterwards"
    for _ in range(TOLD - 2):
        assert not witness.heads, "nothing new was heard"
        assert parse(removal(witness).payload).heads != ()
    assert parse(removal(witness).payload).heads == ()


def test_who_states_seldom_still_lists_the_recording_of_now() -> None:
    """A bin hears a recording for each charge, and states nothing for all of them."""
    heads = HeadBook()
    for number in range(3 * MAX_HEADS):
        heads.hear(head(7, f"0x{number:064x}", "dock1"), number)
    assert [one.chain for one in heads.take()] == [f"0x{3 * MAX_HEADS - back:064x}" for back in (1, 2)]


def test_what_fits_no_statement_is_refused_by_field(tmp_path: Path) -> None:
    payload = removal(chain(tmp_path / "journal")).payload
    for change in ({"type": "bin.wish"}, {"weight_n": "heavy"}, {"surplus": 1}, {"seq": 0}, {"version": 2}):
        with pytest.raises(BadStatement):
            parse(payload | change)
