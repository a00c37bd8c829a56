"""A ruling of several oracles that is challenged: by the bridge, the command line and the console."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect
from typer.testing import CliRunner

from rodeo.access.roles import Role
from rodeo.bus.messages import Vote
from rodeo.errors import RemoteError
from rodeo.judging import votes
from rodeo.money.currency import IEC
from rodeo.signing import keystores, wallets
from rodeo_cli import app
from tests.support.browser import chromium
from tests.support.console import PASSPHRASE, Desk
from tests.support.dao import Dao, founded
from tests.support.executor import Executor, Film, stored
from tests.support.index import index_differences
from tests.support.site import NewSite

pytestmark = pytest.mark.long

ORACLES = ("olga", "otto", "omar")
JUDGES = ("anna", "bert", "carl", "dora")
APPEAL = ("emil", "finn", "gus", "hanna")
WINDOW_S, DECISION_S, STAKE, JUDGE_STAKE = 600, 900, 20.0, 10
"""A judge's stake stands for ten times as much: for one cleaning at a time."""
SITE = (
    "".join(f'\n[[oracles]]\nname = "{name}"\n' for name in ORACLES)
    + "".join(f'\n[[participants]]\nname = "{name}"\n' for name in (*JUDGES, *APPEAL, "mallory"))
    + f"\n[disputes]\njudges = {list(JUDGES)!r}\nvotes = 3\nstake_iec = {STAKE}\n"
    + f"window_s = {WINDOW_S}\ndecision_s = {DECISION_S}\njudge_stake_iec = {JUDGE_STAKE}\n"
    + f"[disputes.appeal]\njudges = {list(APPEAL)!r}\nvotes = 4\nstake_iec = {2 * STAKE}\n"
    + f"window_s = {WINDOW_S}\ndecision_s = {DECISION_S}\njudge_stake_iec = {JUDGE_STAKE}\n"
)
REPORT = {"report_sha256": "0x" + "b" * 64, "report_uri": "file:///srv/store/report.json"}


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    with founded(new_site(SITE)) as organization:
        organization.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        yield organization


class Clock:
    """The site's time advances with each test."""

    now_s = 2_000_000_000.0


def pass_time(dao: Dao, seconds: float) -> None:
    Clock.now_s += seconds
    dao.set_clock(Clock.now_s)


def proven(dao: Dao) -> int:
    """A task whose proof waits for the oracles, whose stakes are there."""
    deposit_stakes(dao)
    return submitted(dao)


def submitted(dao: Dao) -> int:
    pass_time(dao, 10)
    task_id = dao.post()
    dao.prove(task_id)
    return task_id


def rule(dao: Dao, task_id: int, ruling: str = "accepted") -> dict[str, Any]:
    """What two of the three oracles say, posted by a bystander."""
    task = dao.task(task_id)
    vote = Vote(
        task_id=task_id,
        attempt=task["attempt"],
        proof_sha256=task["proof_sha256"],
        report_sha256=REPORT["report_sha256"],
        rules_sha256=task["rules_sha256"],
        ruling=ruling,
        amount_iec=task["price_iec"] if ruling == "accepted" else "0",
        reason=ruling,
    )
    chain = dao.state("chain")
    signatures = [
        votes.sign(
            vote,
            wallets.load(dao.site, f"{name}-device"),
            chain["chain_id"],
            chain["contracts"]["OracleCommittee"],
            IEC,
        )
        for name in ORACLES[:2]
    ]
    request = {"vote": vote.model_dump(mode="json"), "report_uri": REPORT["report_uri"]}
    dao.command("mallory", "post_votes", signatures=signatures, **request)
    return dao.task(task_id)


def rodeo(dao: Dao, *arguments: str, status: int = 0, typed: str | None = None) -> str:
    """What `rodeo task dispute` prints. Somebody agrees to challenges, or what is `typed` answers."""
    agreed = ["--yes"] if arguments[0] == "challenge" and typed is None else []
    done = CliRunner().invoke(
        app,
        ["task", "dispute", *arguments, *agreed],
        env={"RODEO_SITE": str(dao.running.path), "COLUMNS": "300"},
        input=typed,
    )
    assert done.exit_code == status, done.output
    return done.output


def task_shown(dao: Dao, task_id: int) -> str:
    environment = {"RODEO_SITE": str(dao.running.path), "COLUMNS": "300"}
    return CliRunner().invoke(app, ["task", "show", str(task_id)], env=environment).output


