"""What was done is paid for once."""

from __future__ import annotations

from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.checks.acts import Act, ConsumedActs, MalformedAct, Spent, Wait, acts_unspent

DROP = "bin/itrash/drop/7"
STORE = "file:///store"


def overlap(one: str, other: str) -> bool:
    found = Act.parse(one).overlaps(Act.parse(other))
    assert Act.parse(other).overlaps(Act.parse(one)) is found
    return found


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (DROP, DROP, True),
        (DROP, "bin/itrash/drop/8", False),
        (DROP, "bin/other/drop/7", False),
        ("mocap/item3/120-180", "mocap/item3/180-200", True),
        ("mocap/item3/120-180", "mocap/item3/181-200", False),
        ("mocap/item3/120-180", "mocap/item3/150", True),
        ("mocap/item3/120-180", "mocap/item4/120-180", False),
        ("meter/dock1/register/1000.0-1200.0", "meter/dock1/register/1200.0-1300.0", False),
        ("meter/dock1/register/1000.0-1200.0", "meter/dock1/register/1199.9-1300.0", True),
        ("meter/dock1/register/1000.0-1200.0", "meter/dock1/register/1100.0-1150.0", True),
        ("meter/dock1/register/9007199254740993.5-9007199254740994.0",
         "meter/dock1/register/9007199254740992.5-9007199254740993.5", False),
    ],
)  # fmt: skip
def test_acts_of_the_same_thing_overlap_where_their_numbers_do(one: str, other: str, same: bool) -> None:
    assert overlap(one, other) is same


@pytest.mark.parametrize(
    "text",
    ["", "7", "bin/itrash/drop/", "bin/itrash/drop/x", "mocap/item3/9-3", "a b/1", "/1", "x/-5", "x/nan",
     "x/1e9", "x/1-2-3", "x/" + "9" * 400],
)  # fmt: skip
def test_what_is_no_act_is_an_error(text: str) -> None:
    with pytest.raises(MalformedAct):
        Act.parse(text)


class Chain:
    """Events as the index tells them, with the reports that rulings name."""

    def __init__(self, kind: str = "waste_disposal") -> None:
        self.acts = ConsumedActs()
        self.kind = kind
        self.told: list[DaoEvent] = []
        self._reports: dict[str, list[str]] = {}

    def event(self, name: str, task_id: int, **args: Any) -> DaoEvent:
        seq = len(self.told) + 1
        event = DaoEvent(
            seq=seq, name=name, block=seq, log_index=0, tx_hash="0x", time_s=0.0, task_id=task_id, args=args
        )
        self.told.append(event)
        self.acts.on_event(event)
        return event

    def submitted(self, task_id: int, attempt: int = 1, executor: str = "panther1") -> DaoEvent:
        if not any(e.name == "TaskRegistered" and e.task_id == task_id for e in self.told):
            self.event("TaskRegistered", task_id, kind=self.kind)
        return self.event("ProofSubmitted", task_id, attempt=attempt, executor=executor)

    def ruled(
        self,
        task_id: int,
        *acts: str,
        ruling: str = "accepted",
        attempt: int = 1,
        read: bool = True,
        passed_on: bool = False,
    ) -> DaoEvent:
        """A ruling that stands, with a report that lists `acts`."""
        sha256 = f"0x{len(self._reports):056x}{task_id:06x}{attempt:02x}"
        self._reports[sha256] = list(acts)
        if read:
            self.acts.read(sha256, acts)
        self.event("Reported", task_id, report_uri=f"{STORE}/{sha256[2:]}.json", reason="")
        if passed_on:
            self.event("PassedOn", task_id, attempt=attempt)
        return self.event("Ruled", task_id, attempt=attempt, ruling=ruling, report=sha256)

    def passed_on(self, task_id: int, *acts: str) -> None:
        self.ruled(task_id, *acts, ruling="void", passed_on=True)

    def accepted(self, task_id: int, *acts: str, attempt: int = 1) -> DaoEvent:
        """Accepted, and concluded."""
        self.ruled(task_id, *acts, attempt=attempt)
        return self.event("TaskSettled", task_id)

    def rejected(self, task_id: int) -> None:
        self.ruled(task_id, ruling="rejected")
        self.event("TaskRequeued", task_id)

    def silent(self, task_id: int) -> None:
        """Nobody ruled in the verdict window."""
        self.event("Ruled", task_id, attempt=1, ruling="void", report="0x" + "00" * 32)

    def undone(self, event: DaoEvent) -> None:
        assert event.task_id is not None
        self.event("EventUndone", event.task_id, **event.args, undone_seq=event.seq, undone_name=event.name)

    def rebuilt(self) -> ConsumedActs:
        """As an oracle learns it that starts now, from the events and the reports in the store."""
        acts = ConsumedActs()
        for event in self.told:
            acts.on_event(event)
        for submission in acts.unread():
            for _, sha256 in submission.reports:
                acts.read(sha256, self._reports[sha256])
        return acts


