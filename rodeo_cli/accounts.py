"""Accounts of the console, on the machine where it runs: the first administrator is made here."""

from __future__ import annotations

import os
import secrets
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.bus.messages import Status
from rodeo.errors import NoResponder
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    print_listing,
    reports_errors,
    say,
)
from rodeo_cli.layout import Row

if TYPE_CHECKING:
    from rodeo.access.accounts import Accounts

accounts = typer.Typer(help="Manage the accounts of people who may use the console.", no_args_is_help=True)

PASSPHRASE_VARIABLE = "RODEO_CONSOLE_PASSPHRASE"
"""Variable with the passphrase when nobody is asked for it."""

NameArgument = Annotated[str, typer.Argument(help="The name to log in with.")]


@accounts.command("create-admin")
@reports_errors
def create_admin(name: NameArgument = "admin", site: SiteOption = DEFAULT_SITE) -> None:
    """Create an administrator, who may also operate, pay and judge."""
    _add(site, name, [role for role in Role if role is not Role.EXECUTOR], None)


@accounts.command("create")
@reports_errors
def create(
    name: NameArgument,
    role: Annotated[list[Role] | None, typer.Option("--role", help="Repeatable.")] = None,
    participant: Annotated[
        str | None,
        typer.Option(help="The participant whose wallet the executor uses. Required for that role."),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Create an account. Without a role it is read-only."""
    _add(site, name, role or [], participant)


@accounts.command("passphrase")
@reports_errors
def passphrase(name: NameArgument, site: SiteOption = DEFAULT_SITE) -> None:
    """Set a new passphrase and end all sessions of the old one."""
    _accounts(site).set_passphrase(name, _passphrase())
    say(f"{name} has a new passphrase")


@accounts.command("token")
@reports_errors
def token(
    name: NameArgument,
    label: Annotated[str, typer.Option(help="What the token is for.")] = "command line",
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Print a new token for programs that act for this person. It is shown only once."""
    typer.echo(_accounts(site).issue_token(name, label))


@accounts.command("link")
@reports_errors
def link(name: NameArgument, site: SiteOption = DEFAULT_SITE) -> None:
    """Print a link that opens the console logged in as this person: once, within an hour, on this machine."""
    with connected(site) as (loaded, bus):
        key = topics.STATUS.name(org=loaded.org, process="console")
        url = queries.fitting(Status, bus.query(key), key).details.get("http")
    if url is None:
        raise NoResponder("the console does not serve pages yet", key=key)
    typer.echo(_link(loaded, str(url), name))


DEMO = "demo"
"""Role of somebody who looks at a demo: everything but the accounts of others and the organization's
rules."""


def login_link(site: Site, url: str) -> str:
    """A link that opens the console at `url`, logged in as an account of the demo's own, which nobody else
    can open: its passphrase is random and never shown."""
    with closing(_accounts_of(site)) as accounts:
        if DEMO not in [user.name for user in accounts.users()]:
            accounts.add_user(DEMO, secrets.token_urlsafe(32), [Role.OPERATOR, Role.TREASURER, Role.AUDITOR])
    return _link(site, url, DEMO)


def _link(site: Site, url: str, name: str) -> str:
    with closing(_accounts_of(site)) as accounts:
        # Behind #, which browsers send to nobody.
        return f"{url}/login/link#{accounts.make_link(name)}"


@accounts.command("list")
@reports_errors
def list_accounts(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List accounts and their roles."""
    users = _accounts(site).users()
    document = [{"name": one.name, "roles": sorted(one.roles), "participant": one.participant,
                 "disabled": one.disabled} for one in users]  # fmt: skip
    rows = (
        Row(
            (
                one.name,
                ", ".join(sorted(one.roles)),
                one.participant or "",
                "disabled" if one.disabled else "",
            )
        )
        for one in users
    )
    print_listing(document, as_json, ("name", "roles", "participant", "state"), rows, folds=(1,))


def _accounts(site_path: Path) -> Accounts:
    return _accounts_of(Site.load(site_path))


def _accounts_of(site: Site) -> Accounts:
    # Imported here: only these commands need a database and argon2.
    from rodeo.access.accounts import Accounts, accounts_path

    return Accounts(accounts_path(site), site.console)


def _add(site_path: Path, name: str, roles: list[Role], participant: str | None) -> None:
    from rodeo.access.accounts import require_participant

    require_participant(Site.load(site_path), roles, participant)
    _accounts(site_path).add_user(name, _passphrase(), roles, participant)
    say(f"{name} may log in as {', '.join(roles) or 'a reader'}")


def _passphrase() -> str:
    given = os.environ.get(PASSPHRASE_VARIABLE)
    return (
        given if given is not None else typer.prompt("Passphrase", hide_input=True, confirmation_prompt=True)
    )