def fund(dao: Dao, name: str) -> None:
    to = keystores.address(dao.site, name)
    dao.command("panther1", "transfer", to=to, amount_iec="50")


def ended(dao: Dao, task_id: int, name: str) -> None:
    dao.wait_for(lambda: name in dao.names_of(task_id), name)


def decided(dao: Dao, task_id: int) -> None:
    """By the judges of challenges, and nobody appeals."""
    dao.wait_for(lambda: dao.task(task_id)["dispute"]["instance"] == 1, "the decision")
    pass_time(dao, WINDOW_S + 10)
    over(dao, task_id)


def over(dao: Dao, task_id: int) -> None:
    """Paid, and its stakes are settled: the bridge does both, and nobody asks."""
    ended(dao, task_id, "TaskSettled")
    ended(dao, task_id, "CaseSettled")


def show(dao: Dao) -> dict[str, Any]:
    """What the command line shows of the organization."""
    shown: dict[str, Any] = json.loads(organization(dao, "show", "--json"))
    return shown


def stakes(dao: Dao) -> dict[str, float]:
    """What counts for the votes of each oracle, IEC."""
    return {one["name"]: float(one["stake_iec"]) for one in show(dao)["judges"]}


def deposit_stakes(dao: Dao) -> None:
    """What oracles have lost is there again."""
    for name, stake in stakes(dao).items():
        if stake < JUDGE_STAKE:
            organization(dao, "deposit-stake", name, str(JUDGE_STAKE - stake))


def organization(dao: Dao, *arguments: str, status: int = 0) -> str:
    environment = {"RODEO_SITE": str(dao.running.path), "COLUMNS": "300"}
    done = CliRunner().invoke(app, ["organization", *arguments], env=environment)
    assert done.exit_code == status, done.output
    return done.output


def test_oracles_that_agree_leave_time_to_object(dao: Dao, tmp_path: Path) -> None:
    """Real oracles, real work."""
    dao.running.start("oracle.olga", "oracle.otto")
    executor = Executor(dao, Film(dao), tmp_path)
    task_id = executor.assigned()
    attempt = executor.submit(task_id, *stored(executor, task_id))
    dao.wait_for(lambda: "Ruled" in dao.names_of(task_id), "the votes")
    for name in ("oracle.olga", "oracle.otto"):  # neither tries again and again
        dao.running.wait_for_status(name, lambda one: one.details["votes"] == [])
    task = dao.task(task_id)
    assert (task["state"], task["standing"]["ruling"]) == ("ruled", "accepted")
    assert dao.names_of(task_id).count("Ruled") == 1
    dao.set_clock(executor.take.end_s + 5 + WINDOW_S + 10)
    assert executor.verdict(task_id, attempt)["verdict"] == "accepted"
    dao.wait_for(lambda: "TaskSettled" in dao.names_of(task_id), "the payment")
    for name in ("oracle.olga", "oracle.otto"):
        dao.running.kill(name)


def test_a_ruling_is_paid_when_its_window_is_over(dao: Dao) -> None:
    task_id = proven(dao)
    task = rule(dao, task_id)
    assert (task["state"], task["verdict"]) == ("ruled", None)
    assert task["standing"]["ruling"] == "accepted"
    assert task["standing"]["until"] == task["dispute"]["until"]
    assert task["dispute"]["until"] == pytest.approx(Clock.now_s + WINDOW_S, abs=5)
    assert "TaskSettled" not in dao.names_of(task_id)
    pass_time(dao, WINDOW_S + 10)
    over(dao, task_id)
    task = dao.task(task_id)
    assert (task["state"], task["verdict"], task["standing"]) == ("settled", "accepted", None)
    assert task["dispute"]["settled"] is True
    assert index_differences(dao.state, dao.client()) == []