@pytest.fixture
def chain() -> Chain:
    return Chain()


def spent_by(acts: ConsumedActs, task_id: int, *claimed: str) -> int | None:
    """Task whose proof was paid for one of these, or claims it."""
    found = acts.spent(task_id, 1, claimed)
    assert not isinstance(found, Wait), found
    return found.by.task_id if found else None


def test_an_act_of_an_accepted_proof_is_spent(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, "mocap/item3/120-180", DROP)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, "mocap/item3/150-200") == 1
    assert spent_by(chain.acts, 2, "mocap/item3/190-200", DROP) == 1
    assert spent_by(chain.acts, 2, "mocap/item3/190-200", "bin/itrash/drop/8") is None


def test_what_was_spent_is_known_after_a_restart(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, DROP)
    chain.submitted(2)
    assert spent_by(chain.rebuilt(), 2, DROP) == 1


def test_events_that_an_index_tells_again_change_nothing(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, DROP)
    chain.submitted(2)
    for event in list(chain.told):
        chain.acts.on_event(event)
    assert spent_by(chain.acts, 2, DROP) == 1


def test_a_rejected_thief_burns_nothing(chain: Chain) -> None:
    chain.submitted(1)
    chain.acts.judged(1, 1, [])
    chain.rejected(1)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) is None


def test_an_earlier_attempt_at_the_same_task_counts_like_any_other(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, DROP)
    chain.submitted(1, attempt=2)
    found = chain.acts.spent(1, 2, [DROP])
    assert isinstance(found, Spent)
    assert (found.by.task_id, found.by.attempt) == (1, 1)


def test_while_the_report_of_an_accepted_verdict_is_missing_nothing_counts_as_unspent(chain: Chain) -> None:
    chain.submitted(1)
    ruled = chain.ruled(1, DROP, read=False)
    chain.event("TaskSettled", 1)
    chain.submitted(2)
    assert isinstance(chain.acts.spent(2, 1, ["bin/itrash/drop/8"]), Wait)
    assert [one.task_id for one in chain.acts.unread()] == [1]
    chain.acts.read(ruled.args["report"], [DROP])
    assert spent_by(chain.acts, 2, DROP) == 1


def test_the_later_submission_waits_for_the_verdict_of_the_earlier_one(chain: Chain) -> None:
    chain.submitted(1)
    chain.submitted(2)
    assert isinstance(chain.acts.spent(2, 1, [DROP]), Wait)
    chain.acts.judged(1, 1, [DROP])
    assert isinstance(chain.acts.spent(2, 1, [DROP]), Wait)
    chain.accepted(1, DROP)
    assert spent_by(chain.acts, 2, DROP) == 1


def test_the_earlier_submission_waits_for_nobody(chain: Chain) -> None:
    chain.submitted(1)
    chain.submitted(2)
    chain.acts.judged(2, 1, [DROP])
    assert spent_by(chain.acts, 1, DROP) is None


def test_nobody_waits_for_one_that_claims_something_else(chain: Chain) -> None:
    chain.submitted(1)
    chain.submitted(2)
    chain.acts.judged(1, 1, ["bin/itrash/drop/8"])
    assert spent_by(chain.acts, 2, DROP) is None


def test_who_is_due_waits_for_no_proof_that_others_have_in_line(chain: Chain) -> None:
    chain.submitted(1, executor="somebody with many")
    chain.submitted(2)
    chain.submitted(3)
    assert isinstance(chain.acts.spent(2, 1, [DROP]), Wait)
    assert chain.acts.spent(2, 1, [DROP], due=True) is None
    own = chain.acts.spent(3, 1, [DROP], due=True)
    assert isinstance(own, Wait) and own.on.task_id == 2
    chain.acts.judged(1, 1, [DROP])
    other = chain.acts.spent(3, 1, [DROP], due=True)
    assert isinstance(other, Wait) and other.on.task_id == 1


