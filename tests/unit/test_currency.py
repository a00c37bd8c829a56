"""Tokens with other decimals than IECoin."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import pytest
from eth_abi import encode
from eth_utils import function_signature_to_4byte_selector

from rodeo.chain.node.translation import decode_revert
from rodeo.chain.reputation import Work
from rodeo.money.currency import IEC, Currency, InvalidAmount

DOLLAR = Currency(6)


@pytest.mark.parametrize(
    ("amount", "units"), [("0", 0), ("0.000001", 1), ("12.5", 12_500_000), ("1000000000.000001", 10**15 + 1)]
)
def test_amounts_survive_both_ways(amount: str, units: int) -> None:
    assert DOLLAR.to_units(Decimal(amount)) == units
    assert DOLLAR.text(units) == amount


@pytest.mark.parametrize(
    "amount", ["1E-7", "1.2345678", f"{10**60}.{'0' * 100}1", "1E-999999999999"], ids=lambda text: text[:12]
)
def test_what_is_finer_than_the_token_is_refused(amount: str) -> None:
    with pytest.raises(InvalidAmount) as refused:
        DOLLAR.to_units(Decimal(amount))
    assert refused.value.details == {"amount": amount, "decimals": 6}


@pytest.mark.parametrize("amount", ["9" * 72, "9" * 200, "1E+999999999999"], ids=lambda text: text[:12])
def test_what_no_contract_can_count_is_refused_and_not_rounded(amount: str) -> None:
    with pytest.raises(InvalidAmount, match="count") as refused:
        DOLLAR.to_units(Decimal(amount))
    assert refused.value.details == {"amount": amount}


@pytest.mark.parametrize(
    ("amount", "units"),
    [("9" * 71 + ".999999", 10**77 - 1), ("1." + "0" * 200, 10**6), ("0E+999999999999", 0)],
    ids=lambda value: str(value)[:12],
)
def test_many_digits_are_kept(amount: str, units: int) -> None:
    assert DOLLAR.to_units(Decimal(amount)) == units


@pytest.mark.parametrize(
    ("due", "paid"), [("1/3", "0.333333"), ("5/2", "2.5"), ("1/10000000", "0.000001"), ("0", "0")]
)
def test_a_payment_by_quantity_is_rounded_down_but_never_to_nothing(due: str, paid: str) -> None:
    assert DOLLAR.payable(Fraction(due)) == Decimal(paid)


@pytest.mark.parametrize(("decimals", "unit"), [(2, 1), (6, 1), (9, 1), (10, 10), (18, 10**9)])
def test_prices_are_multiples_of_a_billionth_or_of_the_smallest_unit(decimals: int, unit: int) -> None:
    assert Currency(decimals).price_unit == unit


@pytest.mark.parametrize(
    ("price", "reward"),
    [
        ("0", "0"),
        ("100", "100"),
        ("99.71", "99.8"),
        ("1001", "1010"),
        ("999.000000001", "1000"),
        ("0.000000999", "0.000000999"),
        ("0.000001001", "0.00000101"),
    ],
)
def test_three_digits_of_a_price_count_for_who_names_nobody(price: str, reward: str) -> None:
    assert IEC.reward_for(IEC.to_units(Decimal(price))) == IEC.to_units(Decimal(reward))
    assert DOLLAR.reward_for(DOLLAR.to_units(Decimal("12.345"))) == DOLLAR.to_units(Decimal("12.4"))


@pytest.mark.parametrize("decimals", [2, 6, 9, 18])
def test_the_same_work_makes_the_same_name_in_each_token(decimals: int) -> None:
    currency = Currency(decimals)
    work = Work().plus(currency.to_units(Decimal(30)), True, 0, currency=currency)
    assert (work.reputation(0, currency), Work().reputation(0, currency)) == (36, 32)


def test_what_a_contract_refuses_is_told_in_its_token() -> None:
    data = function_signature_to_4byte_selector("BondTooHigh(uint256,uint256)")
    data += encode(["uint256", "uint256"], [2_500_000, 1])
    assert decode_revert(data, DOLLAR).details["bond_iec"] == "2.5"
    assert decode_revert(data, IEC).details["bond_iec"] == "0.0000000000025"