def test_a_ruling_is_overturned_from_the_command_line(dao: Dao, tmp_path: Path) -> None:
    task_id = proven(dao)
    rule(dao, task_id, "rejected")
    before = dao.balances()["panther1"]
    shown = rodeo(dao, "show", str(task_id))
    assert (
        "the oracles" in shown and "rejected" in shown and "report.json" in shown and "rodeo verify" in shown
    )
    challenges = ("challenge", str(task_id), "--reason", "it is in the bin", "--as", "panther1")
    signed = tmp_path / "challenge.json"
    assert "rodeo task relay" in rodeo(dao, *challenges, "--sign", str(signed))
    assert "challenger" not in dao.task(task_id)["dispute"]
    assert dao.task(task_id)["dispute"]["stakes_iec"] == [f"{STAKE:g}", f"{2 * STAKE:g}"]
    for typed in ("n\n", ""):
        said = rodeo(dao, *challenges, status=1, typed=typed)
        assert "takes 20 IEC of panther1" in said and "nothing was sent" in said
    assert "challenger" not in dao.task(task_id)["dispute"]
    assert "20 IEC, lost if the ruling is right" in rodeo(dao, "show", str(task_id))
    # Whoever sends it pays the gas, and the robot the stake.
    dao.command("anna", "relay", signed=json.loads(signed.read_text()))
    assert dao.task(task_id)["dispute"]["challenger"] == keystores.address(dao.site, "panther1")
    assert dao.balances()["panther1"] == before - STAKE
    with pytest.raises(RemoteError) as caught:
        dao.command("anna", "relay", signed=json.loads(signed.read_text()))
    assert caught.value.code == "nonce_used"
    shown = rodeo(dao, "show", str(task_id))
    assert "it is in the bin" in shown and "20 IEC at stake" in shown

    file = str(tmp_path / "votes.json")
    rodeo(dao, "vote", str(task_id), "accepted", "--as", "anna", "--votes", file)
    rodeo(dao, "vote", str(task_id), "rejected", "--as", "bert", "--votes", file)  # alone
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "carl", "--votes", file)
    assert "1 equal vote is missing" in said
    assert dao.task(task_id)["dispute"]["instance"] == 0
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "dora", "--votes", file)
    assert "That was enough" in said and "unless it is challenged again" in said
    shown = rodeo(dao, "show", str(task_id))
    assert "the judges of challenges" in shown and "accepted, 100 IEC" in shown
    decided(dao, task_id)
    task = dao.task(task_id)
    assert (task["verdict"], task["reason"]) == ("accepted", "decided by the judges of challenges")
    assert dao.balances()["panther1"] == before + 100
    transfers = {one["reason"] for one in dao.state("transfers", task_id=task_id)["transfers"]}
    assert {"stake", "stake_paid"} <= transfers
    shown = rodeo(dao, "show", str(task_id))
    for said in (
        "the oracles ruled rejected: olga, otto voted for it",
        "panther1 challenged that with 20 IEC at stake: it is in the bin",
        "the judges of challenges ruled accepted, 100 IEC: anna, carl, dora voted for it",
        "olga lost 10 IEC for a ruling that was overturned",
        "panther1 got 20 IEC of the stakes",
        "the treasury got 20 IEC of the stakes",
        "the case was closed",
    ):
        assert said in shown and said in task_shown(dao, task_id)
    # Who voted for what was overturned pays the treasury, and does not vote until somebody adds to its stake.
    assert stakes(dao) == {"olga": 0.0, "otto": 0.0, "omar": JUDGE_STAKE}
    paid = [
        one["amount_iec"]
        for one in dao.state("transfers", task_id=task_id)["transfers"]
        if one["to"] == dao.state("organization")["address"] and one["reason"] == "stake_paid"
    ]
    assert [float(one) for one in paid] == [2 * JUDGE_STAKE]
    task_id = submitted(dao)
    with pytest.raises(RemoteError) as refused:
        rule(dao, task_id)
    assert refused.value.code == "stake_too_low"
    assert f"stake 0 IEC of {JUDGE_STAKE} IEC, so that its votes do not count" in organization(dao, "show")
    deposit_stakes(dao)
    assert set(stakes(dao).values()) == {JUDGE_STAKE}
    assert "do not count" not in organization(dao, "show")
    rule(dao, task_id)
    pass_time(dao, WINDOW_S + 10)
    over(dao, task_id)
    assert "settled" in rodeo(dao, "show", str(task_id))