def test_who_was_passed_in_line_waits_for_the_verdict_that_may_pay_for_the_same_act(chain: Chain) -> None:
    chain.submitted(1, executor="somebody with many")
    chain.submitted(2)
    chain.acts.judged(2, 1, [DROP])
    assert chain.acts.spent(2, 1, [DROP], due=True) is None
    chain.acts.judged(1, 1, [DROP])
    wait = chain.acts.spent(1, 1, [DROP])
    assert isinstance(wait, Wait) and wait.on.task_id == 2
    assert chain.acts.spent(1, 1, ["bin/itrash/drop/8"]) is None
    chain.accepted(2, DROP)
    found = chain.acts.spent(1, 1, [DROP])
    assert isinstance(found, Spent)
    assert acts_unspent([DROP], found).fault == "the oracle, which decided a later submission first"


def test_who_was_passed_in_line_waits_for_no_verdict_that_does_not_come(chain: Chain) -> None:
    chain.submitted(1, executor="somebody with many")
    chain.submitted(2)
    chain.acts.judged(2, 1, [DROP])
    assert chain.acts.spent(2, 1, [DROP], due=True) is None
    chain.acts.judged(2, 1, None)
    chain.acts.judged(2, 1, [DROP])
    chain.acts.judged(1, 1, [DROP])
    assert chain.acts.spent(1, 1, [DROP]) is None


@pytest.mark.parametrize("end", ["TaskRequeued", "TaskFailed", "TaskCancelled"])
def test_nobody_waits_for_an_attempt_that_ended_without_a_verdict(chain: Chain, end: str) -> None:
    chain.submitted(1)
    chain.submitted(2)
    chain.event(end, 1)
    assert spent_by(chain.acts, 2, DROP) is None


def test_nobody_waits_for_one_that_gets_no_verdict_from_here(chain: Chain) -> None:
    chain.submitted(1)
    chain.submitted(2)
    chain.acts.judged(1, 1, None)
    assert spent_by(chain.acts, 2, DROP) is None


def test_an_act_that_a_later_submission_was_paid_for_is_told_apart(chain: Chain) -> None:
    chain.submitted(1)
    chain.submitted(2)
    chain.accepted(2, DROP)
    found = chain.acts.spent(1, 1, [DROP])
    assert isinstance(found, Spent)
    assert not found.earlier


@pytest.fixture
def undone(chain: Chain) -> Chain:
    """A concluded acceptance of task 1 was taken off the chain; somebody else claims the same in task 2."""
    chain.submitted(1, executor="one")
    ruled = chain.ruled(1, DROP)
    settled = chain.event("TaskSettled", 1)
    chain.submitted(2, executor="the other")
    chain.undone(settled)
    chain.undone(ruled)
    return chain


def test_an_acceptance_that_was_taken_off_the_chain_keeps_its_claim_until_the_attempt_loses(
    undone: Chain,
) -> None:
    """Also for an oracle that is started now, whose own verification is not there to tell."""
    for acts in (undone.acts, undone.rebuilt()):
        assert isinstance(acts.spent(2, 1, [DROP]), Wait)
    undone.rejected(1)
    for acts in (undone.acts, undone.rebuilt()):
        assert spent_by(acts, 2, DROP) is None


def test_when_due_an_acceptance_that_was_taken_off_the_chain_counts_as_spent(undone: Chain) -> None:
    found = undone.acts.spent(2, 1, [DROP], due=True)
    assert isinstance(found, Spent)
    assert found.by.task_id == 1


def test_an_acceptance_that_is_posted_again_is_spent_once(undone: Chain) -> None:
    undone.accepted(1, DROP)
    assert spent_by(undone.acts, 2, DROP) == 1


def test_the_executor_of_an_acceptance_that_was_undone_claims_nothing_again(chain: Chain) -> None:
    """The proof itself was taken off the chain, too, and does not come back at once."""
    submitted = chain.submitted(1)
    chain.undone(chain.ruled(1, DROP))
    chain.undone(submitted)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) == 1
    assert spent_by(chain.rebuilt(), 2, DROP) == 1


