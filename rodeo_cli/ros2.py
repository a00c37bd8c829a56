"""Commands for those who take part with ROS 2 nodes: the file with which rmw_zenoh connects them."""

from __future__ import annotations

import json
import threading
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.access import nodes_of
from rodeo.errors import ConfigError
from rodeo.host.files import replace_file, writing
from rodeo.site.config import Site
from rodeo.site.names import node_identity
from rodeo.site.tls import identity
from rodeo_cli.common import DEFAULT_SITE, SiteOption, reports_errors, say

ros2 = typer.Typer(help="Connect a participant's ROS 2 nodes to the site.", no_args_is_help=True)


@ros2.callback()
def _group() -> None:
    """So that `session` stays a word of its own."""


@ros2.command()
@reports_errors
def session(
    participant: Annotated[
        str, typer.Argument(help="Whose nodes, by the name in the site file.", metavar="PARTICIPANT")
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="File to write.", show_default="ros2/PARTICIPANT.json5 in the data directory"),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Write rmw_zenoh's session file for a participant's nodes: router and certificate.

    On another machine change the paths of the certificate's files in it.
    """
    loaded = Site.load(site)
    known = sorted(nodes_of(loaded))
    if node_identity(participant) not in known:
        raise ConfigError(
            f"{participant} has no ROS 2 nodes on this site: name them in [[ros]], or as a robot's mind",
            known=known,
        )
    path = out or loaded.data_dir / "ros2" / f"{participant}.json5"
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, json.dumps(session_file(loaded, participant), indent=2) + "\n")
    say(f"export RMW_IMPLEMENTATION=rmw_zenoh_cpp ROS_DOMAIN_ID={loaded.bus.domain_id}")
    say(f"export RMW_ZENOH_SESSION_CONFIG_URI={path.absolute()}")


@ros2.command()
@reports_errors
def relay(
    name: Annotated[
        str, typer.Argument(help="A robot or a participant, by its name in the site file.", metavar="NAME")
    ],
    listen: Annotated[
        str, typer.Option(help="Where zenoh-bridge-ros2dds connects.", metavar="ENDPOINT")
    ] = "tcp/127.0.0.1:7450",
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Let nodes with a stock DDS take part: carry their names between zenoh-bridge-ros2dds and the site.

    Runs until Ctrl-C.
    """
    # Imported here: the messages take their time.
    from rodeo_cli.dds import relayed

    stop = threading.Event()
    with relayed(Site.load(site), name, listen, stop) as count, suppress(KeyboardInterrupt):
        say(f"{count} names of {name} are carried. Connect zenoh-bridge-ros2dds to {listen}.")
        stop.wait()


def session_file(site: Site, participant: str) -> dict[str, Any]:
    """Zenoh's configuration of a node of `participant`. Raises ConfigError where a certificate is missing."""
    shown = identity(site, node_identity(participant))
    tls = {} if shown is None else {"transport": {"link": {"tls": shown.zenoh()}}}
    return {
        # Not a peer, as is rmw_zenoh's default: what peers tell each other passes no router's rules.
        "mode": "client",
        "connect": {"endpoints": [site.bus.router], "timeout_ms": -1},
        "listen": {"endpoints": []},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        # What latched topics keep has to be stamped.
        "timestamping": {"enabled": True},
        # rmw_zenoh's own, for services that take long.
        "queries_default_timeout": 600_000,
        **tls,
    }
