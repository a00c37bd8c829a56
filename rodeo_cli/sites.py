"""Commands about a site that does not run: check its file, prepare it, remove it."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Annotated

import typer

from rodeo.errors import InvalidRequest
from rodeo_cli.common import (
    DEFAULT_SITE,
    DEFAULT_SITE_SHOWN,
    JsonOption,
    SiteOption,
    print_json,
    print_listing,
    reports_errors,
    say,
)

sites = typer.Typer(
    help="Check a site file, prepare a site for its processes, and remove its data.", no_args_is_help=True
)


@sites.command()
@reports_errors
def check(
    file: Annotated[
        Path,
        typer.Argument(
            help="Site file.", envvar="RODEO_SITE", metavar="FILE", show_default=DEFAULT_SITE_SHOWN
        ),
    ] = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """Report errors and warnings in a site file, with their lines. Exit status 1 if there is an error."""
    # Imported here: what looks for ways in the room takes its time, and the other commands need none.
    from rodeo_cli.site_check import check as check_file

    findings = check_file(file)
    if as_json:
        print_json({"site_file": str(file), "findings": [finding.to_json() for finding in findings]})
    else:
        for finding in findings:
            say(str(finding))
        if not findings:
            say(f"{file}: nothing found")
    if any(finding.severity == "error" for finding in findings):
        raise typer.Exit(1)


@sites.command()
@reports_errors
def prepare(
    site: SiteOption = DEFAULT_SITE,
    wait: Annotated[
        bool,
        typer.Option("--wait", help="On an external chain, wait until the wallets have their gas money."),
    ] = False,
) -> None:
    """Generate keys and certificates, check the wallets' gas money and deploy the contracts.

    Prints each step and does only what is missing. You may run it again.
    """
    # Imported here: the chain's library takes a second, and the other commands need none.
    from deploy.prepare import prepare as prepare_site

    prepare_site(site, say, threading.Event(), wait)


@sites.command()
@reports_errors
def wallets(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Generate the missing keystores of a site on an external chain, and print all accounts.

    RODEO_KEYSTORE_PASSPHRASE encrypts them. Existing keystores are kept (Web3 Secret Storage, as
    `cast wallet` writes it). The list shows which accounts need the chain's native currency for gas.
    """
    # Imported here: the chain's library takes a second, and the other commands need none.
    from rodeo.site.config import Site
    from rodeo_cli.wallets import COLUMNS, accounts, rows

    found = accounts(Site.load(site))
    print_listing(found, as_json, COLUMNS, rows(found), folds=(2,), after=found["problem"])


@sites.command()
@reports_errors
def remove(
    site: SiteOption = DEFAULT_SITE,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove without asking.")] = False,
    keys: Annotated[
        bool,
        typer.Option("--keys", help="On an external chain, remove the keys, too. Only together with --yes."),
    ] = False,
) -> None:
    """Remove the data of a site that does not run: chain, proofs, accounts, logs. The site file stays.

    Names what goes and asks before. Keys of an external chain hold money: they stay without --keys --yes.
    """
    # Imported here: the other commands need none of it.
    from rodeo.site.config import Site
    from rodeo_cli.site_removal import removal_of
    from rodeo_cli.site_removal import remove as remove_parts

    loaded = Site.load(site)
    removal = removal_of(loaded, keys and yes)
    if keys and not yes:
        raise InvalidRequest("--keys removes what may hold money: it takes --yes, too")
    for part in removal.parts:
        say(f"{part.path}  {part.size_bytes / 1e6:.1f} MB")
    for path in removal.kept:
        say(f"{path}  stays: keys and contracts of an external chain")
    if not removal.parts:
        say(f"{loaded.data_dir}: there is nothing to remove")
        return
    if loaded.chain.backend == "external" and not removal.kept:
        say("Whoever has no copy of these keys loses all that their addresses hold.")
    if not yes and not _confirmed(f"Remove {len(removal.parts)} folders of {loaded.org} for good?"):
        say("nothing was removed")
        raise typer.Exit(1)
    remove_parts(loaded, removal)
    say(f"removed. {site} stays: `rodeo up --site {site}` begins anew")


def _confirmed(question: str) -> bool:
    """Raises InvalidRequest where nobody can be asked."""
    if not sys.stdin.isatty():
        raise InvalidRequest("nobody is there to ask: repeat it with --yes")
    return typer.confirm(question, default=False)
