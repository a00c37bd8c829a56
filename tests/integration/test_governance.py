"""Members, or owners of tokens, decide by vote, with real processes: propose, vote, queue, wait, execute.
An administrator who waits proposes, waits and executes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo_cli import app
from tests.support.dao import PARAMS, Dao
from tests.support.site import RunningSite, write_site

DELAY_S, PERIOD_S = 3600, 86_400
SITE = f"""participants = [{{ name = "alice" }}, {{ name = "bob" }}, {{ name = "carla" }}]

[governance]
kind = "vote"
delay_s = {DELAY_S}
voting_period_s = {PERIOD_S}
members = ["alice", "bob", "panther1"]
"""


OWNERS = SITE.replace('members = ["alice", "bob", "panther1"]', 'votes = "tokens"\nproposal_iec = 200')


WAITING = f"""participants = [{{ name = "alice" }}]

[governance]
delay_s = {DELAY_S}
"""


@pytest.fixture(scope="module")
def dao(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Dao]:
    yield from running_site(tmp_path_factory, chain_backend, SITE)


@pytest.fixture(scope="module")
def owned(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Dao]:
    yield from running_site(tmp_path_factory, chain_backend, OWNERS)


@pytest.fixture(scope="module")
def waiting(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Dao]:
    yield from running_site(tmp_path_factory, chain_backend, WAITING)


def running_site(tmp_path_factory: pytest.TempPathFactory, chain_backend: str, site: str) -> Iterator[Dao]:
    running = RunningSite(write_site(tmp_path_factory.mktemp("vote"), chain_backend, site))
    organization = Dao(running)
    try:
        organization.start()
        yield organization
    finally:
        organization.stop()
        running.stop()


def rodeo(dao: Dao, *arguments: str, status: int = 0) -> str:
    """What `rodeo organization ARGUMENTS` prints."""
    done = CliRunner().invoke(
        app, ["organization", *arguments], env={"RODEO_SITE": str(dao.running.path), "COLUMNS": "300"}
    )
    assert done.exit_code == status, done.output
    return done.output


def proposals(dao: Dao) -> dict[int, dict[str, Any]]:
    listed = json.loads(rodeo(dao, "proposals", "--json"))["proposals"]
    return {one["number"]: one for one in listed}


def test_the_members_change_a_price_and_admit_somebody(dao: Dao) -> None:
    now_s = float(dao.client().w3.eth.get_block("latest")["timestamp"])

    def pass_time(s: float) -> None:
        nonlocal now_s
        now_s += s
        dao.set_clock(now_s)

    pass_time(10)
    offer = dao.command("organization", "register_service", kind="battery_charging", price_iec="5")
    service = str(offer["service_id"])
    # The key that set the organization up is nobody's administrator.
    rodeo(dao, "terms", "--bond", "1", status=1)
    assert "decided by" in (shown := rodeo(dao, "show")) and "the members, by vote" in shown

    assert "Proposal 1" in rodeo(
        dao, *("propose", "--why", "a charge costs more", "price", service, "8", "--as", "alice")
    )
    assert "Proposal 2" in rodeo(dao, "propose", "--why", "she helps", "admit", "carla", "--as", "bob")
    judge = "0x" + "1d" * 20
    rodeo(dao, "propose", "--why", "it is careful", "seat", judge, "--owner", "carla", "--as", "alice")
    rodeo(dao, "propose", "--why", "I want it", "members-only", "--as", "carla", status=1)
    pass_time(10)
    for number in ("1", "2", "3"):
        for member, support in (("alice", "for"), ("panther1", "for"), ("bob", "against")):
            rodeo(dao, "vote", number, support, "--as", member)
    rodeo(dao, "queue", "1", status=1)  # the vote goes on
    assert "no_votes" in rodeo(dao, "wrap", "5", "--as", "panther1", status=1)
    first = proposals(dao)[1]
    assert first["state"] == "active" and first["votes"] == {"against": 1, "for": 2, "abstain": 0}
    assert {one["voter_name"]: one["support"] for one in first["ballots"]}["bob"] == "against"
    (call,) = first["calls"]
    assert (call["contract"], call["function"]) == ("Organization", "updateService")
    assert call["args"] == {"service_id": int(service), "price": 8 * 10**18, "state": "active"}
    assert "Organization.updateService" in rodeo(dao, "proposals")

    pass_time(PERIOD_S)
    for number in ("1", "2", "3"):
        rodeo(dao, "queue", number)
    rodeo(dao, "execute", "1", status=1)  # the delay runs
    assert {one["state"] for one in proposals(dao).values()} == {"queued"}
    pass_time(DELAY_S + 1)
    for number in ("1", "2", "3"):
        rodeo(dao, "execute", number, "--as", "carla")  # anybody may
    assert {one["state"] for one in proposals(dao).values()} == {"executed"}
    (offered,) = dao.state("services")["services"]
    assert offered["price_iec"] == "8"
    members = {one["name"] for one in dao.state("organization")["roles"]["MEMBER_ROLE"]}
    assert members == {"alice", "bob", "panther1", "carla"}
    carla = next(one["address"] for one in dao.state("wallets")["wallets"] if one["name"] == "carla")
    assert dao.client().votes(carla) == 1
    (seated,) = dao.state("organization")["judges"]
    assert (seated["key"].lower(), seated["owner_name"]) == (judge, "carla")


def test_only_tokens_that_were_wrapped_before_a_proposal_vote_on_it(owned: Dao) -> None:
    now_s = float(owned.client().w3.eth.get_block("latest")["timestamp"])

    def pass_time(s: float) -> None:
        nonlocal now_s
        now_s += s
        owned.set_clock(now_s)

    pass_time(10)
    offer = owned.command("organization", "register_service", kind="battery_charging", price_iec="5")
    price = ("propose", "--why", "a charge costs more", "price", str(offer["service_id"]), "8")
    for name, amount in (("alice", "300"), ("bob", "500"), ("carla", "1000")):
        owned.command("organization", "transfer", to=name, amount_iec=amount)
    rodeo(owned, "wrap", "300", "--as", "alice")
    rodeo(owned, "wrap", "100", "--as", "bob")
    # Carla has more than they, but no votes: she took back what she had wrapped, and 700 are in escrow.
    rodeo(owned, "wrap", "250", "--as", "carla")
    rodeo(owned, "unwrap", "250", "--as", "carla")
    owned.command("carla", "register_task", kind="waste_disposal", reward_iec="700", params=PARAMS)
    wallets = {one["name"]: one["address"] for one in owned.state("wallets")["wallets"]}
    assert [owned.client().votes(wallets[name]) // 10**18 for name in ("alice", "bob", "carla")] == [
        300,
        100,
        0,
    ]
    pass_time(10)
    for who in ("bob", "carla"):  # too few, and none
        rodeo(owned, *price, "--as", who, status=1)
    rodeo(owned, *price, "--as", "alice")
    pass_time(10)
    rodeo(owned, "wrap", "300", "--as", "carla")  # too late for this one
    pass_time(10)
    for who, support in (("alice", "for"), ("bob", "against"), ("carla", "against")):
        rodeo(owned, "vote", "1", support, "--as", who)
    rodeo(owned, "unwrap", "300", "--as", "alice")  # what was counted stays
    (proposal,) = proposals(owned).values()
    assert proposal["votes"] == {"against": "100", "for": "300", "abstain": "0"}
    pass_time(PERIOD_S)
    rodeo(owned, "queue", "1")
    pass_time(DELAY_S + 1)
    rodeo(owned, "execute", "1", "--as", "carla")
    assert proposals(owned)[1]["state"] == "executed"
    assert owned.state("services")["services"][0]["price_iec"] == "8"


def test_what_an_administrator_who_waits_proposes_is_executed_after_the_delay(waiting: Dao) -> None:
    now_s = float(waiting.client().w3.eth.get_block("latest")["timestamp"]) + 10
    waiting.set_clock(now_s)
    assert "the administrator, 1 h 0 min after a proposal" in rodeo(waiting, "show")
    assert "has_to_be_proposed" in rodeo(waiting, "terms", "--bond", "1", status=1)
    bond = ("propose", "--why", "only a better lid", "terms", "--bond", "1")
    assert "needed role: PROPOSER_ROLE" in rodeo(waiting, *bond, "--as", "alice", status=1)
    assert "Proposal 1: anybody can execute it in 1 h 0 min" in rodeo(waiting, *bond)
    assert "Proposal 2" in rodeo(waiting, *bond)  # once more
    assert "CANCELLER_ROLE" in rodeo(waiting, "cancel", "2", "--as", "alice", status=1)
    assert "Proposal 2 is cancelled" in rodeo(waiting, "cancel", "2")
    for refused in (("vote", "1", "for"), ("queue", "1")):
        assert "no_votes" in rodeo(waiting, *refused, status=1)
    assert "state: waiting" in rodeo(waiting, "execute", "1", "--as", "alice", status=1)
    # What it would do is shown beside what its text says.
    listed = rodeo(waiting, "proposals")
    assert "only a better lid" in listed and "Organization.setTerms" in listed and "not before" in listed
    waiting.set_clock(now_s + DELAY_S + 60)
    assert {one["number"]: one["state"] for one in proposals(waiting).values()} == {1: "ready", 2: "canceled"}
    rodeo(waiting, "execute", "1", "--as", "alice")
    assert waiting.state("organization")["terms"]["bond_iec"] == "1"
