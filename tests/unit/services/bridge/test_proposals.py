"""An administrator who waits: what its key proposes in the bridge, and what everybody sees of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from eth_utils import to_bytes

from deploy import contracts, founding, gas_money
from rodeo.chain import contract_calls
from rodeo.chain.client import ChainClient, connect
from rodeo.chain.contracts.types import Role, TimelockRole
from rodeo.chain.node.errors import ContractReverted
from rodeo.chain.proposals import WHY
from rodeo.chain.views import DecisionViews
from rodeo.commands import COMMANDS
from rodeo.commands.errors import (
    ActsAtOnce,
    HasToBeProposed,
    MembersDecide,
    NoVotes,
    UnexpectedProposalState,
    UnknownProposal,
)
from rodeo.commands.governance import CancelProposal, HandOver
from rodeo.errors import InvalidRequest
from rodeo.signing import keystores, wallets
from rodeo.site.sections import GovernanceConfig, ParticipantConfig
from tests.support.office import Office
from tests.support.organization import GENESIS_S, Organization, founded, running_chain
from tests.support.views import view

pytestmark = pytest.mark.long

DELAY_S = 3600
TERMS = {"bond_iec": "3", "penalty_iec": "1", "max_failures": 2}
VOTING = dict.fromkeys(("OrganizationTimelock", "OrganizationGovernor", "MemberVotes"), f"0x{7:040}")


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Office]:
    held, folder = list[Office](), tmp_path_factory.mktemp("office")
    with founded(
        folder,
        lambda: held[0].now_s if held else GENESIS_S,
        governance=GovernanceConfig(delay_s=DELAY_S),
        participants=[ParticipantConfig(name="alice")],
    ) as organization:
        held.append(Office(organization, folder))
        held[0].read()
        assert held[0].proposals() == []  # what the founder was told at once is none
        yield held[0]
        held[0].index.close()


def test_what_the_administrator_proposes_is_seen_by_all_and_done_by_anybody_after_the_delay(
    office: Office,
) -> None:
    first = office.propose("set_terms", TERMS, "a bond")
    # Equal ones may be proposed again.
    second = office.propose("set_terms", TERMS, "a bond")
    assert second == first + 1
    shown = office.proposals()[1]
    assert (shown["description"], shown["state"]) == ("a bond", "waiting")
    assert shown["proposer"] is None and shown["vote_end_s"] is None
    assert shown["ready_s"] - shown["created_s"] == DELAY_S
    (call,) = shown["calls"]
    assert (call["contract"], call["function"]) == ("Organization", "setTerms")
    assert call["args"]["terms"]["bond"] == 3 * 10**18
    with pytest.raises(UnexpectedProposalState) as early:
        office.command("alice", "execute_proposal", proposal=first)
    assert early.value.details == {"proposal": first, "state": "waiting", "wanted": "ready"}
    office.now_s += DELAY_S + 1
    assert office.state(first) == "ready"
    office.command("alice", "execute_proposal", proposal=first)
    assert office.client.rules.terms().bond == 3 * 10**18
    assert (office.state(first), office.state(second)) == ("executed", "ready")
    with pytest.raises(UnexpectedProposalState):
        office.command("organization", "cancel_proposal", proposal=first)
    office.command("organization", "cancel_proposal", proposal=second)
    assert office.state(second) == "canceled"
    with pytest.raises(UnexpectedProposalState):
        office.command("alice", "execute_proposal", proposal=second)
    with pytest.raises(UnknownProposal):
        office.command("alice", "execute_proposal", proposal=second + 1)


def test_nobody_else_proposes_or_cancels_and_the_administrators_key_does_nothing_at_once(
    office: Office,
) -> None:
    made = office.propose("set_members_only", {"enabled": True})
    for name, fields, role in (
        ("propose", {"command": "set_terms", "request": TERMS, "description": "mine"}, "PROPOSER_ROLE"),
        ("cancel_proposal", {"proposal": made}, "CANCELLER_ROLE"),
    ):
        with pytest.raises(ContractReverted) as refused:
            office.command("alice", name, **fields)
        assert refused.value.args_by_name["needed_role"] == role
    for name, fields in (
        ("set_terms", TERMS),
        ("grant_role", {"role": "treasurer", "account": "alice"}),
        ("set_delay", {"delay_s": 1}),
        ("hand_over", {"account": "alice"}),
    ):
        with pytest.raises(HasToBeProposed) as at_once:
            office.command("organization", name, **fields)
        assert at_once.value.details == {"command": name, "delay_s": DELAY_S}
        assert "rodeo organization propose --why" in str(at_once.value)
    for name, fields in (
        ("cast_vote", {"proposal": made, "support": "for"}),
        ("queue_proposal", {"proposal": made}),
    ):
        with pytest.raises(NoVotes):
            office.command("alice", name, **fields)
    # The guardian and the operators wait for nothing.
    office.command("organization", "pause_tasks", duration_s=600)
    office.command("organization", "resume_tasks")
    office.command(
        "organization", "register_service", kind="battery_charging", price_iec="5", auto_accept=True
    )


def test_the_administrator_hands_over_and_changes_the_delay_by_proposals_only(office: Office) -> None:
    faster = office.propose("set_delay", {"delay_s": 60})
    given = office.propose("hand_over", {"account": "alice"}, "she is the administrator now")
    functions = [(one["contract"], one["function"]) for one in office.proposals()[0]["calls"]]
    assert functions == [("OrganizationTimelock", did) for did in ("grantRole",) * 2 + ("revokeRole",) * 2]
    # It is shown who may propose, and who the organization's own administrator is.
    keys, timelock = office.names.keys, office.client.deployment.address("OrganizationTimelock")
    roles = office.index.rules.roles()
    assert roles["PROPOSER_ROLE"] == roles["CANCELLER_ROLE"] == [keys["organization"]]
    assert roles[Role.ADMINISTRATOR] == [timelock]
    office.now_s += DELAY_S + 1
    for number in (faster, given):
        office.command("alice", "execute_proposal", proposal=number)
    roles = office.index.rules.roles()
    assert roles["PROPOSER_ROLE"] == roles["CANCELLER_ROLE"] == [keys["alice"]]
    with pytest.raises(ContractReverted):
        office.propose("set_members_only", {"enabled": True})
    last = office.propose("set_members_only", {"enabled": True}, who="alice")
    office.now_s += 61
    office.command("organization", "execute_proposal", proposal=last)
    assert view(office.client, "Organization", "membersOnly")
    back = office.propose("hand_over", {"account": "organization"}, who="alice")
    slower = office.propose("set_delay", {"delay_s": DELAY_S}, who="alice")
    office.now_s += 61
    for number in (back, slower):
        office.command("alice", "execute_proposal", proposal=number)
    assert office.index.rules.roles()["PROPOSER_ROLE"] == [keys["organization"]]
    assert office.client.decisions.delay_s() == DELAY_S


def test_a_proposal_that_cannot_be_carried_out_stays_and_says_why(office: Office) -> None:
    number = office.propose(
        "revoke_role", {"role": "administrator", "account": office.client.rules.administrator()}
    )
    office.now_s += DELAY_S + 1
    with pytest.raises(ContractReverted) as refused:
        office.command("alice", "execute_proposal", proposal=number)
    assert refused.value.name == "AccessControlEnforcedDefaultAdminRules"
    assert office.state(number) == "ready"


def test_a_proposed_price_names_the_state_that_the_service_has_afterwards(office: Office) -> None:
    with pytest.raises(InvalidRequest, match="names the state"):
        office.propose("update_service", {"service_id": 1, "price_iec": "8"})


def test_what_the_contracts_would_refuse_after_the_delay_is_refused_at_once(
    office: Office, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InvalidRequest, match="SetTerms") as refused:
        office.propose("set_terms", TERMS | {"penalty_iec": "4"})
    assert "the penalty is higher than the bond" in str(refused.value.details)
    provider = office.account("panther1").address
    monkeypatch.setattr(office.index.services, "get", lambda _number: {"provider": provider})
    with pytest.raises(InvalidRequest, match="does not offer this service"):
        office.propose("update_service", {"service_id": 1, "price_iec": "8", "state": "active"})


def test_what_is_scheduled_past_the_bridge_is_listed_too_with_the_calls_beside_its_text(
    office: Office,
) -> None:
    """The administrator is an adversary here, and speaks to the timelock itself."""
    client, timelock = office.client, contract_calls.OrganizationTimelockCalls(office.client.deployment)
    alice = office.names.keys["alice"]
    grant = client.organization_calls.grant_role(Role.TREASURER, alice)
    # The organization hands out any role, and that of the timelock's proposers means nothing in it.
    other = client.organization_calls.grant_role(TimelockRole.PROPOSER, alice)  # type: ignore[arg-type]
    data, nothing = to_bytes(hexstr=grant.data), bytes(32)
    lie = [b"nothing", b"\xff happens"]
    office.send(
        "organization",
        timelock.schedule_batch(
            [WHY, grant.to, WHY], [0] * 3, [lie[0], data, lie[1]], nothing, nothing, DELAY_S
        ),
    )
    shown, *_earlier = office.proposals()
    last = shown["number"]
    assert shown["description"] == "nothing\n\ufffd happens"
    (call,) = shown["calls"]
    assert (call["function"], call["args"]["role"]) == ("grantRole", "TREASURER_ROLE")
    # As one call and not as a batch, in which it has another id, and after another operation.
    first = to_bytes(hexstr=shown["id"])
    single = timelock._call(
        "OrganizationTimelock", "schedule", grant.to, 0, data, first, b"\x07" * 32, DELAY_S
    )
    office.send("organization", single)
    office.send("organization", client.governance_calls.schedule([other], "c", bytes(32), DELAY_S))
    # One without calls does nothing, and is no proposal.
    office.send("organization", timelock.schedule_batch([], [], [], nothing, b"\x01" * 32, DELAY_S))
    assert [one["number"] for one in office.proposals()][:4] == [last + 2, last + 1, last, last - 1]
    office.now_s += DELAY_S + 1
    with pytest.raises(ContractReverted) as order:
        office.command("alice", "execute_proposal", proposal=last + 1)
    assert order.value.name == "TimelockUnexecutedPredecessor"
    for number in (last, last + 1, last + 2):
        office.command("alice", "execute_proposal", proposal=number)
    assert [one["state"] for one in office.proposals()[:3]] == ["executed"] * 3
    assert client.rules.has_role(Role.TREASURER, alice)
    assert office.index.rules.roles()["PROPOSER_ROLE"] == [office.names.keys["organization"]]


def test_what_a_founder_leaves_to_be_done_later_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An adversary founds with other software, which cancels nothing that was scheduled without a delay."""
    with running_chain("eth-tester", tmp_path) as lab:
        site = lab.model_copy(update={"governance": GovernanceConfig(delay_s=DELAY_S)})
        wallets.ensure_wallets(site)
        w3, founder = connect(site.chain.url), wallets.load(site, "organization")
        gas_money.fund(w3, [keystores.address(site, name) for name in keystores.wallet_names(site)])
        deployment = founding.create_contracts(site, w3, founder, lambda _text: None)
        client = ChainClient(site.chain.url, deployment)
        grant = client.organization_calls.grant_role(Role.TREASURER, founder.address)
        client.send(founder, client.governance_calls.found([grant], bytes(32))[0])
        monkeypatch.setattr(DecisionViews, "pending", lambda _views: {})
        contracts.set_up(site, w3, deployment, founder, lambda _text: None)
        office = Office(Organization(site), tmp_path)
        office.read()
        (shown,) = office.proposals()
        assert (shown["number"], shown["state"], shown["calls"][0]["function"]) == (1, "ready", "grantRole")
        office.command("organization", "execute_proposal", proposal=1)
        assert office.state(1) == "executed"
        office.index.close()