def test_an_appeal_overturns_the_judges_of_challenges(
    dao: Dao, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where the files of votes are by default
    task_id = proven(dao)
    rule(dao, task_id, "rejected")
    before = dao.balances()["panther1"]
    rodeo(dao, "challenge", str(task_id), "--reason", "it is in the bin", "--as", "panther1")
    for name in JUDGES[:3]:
        rodeo(dao, "vote", str(task_id), "rejected", "--as", name)
    assert "the judges of challenges" in rodeo(dao, "show", str(task_id))
    rodeo(dao, "challenge", str(task_id), "--reason", "it is still there", "--as", "panther1")
    assert dao.balances()["panther1"] == before - STAKE - 2 * STAKE
    assert "not_a_judge" in rodeo(dao, "vote", str(task_id), "accepted", "--as", "anna", status=1)
    for name in APPEAL[:3]:
        said = rodeo(dao, "vote", str(task_id), "accepted", "--as", name)
    assert "1 equal vote is missing in appeal-" in said
    assert "That was enough" in rodeo(dao, "vote", str(task_id), "accepted", "--as", APPEAL[3])
    over(dao, task_id)
    task = dao.task(task_id)
    assert (task["verdict"], task["reason"]) == ("accepted", "decided by the judges of the appeal")
    assert dao.balances()["panther1"] == before + 100

    # The judges of challenges lost their stakes, and vote again when somebody has deposited.
    task_id = proven(dao)
    rule(dao, task_id, "rejected")
    rodeo(dao, "challenge", str(task_id), "--reason", "it is in the bin", "--as", "panther1")
    assert "stake_too_low" in rodeo(dao, "vote", str(task_id), "accepted", "--as", "anna", status=1)
    for name in JUDGES[:3]:
        organization(dao, "deposit-stake", name, str(JUDGE_STAKE))
        rodeo(dao, "vote", str(task_id), "accepted", "--as", name)
    decided(dao, task_id)


def test_a_judge_who_takes_its_stake_back_holds_up_no_other(dao: Dao, tmp_path: Path) -> None:
    """The contract's error names its seat, and refuses all votes that come with its own."""
    task_id = proven(dao)
    rule(dao, task_id, "rejected")
    rodeo(dao, "challenge", str(task_id), "--reason", "it is in the bin", "--as", "panther1")
    file = str(tmp_path / "votes.json")
    rodeo(dao, "vote", str(task_id), "accepted", "--as", "bert", "--votes", file)
    organization(dao, "announce-withdrawal", "bert", str(JUDGE_STAKE), "--as", "bert")
    rodeo(dao, "vote", str(task_id), "accepted", "--as", "anna", "--votes", file)
    # One vote too few without it: who posts hears why.
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "carl", "--votes", file, status=1)
    assert "stake_too_low" in said
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "dora", "--votes", file)
    assert (
        f"The vote of {keystores.address(dao.site, 'bert')} in {file} does not count: stake_too_low" in said
    )
    assert "That was enough" in said
    decided(dao, task_id)
    organization(dao, "deposit-stake", "bert", str(JUDGE_STAKE))


def test_a_judges_owner_takes_its_stake_back(dao: Dao) -> None:
    said = organization(dao, "announce-withdrawal", "omar", "2", "--as", "mallory", status=1)
    assert "not_owner" in said
    organization(dao, "announce-withdrawal", "omar", "2", "--as", "omar")
    assert stakes(dao)["omar"] == JUDGE_STAKE - 2
    (omar,) = (one for one in show(dao)["judges"] if one["name"] == "omar")
    assert float(omar["leaving_iec"]) == 2 and omar["leaving_until_s"] > Clock.now_s
    assert "2 IEC leave after" in organization(dao, "show")
    assert "withdrawal_too_early" in organization(dao, "withdraw-stake", "omar", status=1)
    deposit_stakes(dao)
    assert stakes(dao)["omar"] == JUDGE_STAKE


def test_who_challenges_what_is_right_pays_the_other(dao: Dao, tmp_path: Path) -> None:
    task_id = proven(dao)
    rule(dao, task_id)
    before = dao.balances()["panther1"]
    # An operator stands for the organization, which posted the task; its key pays.
    fund(dao, "anna")
    rodeo(dao, "challenge", str(task_id), "--reason", "I do not believe it", "--as", "anna")
    assert dao.task(task_id)["dispute"]["challenger"] == keystores.address(dao.site, "anna")
    file = str(tmp_path / "votes.json")
    for name in ("bert", "carl", "dora"):
        rodeo(dao, "vote", str(task_id), "accepted", "--as", name, "--votes", file)
    decided(dao, task_id)
    assert dao.balances()["panther1"] == before - 50 + STAKE + 100


@pytest.fixture(scope="module")
def desk(dao: Dao) -> Iterator[Desk]:
    dao.running.start("console")
    with chromium(three_d=False) as browser:
        desk = Desk(dao.running, browser)
        for person, participant in (("olli", "panther1"), ("bea", "bert")):
            desk.accounts.add_user(person, PASSPHRASE, [Role.EXECUTOR], participant)
        yield desk


