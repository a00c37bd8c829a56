from __future__ import annotations

from rodeo.chain.reputation import Work, is_own

IEC = 10**18
DAY_S = 86_400
ALICE, BOB = "0x" + "a1" * 20, "0x" + "b0" * 20


def test_work_counts_half_after_ninety_days() -> None:
    work = Work().plus(80 * IEC, True, 0, ALICE).plus(40 * IEC, False, 0)
    assert work.at(90 * DAY_S) == Work(40 * 10**9, 20 * 10**9, 90)


def test_it_does_not_matter_how_often_decay_is_computed() -> None:
    often = Work().plus(80 * IEC, True, 0)
    for day in range(0, 400, 7):
        often = often.at(day * DAY_S)
    assert abs(often.at(400 * DAY_S).done - Work(80 * 10**9, 0, 0).at(400 * DAY_S).done) < 60


def test_a_newcomer_has_half_and_much_work_never_a_whole() -> None:
    assert Work().reputation(10**9) == 32
    assert Work().plus(10**40, True, 0).plus(10**40, True, 0).reputation(0) == 63


def test_less_than_a_unit_changes_nothing() -> None:
    assert Work(1, 2, 3).plus(10**9 - 1, True, 100 * DAY_S) == Work(1, 2, 3)


def test_the_first_attempt_of_a_day_for_a_creator_counts_and_those_behind_it_do_not() -> None:
    once = Work().plus(80 * IEC, True, 0, ALICE)
    assert once.plus(80 * IEC, True, DAY_S - 1, ALICE) == once.plus(80 * IEC, False, 0, ALICE) == once
    assert once.plus(80 * IEC, True, DAY_S, ALICE).done > 150 * 10**9
    between = once.plus(80 * IEC, True, 0, BOB)
    assert between.plus(80 * IEC, True, 0, ALICE).done == 240 * 10**9


def test_all_work_for_the_organization_counts_and_is_not_in_the_row() -> None:
    twice = Work().plus(80 * IEC, True, 0, ALICE).plus(80 * IEC, True, 0).plus(80 * IEC, True, 0)
    assert twice.done == 240 * 10**9
    assert twice.plus(80 * IEC, True, 0, ALICE) == twice
    tomorrow = twice.plus(80 * IEC, True, DAY_S)
    assert tomorrow.plus(80 * IEC, True, DAY_S, ALICE) != tomorrow


def test_who_has_the_same_owner_works_for_itself() -> None:
    owners = {"robot": "owner", "other": "owner"}
    assert is_own("robot", "robot", {}, "robot") and not is_own("robot", "other", {}, "other")
    assert is_own("robot", "owner", owners, "owner") and is_own("owner", "robot", owners, "robot")
    assert is_own("robot", "other", owners, "other") and not is_own("stranger", "robot", owners, "robot")


def test_whose_earnings_go_back_to_who_pays_works_for_itself() -> None:
    owners = {"robot": "owner"}
    assert is_own("safe", "provider", {}, "safe") and not is_own("creator", "provider", {}, "safe")
    assert is_own("robot", "provider", owners, "owner") and not is_own("robot", "provider", owners, "robot")
