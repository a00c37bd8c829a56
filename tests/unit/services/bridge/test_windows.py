"""With which execution windows and grace period a kind is allowed."""

from __future__ import annotations

from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import ValidationError

from rodeo.chain.contracts.abi import Windows
from rodeo.commands.organization import AllowKind
from rodeo.errors import InvalidRequest
from rodeo.kinds import MAX_WINDOW_S, PEOPLES_MIN_WINDOW_S, VERDICT_WINDOWS_S
from rodeo.money.currency import IEC

ON_CHAIN = {
    "min_window_s": 600,
    "max_window_s": 7200,
    "grace_s": 180,
    "min_verdict_window_s": 900,
    "max_verdict_window_s": 9000,
    "audit_window_s": 60,
    "reference_price": 70 * 10**18,
}
JUDGED = 900, 9000, 60
"""The verdict and audit windows that are on chain."""
FIRST = (*VERDICT_WINDOWS_S, 0)
DECLARED = SimpleNamespace(windows_s=(900, 3600), grace_period_s=240, reference_price_iec=Decimal(80))


def windows(
    there: dict[str, int] | None = None, declared: Any = None, **said: Any
) -> list[tuple[str, Windows, int]]:
    """What `setWindows` is called with, if at all, where the chain has `there`."""
    calls: Any = SimpleNamespace(set_windows=lambda *given: given)
    desk: Any = SimpleNamespace(
        index=SimpleNamespace(rules=SimpleNamespace(kind=lambda _kind: there)),
        kinds=SimpleNamespace(get=lambda _kind: declared),
        client=SimpleNamespace(organization_calls=calls),
        currency=IEC,
    )
    command = AllowKind.model_validate({"kind": "dusting", "judge": "auditor", **said})
    return command._windows(desk)  # type: ignore[return-value]


def test_a_kind_gets_the_windows_that_it_declares_and_keeps_them() -> None:
    assert windows(declared=DECLARED) == [("dusting", Windows(900, 3600, 240, *FIRST), 80 * 10**18)]
    assert windows(ON_CHAIN, DECLARED) == []
    assert windows(None, judge=None, allowed=False) == []


def test_people_may_accept_for_long_where_nobody_declares_a_kind() -> None:
    people = Windows(PEOPLES_MIN_WINDOW_S, MAX_WINDOW_S, PEOPLES_MIN_WINDOW_S // 2, *FIRST)
    assert windows() == [("dusting", people, 100 * 10**18)]


def test_what_is_left_out_stays_as_it_is() -> None:
    assert windows(ON_CHAIN, max_window_s=9000) == [
        ("dusting", Windows(600, 9000, 180, *JUDGED), 70 * 10**18)
    ]
    assert windows(ON_CHAIN, grace_s=60) == [("dusting", Windows(600, 7200, 60, *JUDGED), 70 * 10**18)]
    verdicts = {"min_verdict_window_s": 1200, "max_verdict_window_s": 2400}
    assert windows(ON_CHAIN, **verdicts, audit_window_s=0) == (
        [("dusting", Windows(600, 7200, 180, 1200, 2400, 0), 70 * 10**18)]
    )


def test_the_reference_price_changes_alone_and_is_declared_or_named() -> None:
    assert windows(ON_CHAIN, reference_price_iec="45.5") == [
        ("dusting", Windows(600, 7200, 180, *JUDGED), 455 * 10**17)
    ]
    assert windows(declared=DECLARED, reference_price_iec="45") == [
        ("dusting", Windows(900, 3600, 240, *FIRST), 45 * 10**18)
    ]
    with pytest.raises(ValidationError):
        windows(ON_CHAIN, reference_price_iec="0")  # nobody would have a record


def test_a_grace_period_that_nobody_named_gives_way_to_a_short_window() -> None:
    assert windows(ON_CHAIN, min_window_s=120) == [("dusting", Windows(120, 7200, 60, *JUDGED), 70 * 10**18)]
    assert windows(ON_CHAIN, min_window_s=90) == [("dusting", Windows(90, 7200, 40, *JUDGED), 70 * 10**18)]
    with pytest.raises(InvalidRequest) as refused:
        windows(ON_CHAIN, min_window_s=120, grace_s=180)
    assert refused.value.details == {"grace_s": 180, "min_window_s": 120}


def test_the_shortest_window_is_no_longer_than_the_longest() -> None:
    with pytest.raises(InvalidRequest) as refused:
        windows(ON_CHAIN, min_window_s=8000)
    assert refused.value.details == {"min_window_s": 8000, "max_window_s": 7200}