def test_where_nothing_is_proposed_or_members_decide_the_bridge_says_so(tmp_path: Path) -> None:
    proposal = {"command": "set_terms", "request": TERMS, "description": "why"}
    with founded(tmp_path) as organization:
        office = Office(organization, tmp_path)
        for name, fields in (
            ("propose", proposal),
            ("execute_proposal", {"proposal": 1}),
            ("cancel_proposal", {"proposal": 1}),
            ("hand_over", {"account": "panther1"}),
            ("set_delay", {"delay_s": 5}),
        ):
            with pytest.raises(ActsAtOnce):
                office.command("organization", name, **fields)
        office.command("organization", "set_terms", **TERMS)
        # As where members decide, without founding one more.
        decided = office.client.deployment.model_copy(
            update={"contracts": {**office.client.deployment.contracts, **VOTING}}
        )
        client: Any = SimpleNamespace(deployment=decided)
        desk = replace(office.wallet("panther1").desk, client=client)
        with pytest.raises(MembersDecide):
            HandOver(account="panther1").calls(desk)
        known: Any = SimpleNamespace(
            votes=SimpleNamespace(proposal=lambda _number: {"number": 1, "id": "0x01"})
        )
        with pytest.raises(MembersDecide):
            CancelProposal(proposal=1).calls(replace(desk, index=known))
        office.index.close()


def test_what_only_the_administrator_may_do_has_to_be_proposed() -> None:
    declared = [model.declared for model in COMMANDS.values()]
    assert {one.name for one in declared if one.proposable and not one.of_administrator} == {
        "change_judge_key",
        "remove_judge",
        "resume_tasks",
        "update_service",
    }
    assert all(one.proposable for one in declared if one.of_administrator)
