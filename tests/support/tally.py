"""Names tests that fail at once, and counts all for the last line of `make test`.

A plugin that `python -m tests` loads. With pytest-xdist the process that people see counts."""

from __future__ import annotations

import json
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pytest

_KEY = "deselected"
LONG_S = 300.0
"""Wall time after which a running test is named, so that a suite which is ended shows what held it."""
OUT_OF_TIME = "out of time"


@dataclass
class Tally:
    passed: int = 0
    failed: int = 0
    skipped: dict[str, int] = field(default_factory=dict)
    """Reason -> number of tests."""
    deselected: int = 0

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.passed + other.passed,
            self.failed + other.failed,
            dict(Counter(self.skipped) + Counter(other.skipped)),
            self.deselected + other.deselected,
        )

    def __str__(self) -> str:
        skipped = sum(self.skipped.values())
        why = "; ".join(f"{count}: {reason}" for reason, count in sorted(self.skipped.items()))
        return f"{self.passed} passed, {self.failed} failed, {skipped} skipped" + (f" ({why})" if why else "")

    @classmethod
    def read(cls, path: Path) -> Tally:
        return cls(**json.loads(path.read_text()))


class _Counting:
    def __init__(self, config: pytest.Config, path: Path, until_s: float | None) -> None:
        self._config = config
        self._path = path
        self._until_s = until_s
        self._tally = Tally()
        self._failed: set[str] = set()
        self._since: dict[str, float] = {}
        """Test that runs -> wall time of its start, until it is named or ends."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        if self._until_s is not None and time.time() > self._until_s:
            pytest.skip(OUT_OF_TIME)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._since[nodeid] = time.monotonic()
        for one, since_s in list(self._since.items()):
            if time.monotonic() - since_s > LONG_S:
                self._say(f"runs for {LONG_S:.0f} s and more: {one}")
                del self._since[one]

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self._since.pop(nodeid, None)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        tally = self._tally
        if report.failed:
            self._failed.add(report.nodeid)
            self._name(report)
        elif report.skipped and not hasattr(report, "wasxfail"):
            why = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
            reason = why.removeprefix("Skipped: ")
            tally.skipped[reason] = tally.skipped.get(reason, 0) + 1
            if reason == OUT_OF_TIME:
                self._say(f"{reason}: {report.nodeid}")
        elif report.when == "call":
            tally.passed += 1

    def _name(self, report: pytest.TestReport) -> None:
        """At once: pytest tells which test failed at its end, which may be minutes away."""
        last = report.longreprtext.strip().rpartition("\n")[2]
        self._say(f"failed ({report.when}): {report.nodeid}: {last}")

    def _say(self, line: str) -> None:
        if terminal := self._config.pluginmanager.getplugin("terminalreporter"):
            terminal.write(f"\n{line}\n")

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._failed.add(report.nodeid)
        elif report.skipped and isinstance(report.longrepr, tuple):
            reason = report.longrepr[2].removeprefix("Skipped: ")
            self._tally.skipped[reason] = self._tally.skipped.get(reason, 0) + 1

    def pytest_deselected(self, items: list[pytest.Item]) -> None:
        self._tally.deselected += len(items)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: object) -> None:
        """Workers of pytest-xdist select for themselves, each the same."""
        self._tally.deselected = getattr(node, "workeroutput", {}).get(_KEY, self._tally.deselected)

    def pytest_sessionfinish(self) -> None:
        worker: dict[str, int] | None = getattr(self._config, "workeroutput", None)
        if worker is not None:
            worker[_KEY] = self._tally.deselected
            return
        self._tally.failed = len(self._failed)
        self._path.write_text(json.dumps(asdict(self._tally)))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--tally", type=Path, help="write what was counted to this file")
    parser.addoption(
        "--until", type=float, help="begin no test after this time (s since 1970), but skip it by name"
    )


def pytest_configure(config: pytest.Config) -> None:
    path = config.getoption("--tally")
    if path is not None:
        config.pluginmanager.register(_Counting(config, path, config.getoption("--until")))
