"""Votes by wrapped tokens: an organization that is deployed so, and what the bridge sends to vote in it."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from eth_account.signers.local import LocalAccount
from eth_utils import keccak

from deploy import contracts
from rodeo.chain import artifacts, events
from rodeo.chain.client import ChainClient
from rodeo.chain.encoding import Call
from rodeo.chain.errors import ContractReverted
from rodeo.chain.governance import SUPPORT, Proposed
from rodeo.chain.types import Event
from rodeo.config import GovernanceConfig
from rodeo.currency import IEC
from services.bridge.commands import Wallet
from services.bridge.errors import InsufficientFunds
from services.bridge.index import Index, Position, TimedLog, sqlite_url
from services.bridge.names import Names
from tests.support.organization import CHAIN_ID, GENESIS_S, Organization, founded

PERIOD_S, DELAY_S = 3600, 60


def wallet(organization: Organization, participant: str) -> Wallet:
    client, unused = organization.client, SimpleNamespace()
    fields: dict[str, Any] = {
        "transactions": unused,
        "index": SimpleNamespace(balance=client.balance, proposal_number=lambda _key: None),
        "names": Names(organization.site, client.deployment),
        "store": unused,
        "economy": organization.site.economy,
        "kinds": unused,
    }
    return Wallet(participant, client, **fields)


def with_params(client: ChainClient, proposal_id: int, support: str) -> Call:
    governor = client.w3.eth.contract(
        address=client.deployment.address("OrganizationGovernor"),
        abi=artifacts.load("OrganizationGovernor").abi,
    )
    said = [proposal_id, SUPPORT.index(support), "why", b"params"]
    return Call(governor.address, governor.encode_abi("castVoteWithReasonAndParams", said), "castVote")


def tally(organization: Organization, folder: Path) -> dict[str, int]:
    """Of the only proposal, as the bridge's index shows it."""
    client, eth = organization.client, organization.client.w3.eth
    deployment = client.deployment
    url = sqlite_url(folder / "tally.sqlite")
    index = Index(url, CHAIN_ID, deployment.genesis_hash, deployment.contracts)
    for number in range(deployment.block, eth.block_number + 1):
        block = eth.get_block(number)
        logs = [TimedLog(log, block["timestamp"]) for log in client.logs(number, number)]
        index.apply(logs, Position(number, block["hash"].to_0x_hex(), block["timestamp"]))
    row = index.proposal(1)
    index.close()
    assert row is not None
    return {support: row[support] for support in SUPPORT}


def test_who_wrapped_tokens_decides_and_who_only_has_them_does_not(tmp_path: Path) -> None:
    now_s = GENESIS_S
    governance = GovernanceConfig(
        kind="vote", votes="tokens", proposal_iec=Decimal(1000), delay_s=DELAY_S, voting_period_s=PERIOD_S
    )
    with founded(tmp_path, lambda: now_s, governance=governance) as organization:
        client, robot, founder = organization.client, organization.robot, organization.operator
        assert client.deployment.votes_by == "tokens"
        assert client.administrator() == client.deployment.address("OrganizationTimelock")
        assert client.balance(founder.address) > client.balance(robot.address) == IEC.to_units(Decimal(2000))

        def command(account: LocalAccount, name: str, **fields: Any) -> list[Event]:
            participant = "panther1" if account is robot else "organization"
            of = wallet(organization, participant)
            *before, last = of._orders(name, *of._parse(name, fields))
            for order in before:
                organization.send(account, order.call)
            return organization.events(account, last.call)

        with pytest.raises(InsufficientFunds):
            command(robot, "wrap_tokens", amount_iec="2001")
        command(robot, "wrap_tokens", amount_iec="1600")
        command(robot, "unwrap_tokens", amount_iec="100")
        assert (
            client.votes(robot.address) == IEC.to_units(Decimal(1500)) and client.votes(founder.address) == 0
        )
        assert client.balance(robot.address) == IEC.to_units(Decimal(500))
        with pytest.raises(ContractReverted) as lacking:
            command(robot, "unwrap_tokens", amount_iec="1501")
        assert lacking.value.name == "ERC20InsufficientBalance"

        now_s += 10
        open_to_members = {"command": "set_members_only", "request": {"enabled": True}, "description": "why"}
        with pytest.raises(ContractReverted) as refused:
            command(founder, "propose", **open_to_members)
        assert refused.value.name == "GovernorInsufficientProposerVotes"
        assert refused.value.args_by_name["threshold"] == IEC.to_units(Decimal(1000))
        (proposed,) = command(robot, "propose", **open_to_members)
        assert isinstance(proposed, events.ProposalCreated)
        now_s += 10
        # Too late for this proposal.
        command(founder, "wrap_tokens", amount_iec="5000")
        calls = client.governance_calls
        weights = []
        (cast,) = organization.events(founder, calls.cast_vote(proposed.proposal_id, "against"))
        assert isinstance(cast, events.VoteCast)
        weights.append(cast.weight)
        # By another function of the governor, whose event is another one.
        (cast,) = organization.events(robot, with_params(client, proposed.proposal_id, "for"))
        assert isinstance(cast, events.VoteCastWithParams)
        weights.append(cast.weight)
        assert weights == [0, IEC.to_units(Decimal(1500))]
        assert tally(organization, tmp_path) == {"against": 0, "for": weights[1], "abstain": 0}
        now_s += PERIOD_S
        decided = Proposed(
            proposed.targets, proposed.values, proposed.calldatas, keccak(text=proposed.description)
        )
        organization.send(robot, calls.queue(decided))
        now_s += DELAY_S + 1
        organization.send(robot, calls.execute(decided))
        assert client.members_only()

        by_members = governance.model_copy(update={"votes": "members", "members": ["panther1"]})
        site = organization.site.model_copy(update={"governance": by_members})
        with pytest.raises(contracts.OtherGovernance) as other:
            Organization(site).deploy()
        assert other.value.details == {"wanted": "members", "found": "tokens"}
