"""Amounts and kinds between Python and the chain."""

from __future__ import annotations

from decimal import Decimal

import pytest

from rodeo.chain.contracts.types import bytes32_to_kind, kind_to_bytes32
from rodeo.money.currency import IEC


@pytest.mark.parametrize(
    ("iec", "wei"),
    [
        ("0", 0),
        ("100", 100 * 10**18),
        ("0.000000000000000001", 1),
        ("123456789012345678901.000000000000000001", 123456789012345678901 * 10**18 + 1),
    ],
)
def test_amounts_survive_both_ways(iec: str, wei: int) -> None:
    assert IEC.to_units(Decimal(iec)) == wei
    assert f"{IEC.from_units(wei):f}" == iec


@pytest.mark.parametrize("iec", ["-1", "NaN", "Infinity", "0.0000000000000000001"])
def test_what_is_no_amount_is_refused(iec: str) -> None:
    with pytest.raises(ValueError, match=iec if iec != "0.0000000000000000001" else "18 decimals"):
        IEC.to_units(Decimal(iec))


def test_a_kind_survives_both_ways() -> None:
    assert bytes32_to_kind(kind_to_bytes32("waste_disposal")) == "waste_disposal"


@pytest.mark.parametrize("kind", ["", "x" * 33, "ämter"])
def test_a_kind_that_does_not_fit_is_refused(kind: str) -> None:
    with pytest.raises(ValueError):
        kind_to_bytes32(kind)


def test_bytes_that_are_no_text_stay_hex() -> None:
    assert bytes32_to_kind(b"\xff" * 32) == "0x" + "ff" * 32
