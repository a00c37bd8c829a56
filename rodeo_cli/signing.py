"""Requests that a participant only signs: somebody else sends them, and pays the gas."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from rodeo.bus.messages import SignedRequest
from rodeo.bus.session import Bus, decode_json, validate
from rodeo.display.formatting import (
    span,
)
from rodeo.errors import InvalidRequest
from rodeo.site.config import Site
from rodeo_cli.common import (
    print_json,
    say,
    send_command,
    write_file,
)

SignOption = Annotated[
    Path | None,
    typer.Option(
        "--sign",
        metavar="FILE",
        dir_okay=False,
        help="Only sign, into this file. Whoever sends it with `rodeo task relay` pays the gas.",
    ),
]


ValidOption = Annotated[
    int, typer.Option("--valid", help="Seconds of block time for which what is signed may be sent.")
]


SignedArgument = Annotated[
    Path, typer.Argument(metavar="FILE", exists=True, dir_okay=False, help="A signed request.")
]


def sign_into(
    site: Site,
    bus: Bus,
    participant: str,
    command: str,
    request: dict[str, Any],
    valid_s: int,
    file: Path,
    as_json: bool = False,
) -> None:
    """Have the participant's wallet sign, and write what `relay` takes into `file`."""
    if not file.absolute().parent.is_dir():
        raise InvalidRequest("there is no such folder to write into", file=str(file))
    signed = send_command(site, bus, participant, "sign", command=command, request=request, valid_s=valid_s)
    write_file(file, json.dumps(signed, indent=2) + "\n")
    if as_json:
        print_json(signed)
    elif signed["request"]["signature"] is None:
        say(
            f"The bridge does not have {participant}'s key: sign each `typed_data` in {file} with the wallet,"
        )
        say("and write the results as `signature`.")
    else:
        say(f"{participant} signed it. Send it within {span(valid_s)}: rodeo task relay {file} --as SENDER")


def signed_in(file: Path) -> dict[str, Any]:
    """The request in a file of `sign_into`. Raises MalformedJson or InvalidRequest."""
    return validate(SignedRequest, decode_json(file.read_bytes())).model_dump(mode="json")
