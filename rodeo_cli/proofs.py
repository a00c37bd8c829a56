"""`rodeo proof`: a sealed recording in other people's tools. The sealed file is only read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rodeo.errors import InvalidRequest
from rodeo.evidence.errors import CorruptProof, EvidenceError, UnsealedProof
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    make_folder,
    print_json,
    reports_errors,
    say,
    write_file,
)

if TYPE_CHECKING:
    from rodeo.checks.case import Case, ChainRecord
    from rodeo.evidence.proof import Proof

proofs = typer.Typer(
    help="Export a proof for other people's tools, and draw it. The proof itself is only read.",
    no_args_is_help=True,
)

ProofArgument = Annotated[
    Path, typer.Argument(help="A proof (MCAP).", metavar="FILE", exists=True, dir_okay=False)
]
IntoOption = Annotated[Path, typer.Option("--into", help="Folder for what is written.", metavar="FOLDER")]
OfflineOption = Annotated[
    bool,
    typer.Option("--offline", help="Do not ask the bridge. Whose keys signed is then not checked."),
]


@proofs.command()
@reports_errors
def export(
    file: ProofArgument,
    into: IntoOption = Path(),
    site: SiteOption = DEFAULT_SITE,
    offline: OfflineOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the poses that motion capture signed as a derived MCAP with /tf in frame map, and as CSV.

    Foxglove and rosbags open the MCAP. Nobody seals what is written here: its name and its metadata say that
    it is derived, and no oracle accepts it. The robot's own odometry drifts; these poses do not.
    """
    # Imported here: only these commands need the readers of recordings.
    from rodeo_cli.proof_export import bodies_of, mcap, table

    proof = _opened(file)
    case = _case(proof, Site.load(site), _record(site, file, offline))
    bodies = bodies_of(case)
    make_folder(into)
    written = {"mcap": _derived(file, into, ".mcap"), "csv": _derived(file, into, ".csv")}
    write_file(written["mcap"], mcap(case, bodies))
    write_file(written["csv"], table(case, bodies))
    document = {name: str(path) for name, path in written.items()}
    if as_json:
        print_json(document | {"bodies": list(bodies.poses), "poses": bodies.source})
        return
    say(f"{written['mcap']}: /tf of {', '.join(bodies.poses)}, by {bodies.source}")
    say(f"{written['csv']}: the same poses, a row for each")
    say(f"Both are derived, and prove nothing. The proof is {file}, which is unchanged.")


@proofs.command()
@reports_errors
def plot(
    file: ProofArgument,
    into: IntoOption = Path(),
    site: SiteOption = DEFAULT_SITE,
    offline: OfflineOption = False,
    as_json: JsonOption = False,
) -> None:
    """Draw a proof as one picture (SVG): the path of robot and item, the grip, the bin's words, the verdict.

    The verdict is what the checks say here and now, as `rodeo verify` does. A browser shows the picture.
    """
    from rodeo.checks.verify import verify_proof
    from rodeo_cli.proof_plot import picture

    proof = _opened(file)
    loaded, record = Site.load(site), _record(site, file, offline)
    case = _case(proof, loaded, record)
    report = verify_proof(proof, loaded, record)
    path = _derived(file, into, ".svg")
    make_folder(into)
    write_file(path, picture(case, report))
    if as_json:
        print_json({"svg": str(path), "outcome": report.outcome, "reason": report.reason})
    else:
        say(f"{path}: {report.outcome}")


def _derived(file: Path, into: Path, suffix: str) -> Path:
    """The name says that the file is derived. Raises InvalidRequest where it would replace the proof."""
    path = into / f"{file.stem}.derived{suffix}"
    if path.resolve() == file.resolve():
        raise InvalidRequest("this would overwrite the file that is read", file=str(file))
    return path


def _opened(file: Path) -> Proof:
    """Raises EvidenceError in words for whoever took another file for a proof."""
    from mcap.writer import MCAP0_MAGIC

    from rodeo.evidence.proof import open_proof
    from rodeo.evidence.unsealed import is_never_sealed

    try:
        return open_proof(file)
    except EvidenceError as error:
        with file.open("rb") as opened:
            beginning = opened.read(64)
        if beginning.lstrip()[:1] in (b"{", b"["):
            raise CorruptProof(
                "this is a JSON document, such as a receipt or a report, and no recording: name the MCAP "
                "file whose hash it holds",
                file=str(file),
            ) from error
        if beginning[: len(MCAP0_MAGIC)] != MCAP0_MAGIC[: len(beginning)]:
            raise CorruptProof("this is no MCAP file, as each proof is", file=str(file)) from error
        if is_never_sealed(file):
            raise UnsealedProof(
                "this MCAP file is another tool's recording, or was derived from a proof: nobody sealed it",
                file=str(file),
            ) from error
        raise


def _case(proof: Proof, site: Site, record: ChainRecord | None) -> Case:
    from rodeo.checks.verify import case_of

    return case_of(proof, site, record)


def _record(site: Path, file: Path, offline: bool) -> ChainRecord | None:
    """What the running site's chain says of the proof, if there is one."""
    if offline:
        return None
    from rodeo_cli.verify import chain_views, warn

    known = chain_views(site, [file])[file]
    warn(known.warnings)
    return known.chain_record
