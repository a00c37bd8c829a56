"""The story of a dispute, from its first ruling to the last stake."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent, Ruling, Standing
from rodeo.bus.queries import Organization, Wallet
from rodeo.display.story import story
from rodeo.judging.rulings import can_only_lose
from rodeo_testing import answers

ORGANIZATION, ROBOT, STRANGER, ANNA, KEY = ("0x" + digit * 40 for digit in "12347")
ORACLES, DISPUTES = "0x" + "5" * 40, "0x" + "6" * 40


def told(*events: DaoEvent) -> list[str]:
    return [f"{one.attempt}: {one.text}" for one in story(events, organization(), [wallet()])]


def organization() -> Organization:
    """Two oracles, and one judge of challenges."""
    judges = {
        name: {"seat": seat, "key": key, "name": name, "owner": key, "owner_name": None}
        for name, seat, key in (("olga", 0, STRANGER), ("otto", 3, STRANGER), ("anna", 1, ANNA))
    }
    contracts = answers.CONTRACTS | {"OracleCommittee": ORACLES, "DisputeCommittee": DISPUTES}
    committee = {"name": "DisputeCommittee", "judges": [judges["anna"]], "kinds": []}
    said = {"address": ORGANIZATION, "judges": [judges["olga"], judges["otto"]], "committees": [committee]}
    said["roles"] = {"OPERATOR_ROLE": [{"address": KEY, "name": "organization"}]}
    return Organization.model_validate(answers.organization() | said | {"contracts": contracts})


def wallet() -> Wallet:
    amounts = {"balance_iec": "0", "owed_iec": "0"}
    return Wallet.model_validate(
        {"name": "panther1", "address": ROBOT, "payout": None, "payout_name": None} | amounts
    )


def event(seq: int, name: str, tx: str = "0x1", **args: Any) -> DaoEvent:
    return DaoEvent(
        seq=seq,
        name=name,
        block=seq,
        log_index=0,
        tx_hash=tx,
        time_s=float(seq),
        task_id=1,
        args={"task_id": 1, **args},
    )


def ruled(seq: int, instance: int, ruling: str, voters: int, amount_iec: str = "0") -> list[DaoEvent]:
    said = {"attempt": 2, "ruling": ruling}
    return [
        event(seq, "InstanceRuled", f"0x{seq}", **said, instance=instance, voters=voters),
        event(seq + 1, "Ruled", f"0x{seq}", **said, amount_iec=amount_iec),
    ]


def test_each_step_is_told_with_whoever_did_it() -> None:
    assert told(
        event(1, "TaskAssigned", attempt=2),
        *ruled(2, 0, "rejected", 0b1001),
        event(4, "Challenged", instance=0, challenger=ROBOT, stake_iec="20", reason="it is in the bin"),
        *ruled(5, 1, "accepted", 0b10, "100"),
        event(7, "CaseSettled", attempt=2, voided=False),
        event(8, "StakeLost", committee=ORACLES, seat=3, amount_iec="10"),
        event(9, "StakePaid", account=ROBOT, amount_iec="20"),
        event(10, "StakePaid", account=ORGANIZATION, amount_iec="10"),
        event(11, "StakePaid", account=STRANGER.replace("3", "9"), amount_iec="1"),
    ) == [
        "2: the oracles ruled rejected: olga, otto voted for it",
        "2: panther1 challenged that with 20 IEC at stake: it is in the bin",
        "2: the judges of challenges ruled accepted, 100 IEC: anna voted for it",
        "2: the case was closed",
        "2: otto lost 10 IEC for a ruling that was overturned",
        "2: panther1 got 20 IEC of the stakes",
        "2: the treasury got 10 IEC of the stakes",
        f"2: {'0x' + '9' * 40} got 1 IEC of the stakes",
    ]


def test_the_organizations_own_key_challenges_under_its_name() -> None:
    challenged = event(3, "Challenged", instance=0, challenger=KEY, stake_iec="20", reason="no")
    (step,) = story([challenged], organization())
    assert step.who == ["organization"]


def test_what_a_reorganization_took_back_is_no_part_of_it() -> None:
    gone = event(3, "Challenged", instance=0, challenger=ROBOT, stake_iec="20", reason="no")
    assert told(gone, event(4, "EventUndone", undone_seq=3, undone_name="Challenged")) == []


def test_a_judge_that_nobody_knows_is_named_by_its_seat() -> None:
    assert told(
        *ruled(1, 0, "void", 0b10), event(3, "StakeLost", committee=ROBOT, seat=5, amount_iec="1")
    ) == [
        "2: the oracles ruled void: seat 1 voted for it",
        "2: seat 5 lost 1 IEC for a ruling that was overturned",
    ]


@pytest.mark.parametrize(
    ("ruling", "amount", "creator", "executor", "loses"),
    [
        ("rejected", "0", True, False, True),
        ("rejected", "0", False, True, False),
        ("accepted", "100", False, True, True),
        ("accepted", "99", False, True, False),
        ("accepted", "100", True, False, False),
        ("given_up", "0", True, False, False),
        ("impossible", "0", True, False, False),
        ("void", "0", False, True, False),
        ("rejected", "0", False, False, False),  # a judge
        ("accepted", "100", True, True, False),  # both sides: any other ruling is right
    ],
)
def test_a_party_that_has_all_it_can_have_can_only_lose_by_a_challenge(
    ruling: Ruling, amount: str, creator: bool, executor: bool, loses: bool
) -> None:
    standing = Standing(ruling=ruling, amount_iec=Decimal(amount), until=1.0)
    assert bool(can_only_lose(standing, Decimal(100), creator, executor)) is loses
