"""What commands print for programs: one JSON document with `--json`, plain whole lines into a pipe."""

from __future__ import annotations

import io
import json
import os
import pty
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo.access.accounts import Accounts, accounts_path
from rodeo.access.roles import Role
from rodeo.bus.messages import Status
from rodeo.errors import RemoteError
from rodeo.site.config import Site
from rodeo.site.processes import processes_of
from rodeo_cli import (
    app,
    budget_votes,
    common,
    organization,
    people,
    proposals,
    robot,
    services,
    tasks,
    verify,
)
from rodeo_cli import site as site_commands
from rodeo_testing import answers
from rodeo_testing.waiting import HANG_S
from tests.support.command import tree
from tests.support.site import LAB, write_site

ACTS = {
    "rodeo deploy systemd", "rodeo deploy compose", "rodeo ros2 relay",
    "rodeo ros2 session", "rodeo proof export", "rodeo proof plot", "rodeo init", "rodeo site remove",
    "rodeo up", "rodeo down", "rodeo demo", "rodeo experiment paper",
    "rodeo experiment ablation", "rodeo pool start", "rodeo pool worker",
    "rodeo site prepare", "rodeo kind new", "rodeo bin correct", "rodeo seen say",
    "rodeo task accept", "rodeo task abandon", "rodeo task submit", "rodeo task judge", "rodeo task cancel",
    "rodeo task revoke", "rodeo task allow-payments",
    "rodeo task dispute challenge", "rodeo task dispute vote", "rodeo task dispute settle",
    "rodeo task conclude", "rodeo task match", "rodeo service agree", "rodeo service set-namers",
    "rodeo service offer", "rodeo service price", "rodeo service pause", "rodeo service resume",
    "rodeo service withdraw", "rodeo service payout",
    "rodeo console create-admin", "rodeo console create", "rodeo console passphrase", "rodeo console token",
    "rodeo console link",
    *(f"rodeo robot {order}" for order in robot.ORDERS),
    *(f"rodeo organization {change}" for change in (
        "policy", "kind", "terms", "members-only", "admit", "dismiss", "vouch", "grant", "revoke", "suspend",
        "suspend-provider", "reinstate-provider",
        "reinstate", "rescue", "deposit", "withdraw", "register-device", "sign-device", "revoke-device",
        "instances",
        "retire-rules", "budget", "pause", "resume", "vote", "queue", "execute", "cancel", "judge-key",
        "seat", "unseat", "quorum", "remove-judge", "sign-seat",
        "deposit-stake", "announce-withdrawal", "withdraw-stake", "vote-budget", "pay-budget",
    )),
    *(f"rodeo organization propose {change}" for change in (
        "policy", "kind", "terms", "members-only", "admit", "dismiss", "vouch", "grant", "revoke", "suspend",
        "suspend-provider", "reinstate-provider",
        "reinstate", "rescue", "register-device", "revoke-device", "retire-rules", "budget",
        "instances", "resume",
        "price", "judge-key", "remove-judge", "seat", "unseat", "quorum", "hand-over", "delay", "budget-vote",
    )),
}  # fmt: skip
"""Commands that change something and list nothing."""

