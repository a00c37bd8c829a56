"""Odd values end with a named outcome, and nobody is paid for words that nobody signed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rodeo.evidence.seal import RunningHash
from rodeo.evidence.tally import Tally
from rodeo.site.config import Site
from tests.forgeries.catalogue import Shops
from tests.forgeries.fuzz import fuzzed
from tests.support.site import LAB

pytestmark = pytest.mark.long

SEEDS = 300
AT_ONCE = 30


@pytest.fixture(scope="module")
def shops(tmp_path_factory: pytest.TempPathFactory) -> Shops:
    return Shops(Site.load(LAB), tmp_path_factory.mktemp("fuzzed"))


@pytest.mark.parametrize("first", range(0, SEEDS, AT_ONCE))
def test_odd_values_end_with_a_named_outcome(shops: Shops, first: int) -> None:
    for number in range(first, first + AT_ONCE):
        drawn = fuzzed(f"test:{number}")
        if (wrong := drawn.wrong(shops)) is not None:
            pytest.fail(f"seed {number} {wrong}: {drawn.minimized(shops).words}")


def test_a_seed_stands_for_the_same_changes() -> None:
    seeds = [f"test:{number}" for number in range(100)]
    assert [fuzzed(seed).words for seed in seeds] == [fuzzed(seed).words for seed in seeds]
    assert len({fuzzed(seed).words for seed in seeds}) > 90


def test_a_statement_that_is_left_out_shifts_no_other(shops: Shops) -> None:
    drawn = fuzzed("6ce8bd95a1937f874db23262a09f03a82dc70cf0:215")
    assert [change.words[:22] for change in drawn.changes] == [
        "an odd statement 8 (36",
        "an odd statement 29 (2",
        "an odd statement 8 (40",
    ]
    assert drawn.wrong(shops) is None


def test_what_raises_unforeseen_is_found_and_minimized(shops: Shops, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_sequences: object) -> Tally:
        raise ZeroDivisionError

    drawn = next(one for one in map(fuzzed, map(str, range(100))) if len(one.changes) == 3)
    harmless = replace(drawn, changes=(replace(drawn.changes[0], apply=lambda _run: None),) * 3)
    assert harmless.wrong(shops) is None
    monkeypatch.setattr(Tally, "of", broken)
    wrong = harmless.wrong(shops)
    assert wrong is not None
    assert "raised unforeseen: tallied could not be computed: ZeroDivisionError" in wrong


def test_a_changed_file_that_is_accepted_is_found(shops: Shops, monkeypatch: pytest.MonkeyPatch) -> None:
    """The running hash covers nothing."""
    seeds = map(fuzzed, map(str, range(1000)))
    drawn = next(one for one in seeds if len(one.changes) == 1 and "a publish time" in one.words)
    assert drawn.wrong(shops) is None
    monkeypatch.setattr(RunningHash, "hexdigest", lambda _self: "00" * 32)
    assert drawn.wrong(shops) == "was accepted although the sealed file was changed"
