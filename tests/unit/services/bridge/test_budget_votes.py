"""Members split money by quadratic votes: what the bridge takes, refuses and shows, on the real contracts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.session import Request
from rodeo.chain import artifacts
from rodeo.chain.encoding import Call
from rodeo.chain.node.errors import ContractReverted
from rodeo.chain.node.translation import decode_revert
from rodeo.chain.proposals import BUDGET_CREDITS, SUPPORT, shares
from rodeo.commands.errors import (
    AlreadyProposed,
    HasToBeProposed,
    InsufficientFunds,
    NoCredits,
    NotARecipient,
    NothingToPay,
    NoVotes,
    TooFewCredits,
    UnexpectedBudgetVoteState,
    UnknownBudgetVote,
)
from rodeo.commands.governance import OpenBudgetVote
from rodeo.errors import InvalidRequest
from rodeo.signing import keystores
from rodeo.site.sections import BudgetConfig, GovernanceConfig, ParticipantConfig
from services.bridge.wallet import parse
from tests.support.office import Office
from tests.support.organization import GENESIS_S, founded

pytestmark = pytest.mark.long

DELAY_S, PERIOD_S, DURATION_S = 60, 3600, 7200
MEMBERS = ("alice", "bob", "panther1")
REPAIRS = "0x" + "4e" * 20
REPAIRS_SHOWN = "0x4E4E4E4e4E4e4e4E4e4E4E4e4E4E4E4E4e4E4e4e"
SOURCE = Path(__file__).parents[4] / "contracts/src/governance/BudgetVotes.sol"


class Members(Office):
    """Members that decide, and split money."""

    def decide(self, command: str, request: dict[str, Any]) -> None:
        # The governor takes equal calls again only with another text.
        number = self.propose(command, request, f"as of {self.now_s}", who="alice")
        self.now_s += 10
        for member in MEMBERS:
            if self.client.decisions.votes(self.names.keys[member]):
                self.command(member, "cast_vote", proposal=number, support="for")
        self.now_s += PERIOD_S
        self.command("carla", "queue_proposal", proposal=number)
        self.now_s += DELAY_S + 1
        self.command("carla", "execute_proposal", proposal=number)
        self.now_s += 10

    def open(self, *recipients: str, amount_iec: str = "100") -> int:
        request = {"recipients": list(recipients), "amount_iec": amount_iec, "duration_s": DURATION_S}
        self.decide("open_budget_vote", request)
        return int(self.budget_votes()[0]["number"])

    def cast(self, who: str, number: int, **votes: int) -> None:
        self.command(who, "cast_budget_vote", budget_vote=number, votes=votes)

    def pay(self, number: int, recipient: str) -> None:
        self.command("carla", "pay_budget_share", budget_vote=number, recipient=recipient)

    def budget_votes(self, **parameters: Any) -> list[dict[str, Any]]:
        wanted = {name: str(value) for name, value in parameters.items()}
        found = self.queries.answer("budget_votes", Request("state/budget_votes", wanted, b""))
        return list(found["budget_votes"])

    def shown(self, number: int) -> dict[str, Any]:
        (found,) = self.budget_votes(number=number)
        return found

    def owns(self, who: str) -> int:
        return self.client.token.balance(self.names.addresses.get(who, who))


@pytest.fixture(scope="module")
def members(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Members]:
    held, folder = list[Members](), tmp_path_factory.mktemp("members")
    governance = GovernanceConfig(
        kind="vote",
        delay_s=DELAY_S,
        voting_period_s=PERIOD_S,
        members=list(MEMBERS),
        budgets={"treasurer": BudgetConfig(iec=Decimal(1600))},
    )
    people = [ParticipantConfig(name=name) for name in ("alice", "bob", "carla")]
    with founded(
        folder,
        lambda: held[0].now_s if held else GENESIS_S,
        governance=governance,
        participants=people,
    ) as organization:
        held.append(Members(organization, folder))
        held[0].read()
        held[0].now_s += 10
        assert held[0].budget_votes() == []
        yield held[0]
        held[0].index.close()


def test_members_split_an_amount_and_everybody_is_paid_what_the_votes_say_once(members: Members) -> None:
    number = members.open("carla", REPAIRS)
    members.cast("alice", number, carla=10)
    # Voting again replaces what was given before, and counts once.
    members.cast("bob", number, carla=10)
    members.cast("bob", number, **{"carla": 6, REPAIRS: 4})
    found = members.shown(number)
    assert (found["state"], found["amount_iec"], found["credits"]) == ("open", "100", 100)
    assert found["end_s"] - found["opened_s"] == DURATION_S
    assert [(one["name"], one["votes"], one["share_iec"]) for one in found["recipients"]] == [
        ("carla", 16, "80"),
        (None, 4, "20"),
    ]
    given = {one["voter_name"]: (one["votes"], one["credits_used"]) for one in found["ballots"]}
    assert given == {"alice": ([10, 0], 100), "bob": ([6, 4], 52)}
    with pytest.raises(UnexpectedBudgetVoteState) as early:
        members.pay(number, "carla")
    assert early.value.details == {"budget_vote": number, "end_s": int(found["end_s"])}
    members.now_s += DURATION_S
    with pytest.raises(UnexpectedBudgetVoteState, match="voting has ended"):
        members.cast("alice", number, carla=1)
    assert members.shown(number)["state"] == "ended"
    before = members.owns("carla")
    members.pay(number, "carla")
    assert members.shown(number)["state"] == "ended"
    with pytest.raises(NothingToPay) as again:
        members.pay(number, "carla")
    assert again.value.details["paid_iec"] == "80"
    members.pay(number, REPAIRS)
    assert (members.owns("carla") - before, members.owns(REPAIRS)) == (80 * 10**18, 20 * 10**18)
    found = members.shown(number)
    assert found["state"] == "paid"
    assert [one["paid_iec"] for one in found["recipients"]] == ["80", "20"]
    # Who speaks to the contract itself is paid no more.
    with pytest.raises(ContractReverted) as twice:
        members.send("carla", members.client.governance_calls.budgets.pay(number, 0))
    assert (twice.value.name, twice.value.details) == ("PaidAlready", {"round_id": number, "index": 0})


def test_votes_that_cannot_be_are_refused_with_their_values(members: Members) -> None:
    number = members.open("carla", REPAIRS)
    for votes, needed in (({"carla": 11}, 121), ({"carla": 10, REPAIRS: 1}, 101), ({REPAIRS: 2**31}, 2**62)):
        with pytest.raises(TooFewCredits) as over:
            members.cast("alice", number, **votes)
        assert over.value.details == {"votes": votes, "needed": needed, "credits": 100}
    with pytest.raises(NotARecipient) as stranger:
        members.cast("alice", number, bob=1)
    assert stranger.value.details == {"recipient": "bob", "known": ["carla", REPAIRS_SHOWN]}
    with pytest.raises(InvalidRequest, match="named twice"):
        members.cast("alice", number, **{"carla": 1, members.names.keys["carla"]: 9})
    for unfit in (-1, "3", 1.5):
        with pytest.raises(InvalidRequest):
            members.cast("alice", number, carla=unfit)  # type: ignore[arg-type]
    with pytest.raises(UnknownBudgetVote):
        members.cast("alice", number + 1, carla=1)
    assert members.shown(number)["ballots"] == []
    # Nobody voted: nobody is paid, and the money stays where it is.
    members.now_s += DURATION_S
    with pytest.raises(NothingToPay, match="got no votes"):
        members.pay(number, "carla")
    assert members.shown(number)["state"] == "ended"


def test_only_members_from_before_have_credits_once_for_each_identity(members: Members) -> None:
    number = members.open("carla", REPAIRS)
    members.cast("bob", number, **{"carla": 6, REPAIRS: 8})
    votes = members.client.governance_calls.budgets.vote(number, [10, 0])
    with pytest.raises(NoCredits) as refused:
        members.cast("carla", number, carla=10)
    assert refused.value.details == {"participant": "carla", "budget_vote": number}
    # A robot is a member by its wallet. The key of its body, and the organization's own, are no identities.
    site = members.organization.site
    for keystore in ("panther1-device", "organization"):
        with pytest.raises(ContractReverted) as second:
            members.client.simulate(votes, keystores.address(site, keystore))
        assert second.value.details == {"account": keystores.address(site, keystore)}
        assert second.value.name == "NotAMember"
    members.cast("panther1", number, **{REPAIRS: 10})
    # Whoever is admitted meanwhile votes only in what is opened later.
    longer = {"recipients": ["carla", "bob"], "amount_iec": "10", "duration_s": 10 * PERIOD_S}
    members.decide("open_budget_vote", longer)
    later = int(members.budget_votes()[0]["number"])
    members.decide("admit", {"account": "carla"})
    with pytest.raises(NoCredits):
        members.cast("carla", later, carla=10)
    # Who is dismissed votes no more, and changes nothing: what it gave stays, as its vote on a proposal does.
    members.cast("bob", later, bob=10)
    members.decide("dismiss", {"account": "bob"})
    with pytest.raises(NoCredits):
        members.cast("bob", later, carla=1)
    members.cast("alice", later, carla=10)
    assert [one["votes"] for one in members.shown(later)["recipients"]] == [10, 10]
    # Admitted again, it has the one ballot that it had.
    members.decide("admit", {"account": "bob"})
    members.cast("bob", later, bob=5)
    members.now_s += 10 * PERIOD_S
    # A recipient that is no member any more is paid what the members gave it.
    members.decide("dismiss", {"account": "carla"})
    before = members.owns("carla")
    members.pay(later, "carla")
    assert members.owns("carla") - before == 10 * 10**18 * 10 // 15


def test_a_budget_vote_that_cannot_be_paid_is_not_proposed(members: Members) -> None:
    contracts = members.client.deployment.contracts
    request = {"recipients": ["carla"], "amount_iec": "1"}

    def propose(**changes: Any) -> None:
        members.propose("open_budget_vote", request | changes, who="alice")

    with pytest.raises(InsufficientFunds) as lacking:
        propose(amount_iec="1000000")
    assert lacking.value.details["needed_iec"] == "1000000" and lacking.value.details["balance_iec"]
    for own in ("organization", contracts["TaskManager"], "0x" + "00" * 20):
        with pytest.raises(NotARecipient) as nobody:
            propose(recipients=["carla", own])
        assert nobody.value.details == {"recipient": own}
    with pytest.raises(NotARecipient, match="named once"):
        propose(recipients=["carla", members.names.keys["carla"].lower()])
    for unfit in ([], ["carla"] * 17):
        with pytest.raises(InvalidRequest):
            propose(recipients=unfit)
    with pytest.raises(InvalidRequest, match="typing mistake"):
        propose(recipients=[REPAIRS_SHOWN.replace("0x4E", "0x4e")])
    with pytest.raises(InvalidRequest):
        propose(duration_s=59)
    with pytest.raises(HasToBeProposed):
        members.command("organization", "open_budget_vote", **request)


def test_what_the_treasury_lacks_is_paid_when_it_is_there_and_keeps_nobody_else_waiting(
    members: Members,
) -> None:
    number = members.open("carla", REPAIRS, amount_iec="900")
    members.cast("alice", number, **{"carla": 9, REPAIRS: 1})
    members.now_s += DURATION_S
    treasury = members.client.token.balance(members.client.organization)
    left = str(members.client.currency.from_units(treasury - 500 * 10**18))
    members.command("organization", "withdraw", to="bob", amount_iec=left)
    with pytest.raises(InsufficientFunds) as lacking:
        members.pay(number, "carla")
    assert (lacking.value.details["balance_iec"], lacking.value.details["needed_iec"]) == ("500", "810")
    members.pay(number, REPAIRS)
    # What treasurers took of their budget in this period makes nobody wait.
    members.command("organization", "deposit", amount_iec="1000")
    members.pay(number, "carla")
    assert members.shown(number)["state"] == "paid"


def test_without_its_role_the_contract_pays_nobody(members: Members) -> None:
    """Members take the role from it, for example where they find that votes were bought."""
    number = members.open("carla")
    members.cast("alice", number, carla=1)
    members.decide(
        "revoke_role", {"role": "allocator", "account": members.client.deployment.address("BudgetVotes")}
    )
    members.now_s += DURATION_S
    with pytest.raises(ContractReverted) as refused:
        members.pay(number, "carla")
    assert refused.value.args_by_name["needed_role"] == "ALLOCATOR_ROLE"


def test_what_was_proposed_before_needs_other_words(members: Members) -> None:
    terms = {"bond_iec": "3", "penalty_iec": "1", "max_failures": 2}
    number = members.propose("set_terms", terms, "a bond", who="alice")
    with pytest.raises(AlreadyProposed) as again:
        members.propose("set_terms", terms, "a bond", who="alice")
    assert again.value.details == {"proposal": number, "description": "a bond"}
    assert members.propose("set_terms", terms, "a bond, once more", who="alice") == number + 1


def test_a_member_cannot_end_the_proposals_of_others_by_proposing_the_same_first(members: Members) -> None:
    """The governor knows a proposal by its calls and words, and whoever proposed it first may cancel it."""
    fields = {"command": "set_members_only", "request": {"enabled": True}, "description": "mine"}
    wallet = members.wallet("alice")
    (seen,) = wallet.orders(parse("propose", fields))
    with pytest.raises(ContractReverted) as refused:
        members.send("bob", seen.call)
    assert refused.value.name == "GovernorRestrictedProposer"
    members.send("alice", seen.call)
    shown = members.proposals()[0]
    assert (shown["description"], shown["proposer"]) == ("mine", wallet.desk.key_address)
    # Bob's own proposal in the same words is another one.
    assert members.propose("set_members_only", {"enabled": True}, "mine", who="bob") == shown["number"] + 1


def test_a_vote_by_any_function_of_the_governor_counts(members: Members) -> None:
    number = members.propose("set_members_only", {"enabled": True}, "counted", who="alice")
    members.now_s += 10
    members.command("alice", "cast_vote", proposal=number, support="against")
    (proposal,) = (one for one in members.proposals() if one["number"] == number)
    governor = members.client.w3.eth.contract(
        address=members.client.deployment.address("OrganizationGovernor"),
        abi=artifacts.load("OrganizationGovernor").abi,
    )
    said = [int(proposal["id"], 16), SUPPORT.index("for"), "why", b"params"]
    data = governor.encode_abi("castVoteWithReasonAndParams", said)
    members.send("panther1", Call(governor.address, data, "castVote"))
    (proposal,) = (one for one in members.proposals() if one["number"] == number)
    assert proposal["votes"] == {"against": 1, "for": 1, "abstain": 0}
    assert {one["voter_name"]: (one["support"], one["weight"]) for one in proposal["ballots"]} == {
        "alice": ("against", 1),
        "panther1": ("for", 1),
    }


def test_where_members_do_not_decide_there_are_no_budget_votes(tmp_path: Path) -> None:
    with founded(tmp_path, governance=GovernanceConfig(delay_s=DELAY_S)) as organization:
        office = Members(organization, tmp_path)
        office.read()
        assert office.budget_votes() == []
        with pytest.raises(NoVotes):
            office.propose("open_budget_vote", {"recipients": ["panther1"], "amount_iec": "1"})
        for name, fields in (("cast_budget_vote", {"votes": {}}), ("pay_budget_share", {"recipient": "a"})):
            with pytest.raises(NoVotes):
                office.command("panther1", name, budget_vote=0, **fields)
        office.index.close()


def test_the_bounds_are_those_of_the_contract() -> None:
    source = SOURCE.read_text()
    assert f"CREDITS = {BUDGET_CREDITS};" in source
    most = OpenBudgetVote.model_json_schema()["properties"]["recipients"]["maxItems"]
    assert re.findall(r"MAX_RECIPIENTS = (\d+);", source) == [str(most)]


@pytest.mark.parametrize(
    ("amount", "votes", "paid"), [(100, [1, 2], [33, 66]), (100, [0, 0], [0, 0]), (7, [3, 0], [7, 0])]
)
def test_shares_are_divided_as_the_contract_divides(amount: int, votes: list[int], paid: list[int]) -> None:
    assert shares(amount, votes) == paid


def test_credits_are_no_amounts() -> None:
    from eth_abi import encode
    from eth_utils import keccak

    data = keccak(text="TooFewCredits(address,uint256,uint256)")[:4]
    data += encode(["address", "uint256", "uint256"], [REPAIRS, 121, 100])
    assert decode_revert(data).details == {"account": REPAIRS_SHOWN, "needed": 121, "credits": 100}
