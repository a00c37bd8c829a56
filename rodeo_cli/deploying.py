"""Commands that write what starts a site's processes on computers that run for years."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from rodeo.display.formatting import count
from rodeo_cli.common import DEFAULT_SITE, SiteOption, make_folder, reports_errors, say, write_file

deploying = typer.Typer(
    help="Write what starts the site's processes in place of `rodeo up`: systemd units, or containers.",
    no_args_is_help=True,
)

OutOption = Annotated[
    Path,
    typer.Option(help="Folder to write to; each of [hosts] gets a folder in it.", metavar="DIR"),
]
PassphraseOption = Annotated[
    Path | None,
    typer.Option(
        help="File with the passphrase of the keystores; by default /etc/rodeo/ORG.passphrase, for units "
        "of a local chain keys/passphrase in the data folder.",
        metavar="FILE",
    ),
]


@deploying.command()
@reports_errors
def systemd(
    out: OutOption,
    site: SiteOption = DEFAULT_SITE,
    user: Annotated[str, typer.Option(help="User who runs the processes.")] = "rodeo",
    python: Annotated[
        Path | None,
        typer.Option(help="Python in which RODEO is installed; by default this one.", metavar="FILE"),
    ] = None,
    passphrase: PassphraseOption = None,
) -> None:
    """Write a systemd unit for each process, and a target for all of them.

    `systemctl start rodeo-ORG.target` starts them. Paths are those of this computer.
    """
    # Imported here: the other commands need neither.
    from deploy import hosting, units

    loaded = hosting.load(site)
    opened = passphrase or hosting.default_passphrase(loaded)
    files = units.units(loaded, site, python or Path(sys.executable), user, opened.absolute())
    _write(out, files)
    for folder, entries in hosting.by_host(loaded):
        say(f"{out / folder}: {count(len(entries), 'unit')} and {units.target_name(loaded)}")


@deploying.command()
@reports_errors
def compose(out: OutOption, site: SiteOption = DEFAULT_SITE, passphrase: PassphraseOption = None) -> None:
    """Write a Dockerfile and a compose file, with a container for each process.

    Put the wheel of RODEO beside them. `docker compose run --rm rodeo site prepare` makes keys and contracts,
    and `docker compose up --detach` starts the processes.
    """
    # Imported here: the other commands need neither.
    from deploy import containers, hosting

    loaded = hosting.load(site)
    opened = passphrase or Path("/etc/rodeo") / f"{loaded.org}.{hosting.PASSPHRASE}"
    _write(out, containers.containers(loaded, site, opened.absolute()))
    for folder, entries in hosting.by_host(loaded):
        say(f"{out / folder}: Dockerfile and compose.yaml with {count(len(entries), 'container')}")


def _write(out: Path, files: dict[str, str]) -> None:
    for folder in {(out / name).parent for name in files}:
        make_folder(folder)
    for name, text in files.items():
        write_file(out / name, text)