@pytest.mark.parametrize("end", ["TaskRequeued", "TaskFailed", "TaskCancelled"])
def test_an_undone_proof_that_never_comes_back_claims_nothing_when_its_attempt_ends(
    chain: Chain, end: str
) -> None:
    submitted = chain.submitted(1)
    chain.undone(chain.ruled(1, DROP))
    chain.undone(submitted)
    chain.event(end, 1)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) is None


def test_an_undone_task_claims_nothing(chain: Chain) -> None:
    registered = chain.event("TaskRegistered", 1, kind=chain.kind)
    submitted = chain.submitted(1)
    for event in (chain.ruled(1, DROP), submitted, registered):
        chain.undone(event)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) is None


def test_an_undone_proof_claims_nothing_once_somebody_else_makes_the_attempt(chain: Chain) -> None:
    submitted = chain.submitted(1, executor="one")
    chain.undone(chain.ruled(1, DROP))
    chain.undone(submitted)
    chain.submitted(1, executor="the other")
    assert spent_by(chain.acts, 1, DROP) is None


def test_after_a_reorganization_whoever_is_accepted_first_is_paid(chain: Chain) -> None:
    """Its executor cannot have the claim that the other proof waited for forgotten."""
    chain.submitted(1, executor="one")
    ruled = chain.ruled(1, DROP)
    chain.submitted(2, executor="the other")
    chain.undone(ruled)
    chain.accepted(2, DROP)
    assert spent_by(chain.acts, 1, DROP) == 2
    chain.ruled(1, ruling="rejected")
    assert spent_by(chain.rebuilt(), 1, DROP) == 2


def test_a_submission_that_was_taken_off_the_chain_is_waited_for_no_longer(chain: Chain) -> None:
    first = chain.submitted(1)
    chain.submitted(2)
    chain.undone(first)
    assert spent_by(chain.acts, 2, DROP) is None


@pytest.mark.parametrize(
    ("ruling", "said"),
    [
        ("accepted", "was accepted in"),
        ("rejected", "has a ruling that may be replaced in"),
        ("void", "is with auditors in"),
    ],
)
def test_an_executor_claims_nothing_again_that_one_of_its_rulings_may_pay_for(
    chain: Chain, ruling: str, said: str
) -> None:
    """Two tasks, one challenged, one concluded: also where the judges of the challenge accept it."""
    chain.submitted(1)
    chain.ruled(1, DROP, ruling=ruling, passed_on=ruling == "void")
    chain.submitted(2)
    found = chain.acts.spent(2, 1, [DROP])
    assert isinstance(found, Spent)
    check = acts_unspent([DROP], found)
    assert check.passed is False
    assert check.fault is None
    assert f"{said} task 1 attempt 1" in check.detail
    assert spent_by(chain.rebuilt(), 2, DROP) == 1
    assert spent_by(chain.acts, 2, "bin/itrash/drop/8") is None


def test_both_submitted_at_once_the_later_waits_until_the_earlier_is_passed_on(chain: Chain) -> None:
    chain.submitted(1)
    chain.submitted(2)
    chain.acts.judged(1, 1, [DROP])
    assert isinstance(chain.acts.spent(2, 1, [DROP]), Wait)
    chain.passed_on(1, DROP)
    assert spent_by(chain.acts, 2, DROP) == 1


@pytest.mark.parametrize("ruling", ["rejected", "given_up", "impossible", "void"])
def test_somebody_elses_claim_that_was_not_accepted_takes_nothing_from_who_proves_it(
    chain: Chain, ruling: str
) -> None:
    chain.submitted(1, executor="a thief")
    chain.ruled(1, DROP, ruling=ruling)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) is None


def test_somebody_elses_claim_that_was_accepted_is_waited_for_until_it_is_concluded(chain: Chain) -> None:
    chain.submitted(1, executor="a thief")
    chain.ruled(1, DROP)
    chain.submitted(2)
    wait = chain.acts.spent(2, 1, [DROP])
    assert isinstance(wait, Wait) and wait.on.task_id == 1
    # Nobody is rejected for what is not decided: who is due is for people to decide.
    found = chain.acts.spent(2, 1, [DROP], due=True)
    assert isinstance(found, Spent)
    assert acts_unspent([DROP], found).fault == "another executor, whose claim may still be rejected"
    chain.event("TaskSettled", 1)
    settled = chain.acts.spent(2, 1, [DROP])
    assert isinstance(settled, Spent) and acts_unspent([DROP], settled).fault is None


