"""`python -m training [--data DIR] [--out FOLDER] [--add-corrections SITE]`

Without corrections it trains the bin's classifier from ImageNet's weights (`training.train`);
with those that the bins of a site keep it fine-tunes the installed one
(`training.corrected`).

What is not named is looked for in the project's folder, wherever the command is started.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rodeo.errors import RodeoError
from rodeo.site.config import Site
from training import needs
from training.allowed import Allowed
from training.crossed import FOLDS_DIR
from training.others import FETCHED


@dataclass(frozen=True)
class Asked:
    """What the command is to do."""

    data: Path
    out: Path
    site: Site | None
    """The site whose corrections it learns from; None: it trains from ImageNet's weights."""
    folds: Path
    others: Path
    shorten: int


def asked(given: Sequence[str] | None = None) -> Asked:
    """By the command line. Raises ConfigError."""
    parser = argparse.ArgumentParser(description="Train the bin's classifier.")
    parser.add_argument(
        "--data",
        type=Path,
        default=needs.PHOTOS,
        help="folder of train/<class>/ and val/<class>/ (%(default)s)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help=f"folder for the new model ({needs.MODEL}; of corrections: model in the site's data_dir)",
    )
    parser.add_argument(
        "--add-corrections",
        type=Path,
        metavar="SITE",
        help="site file: learn from what people corrected there",
    )
    parser.add_argument(
        "--folds", type=Path, default=FOLDS_DIR, help="folder of the cross-validated networks (%(default)s)"
    )
    parser.add_argument(
        "--others", type=Path, default=FETCHED, help="folder of photos of other things (%(default)s)"
    )
    parser.add_argument("--shorten", type=int, default=1, metavar="TIMES", help="less work, to try it out")
    found = parser.parse_args(given)
    site = None if found.add_corrections is None else Site.load(found.add_corrections)
    usual = needs.MODEL if site is None else site.data_dir / "model"
    return Asked(found.data, found.out or usual, site, found.folds, found.others, found.shorten)


def main(given: Sequence[str] | None = None) -> None:
    """Raises ConfigError, NotInstalled, NoPhotos, NoSamples and NoFolds before any work, and what training
    raises."""
    what = asked(given)
    needs.check(what.data, what.others, None if what.site is None else what.folds)
    # Imports torch: `needs.check` has named what is missing.
    from training import corrected, train

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    train.prepare()
    recipe = train.Recipe().shortened(what.shorten)
    if what.site is None:
        after = train.WEATHER.shortened(what.shorten)
        train.main(what.data, what.others, what.out, recipe, what.folds, after=after)
        return
    gentle = corrected.GENTLE.shortened(what.shorten)
    report = corrected.add_corrections(
        what.site,
        Allowed.at(what.site),
        what.data,
        what.folds,
        lambda: corrected.Material.load(recipe, what.data, what.others),
        what.out,
        recipe,
        gentle,
    )
    print("\n".join(report))


if __name__ == "__main__":
    try:
        main()
    except RodeoError as error:
        sys.exit(str(error))
