"""`rodeo classify`: what is in a photo, by the bin's own classifier. No site needs to run."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from rodeo.errors import RequestError, RodeoError
from rodeo.site.config import Site
from rodeo_cli.common import DEFAULT_SITE, JsonOption, SiteOption, console, errors, print_json, reports_errors

Photos = Annotated[list[Path], typer.Argument(metavar="FILE...", help="JPEG, PNG or WebP.")]


class Unreadable(RodeoError):
    """The file is not there or may not be read."""


@reports_errors
def classify(
    files: Photos,
    site: SiteOption = DEFAULT_SITE,
    bin_name: Annotated[
        str | None, typer.Option("--bin", help="Which bin of the site; the first by default.", metavar="NAME")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what waste each photo shows, and which compartment of a bin of the site takes it."""
    # OpenCV takes its time to import; the other commands should not wait for it.
    import numpy as np

    from rodeo.vision.classifier import Classifier

    loaded = Site.load(site)
    config = next(iter(loaded.bins), None) if bin_name is None else loaded.bin(bin_name)
    classifier = Classifier()
    classifier.logits(np.zeros((8, 8, 3), np.uint8))  # the first picture takes longer, whichever it is
    answers, failed = [], False
    for path in files:
        try:
            answer = classified(classifier, path)
        except (RequestError, Unreadable) as error:
            failed = True
            errors.print(
                f"[bold red]{error.code}[/]: {escape(f'{path}: {error}')}", highlight=False, soft_wrap=True
            )
            answers.append({"file": str(path), "error": error.to_json()})
            continue
        if config is not None:
            answer["compartment"] = config.compartment_for(answer["class"], answer["probabilities"])
        answers.append(answer)
        if not as_json:
            console.print(_line(answer), highlight=False, soft_wrap=True)
    if as_json:
        print_json(answers)
    if failed:
        raise typer.Exit(1)


def classified(classifier: Any, path: Path) -> dict[str, Any]:
    from rodeo.vision.images import MOST_READ_BYTES

    try:
        with path.open("rb") as file:
            data = file.read(MOST_READ_BYTES)
    except OSError as error:
        raise Unreadable("cannot read the photo", reason=error.strerror) from error
    started_s = time.perf_counter()
    found = classifier.classify(data)
    milliseconds = (time.perf_counter() - started_s) * 1e3
    return {
        "file": str(path),
        "class": found.label,
        "compartment": "",
        "probabilities": found.told,
        "milliseconds": round(milliseconds, 2),
    }


def _line(answer: dict[str, Any]) -> str:
    by_probability = sorted(answer["probabilities"].items(), key=lambda one: -one[1])
    probabilities = " ".join(f"{name} {p:.2f}" for name, p in by_probability)
    return (
        f"{escape(answer['file'])}: [bold]{answer['class']}[/] -> {answer['compartment']}"
        f"  [dim]{probabilities}  {answer['milliseconds']:.1f} ms[/]"
    )