@pytest.mark.parametrize(
    ("person", "participant", "first"), [("olli", "panther1", "rejected"), ("bea", "bert", "accepted")]
)
def test_a_party_and_a_judge_challenge_in_the_console(
    dao: Dao, desk: Desk, tmp_path: Path, person: str, participant: str, first: str
) -> None:
    if participant != "panther1":
        fund(dao, participant)
    task_id = proven(dao)
    rule(dao, task_id, first)
    before = dao.balances()["panther1"]
    page = desk.page(person, f"/tasks/{task_id}")
    said = "accepted, 100 IEC" if first == "accepted" else first
    expect(page.get_by_text(f"{said}; it can be challenged until")).to_be_visible()
    page.get_by_role("button", name="Challenge").click()
    asked = page.get_by_role("dialog")
    expect(asked.get_by_text(f"{participant} loses 20 IEC if it is right")).to_be_visible()
    asked.get_by_label("Why it is wrong").fill("the bin shows something else")
    asked.get_by_role("button", name="Challenge").click()
    expect(
        page.get_by_text("challenged: the bin shows something else; it stands unless the judges decide by")
    ).to_be_visible()
    assert dao.task(task_id)["dispute"]["challenger"] == keystores.address(dao.site, participant)
    expect(page.get_by_role("button", name="Challenge")).to_have_count(0)
    file = str(tmp_path / "votes.json")
    for name in ("anna", "carl", "dora"):
        rodeo(dao, "vote", str(task_id), "accepted", "--as", name, "--votes", file)
    decided(dao, task_id)
    expect(page.locator(".page-head .badge")).to_have_text("settled")
    story = page.get_by_role("list", name="Story of the dispute")
    expect(story.get_by_text(f"{participant} challenged that with 20 IEC at stake")).to_be_visible()
    expect(story.get_by_text("panther1 got 20 IEC of the stakes")).to_be_visible()
    with desk.client("reader") as client:
        told = client.get(f"/tasks/{task_id}/dispute").json()
    assert [one["who"] for one in told if one["what"] == "challenged"] == [[participant]]
    # Whoever was wrong pays the other.
    assert dao.balances()["panther1"] == before + 100 + (0 if first == "rejected" else STAKE)


def test_silent_judges_leave_the_ruling_and_give_the_stake_back(dao: Dao) -> None:
    task_id = proven(dao)
    rule(dao, task_id)
    fund(dao, "bert")
    before = dao.balances()["bert"]
    rodeo(dao, "challenge", str(task_id), "--reason", "no", "--as", "bert")
    pass_time(dao, DECISION_S + 10)
    over(dao, task_id)
    assert dao.balances()["bert"] == before


def forged(dao: Dao, signed: dict[str, Any]) -> str:
    """The vote with the signature of somebody who is no judge."""
    chain = dao.state("chain")
    committee = chain["contracts"]["DisputeCommittee"]
    key = wallets.load(dao.site, "mallory")
    return votes.sign(Vote.model_validate(signed["vote"]), key, chain["chain_id"], committee, IEC)


def test_votes_that_do_not_count_in_the_file_keep_nobody_from_deciding(dao: Dao, tmp_path: Path) -> None:
    task_id = proven(dao)
    rule(dao, task_id, "rejected")
    rodeo(dao, "challenge", str(task_id), "--reason", "it is in the bin", "--as", "panther1")
    file = tmp_path / "votes.json"
    voted = ("--votes", str(file))
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "mallory", *voted, status=1)
    assert "not_a_judge" in said and not file.exists()
    rodeo(dao, "vote", str(task_id), "rejected", "--as", "anna", *voted)
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "anna", *voted)  # thinks again
    assert "2 equal votes are missing" in said
    held = json.loads(file.read_text())
    assert [one["vote"]["ruling"] for one in held] == ["accepted"]
    nobodys = {**held[0], "signature": "0x" + "0" * 128}
    file.write_text(json.dumps([{**held[0], "signature": forged(dao, held[0])}, nobodys, *held]))
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "bert", *voted)
    assert "does not count: not_a_judge" in said and "1 equal vote is missing" in said
    said = rodeo(dao, "vote", str(task_id), "accepted", "--as", "carl", *voted)
    assert "That was enough" in said
    decided(dao, task_id)


