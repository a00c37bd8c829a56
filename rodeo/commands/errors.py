"""Why a command is refused before it costs anything.

RequestError
├── UnknownKind           the organization does not accept this kind of work
├── UnknownTask
├── UnknownService
├── ProviderWithoutService
├── CannotDo              the participant has nothing that does this kind of work
├── AlreadyOffered        the participant has a service of this kind
├── UnknownParticipant
├── NotAJudge             the judge judges no kind of work, nobody made it one, or others judge this
├── InvalidQuorum         the votes are not more than half of a panel of a kind's judges
├── InsufficientFunds     the wallet has less than the command needs
├── RewardBelowPrice      every service on offer costs more
├── DailyLimitReached     the wallet has reached its daily spending limit
├── AssignmentChanged     the proof is for an assignment that the task does not have any more
├── NoVotes               an administrator decides here, and members do not vote
├── HasToBeProposed       the administrator is a timelock, which does nothing at once
├── ActsAtOnce            the administrator's key proposes nothing
├── MembersDecide         no key alone may do this where members decide
├── UnknownProposal
├── AlreadyProposed       the account has proposed the same calls with the same words
├── UnexpectedProposalState  its delay runs, or it was executed or cancelled
├── UnknownBudgetVote
├── UnexpectedBudgetVoteState  members vote still, or no more
├── NotARecipient         nobody can vote for this account, or pay it its share
├── NoCredits             the account was no member before the budget vote was opened, or is none now
├── TooFewCredits         these votes cost more than a member has
├── NothingToPay          the recipient got no votes, or was paid its share
├── KindWithoutQuorum     nobody said how many oracles have to agree about this kind
├── NoDispute             no ruling stands that can be challenged
├── AnotherRuling         the challenge was meant for another ruling, or another stake
├── CanOnlyLose           no decision about this challenge would be better for the challenger
├── CannotSign            the participant signs nothing for others to send
├── NoPermit              the payment token takes no signed permits
├── NotSigned             the request to be sent for somebody lacks a signature
└── OtherContracts        it was signed for other contracts or another chain
"""

from __future__ import annotations

from rodeo.errors import RequestError


class UnknownKind(RequestError):
    """The organization does not accept this kind of work."""


class UnknownTask(RequestError):
    """No such task was ever registered."""


class KindWithoutChecks(RequestError):
    """The oracle has no checks for this kind: people judge it."""


class KindWithoutRules(RequestError):
    """An oracle judges by rules that everybody can name."""


class RulesNotCurrent(RequestError):
    """No task of this kind is posted under these rules; `details["current"]` are those that may be named."""


class UnknownService(RequestError):
    """No such service was ever registered."""


class ProviderWithoutService(RequestError):
    """A task names a provider that offers no work of its kind."""


class CannotDo(RequestError):
    """The participant has nothing that does this kind of work: its service would let every task pass."""


class AlreadyOffered(RequestError):
    """The participant has a service of this kind, which can be changed."""


class UnknownParticipant(RequestError):
    """Neither a participant of this site nor an address."""


class NotAJudge(RequestError):
    """The committee's judge judges no kind of work, or the participant is no judge, or the task has another
    sort of judge."""


class StakeTooLow(RequestError):
    """A judge has not deposited what its vote needs."""


class KindWithoutQuorum(RequestError):
    """Several oracles judge in this organization, and nobody said how many have to agree about this kind."""


class InvalidQuorum(RequestError):
    """The votes of a kind are more than half of its panel, which has at most as many judges as the kind."""


class InsufficientFunds(RequestError):
    """The wallet has less than the command needs."""


class RewardBelowPrice(RequestError):
    """Every service of this kind costs more than the reward."""


class DailyLimitReached(RequestError):
    """The wallet has spent what its limits allow in a day."""


class CannotRaise(RequestError):
    """The reward of this task cannot be raised by this participant, now or to this amount."""


class AssignmentChanged(RequestError):
    """The task is not assigned as it was when the work was done: another nonce binds another proof."""


class NoVotes(RequestError):
    """This organization has an administrator, and its members do not vote."""


class HasToBeProposed(RequestError):
    """The organization's administrator is a timelock: it does this after a proposal and a delay, and no key
    does it at once."""


class ActsAtOnce(RequestError):
    """The key that administers this organization acts at once, and proposes nothing."""


class MembersDecide(RequestError):
    """The members decide in this organization: no key alone may do this."""


class UnknownProposal(RequestError):
    """No such proposal was ever made."""


class AlreadyProposed(RequestError):
    """Members vote on the same calls with the same words of the same member once only."""


class UnexpectedProposalState(RequestError):
    """The delay of the administrator's proposal runs, or it was executed or cancelled before."""


class UnknownBudgetVote(RequestError):
    """No such budget vote was ever opened."""


class UnexpectedBudgetVoteState(RequestError):
    """Members vote until the end of a budget vote, and shares are paid from then on."""


class NotARecipient(RequestError):
    """The account gets no share of this budget vote, or can get none."""


class NoCredits(RequestError):
    """An account that was no member before the budget vote was opened, or is none any more, has no credits
    in it."""


class TooFewCredits(RequestError):
    """The squares of the votes add up to more credits than a member has."""


class NothingToPay(RequestError):
    """The recipient got no votes, or was paid its share."""


class NoDispute(RequestError):
    """No ruling stands that can be challenged."""


class AnotherRuling(RequestError):
    """The ruling that stands, or the stake that a challenge of it takes, is not what was agreed to."""


class CanOnlyLose(RequestError):
    """No decision about the challenge would be better for the challenger than the ruling, so that its stake
    would be lost."""


class CannotSign(RequestError):
    """The participant's wallet signs nothing for others to send."""


class NoPermit(RequestError):
    """The payment token takes no signed permits (ERC-2612): its owner approves the contracts by itself."""


class NotSigned(RequestError):
    """A request to be sent for somebody lacks a signature, or has one that cannot be one."""


class OtherContracts(RequestError):
    """What somebody signed is for other contracts, or for another chain."""
