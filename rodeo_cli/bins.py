"""A bin's pictures, people's corrections, and how often the bin was right."""

from __future__ import annotations

import base64
import binascii
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from pydantic import ValidationError

from rodeo.bus import queries
from rodeo.bus.session import Bus
from rodeo.errors import InvalidRequest, MalformedAnswer, wrong_fields
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    make_folder,
    print_listing,
    reports_errors,
    say,
    write_file,
)
from rodeo_cli.formatting import moment
from rodeo_cli.layout import Row

if TYPE_CHECKING:
    from rodeo.witness.correction import Corrections, Pictured

bins = typer.Typer(help="Tell a bin what items really were.", no_args_is_help=True)

BinOption = Annotated[
    str | None, typer.Option("--bin", help="The bin; the first of the site by default.", metavar="NAME")
]

_TYPED = {"image_sha256": "picture", "class": "item_class"}
"""Field of the signed correction -> the parameter that sets it."""


@bins.command("correct")
@reports_errors
def correct(
    item_class: Annotated[str, typer.Argument(help="What it really was, or unknown.", metavar="CLASS")],
    picture: Annotated[
        str | None,
        typer.Option(help="SHA-256 of the picture; by default of the last item.", metavar="0x..."),
    ] = None,
    bin_name: BinOption = None,
    participant: Annotated[str, typer.Option("--as", help="The auditor who signs.")] = "organization",
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Sign what an item really was, also where the bin was right. A later training may learn from it.

    A bin remembers the pictures of its last items only (`rodeo bin pictures`). It accepts one correction of
    each picture from each person.
    """
    # Signing takes its time to import; the other commands should not wait for it.
    from rodeo.evidence.attestation import attest
    from rodeo.signing import keystores
    from rodeo.witness.correction import Correction, Corrections

    with connected(site) as (loaded, bus):
        name, chain = _bin(loaded, bin_name), queries.ask(bus, loaded.org, queries.CHAIN)
        try:
            said = Correction(
                chain_id=chain.chain_id,
                task_manager=chain.contracts.task_manager,
                organization=chain.contracts.organization,
                bin=name,
                image_sha256=picture or _last_picture(loaded, bus, name),
                item_class=item_class,
            )
        except ValidationError as error:
            wrong = {_TYPED.get(field, field): told for field, told in wrong_fields(error).items()}
            raise InvalidRequest("nobody can sign this", fields=wrong) from error
        signed = attest(said.model_dump(), keystores.open_key(loaded, participant))
        key = topics.BIN_CORRECTIONS.name(org=loaded.org, bin=name)
        found = queries.fitting(Corrections, bus.query(key, signed), key)
    say(f"{name} keeps that this was {item_class}. {_score(found)}")


@bins.command("pictures")
@reports_errors
def pictures(
    save: Annotated[
        Path | None, typer.Option(help="Write each picture there, named by its hash.", metavar="FOLDER")
    ] = None,
    site: SiteOption = DEFAULT_SITE,
    bin_name: BinOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the pictures that can be corrected, the newest first: what the bin said, and what people say."""
    with connected(site) as (loaded, bus):
        name = _bin(loaded, bin_name)
        found = _corrections(loaded, bus, name)
        if save is not None:
            make_folder(save)
            for one in found.pictures:
                picture = _picture(loaded, bus, name, one.image_sha256)
                write_file(save / f"{one.image_sha256}.{_ending(picture)}", picture)
    rows = (
        Row((moment(one.shown_s, loaded), one.item_class, _said(one), one.image_sha256))
        for one in found.pictures
    )
    print_listing(list(found.pictures), as_json, ("shown", "said", "people say", "picture"), rows)


@bins.command("corrections")
@reports_errors
def corrections(
    site: SiteOption = DEFAULT_SITE, bin_name: BinOption = None, as_json: JsonOption = False
) -> None:
    """Show how often the bin named the right class, for the items that people looked at."""
    with connected(site) as (loaded, bus):
        found = _corrections(loaded, bus, _bin(loaded, bin_name))
    rows = (Row((one.name or one.address, str(one.items), str(one.right))) for one in found.people)
    print_listing(found, as_json, ("person", "items", "right"), rows, after=_score(found))


def _corrections(site: Site, bus: Bus, name: str) -> Corrections:
    from rodeo.witness.correction import Corrections  # takes its time to import

    key = topics.BIN_CORRECTIONS.name(org=site.org, bin=name)
    return queries.fitting(Corrections, bus.query(key), key)


def _picture(site: Site, bus: Bus, name: str, image_sha256: str) -> bytes:
    """Raises MalformedAnswer where the bin gives another picture."""
    key = topics.BIN_PICTURE.name(org=site.org, bin=name)
    answer = bus.query(key, parameters={"sha256": image_sha256})
    try:
        picture = base64.b64decode(str(answer.get("data_base64", "")), validate=True)
    except binascii.Error as error:
        raise MalformedAnswer("the bin answered without a picture", key=key) from error
    if "0x" + sha256(picture).hexdigest() != image_sha256:
        raise MalformedAnswer("the bin answered with another picture", key=key, asked=image_sha256)
    return picture


def _ending(picture: bytes) -> str:
    """Ending of the name of its file; a bin classifies these formats only."""
    return "png" if picture.startswith(b"\x89PNG") else "webp" if picture.startswith(b"RIFF") else "jpg"


def _said(one: Pictured) -> str:
    return ", ".join(f"{who}: {label}" for who, label in one.corrections.items())


def _bin(site: Site, name: str | None) -> str:
    if name is None and not site.bins:
        raise InvalidRequest("the site has no bin", organization=site.org)
    return (site.bins[0] if name is None else site.bin(name)).name


def _last_picture(site: Site, bus: Bus, name: str) -> str:
    last = bus.query(topics.BIN_STATE.name(org=site.org, bin=name)).get("classification")
    if last is None:
        raise InvalidRequest("the bin has classified nothing yet", bin=name)
    return str(last["payload"]["image_sha256"])


def _score(found: Corrections) -> str:
    items, right = (sum(getattr(one, what) for one in found.people) for what in ("items", "right"))
    if not items:
        return f"Nobody has told {found.bin} yet what its items were."
    return f"{found.bin} was right in {right} of {items} ({right / items:.0%})."