def test_a_file_of_votes_that_cannot_be_used_is_named(dao: Dao, tmp_path: Path) -> None:
    task_id = proven(dao)
    rule(dao, task_id)
    vote = ("vote", str(task_id), "accepted", "--as", "anna", "--votes")
    said = rodeo(dao, *vote, str(tmp_path / "no folder" / "votes.json"), status=1)
    assert "the file cannot be written" in said and "No such file" in said
    other = tmp_path / "other.json"
    other.write_text("hello")
    said = rodeo(dao, *vote, str(other), status=1)
    assert "not a file of votes" in said and "pydantic" not in said
    assert other.read_text() == "hello"
    pass_time(dao, WINDOW_S + 10)
    ended(dao, task_id, "TaskSettled")


def test_what_cannot_be_challenged_is_refused(dao: Dao) -> None:
    task_id = proven(dao)

    def refused(who: str, name: str, **request: Any) -> str:
        with pytest.raises(RemoteError) as caught:
            dao.command(who, name, **request)
        return caught.value.code

    assert refused("panther1", "challenge", task_id=task_id, reason="no") == "no_dispute"
    assert refused("panther1", "challenge", task_id=4711, reason="no") == "unknown_task"
    rule(dao, task_id)
    assert refused("mallory", "challenge", task_id=task_id, reason="no") == "insufficient_funds"
    fund(dao, "mallory")
    assert refused("mallory", "challenge", task_id=task_id, reason="no") == "neither_party_nor_judge"
    assert refused("mallory", "conclude", task_id=task_id) == "ruling_stands"
    assert refused("mallory", "settle_stakes", task_id=task_id, attempt=1) == "window_not_over"
    assert refused("mallory", "settle_stakes", task_id=task_id, attempt=2) == "no_case"
    assert refused("anna", "sign_vote", task_id=task_id, ruling="undecided") == "invalid_request"
    signed = dao.command("anna", "sign_vote", task_id=task_id, ruling="rejected")
    early = {"vote": signed["vote"], "report_uri": "", "signatures": [signed["signature"]]}
    assert refused("anna", "post_votes", **early) == "not_challenged"
    with pytest.raises(RemoteError) as caught:
        dao.command("panther1", "challenge", task_id=task_id, reason="more")
    assert caught.value.code == "can_only_lose" and "full price" in caught.value.message
    assert caught.value.details["stake_iec"] == f"{STAKE:g}"
    for judge in ("anna", "bert"):
        fund(dao, judge)
    stale: dict[str, Any] = {"attempt": 1, "instance": 1, "stake_iec": f"{2 * STAKE:g}"}
    assert refused("anna", "challenge", task_id=task_id, reason="more", **stale) == "another_ruling"
    agreed: dict[str, Any] = {"attempt": 1, "instance": 0, "stake_iec": f"{STAKE:g}"}
    dao.command("anna", "challenge", task_id=task_id, reason="more", **agreed)
    assert refused("bert", "challenge", task_id=task_id, reason="no") == "challenged_before"
    assert refused("anna", "post_votes", **early) == "too_few_votes"
    assert refused("mallory", "sign_vote", task_id=task_id, ruling="rejected") == "not_a_judge"
    false = {**early, "signatures": [signed["signature"], forged(dao, signed), signed["signature"]]}
    assert refused("anna", "post_votes", **false) == "not_a_judge"
    pass_time(dao, DECISION_S + 10)
    ended(dao, task_id, "TaskSettled")


def test_everybody_sees_the_judges_of_challenges_and_what_they_have_at_stake(dao: Dao) -> None:
    first, second = show(dao)["committees"]
    for committee, name, judges, needed in (
        (first, "DisputeCommittee", JUDGES, 3),
        (second, "AppealCommittee", APPEAL, 4),
    ):
        assert committee["name"] == name
        assert [(one["seat"], one["name"]) for one in committee["judges"]] == list(enumerate(judges))
        kinds = {one["kind"]: (one["votes"], one["seats"]) for one in committee["kinds"]}
        assert kinds["waste_disposal"] == (needed, [0, 1, 2, 3])
    before = first["judges"][3]
    organization(dao, "deposit-stake", "dora", "2")
    first, second = show(dao)["committees"]
    added = float(first["judges"][3]["stake_iec"]) - float(before["stake_iec"])
    assert added == 2 and first["judges"][3]["leaving_iec"] == "0"
    shown = organization(dao, "show")
    assert "judge of challenges in seat 3" in shown and "judge of the appeal in seat 0" in shown
    (dora,) = [line for line in shown.splitlines() if "dora" in line]
    assert f"stake {float(first['judges'][3]['stake_iec']):g} IEC" in dora
