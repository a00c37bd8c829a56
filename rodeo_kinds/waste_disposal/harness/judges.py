"""What becomes of a proof whose judges say nothing: they are down, disagree, or were removed. Silence pays
nobody."""

from __future__ import annotations

from rodeo_kinds.waste_disposal.harness.giving_up import gives_up, kicked, waits
from rodeo_kinds.waste_disposal.harness.workshop import HARNESS, ITEM_POSE, CleaningWorkshop
from rodeo_testing.workshop import Submission, resting


def _nothing_done(shop: CleaningWorkshop) -> Submission:
    return shop.submitted(resting(shop.take, ITEM_POSE, 0))


@HARNESS.forgery("carried", role="executor", judging="silent", doubts="the oracle")
def nothing_done_while_the_oracle_is_down(shop: CleaningWorkshop) -> Submission:
    """The item lies where it lay. The executor takes the oracle off the network for its whole window."""
    return _nothing_done(shop)


@HARNESS.forgery("not_given_up", role="executor", judging="silent", doubts="the oracle")
def kicked_away_while_the_oracle_is_down(shop: CleaningWorkshop) -> Submission:
    """The robot kicks the item, says that it is not there, and nobody judges that."""
    take = waits(shop.take)
    return shop.submitted(gives_up(kicked(take, take.start_s + 9.0, 0.6), 1.0))


@HARNESS.forgery("carried", role="judge", judging="split", doubts="the quorum")
def nothing_done_before_a_quorum_that_is_split(shop: CleaningWorkshop) -> Submission:
    """Some oracles were bribed, and vote that the work was done. They are too few, and so are the others."""
    return _nothing_done(shop)


@HARNESS.forgery("carried", role="judge", judging="removed", doubts="the judge")
def nothing_done_before_a_judge_that_is_removed(shop: CleaningWorkshop) -> Submission:
    """The judge is removed before the rejection is final."""
    return _nothing_done(shop)


@HARNESS.forgery("carried", role="executor", judging="unanswered")
def a_rejection_is_challenged_before_judges_that_are_down(shop: CleaningWorkshop) -> Submission:
    """The executor challenges its rejection while those who decide about it are off."""
    return _nothing_done(shop)


@HARNESS.spoiling(role="creator", judging="unanswered")
def a_payment_is_challenged_before_judges_that_are_down(shop: CleaningWorkshop) -> Submission:
    """The creator challenges what an honest robot is paid while those who decide about it are off."""
    return shop.submitted(shop.take)


@HARNESS.ruining("accepted", role="judge", judging="silent", doubts="the oracle")
def work_that_the_oracle_never_looks_at(shop: CleaningWorkshop) -> Submission:
    """The oracle is down for its whole window after honest work. That is counted against the site."""
    return shop.submitted(shop.take)


@HARNESS.ruining("accepted", role="judge", judging="split", doubts="the quorum")
def work_that_half_of_a_quorum_withholds_its_votes_from(shop: CleaningWorkshop) -> Submission:
    """Too few oracles vote for honest work: the others are down, or do not want it paid."""
    return shop.submitted(shop.take)


@HARNESS.ruining("accepted", role="judge", judging="removed", doubts="the judge")
def work_whose_judge_is_removed(shop: CleaningWorkshop) -> Submission:
    """A guardian removes the judge after honest work was accepted and before it is paid."""
    return shop.submitted(shop.take)
