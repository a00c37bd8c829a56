"""`python -m services.itrash.train --data DIR --out FOLDER [--add-corrections SITE]`

Without corrections it trains the bin's classifier from ImageNet's weights (`services.itrash.training.train`);
with those that the bins of a site keep it fine-tunes the installed one
(`services.itrash.training.corrected`).
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import sys
from pathlib import Path

if __name__ == "__main__" and importlib.util.find_spec("torch") is None:
    sys.exit(
        "Training needs packages that running does not. Install them first:\n\n"
        '    pip install --constraint constraints.txt -e ".[train]"'
    )

from rodeo.config import Site
from rodeo.errors import RodeoError
from services.itrash.training.allowed import Allowed
from services.itrash.training.card import FOLDS_DIR
from services.itrash.training.corrected import GENTLE, Material, add_corrections
from services.itrash.training.others import FETCHED
from services.itrash.training.train import Recipe, main, prepare

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Train the bin's classifier.")
    parser.add_argument("--data", type=Path, required=True, help="folder of train/<class>/ and val/<class>/")
    parser.add_argument("--out", type=Path, required=True, help="folder for the new model")
    parser.add_argument(
        "--add-corrections",
        type=Path,
        metavar="SITE",
        help="site file: learn from what people corrected there",
    )
    parser.add_argument(
        "--folds", type=Path, default=FOLDS_DIR, help="folder of the cross-validated networks"
    )
    parser.add_argument("--others", type=Path, default=FETCHED, help="folder of photos of other things")
    parser.add_argument("--shorten", type=int, default=1, metavar="TIMES", help="less work, to try it out")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    prepare()
    try:
        if arguments.add_corrections is None:
            recipe = Recipe().shortened(arguments.shorten)
            main(arguments.data, arguments.others, arguments.out, recipe, arguments.folds)
        else:
            recipe = GENTLE.shortened(arguments.shorten)
            site = Site.load(arguments.add_corrections)
            report = add_corrections(
                site,
                Allowed.at(site),
                arguments.data,
                arguments.folds,
                lambda: Material.load(recipe, arguments.data, arguments.others),
                arguments.out,
                recipe,
            )
            print("\n".join(report))
    except RodeoError as error:
        sys.exit(str(error))