@pytest.mark.parametrize("ruling", ["rejected", "given_up", "impossible", "void"])
def test_an_acceptance_that_was_replaced_frees_what_it_claimed(chain: Chain, ruling: str) -> None:
    chain.submitted(1, executor="a thief")
    chain.ruled(1, DROP)
    chain.ruled(1, ruling=ruling)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) is None


def test_what_judges_of_a_challenge_accept_is_claimed_as_the_first_report_says(chain: Chain) -> None:
    chain.submitted(1, executor="one")
    rejected = chain.ruled(1, DROP, ruling="rejected")
    chain.event("Ruled", 1, attempt=1, ruling="accepted", report=rejected.args["report"])
    chain.event("TaskSettled", 1)
    chain.submitted(2)
    assert spent_by(chain.rebuilt(), 2, DROP) == 1


def test_an_impossible_task_settles_and_spends_nothing(chain: Chain) -> None:
    chain.submitted(1)
    chain.ruled(1, DROP, ruling="impossible")
    chain.event("TaskSettled", 1)
    chain.submitted(2)
    assert spent_by(chain.rebuilt(), 2, DROP) is None


def test_what_nobody_judged_in_time_may_be_judged_until_its_case_ends(chain: Chain) -> None:
    chain.submitted(1)
    chain.silent(1)
    assert [one.task_id for one in chain.acts.waiting()] == [1]
    chain.submitted(2)
    assert isinstance(chain.acts.spent(2, 1, [DROP]), Wait)
    chain.event("TaskFailed", 1)
    assert [one.task_id for one in chain.acts.waiting()] == [2]
    assert spent_by(chain.acts, 2, DROP) is None


def test_what_a_judge_accepted_that_was_removed_is_free_for_others(chain: Chain) -> None:
    chain.submitted(1, executor="a thief")
    chain.ruled(1, DROP)
    chain.silent(1)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) is None
    assert [one.task_id for one in chain.acts.waiting()] == [2]


@pytest.mark.parametrize("end", ["TaskRequeued", "TaskFailed"])
def test_what_auditors_refused_may_be_claimed(chain: Chain, end: str) -> None:
    chain.submitted(1)
    chain.passed_on(1, DROP)
    chain.event(end, 1)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) is None


def test_one_act_is_paid_once_whatever_the_kinds_of_the_tasks(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, DROP)
    chain.kind = "sorting"
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) == 1
    assert spent_by(chain.rebuilt(), 2, DROP) == 1


def test_a_new_chain_begins_with_nothing_spent(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, DROP)
    fresh = Chain()
    for event in (
        fresh.event("TaskRegistered", 1, kind="waste_disposal"),
        fresh.event("ProofSubmitted", 1, attempt=1, executor="panther1"),
    ):
        chain.acts.on_event(event.model_copy(update={"chain": "0xother"}))
    assert spent_by(chain.acts, 1, DROP) is None


def test_an_index_that_was_made_anew_tells_all_again_and_nothing_counts_twice(chain: Chain) -> None:
    """Without the notices of what was undone before: other events have its numbers now."""
    chain.undone(chain.submitted(1))
    chain.submitted(2)
    chain.accepted(2, DROP)
    told = [event for event in chain.told if event.task_id == 2]
    for seq, event in enumerate(told, start=1):
        chain.acts.on_event(event.model_copy(update={"seq": seq}))
    assert chain.acts.submission(1, 1) is None
    assert [one.task_id for one in chain.acts.waiting()] == []


def test_a_malformed_act_in_a_report_does_not_hide_the_others(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, "nonsense", DROP)
    chain.submitted(2)
    assert spent_by(chain.acts, 2, DROP) == 1


def again(chain: Chain) -> ConsumedActs:
    """As `Chain.rebuilt`, by an oracle that has kept what it promised."""
    acts = ConsumedActs(promised=chain.acts.promised())
    for event in chain.told:
        acts.on_event(event)
    return acts


def promised_to_later(chain: Chain) -> None:
    """Task 2 may be paid for the drop: nobody had the proof of task 1, which was submitted before."""
    chain.submitted(1)
    chain.submitted(2, executor="panther2")
    chain.acts.away(1, 1, True)
    chain.acts.judged(2, 1, [DROP])
    assert chain.acts.spent(2, 1, [DROP]) is None


