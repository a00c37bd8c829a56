"""Accounts of the console, on the machine where it runs: the first administrator is made here."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rodeo.config import Site
from rodeo_cli.common import DEFAULT_SITE, JsonOption, SiteOption, print_listing, reports_errors, say
from rodeo_cli.layout import Row
from services.console.roles import Role

if TYPE_CHECKING:
    from services.console.accounts import Accounts

accounts = typer.Typer(help="Manage the accounts of people who may use the console.", no_args_is_help=True)

PASSPHRASE_VARIABLE = "RODEO_CONSOLE_PASSPHRASE"
"""Where a passphrase comes from when nobody is asked for it."""

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
    # Imported here: only these commands need a database and argon2.
    from services.console.accounts import Accounts, accounts_path

    loaded = Site.load(site_path)
    return Accounts(accounts_path(loaded), loaded.console)


def _add(site_path: Path, name: str, roles: list[Role], participant: str | None) -> None:
    from services.console.accounts import require_participant

    require_participant(Site.load(site_path), roles, participant)
    _accounts(site_path).add_user(name, _passphrase(), roles, participant)
    say(f"{name} may log in as {', '.join(roles) or 'a reader'}")


def _passphrase() -> str:
    given = os.environ.get(PASSPHRASE_VARIABLE)
    return (
        given if given is not None else typer.prompt("Passphrase", hide_input=True, confirmation_prompt=True)
    )
