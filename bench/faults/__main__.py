"""`python -m bench.faults [WORD...]`: the cases whose name or area contains one of the words.

Exit status 1 unless all of them were survived.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from bench.faults.run import figures_of, run_cases, selected


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.faults", description=__doc__)
    parser.add_argument("words", nargs="*", help="a part of a case's name or area; all cases without")
    parser.add_argument("--list", action="store_true", help="say what there is and run nothing")
    parser.add_argument("--figures", type=Path, help="write the figures there and exit with status 0")
    arguments = parser.parse_args()
    cases = selected(arguments.words)
    if not cases:
        parser.error("no case is called like that")
    if arguments.list:
        for one in cases:
            print(f"{one.area:16} {one.name:34} {one.breaks}")
        return 0
    figures = figures_of(run_cases(cases))
    if arguments.figures is not None:
        arguments.figures.write_text(json.dumps(figures))
        return 0
    print(json.dumps(figures, indent=2))
    return 0 if figures["faults_survived"] == figures["faults_cases"] else 1


if __name__ == "__main__":
    sys.exit(main())