def test_what_was_promised_before_a_start_is_promised_after_it(chain: Chain) -> None:
    promised_to_later(chain)
    acts = again(chain)
    acts.judged(1, 1, [DROP])
    found = acts.spent(1, 1, [DROP])
    assert isinstance(found, Wait) and found.on.task_id == 2
    assert acts.spent(2, 1, [DROP]) is None
    assert isinstance(acts.spent(1, 1, [DROP], due=True), Wait)
    late = acts.spent(1, 1, [DROP], due=True, late=True)
    assert isinstance(late, Spent)
    check = acts_unspent([DROP], late)
    assert f'"{DROP}" may be paid for in task 2' in (check.detail or "") and check.fault is not None
    acts.failed(2, 1)
    assert isinstance(acts.spent(1, 1, [DROP]), Wait)
    assert [one.task_id for one in acts.promised().promises] == [2]


def test_what_is_kept_while_events_are_still_heard_loses_no_promise(chain: Chain) -> None:
    promised_to_later(chain)
    acts = ConsumedActs(promised=chain.acts.promised())
    acts.on_event(chain.told[0])
    kept = acts.promised()
    assert [one.task_id for one in kept.promises] == [2]
    for event in chain.told[1:]:
        acts.on_event(event)
    assert acts.promised() == kept


def test_a_promise_outlives_a_reorganization_that_takes_its_proof_off_for_a_while(chain: Chain) -> None:
    chain.submitted(1)
    proof = chain.submitted(2, executor="panther2")
    chain.acts.judged(2, 1, [DROP])
    chain.acts.away(1, 1, True)
    assert chain.acts.spent(2, 1, [DROP]) is None
    chain.acts.promised()
    chain.undone(proof)
    chain.submitted(2, executor="panther2")
    for acts in (chain.acts, again(chain)):
        acts.judged(1, 1, [DROP])
        assert isinstance(acts.spent(1, 1, [DROP]), Wait)


def test_one_that_may_be_paid_and_claims_more_the_next_time_waits_for_nobody_who_waits_for_it(
    chain: Chain,
) -> None:
    """The chain's list of devices has changed between two verifications."""
    promised_to_later(chain)
    acts = again(chain)
    acts.judged(1, 1, [DROP])
    acts.judged(2, 1, [DROP, "mocap/item3/120-180"])
    assert acts.spent(2, 1, [DROP, "mocap/item3/120-180"]) is None
    assert isinstance(acts.spent(1, 1, [DROP]), Wait)


def test_a_last_word_frees_nothing_that_a_ruling_on_its_way_may_pay_for(chain: Chain) -> None:
    promised_to_later(chain)
    acts = again(chain)
    acts.judged(2, 1, [])
    acts.judged(1, 1, [DROP])
    assert isinstance(acts.spent(1, 1, [DROP]), Wait)
    chain.accepted(2, DROP)
    for event in chain.told[-3:]:
        acts.on_event(event)
    acts.read(str(chain.told[-2].args["report"]), [DROP])
    assert isinstance(acts.spent(1, 1, [DROP]), Spent)


def test_a_promise_outlives_an_end_that_is_undone(chain: Chain) -> None:
    """Its ruling lost against the window's end, and may win after a reorganization."""
    promised_to_later(chain)
    end = chain.event("TaskRequeued", 2)
    chain.acts.promised()
    chain.undone(end)
    chain.acts.judged(1, 1, [DROP])
    assert isinstance(chain.acts.spent(1, 1, [DROP]), Wait)


def test_nobody_waits_for_a_decision_that_failed_before_anything_was_promised(chain: Chain) -> None:
    chain.submitted(1)
    chain.submitted(2, executor="panther2")
    assert isinstance(chain.acts.spent(2, 1, [DROP]), Wait)
    chain.acts.failed(1, 1)
    assert chain.acts.spent(2, 1, [DROP]) is None


def test_an_index_that_is_made_anew_is_heard_before_anything_is_free(chain: Chain) -> None:
    chain.submitted(1)
    chain.accepted(1, DROP)
    chain.submitted(2)
    newest = len(chain.told)
    for event in (chain.told[0], chain.told[-1].model_copy(update={"seq": 2})):
        chain.acts.on_event(event)  # it counts from 1 again, and has told of a part
    assert chain.acts.waits(2, 1) and not chain.acts.heard(newest, 0.0)
    found = chain.acts.spent(2, 1, [DROP], newest=newest)
    assert isinstance(found, Wait) and "2 were heard" in found.why
