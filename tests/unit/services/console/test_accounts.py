"""Accounts: what opens a session or a token, and what ends it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from rodeo.access.accounts import Accounts, Mark, accounts_path, require_participant
from rodeo.access.errors import (
    AccountExists,
    AccountsDamaged,
    LoginRefused,
    NotLoggedIn,
    UnknownAccount,
    WeakPassphrase,
)
from rodeo.access.roles import Role
from rodeo.errors import InvalidRequest
from rodeo.site.config import Site
from rodeo.site.sections import ConsoleConfig, ParticipantConfig
from rodeo_cli import app
from rodeo_cli.accounts import login_link
from tests.support.site import LAB, write_site

PASSPHRASE = "correct horse battery"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "accounts.sqlite"


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Wall time as the accounts see it."""
    time_s = [1_800_000_000.0]
    monkeypatch.setattr("rodeo.access.accounts.time.time", lambda: time_s[0])
    return time_s


@pytest.fixture
def accounts(path: Path, now: list[float]) -> Accounts:
    accounts = Accounts(path, ConsoleConfig(session_idle_s=600, session_max_s=3600))
    accounts.add_user("ada", PASSPHRASE, [Role.OPERATOR])
    return accounts


@pytest.mark.parametrize("left", [0.4, 0.0])
def test_damaged_accounts_are_named_with_their_file_and_the_way_out(
    accounts: Accounts, path: Path, left: float
) -> None:
    """A file that was cut, and one that is no database."""
    accounts.close()
    whole = path.read_bytes()
    path.write_bytes(whole[: round(left * len(whole))] or b"no database" * 100)
    with pytest.raises(AccountsDamaged, match="rodeo console create-admin") as damaged:
        Accounts(path, ConsoleConfig())
    assert damaged.value.details["path"] == str(path)
    assert not damaged.value.restart_cures


def test_only_the_right_passphrase_of_an_enabled_account_opens_a_session(accounts: Accounts) -> None:
    session = accounts.session(accounts.log_in("ada", PASSPHRASE))
    assert (session.user.name, session.user.roles) == ("ada", {Role.OPERATOR})
    for name, passphrase in (("ada", PASSPHRASE + " "), ("ada", ""), ("eve", PASSPHRASE)):
        with pytest.raises(LoginRefused):
            accounts.log_in(name, passphrase)
    accounts.change_user("ada", [Role.OPERATOR], None, disabled=True)
    with pytest.raises(LoginRefused):
        accounts.log_in("ada", PASSPHRASE)


def test_a_session_ends_when_nothing_happens_and_at_last_however_busy(
    accounts: Accounts, now: list[float]
) -> None:
    token = accounts.log_in("ada", PASSPHRASE)
    for _ in range(7):
        now[0] += 500
        accounts.session(token, touch=True)
    now[0] += 101  # 3601 s after it began
    with pytest.raises(NotLoggedIn):
        accounts.session(token, touch=True)
    idle = accounts.log_in("ada", PASSPHRASE)
    now[0] += 601
    with pytest.raises(NotLoggedIn):
        accounts.session(idle)


def test_watching_does_not_keep_a_session_alive(accounts: Accounts, now: list[float]) -> None:
    token = accounts.log_in("ada", PASSPHRASE)
    now[0] += 400
    accounts.session(token)
    now[0] += 201
    with pytest.raises(NotLoggedIn):
        accounts.session(token)


@pytest.mark.parametrize("end", ["log out", "new passphrase", "disable"])
def test_a_session_is_over_when_it_is_ended(accounts: Accounts, end: str) -> None:
    token = accounts.log_in("ada", PASSPHRASE)
    if end == "log out":
        accounts.log_out(token)
    elif end == "new passphrase":
        accounts.set_passphrase("ada", "another passphrase")
    else:
        accounts.change_user("ada", [Role.OPERATOR], None, disabled=True)
    with pytest.raises(NotLoggedIn):
        accounts.session(token)


def test_roles_that_are_taken_are_gone_from_open_sessions(accounts: Accounts) -> None:
    token = accounts.log_in("ada", PASSPHRASE)
    accounts.change_user("ada", [Role.AUDITOR], "bob")
    user = accounts.session(token).user
    assert (user.roles, user.participant) == ({Role.AUDITOR}, "bob")


def test_a_token_works_until_it_is_revoked(accounts: Accounts) -> None:
    token = accounts.issue_token("ada", "a program")
    assert accounts.token_user(token).name == "ada"
    (entry,) = accounts.tokens("ada")
    accounts.add_user("bob", PASSPHRASE, [])
    with pytest.raises(UnknownAccount):
        accounts.revoke_token("bob", entry["id"])
    accounts.revoke_token("ada", entry["id"])
    with pytest.raises(NotLoggedIn):
        accounts.token_user(token)


def test_the_file_holds_nothing_that_could_be_used_to_log_in(accounts: Accounts, path: Path) -> None:
    session, token = accounts.log_in("ada", PASSPHRASE), accounts.issue_token("ada", "a program")
    accounts.close()
    stored = path.read_bytes()
    assert b"$argon2id$" in stored
    for secret in (PASSPHRASE, session, token):
        assert secret.encode() not in stored
    assert path.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("passphrase", ["", "short", "x" * 257])
def test_a_passphrase_that_is_too_short_or_endless_is_refused(accounts: Accounts, passphrase: str) -> None:
    with pytest.raises(WeakPassphrase) as caught:
        accounts.add_user("bob", passphrase, [])
    assert caught.value.details == {"characters": len(passphrase)}


