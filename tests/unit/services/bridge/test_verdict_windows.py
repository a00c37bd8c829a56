"""What the bridge refuses to be told about the windows of a kind."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from services.bridge.commands import Wallet
from services.bridge.errors import VerdictWindowTooShort

CASE_S = 2100
KIND = "waste_disposal"


def told(disputes: str | None, longest_s: int, shortest_s: int) -> list[str]:
    """The calls that set the shortest verdict window of a kind."""

    def named(name: str) -> Any:
        return lambda *_: SimpleNamespace(name=name)

    fake: Any = SimpleNamespace
    client = fake(
        disputes=disputes,
        longest_case=lambda kind: longest_s if kind == KIND else 0,
        organization_calls=fake(
            set_verdict_windows=named("setVerdictWindows"), allow_kind=named("allowKind")
        ),
    )
    index = fake(rules=lambda *_: {})
    kinds = fake(by_people=lambda _: False)
    wallet = Wallet("organization", client, fake(), index, fake(), fake(), fake(), kinds)
    command, build = wallet._parse(
        "allow_kind",
        {
            "kind": KIND,
            "review": "oracle",
            "rules_sha256": "0x" + "01" * 32,
            "min_verdict_window_s": shortest_s,
            "max_verdict_window_s": 86_400,
        },
    )
    return [call.name for call in build(wallet, command)]


def test_no_window_is_so_short_that_nobody_can_challenge_the_verdict() -> None:
    with pytest.raises(VerdictWindowTooShort) as refused:
        told("0xd15", CASE_S, CASE_S)
    assert refused.value.details == {
        "kind": KIND,
        "min_verdict_window_s": CASE_S,
        "longest_case_s": CASE_S,
    }
    assert told("0xd15", CASE_S, CASE_S + 1) == ["setVerdictWindows", "allowKind"]


@pytest.mark.parametrize("disputes", [None, "0xd15"])
def test_where_nothing_is_challenged_any_window_will_do(disputes: str | None) -> None:
    assert told(disputes, 0, 60) == ["setVerdictWindows", "allowKind"]
