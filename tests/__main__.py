"""`make test`: the tests in Python and those of the contracts, side by side, and one line at the end."""

from __future__ import annotations

import argparse
import math
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO

from tests.support.tally import Tally

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "out"
LONG_CONTRACTS = "Invariants|WeightTree|Policy|Lines"
"""Whole lives of tasks, cases and proposals, in any order, take minutes; hundreds of trees and queues one."""
FAST = ("evidence", "robot", "person", "recording", "deploy/chain", "lab", "cli", "tools")
SLOW = (
    "lab/test_grasp.py",
    "lab/test_bin.py",
    "cli/test_listings.py",
    "cli/test_film.py",
    "evidence/test_differential.py",
)
"""Folders of tests/unit that `make check` runs, and files in them that it leaves out: about 50 s of CPU."""
ALONE = "alone"
"""The mark of long tests that keep pace with real devices: nothing runs beside them."""
NO_NODE = "contracts: Node is missing, `make system`"
_LONG = re.compile(r"mark\.long|sweep\(")
_TEST = re.compile(r"^\s*def test_", re.MULTILINE)
_FORGE = re.compile(r"(\d+) tests? passed, (\d+) failed, (\d+) skipped")
_FAILURE = re.compile(r"^(?:\x1b\[\d+m)?\[FAIL.*|.*failing tests? in .*", re.MULTILINE)


class Contracts:
    """Foundry's tests, in the background: their compiler keeps one core busy, while tests of sites wait for
    processes. They are skipped by name where there is no Node."""

    def __init__(self, long: bool, until_s: float | None) -> None:
        self.log = OUT / ("test-contracts-long.log" if long else "test-contracts.log")
        self.tally = Tally()
        self._until_s = math.inf if until_s is None else until_s
        self._began = time.monotonic()
        if subprocess.run(["sh", "tools/setup.sh", "node"], capture_output=True, check=False).returncode:
            self.tally.skipped[NO_NODE] = 1
            self._running = None
            return
        chosen = "--match-contract" if long else "--no-match-contract"
        commands = [["npm", "run", "--silent", "contracts:test", "--", chosen, LONG_CONTRACTS]]
        if long:
            commands.insert(0, ["make", "--no-print-directory", "symbolic"])
        say(f"contracts: testing beside, {os.path.relpath(self.log)}")
        self._running = threading.Thread(target=self._run, args=(commands,))
        self._running.start()

    def _run(self, commands: list[list[str]]) -> None:
        with self.log.open("w") as log:
            ended = [self._ended(command, log) for command in commands]
        said = self.log.read_text(errors="replace")
        counts = [tuple(map(int, found)) for found in _FORGE.findall(said)]
        self.tally.passed = sum(passed for passed, _, _ in counts)
        self.tally.failed = sum(failed for _, failed, _ in counts)
        if skipped := sum(skipped for _, _, skipped in counts):
            self.tally.skipped["contracts: skipped by their own"] = skipped
        if any(ended) and not self.tally.failed:
            self.tally.failed = 1  # it did not compile, or the solver found something
        if self.tally.failed:
            say(said)
        say(f"contracts: {self.tally}, {time.monotonic() - self._began:.0f} s")

    def _ended(self, command: list[str], log: IO[str]) -> int:
        """Its exit status; 0 where there is no time left, in which none of them begins."""
        if time.time() > self._until_s:
            self.tally.skipped[f"contracts: no time left for {' '.join(command)}"] = 1
            return 0
        return subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False).returncode

    def wait(self) -> Tally:
        if self._running is not None and self._running.is_alive():
            say("the tests in Python have ended; waiting for the contracts")
            self._running.join()
        if self.tally.failed:  # the whole log may stand a thousand lines above
            for failure in dict.fromkeys(_FAILURE.findall(self.log.read_text(errors="replace"))):
                say(f"contracts: {failure}")
        return self.tally


def with_long() -> list[str]:
    """Files in which a test is marked long: the others need not be imported, four times, to find none. Those
    with most tests come first, and whole sites for one test last: where time ends, most is known."""
    texts = {one: one.read_text() for one in sorted(Path("tests").rglob("test_*.py"))}
    found = [one for one, text in texts.items() if _LONG.search(text)]
    return [str(one) for one in sorted(found, key=lambda one: -len(_TEST.findall(texts[one])))]


def python(chosen: list[str], jobs: int, chain: str, until_s: float | None) -> Tally:
    """pytest's tests, none of which begins after `until_s`. pytest prints its own progress."""
    counted = OUT / "tally.json"
    counted.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-p", "tests.support.tally", "--tally", str(counted)]
    command += ["--chain", chain, "--forks", "--numprocesses", str(jobs), "--dist", "loadfile"]
    command += ["--no-loadscope-reorder", "--durations", "25", "--durations-min", "5", *chosen]
    command += [] if until_s is None else ["--until", str(until_s)]
    status = subprocess.run(command, check=False).returncode
    tally = Tally.read(counted) if counted.exists() else Tally()
    if status and not tally.failed:
        tally.failed = 1
        say(f"pytest ended with status {status}")
    return tally


def say(line: str) -> None:
    print(line, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests", description=__doc__)
    parser.add_argument(
        "--long", action="store_true", help="the tests that take minutes, instead of the others"
    )
    parser.add_argument("--fast", action="store_true", help="the fast unit tests only")
    parser.add_argument("--only", choices=("python", "contracts"), help="one part")
    parser.add_argument("--jobs", type=int, default=3, help="test files that run at the same time")
    parser.add_argument("--chain", default="eth-tester", help="which local chain sites of tests run on")
    parser.add_argument("--minutes", type=float, help="begin no test after this time; name those left")
    asked = parser.parse_args()
    until_s = None if asked.minutes is None else time.time() + 60 * asked.minutes
    os.chdir(ROOT)
    # Containers set it. Hundreds of processes start here, and each would compile the sources anew.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    OUT.mkdir(exist_ok=True)
    tally = Tally()
    if asked.long and asked.only != "contracts":
        tally += python(["-m", ALONE, *with_long()], 0, asked.chain, until_s)
    contracts = None if asked.fast or asked.only == "python" else Contracts(asked.long, until_s)
    if asked.only != "contracts":
        chosen = ["-m", f"long and not {ALONE}", *with_long()] if asked.long else ["-m", "not long"]
        if asked.fast:
            chosen += [
                *(f"tests/unit/{path}" for path in FAST),
                *(f"--ignore=tests/unit/{one}" for one in SLOW),
            ]
        tally += python(chosen, asked.jobs, asked.chain, until_s)
    if contracts is not None:
        tally += contracts.wait()
    more = ""
    if not (asked.long or asked.fast or asked.only) and tally.deselected:
        more = f"; `make test-long` adds {tally.deselected} tests, which take longer"
    say(f"{tally}{more}")
    return 1 if tally.failed else 0


if __name__ == "__main__":
    sys.exit(main())