ALICE, KEY = "0x" + "a1" * 20, "0x" + "c3" * 20
DESCRIPTION = "Clean the whole floor below the long table, " * 8 + "then the rest"
TASK: dict[str, Any] = {
    "id": 12, "kind": "wheel_cleaning", "state": "failed", "attempt": 3, "max_attempts": 3,
    "creator": ALICE, "creator_name": "alice_of_the_northern_workshop" * 3, "executor": None,
    "executor_name": None, "reward_iec": "100", "paid_iec": "0", "refunded_iec": "100", "price_iec": None,
    "accepted": None, "verdict": "rejected", "reason": "the item does not rise in the gripper, " * 6,
    "description": DESCRIPTION,
    "params": {}, "execution_deadline": None, "verdict_deadline": None, "case_end": None,
    "fault": None, "standing": None, "passed": [], "passed_on": False,
    "judge": "auditor", "judge_removed": False,
    "service_id": None, "requested_service_id": None, "requested_provider": None,
    "requested_provider_name": None,
    "registered": 1.0, "assigned": None, "proof_submitted": None, "settled": None,
    "execution_window_s": 60, "verdict_window_s": 60, "grace_s": 20, "proof_sha256": None,
    "rules_sha256": None,
    "proof_uri": None, "report_sha256": None, "report_uri": None, "nonce": None, "dispute": None,
}  # fmt: skip
OFFER = {
    "id": 1, "kind": "waste_disposal", "provider": ALICE, "provider_name": "alice", "price_iec": "5",
    "state": "active", "description": "", "auto_accept": True, "task_id": None, "agrees": True,
    "set_aside_iec": "0",
    "completed": 0, "rejected": 0,
    "expired": 0,
    "bond_iec": "0", "penalty_iec": "0", "max_failures": 0, "failures": 0, "asleep_until": None, "place": 1,
    "reputation": 32, "proven": False, "vouched": False, "rests_until": None, "bond_locked_until": None,
    "stood_back": False, "namers": "proven", "max_void_percent": 0,
}  # fmt: skip
PROPOSAL = {
    "number": 1, "id": "0x" + "1d" * 32, "proposer": ALICE, "proposer_name": "alice", "description": "a bond",
    "calls": [{"contract": "Organization", "function": "setTerms", "args": {"terms": {"bond": 1}}}],
    "state": "active", "created_s": 1.0, "vote_end_s": 9.0, "ready_s": None,
    "votes": {"against": 0, "for": 1, "abstain": 0},
    "ballots": [{"voter": ALICE, "voter_name": "alice", "support": "for", "weight": 1}],
}  # fmt: skip
BUDGET_VOTE = {
    "number": 0, "state": "open", "amount_iec": "100", "opened_s": 1.0, "end_s": 9.0, "credits": 100,
    "recipients": [
        {"address": KEY, "name": "carla", "votes": 16, "share_iec": "80", "paid_iec": None},
        {"address": ALICE, "name": None, "votes": 4, "share_iec": "20", "paid_iec": None},
    ],
    "ballots": [{"voter": ALICE, "voter_name": "alice", "votes": [6, 4], "credits_used": 52}],
}  # fmt: skip
REPLIES: dict[str, dict[str, Any]] = {
    "tasks": {"tasks": [TASK], "total": 1},
    "task/12": TASK,
    "services": {"services": [OFFER], "total": 1},
    "wallets": answers.wallets({"alice": ALICE}),
    "organization": answers.organization(audited=["wheel_cleaning"]) | {"roles": {"AUDITOR_ROLE": []}},
    "devices": {"devices": [{"role": "bin", "name": "itrash", "owner": ALICE, "owner_name": "alice",
                             "address": KEY, "registered": 1.0, "revoked": None, "revoked_because": None}]},
    "roots": answers.roots([{"day": 3, "device": KEY, "root": "0x" + "d4" * 32, "uri": "file:///roots/3"}]),
    "state": {"robot": "panther1", "activity": "cleaning", "progress": 0.4, "soc": 0.5, "paused": False},
    "proposals": {"proposals": [PROPOSAL], "total": 1},
    "budget_votes": {"budget_votes": [BUDGET_VOTE], "total": 1},
    "transactions": {"transactions": [], "total": 0},
}  # fmt: skip


def leaves(group: Any, path: str = "rodeo") -> Iterator[tuple[str, set[str]]]:
    """Each command with its options."""
    for name, one in group.commands.items():
        if hasattr(one, "commands"):
            yield from leaves(one, f"{path} {name}")
        else:
            yield f"{path} {name}", {option for parameter in one.params for option in parameter.opts}


def test_every_command_that_lists_something_has_json() -> None:
    found = dict(leaves(tree()))
    assert found.keys() >= ACTS
    assert [name for name, options in found.items() if "--json" not in options and name not in ACTS] == []