def test_a_name_can_be_taken_once(accounts: Accounts) -> None:
    with pytest.raises(AccountExists):
        accounts.add_user("ada", PASSPHRASE, [])


@pytest.mark.parametrize(
    ("roles", "participant", "says"),
    [
        (
            [Role.EXECUTOR],
            None,
            "an executor works as a participant of this site: choose one of",
        ),
        ([Role.EXECUTOR], "bod", "nobody can work as bod here: this site has the keys of organization, bob"),
        ([Role.EXECUTOR], "panther1", "nobody can work as panther1"),
        ([Role.EXECUTOR], "carla", "nobody can work as carla"),  # her key is elsewhere
        ([Role.AUDITOR], "oracle", "nobody can work as oracle"),
        ([Role.EXECUTOR], "bob", ""),
        ([Role.OPERATOR], None, ""),
    ],
)
def test_an_account_that_nobody_could_work_with_is_refused(
    roles: list[Role], participant: str | None, says: str
) -> None:
    elsewhere = ParticipantConfig(name="carla", address="0x" + "11" * 20)
    people = [ParticipantConfig(name="bob"), elsewhere]
    site = Site.load(LAB).model_copy(update={"participants": people})
    if not says:
        require_participant(site, roles, participant)
        return
    with pytest.raises(InvalidRequest) as refused:
        require_participant(site, roles, participant)
    assert says in refused.value.message


def test_the_terminal_makes_no_executor_without_a_participant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RODEO_CONSOLE_PASSPHRASE", PASSPHRASE)
    site = write_site(tmp_path, extra='participants = [{ name = "bob" }]')
    create = ["console", "create", "eve", "--role", "executor", "--site", str(site)]
    refused = CliRunner().invoke(app, create)
    assert refused.exit_code == 1 and "choose one of organization, bob" in " ".join(refused.output.split())
    assert CliRunner().invoke(app, [*create, "--participant", "bob"]).exit_code == 0


def test_a_link_logs_in_once(accounts: Accounts) -> None:
    link = accounts.make_link("ada")
    session = accounts.session(accounts.log_in_by_link(link))
    assert session.user == accounts.user("ada")
    with pytest.raises(LoginRefused):
        accounts.log_in_by_link(link)
    assert accounts.session_of(session.key).user.name == "ada"


def test_a_link_that_is_too_old_or_was_never_made_opens_nothing(accounts: Accounts, now: list[float]) -> None:
    link = accounts.make_link("ada", valid_s=60.0)
    for token in ("", "made-up", accounts.issue_token("ada", "program")):
        with pytest.raises(LoginRefused):
            accounts.log_in_by_link(token)
    now[0] += 60.0
    with pytest.raises(LoginRefused):
        accounts.log_in_by_link(link)


def test_a_link_of_another_site_opens_nothing(accounts: Accounts, tmp_path: Path) -> None:
    other = Accounts(tmp_path / "other.sqlite", ConsoleConfig())
    other.add_user("ada", PASSPHRASE, [Role.OPERATOR])
    with pytest.raises(LoginRefused):
        accounts.log_in_by_link(other.make_link("ada"))


def test_a_link_is_no_session_and_no_token_of_programs(accounts: Accounts) -> None:
    link = accounts.make_link("ada")
    with pytest.raises(NotLoggedIn):
        accounts.session(link)
    with pytest.raises(NotLoggedIn):
        accounts.token_user(link)


@pytest.mark.parametrize("change", ["disabled", "passphrase"])
def test_links_end_with_what_ends_sessions(accounts: Accounts, change: str) -> None:
    link = accounts.make_link("ada")
    if change == "disabled":
        accounts.change_user("ada", [Role.OPERATOR], None, disabled=True)
    else:
        accounts.set_passphrase("ada", "another " + PASSPHRASE)
    with pytest.raises(LoginRefused):
        accounts.log_in_by_link(link)


def test_the_database_holds_no_link(accounts: Accounts, path: Path) -> None:
    link = accounts.make_link("ada")
    accounts.close()
    assert link.encode() not in path.read_bytes()


def test_a_link_is_for_somebody_who_exists(accounts: Accounts) -> None:
    with pytest.raises(UnknownAccount):
        accounts.make_link("eve")


def test_the_demos_account_may_look_and_act_and_not_administer(tmp_path: Path) -> None:
    site = Site.load(write_site(tmp_path))
    links = [login_link(site, "http://127.0.0.1:1") for _ in range(2)]
    base, _, token = links[0].partition("#")
    assert base == "http://127.0.0.1:1/login/link" and len(set(links)) == 2
    opened = Accounts(accounts_path(site), site.console)
    user = opened.session(opened.log_in_by_link(token)).user
    assert user.roles == {Role.OPERATOR, Role.TREASURER, Role.AUDITOR}
    assert [one.name for one in opened.users()] == ["demo"]


def test_how_far_somebody_has_read_is_kept_for_each_account(path: Path) -> None:
    accounts = Accounts(path, ConsoleConfig())
    for mark in (Mark("0xc", 3, 5.0), Mark("0xc", 4, 6.0)):
        accounts.set_mark("ada", mark)
    accounts.close()
    again = Accounts(path, ConsoleConfig())
    assert (again.mark("ada"), again.mark("eva")) == (Mark("0xc", 4, 6.0), Mark())
    again.close()
