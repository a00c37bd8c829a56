"""Members decide by vote, with real processes: propose, vote, queue, wait, execute.
An administrator who waits proposes, waits and executes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from eth_account import Account
from playwright.sync_api import Page, expect
from typer.testing import CliRunner

from rodeo.access.roles import Role
from rodeo.commands.governance import CastBudgetVote
from rodeo.dao import Participant
from rodeo.signing import wallets
from rodeo_cli import app
from tests.support.browser import chromium
from tests.support.console import PASSPHRASE, Desk
from tests.support.dao import Dao, founded
from tests.support.site import NewSite

pytestmark = pytest.mark.long

DELAY_S, PERIOD_S = 3600, 86_400
REPAIRS = "0x4E4E4E4e4E4e4e4E4e4E4E4e4E4E4E4E4e4E4e4e"
SITE = f"""participants = [{{ name = "alice" }}, {{ name = "bob" }}, {{ name = "carla" }}]

[governance]
kind = "vote"
delay_s = {DELAY_S}
voting_period_s = {PERIOD_S}
members = ["alice", "bob", "panther1"]
"""


WAITING = f"""participants = [{{ name = "alice" }}]

[governance]
delay_s = {DELAY_S}
"""


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    with founded(new_site(SITE)) as dao:
        yield dao


@pytest.fixture(scope="module")
def waiting(new_site: NewSite) -> Iterator[Dao]:
    with founded(new_site(WAITING)) as dao:
        yield dao


def rodeo(dao: Dao, *arguments: str, status: int = 0) -> str:
    """What `rodeo organization ARGUMENTS` prints."""
    done = CliRunner().invoke(
        app, ["organization", *arguments], env={"RODEO_SITE": str(dao.running.path), "COLUMNS": "300"}
    )
    assert done.exit_code == status, done.output
    return done.output


def wallet(dao: Dao, name: str) -> str:
    return next(str(one["address"]) for one in dao.state("wallets")["wallets"] if one["name"] == name)


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
    account = Account.create()
    judge, sits = account.address, ("--signature", dao.possession(account, "carla"))
    rodeo(dao, "propose", "--why", "it is careful", "seat", judge, "--owner", "carla", *sits, "--as", "alice")
    rodeo(dao, "propose", "--why", "I want it", "members-only", "--as", "carla", status=1)
    pass_time(10)
    for number in ("1", "2", "3"):
        for member, support in (("alice", "for"), ("panther1", "for"), ("bob", "against")):
            rodeo(dao, "vote", number, support, "--as", member)
    rodeo(dao, "queue", "1", status=1)  # the vote continues
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
    assert dao.client().decisions.votes(carla) == 1
    (seated,) = dao.state("organization")["judges"]
    assert (seated["key"], seated["owner_name"]) == (judge, "carla")


def budget_vote(dao: Dao, number: int) -> dict[str, Any]:
    (found,) = dao.state("budget_votes", number=number)["budget_votes"]
    return found  # type: ignore[no-any-return]


def test_the_members_split_an_amount_of_the_treasury_and_everybody_is_paid(dao: Dao) -> None:
    now_s = float(dao.client().w3.eth.get_block("pending")["timestamp"])

    def pass_time(s: float) -> None:
        nonlocal now_s
        now_s += s
        dao.set_clock(now_s)

    assert "There are none." in rodeo(dao, "budget-votes")
    assert "BudgetVotes" in rodeo(dao, "show")  # among the treasurers
    pass_time(10)
    open_it = ("budget-vote", "90", "carla", "bob", REPAIRS, "--duration", str(PERIOD_S))
    propose = ("propose", "--why", "who needs it?")
    assert "needed: 90,000 IEC" in rodeo(dao, *propose, "budget-vote", "90000", "bob", status=1)
    told = rodeo(dao, *propose, *open_it, "--as", "alice")
    number = re.findall(r"Proposal (\d+):", told)[0]
    pass_time(10)
    for member in ("alice", "bob", "panther1"):  # a majority, also after carla was admitted
        rodeo(dao, "vote", number, "for", "--as", member)
    pass_time(PERIOD_S)
    dao.running.start("console")
    with chromium(three_d=False) as browser:
        desk = Desk(dao.running, browser)
        desk.accounts.add_user("alice", PASSPHRASE, [Role.EXECUTOR], "alice")
        page, reader = desk.page("alice", "/proposals"), desk.page("reader", "/proposals")
        proposes(page, reader)
        take(page, int(number), "Queue")
        mine = page.get_by_role("region", name=f"Proposal {number}")
        expect(mine).to_contain_text("Can be executed from")
        expect(reader.get_by_role("region", name=f"Proposal {number}").get_by_role("button")).to_have_count(0)
        take(page, int(number), "Execute")
        refused = page.get_by_role("alert").filter(has_text="The contract refused")
        expect(refused).to_contain_text("TimelockUnexpectedOperationState")
        refused.get_by_role("button", name="Close").click()
        pass_time(DELAY_S + 1)
        take(page, int(number), "Execute")
        expect(page.get_by_role("region", name="Budget vote 0")).to_be_visible()
        split(dao, page, reader, int(number), pass_time)


def proposes(page: Page, reader: Page) -> None:
    """The member asks for other terms, and reads before what that would do."""
    expect(reader.get_by_role("button", name="Propose")).to_have_count(0)
    page.get_by_role("button", name="Propose").click()
    page.get_by_role("combobox", name="What").click()
    terms = "Set the terms for services that are offered from now on"
    page.get_by_role("option", name=terms).click()
    page.get_by_role("button", name="Go on").click()
    asked = page.get_by_role("dialog", name=terms)
    for field, said in (
        ("Bond (IEC)", "7"),
        ("Penalty (IEC)", "3"),
        ("Max failures", "2"),
        ("Why", "prudence"),
    ):
        asked.get_by_label(field).fill(said)
    asked.get_by_role("button", name="Review").click()
    sure = page.get_by_role("dialog", name="Propose: set terms?")
    expect(sure).to_contain_text(terms)
    expect(sure).to_contain_text("Members propose and vote")
    sure.get_by_role("button", name="Propose: set terms").click()
    made = reader.get_by_role("region", name=re.compile("^Proposal")).filter(has_text="prudence")
    expect(made).to_contain_text(f"Would do{terms}")
    expect(made).to_contain_text("Organization.setTerms(")


def take(page: Page, number: int, step: str) -> None:
    """Do this to a proposal as the person who is logged in."""
    page.get_by_role("region", name=f"Proposal {number}").get_by_role("button", name=step).click()
    dialog = page.get_by_role("dialog", name=f"{step} proposal {number}?")
    expect(dialog).to_contain_text("BudgetVotes.open")
    dialog.get_by_role("button", name=step).click()


def split(dao: Dao, page: Page, reader: Page, number: int, pass_time: Callable[[float], None]) -> None:
    """Members split what proposal `number` gave them to, on `page` and elsewhere."""
    (call,) = proposals(dao)[number]["calls"]
    assert (call["contract"], call["function"]) == ("BudgetVotes", "open")
    assert call["args"]["amount"] == 90 * 10**18 and call["args"]["duration"] == PERIOD_S
    pass_time(10)

    give = ("vote-budget", "0", "--as")
    for votes, why in (
        (("carla=11",), "needed: 121, credits: 100"),
        (("alice=1",), "not_a_recipient"),
        (("carla=1", f"{wallet(dao, 'carla')}=9"), "named twice"),
    ):
        assert why in rodeo(dao, *give, "alice", *votes, status=1)
    assert "no_credits" in rodeo(dao, *give, "organization", "carla=10", status=1)
    assert "unknown_budget_vote" in rodeo(dao, "vote-budget", "1", "carla=1", "--as", "alice", status=1)
    assert "with 64 credits" in rodeo(dao, *give, "alice", "carla=8")
    # A wallet that the bridge has no key of signs for itself. What it gave before is replaced.
    bob = Participant(dao.running.bus, dao.site.org, "bob", wallets.load(dao.site, "bob"))
    for given in ({"bob": 10}, {"bob": 8, REPAIRS: 6}):
        bob.command("cast_budget_vote", CastBudgetVote(budget_vote=0, votes=given))
    shown = rodeo(dao, "budget-votes", "--as", "bob")
    assert "bob has given 100 of 100 credits: bob 8, 0x4E4E4E4e…4E4e4e 6" in shown and "vote until" in shown
    assert "voting is still open" in rodeo(dao, "pay-budget", "0", status=1)

    card = page.get_by_role("region", name="Budget vote 0")
    expect(card).to_contain_text("64 of 100 credits: carla 8")
    expect(card.get_by_role("progressbar", name="Share of carla")).to_have_attribute(
        "aria-valuenow",
        "36",  # 8 of 22
    )
    card.get_by_role("button", name="Change your votes").click()
    dialog = page.get_by_role("dialog", name="Budget vote 0")
    dialog.get_by_label("Votes for bob").fill("10")
    expect(dialog.get_by_role("status")).to_have_text("164 of 100 credits: too many")
    expect(dialog.get_by_role("button", name="Vote")).to_be_disabled()
    dialog.get_by_label("Votes for bob").fill("6")
    dialog.get_by_role("button", name="Vote").click()
    expect(card).to_contain_text("100 of 100 credits: carla 8, bob 6")
    other = reader.get_by_role("region", name="Budget vote 0")
    expect(other).to_contain_text("14 votes, would get 45 IEC")
    expect(other.get_by_role("button")).to_have_count(0)
    pass_time(PERIOD_S)
    assert "voting has ended" in rodeo(dao, *give, "alice", "carla=1", status=1)
    before = {name: dao.balances()[name] for name in ("carla", "bob")}
    # 28 votes: 8 for carla, 14 for bob and 6 for the repairs.
    expect(other).to_contain_text("14 votes, gets 45 IEC, not paid yet")
    expect(other.get_by_role("button")).to_have_count(0)
    card.get_by_role("button", name="Pay the shares").click()
    dialog = page.get_by_role("dialog", name="Pay these out of the treasury?")
    expect(dialog).to_contain_text("45 IEC")
    dialog.get_by_role("button", name="Pay").click()
    expect(other).to_contain_text("14 votes, was paid 45 IEC")
    expect(card).to_contain_text("paid")
    expect(card.get_by_role("button")).to_have_count(0)
    found = budget_vote(dao, 0)
    assert found["state"] == "paid"
    cents = [int(float(one["paid_iec"]) * 100) for one in found["recipients"]]
    assert cents == [2571, 4500, 1928] and [one["votes"] for one in found["recipients"]] == [8, 14, 6]
    assert dao.balances()["bob"] - before["bob"] == 45
    assert round(dao.balances()["carla"] - before["carla"], 2) == 25.71
    assert dao.client().token.balance(REPAIRS) == 90 * 10**18 * 6 // 28
    assert "There is nothing to pay of budget vote 0." in rodeo(dao, "pay-budget", "0")


def test_what_an_administrator_who_waits_proposes_is_executed_after_the_delay(waiting: Dao) -> None:
    now_s = float(waiting.client().w3.eth.get_block("latest")["timestamp"]) + 10
    waiting.set_clock(now_s)
    assert "the administrator, 1 h after a proposal" in rodeo(waiting, "show")
    assert "has_to_be_proposed" in rodeo(waiting, "terms", "--bond", "1", status=1)
    bond = ("propose", "--why", "only a better lid", "terms", "--bond", "1")
    assert "needed role: PROPOSER_ROLE" in rodeo(waiting, *bond, "--as", "alice", status=1)
    assert "Proposal 1: anybody can execute it in 1 h" in rodeo(waiting, *bond)
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