@pytest.fixture
def piped(monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands print into a pipe, whatever the tests themselves print on."""
    plain = common.console_on(io.StringIO())
    for module in (common, site_commands, verify):
        monkeypatch.setattr(module, "console", plain)


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch, piped: None) -> dict[str, dict[str, Any]]:
    """What the bridge and the robots answer, to be changed."""
    replies = json.loads(json.dumps(REPLIES))

    def query(key: str, *_request: Any, **_more: Any) -> Any:
        return next(reply for what, reply in replies.items() if key.endswith(f"/{what}"))

    @contextmanager
    def connected(_site: Path) -> Iterator[tuple[Site, Any]]:
        yield (
            Site.load(LAB),
            SimpleNamespace(query=query, subscribe_bytes=lambda *_: SimpleNamespace(undeclare=lambda: None)),
        )

    for module in (tasks, services, organization, proposals, budget_votes, robot):
        monkeypatch.setattr(module, "connected", connected)
    return replies  # type: ignore[no-any-return]


LISTINGS = {
    "task list": "tasks",
    "task show 12": "task/12",
    "service list": "services",
    "organization show": "organization",
    "organization devices": "devices",
    "organization roots": "roots",
    "organization proposals": "proposals",
    "organization budget-votes": "budget_votes",
    "robot state panther1": "state",
}


@pytest.mark.parametrize("command", LISTINGS)
def test_json_is_the_whole_reply_and_nothing_else(answered: dict[str, dict[str, Any]], command: str) -> None:
    done = CliRunner().invoke(app, [*command.split(), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout) == answered[LISTINGS[command]]


def test_wallets_are_a_list_and_one_of_them_an_object(answered: dict[str, dict[str, Any]]) -> None:
    everyone = answered["wallets"]["wallets"]
    assert json.loads(CliRunner().invoke(app, ["wallet", "--json"]).stdout) == everyone
    assert json.loads(CliRunner().invoke(app, ["wallet", "alice", "--json"]).stdout) == everyone[0]


def test_an_empty_listing_is_json_too(answered: dict[str, dict[str, Any]]) -> None:
    answered["roots"] = {"roots": [], "total": 0}
    assert (
        json.loads(CliRunner().invoke(app, ["organization", "roots", "--json"]).stdout) == answered["roots"]
    )


def test_an_empty_listing_is_a_sentence_and_no_bare_header(answered: dict[str, dict[str, Any]]) -> None:
    answered["roots"] = {"roots": [], "total": 0}
    assert "day" not in CliRunner().invoke(app, ["organization", "roots"]).stdout
    answered["services"] = {"services": [], "total": 0}
    assert CliRunner().invoke(app, ["service", "list"]).stdout.strip() == "There are none."


def test_a_report_has_one_form(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["report", "--csv", "--json", "--site", str(LAB)])
    assert done.exit_code == 1 and "name one of --json, --csv and --html" in done.output


@pytest.mark.parametrize("command", [*LISTINGS, "wallet"])
def test_into_a_pipe_nothing_is_folded_or_cut_at_any_width(
    answered: dict[str, dict[str, Any]], command: str
) -> None:
    narrow = CliRunner().invoke(app, command.split(), env={"COLUMNS": "20", "FORCE_COLOR": "1"})
    wide = CliRunner().invoke(app, command.split(), env={"COLUMNS": "5000"})
    assert narrow.exit_code == 0, narrow.output
    assert narrow.stdout == wide.stdout != ""
    assert "…" not in narrow.stdout and "\x1b" not in narrow.stdout


def test_a_long_name_a_long_reason_and_a_long_description_stay_on_their_lines(
    answered: dict[str, dict[str, Any]],
) -> None:
    header, row, reason, total = CliRunner().invoke(app, ["task", "list"]).stdout.splitlines()
    assert header.split()[0] == "id" and TASK["creator_name"] in row
    assert reason.strip() == f"rejected: {TASK['reason']}".strip() and total == "1 of 1 task"
    assert DESCRIPTION in CliRunner().invoke(app, ["task", "show", "12"]).stdout


def test_a_service_that_has_not_agreed_to_the_judge_says_what_to_do(
    answered: dict[str, dict[str, Any]],
) -> None:
    offer = OFFER | {"agrees": False, "set_aside_iec": "2"}
    answered["services"] = {"services": [offer], "total": 1}
    said = CliRunner().invoke(app, ["service", "list"]).stdout
    assert "`rodeo service agree 1`" in said and "2 IEC of its bond are set aside" in said


def test_a_service_that_stands_back_says_why_until_when_its_provider_rests_and_who_may_name_it(
    answered: dict[str, dict[str, Any]],
) -> None:
    offer = OFFER | {"stood_back": True, "rests_until": 4e9, "namers": "anybody", "max_void_percent": 20}
    answered["services"] = {"services": [offer], "total": 1}
    status = {"process": "robot_sim", "pid": 1, "ready": True, "reason": "", "activity": ""}
    answered["robot_sim"] = status | {"progress": None, "since_s": 1.0, "time_s": 1.0}
    said = CliRunner().invoke(app, ["service", "list"]).stdout
    assert "newcomer; rests until 2096-10-02 07:06:40 (simulated time)" in said
    assert "stands back: its provider rests" in said
    assert "anybody may name it, unless over 20 % of their tasks end void" in said


@pytest.mark.parametrize(
    ("given", "ruling", "fault"),
    [
        (["--accept"], "accepted", "nobody"),
        (["--given-up"], "given_up", "nobody"),
        (["--void", "creator"], "void", "creator"),
    ],
)
def test_an_auditor_gives_one_ruling(
    monkeypatch: pytest.MonkeyPatch, answered: Any, given: list[str], ruling: str, fault: str
) -> None:
    ruled: list[Any] = []
    monkeypatch.setattr(people, "connected", tasks.connected)
    monkeypatch.setattr("rodeo.person.statement.judge", lambda *told: ruled.append(told[2:]))
    command = ["task", "judge", "12", "--reason", "so it is"]
    assert "give one ruling" in CliRunner().invoke(app, [*command, *given, "--impossible"]).output
    assert "whose doing" in CliRunner().invoke(app, [*command, "--void", "me"]).output
    assert ruled == []
    done = CliRunner().invoke(app, [*command, *given])
    assert ruled == [(12, ruling, "so it is", None, fault)], done.output


@pytest.mark.parametrize(("named", "shown"), [(None, []), (7, [["named", "service", "7"]])])
def test_a_task_says_which_service_it_names(
    answered: dict[str, dict[str, Any]], monkeypatch: pytest.MonkeyPatch, named: int | None, shown: list[str]
) -> None:
    monkeypatch.setitem(answered, "task/12", TASK | {"requested_service_id": named})
    lines = CliRunner().invoke(app, ["task", "show", "12"]).stdout.splitlines()
    assert [line.split() for line in lines if line.startswith("named service")] == shown


@pytest.mark.parametrize(("name", "shown"), [("alice", "alice"), (None, f"{ALICE[:8]}…")])
def test_a_task_says_which_provider_it_names(
    answered: dict[str, dict[str, Any]], monkeypatch: pytest.MonkeyPatch, name: str | None, shown: str
) -> None:
    named = {"requested_provider": ALICE, "requested_provider_name": name}
    monkeypatch.setitem(answered, "task/12", TASK | named)
    lines = CliRunner().invoke(app, ["task", "show", "12"]).stdout.splitlines()
    assert [line.split()[2] for line in lines if line.startswith("named provider")] == [shown]


def test_votes_are_numbers_of_members(answered: dict[str, dict[str, Any]]) -> None:
    votes = {"for": 2, "against": 1, "abstain": 0}
    answered["proposals"]["proposals"][0] |= {"votes": votes}
    assert "2 / 1 / 0" in CliRunner().invoke(app, ["organization", "proposals"]).stdout
    told = json.loads(CliRunner().invoke(app, ["organization", "proposals", "--json"]).stdout)
    assert told["proposals"][0]["votes"] == votes


def quorum_of(kind: str, number: int, state: str) -> dict[str, Any]:
    call = {"contract": "OracleCommittee", "function": "setQuorum", "args": {"kind": kind, "judges": 3}}
    return {**PROPOSAL, "number": number, "state": state, "calls": [call]}


@pytest.mark.parametrize(
    ("before", "warned"),
    [
        (quorum_of("waste_disposal", 4, "waiting"), True),
        (quorum_of("waste_disposal", 4, "ready"), True),
        (quorum_of("waste_disposal", 4, "executed"), False),
        (quorum_of("waste_disposal", 4, "canceled"), False),
        (quorum_of("battery_charging", 4, "waiting"), False),
        ({**PROPOSAL, "number": 4, "state": "waiting"}, False),
    ],
)
def test_a_quorum_that_undoes_a_pending_one_is_proposed_with_a_warning_that_names_it(
    answered: dict[str, dict[str, Any]], before: dict[str, Any], warned: bool
) -> None:
    answered["proposals"] |= {"proposals": [quorum_of("waste_disposal", 5, "waiting"), before], "total": 2}
    answered["wallet/organization/propose"] = {"proposal": 5}
    done = CliRunner().invoke(
        app, ["organization", "propose", "--why", "he left", "unseat", "carl"], env={"COLUMNS": "300"}
    )
    assert done.exit_code == 0 and "Proposal 5" in done.stdout
    told = f"proposal 4 ({before['state']}) sets the judges of waste_disposal, too" in done.stdout
    assert told is warned


@pytest.mark.parametrize(
    ("member", "told"),
    [
        ("alice", "alice has given 52 of 100 credits: carla 6, 0xa1a1a1a1…a1a1a1 4"),
        ("bob", "bob has given none of 100 credits"),
    ],
)
def test_a_budget_vote_shows_who_gets_what_and_what_a_member_has_given(
    answered: dict[str, dict[str, Any]], member: str, told: str
) -> None:
    done = CliRunner().invoke(app, ["organization", "budget-votes", "--as", member])
    header, first, second, note = done.stdout.splitlines()
    assert header.split() == ["no.", "state", "amount", "when", "recipient", "votes", "share"]
    assert first.split()[:4] == ["0", "open", "100", "IEC"] and "vote until" in first
    assert first.split()[-4:] == ["carla", "16", "80", "IEC"]
    assert second.split() == [ALICE, "4", "20", "IEC"] and note.strip() == told


@pytest.mark.parametrize("votes", ["carla", "carla=", "=5", "carla=-1", "carla=1.5", "carla=²", "carla=x"])
def test_votes_for_a_budget_that_cannot_be_read_are_refused_with_what_was_given(
    answered: dict[str, dict[str, Any]], votes: str
) -> None:
    done = CliRunner().invoke(app, ["organization", "vote-budget", "0", votes])
    assert done.exit_code == 1 and f"given: {votes}" in done.output
    twice = CliRunner().invoke(app, ["organization", "vote-budget", "0", "carla=1", "carla=2"])
    assert twice.exit_code == 1 and "a recipient is named twice" in twice.output


def test_a_share_that_cannot_be_paid_keeps_no_other_waiting(
    answered: dict[str, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    answered["budget_votes"]["budget_votes"][0]["state"] = "ended"
    paid: list[str] = []

    def query(key: str, request: Any = None, **_more: Any) -> Any:
        if key.endswith("/budget_votes"):
            return answered["budget_votes"]
        assert key.endswith("/wallet/bob/pay_budget_share")
        if request["recipient"] == KEY:
            raise RemoteError("insufficient_funds", "the account's balance is too low for this", {})
        paid.append(request["recipient"])
        return {}

    @contextmanager
    def connected(_site: Path) -> Iterator[tuple[Site, Any]]:
        yield (
            Site.load(LAB),
            SimpleNamespace(query=query, subscribe_bytes=lambda *_: SimpleNamespace(undeclare=lambda: None)),
        )

    monkeypatch.setattr(budget_votes, "connected", connected)
    done = CliRunner().invoke(app, ["organization", "pay-budget", "0", "--as", "bob"])
    assert paid == [ALICE] and done.exit_code == 1
    assert "was paid 20 IEC" in done.output and "insufficient_funds" in done.output
    answered["budget_votes"]["budget_votes"][0]["recipients"] = []
    nothing = CliRunner().invoke(app, ["organization", "pay-budget", "0", "--as", "bob"])
    assert nothing.exit_code == 0 and "There is nothing to pay of budget vote 0." in nothing.output
    answered["budget_votes"]["budget_votes"] = []
    unknown = CliRunner().invoke(app, ["organization", "pay-budget", "3", "--as", "bob"])
    assert unknown.exit_code == 1 and "no such budget vote" in unknown.output


def test_what_others_wrote_does_not_steer_the_terminal(answered: dict[str, dict[str, Any]]) -> None:
    answered["tasks"]["tasks"][0] |= {"creator_name": "eve\x1b[2J\x1b[31m\n7", "reason": "a\x1b]0;title\x07"}
    shown = CliRunner().invoke(app, ["task", "list"]).stdout
    assert "\x1b" not in shown and "\x07" not in shown and "eve�[2J�[31m 7" in shown
    assert len(shown.splitlines()) == 4


def test_a_role_that_nobody_has_says_so(answered: dict[str, dict[str, Any]]) -> None:
    shown = CliRunner().invoke(app, ["organization", "show"]).stdout.splitlines()
    assert ["auditors", "nobody"] in [line.split() for line in shown]


def test_suspended_providers_are_named(answered: dict[str, dict[str, Any]]) -> None:
    answered["organization"]["suspended_providers"] = [{"address": ALICE, "name": "carla"}]
    shown = CliRunner().invoke(app, ["organization", "show"]).stdout.splitlines()
    assert ["suspended", "provider", "carla"] in [line.split() for line in shown]


@pytest.mark.parametrize(("terminal", "shown"), [(False, " 40%"), (True, "━━━━━━")])
def test_progress_is_a_number_in_a_pipe_and_a_bar_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, terminal: bool, shown: str
) -> None:
    monkeypatch.setattr(site_commands, "console", SimpleNamespace(is_terminal=terminal, width=200))
    now_s = time.time()
    status = Status(
        process="oracle", pid=1, ready=True, reason="", activity="verifying", progress=0.4,
        since_s=now_s, time_s=now_s,
    )  # fmt: skip
    cell = site_commands.table_row(site_commands.Row("oracle", "ready", status=status)).cells[3]
    assert shown in f" {cell}" and ("━" in cell) is terminal


# -- sites, accounts and processes, as their commands find them ------------------------------------------


def test_findings_about_a_site_file_are_json_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f'extends = "{LAB}"\ndata_dir = "data"\nclock.sped = 1\n')
    done = CliRunner().invoke(app, ["site", "check", str(path), "--json"])
    (finding,) = json.loads(done.stdout)["findings"]
    assert done.exit_code == 1 and json.loads(done.stdout)["site_file"] == str(path)
    assert {name: finding[name] for name in ("severity", "file", "line", "place")} == {
        "severity": "error", "file": str(path), "line": 3, "place": "clock.sped"
    }  # fmt: skip
    assert finding["text"]


def test_a_site_file_without_findings_is_json_and_no_failure() -> None:
    done = CliRunner().invoke(app, ["site", "check", str(LAB), "--json"])
    assert done.exit_code == 0 and json.loads(done.stdout)["findings"] == []


def test_accounts_of_the_console_are_a_table_or_json(tmp_path: Path, piped: None) -> None:
    path = write_site(tmp_path)
    site = Site.load(path)
    accounts = Accounts(accounts_path(site), site.console)
    accounts.add_user("ada", "correct horse battery", [Role.OPERATOR, Role.AUDITOR])
    done = CliRunner().invoke(app, ["console", "list", "--site", str(path), "--json"])
    assert json.loads(done.stdout) == [
        {"name": "ada", "roles": ["auditor", "operator"], "participant": None, "disabled": False}
    ]
    shown = CliRunner().invoke(app, ["console", "list", "--site", str(path)]).stdout.splitlines()
    assert [line.split() for line in shown] == [["name", "roles"], ["ada", "auditor,", "operator"]]


def rodeo(path: Path, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "rodeo_cli", *arguments, "--site", str(path)]


COLOURFUL = {"FORCE_COLOR": "1", "TTY_COMPATIBLE": "1", "COLUMNS": "20", "TERM": "xterm-256color"}


def test_status_into_a_pipe_has_a_plain_whole_line_for_each_process(tmp_path: Path) -> None:
    path = write_site(tmp_path)
    done = subprocess.run(
        rodeo(path, "status"), env={**os.environ, **COLOURFUL}, capture_output=True, text=True, timeout=HANG_S
    )
    header, *lines = done.stdout.splitlines()
    assert done.returncode == 1 and "\x1b" not in done.stdout + done.stderr
    assert header.split() == ["process", "state", "doing"]
    assert [line.split() for line in lines] == [
        [process.name, "down", "not", "running"] for process in processes_of(Site.load(path))
    ]


def test_status_on_a_terminal_has_colours_and_its_width(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    environment = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "TERM")}
    environment |= {"TERM": "xterm-256color", "COLUMNS": "60"}
    with subprocess.Popen(rodeo(write_site(tmp_path), "status"), env=environment, stdout=theirs) as command:
        os.close(theirs)
        shown = b""
        while True:
            try:
                part = os.read(ours, 4096)
            except OSError:  # how Linux says that nobody writes any more
                break
            if not part:
                break
            shown += part
    os.close(ours)
    assert command.returncode == 1 and b"\x1b[31mdown" in shown
