"""The sweep over a real folder as store, with an executor that is played."""

from __future__ import annotations

import json
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.checks.acts import Judged, judged_files
from rodeo.evidence.store import Store
from rodeo.site.config import Site
from services.oracle import scrub
from services.oracle.scrub import Scrub
from tests.support.copies import CopyBus

DAY_S = 86400.0


class Sweep:
    """Three proofs in the store, and a wall clock that the test sets."""

    def __init__(self, site: Site, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.site = site.model_copy(update={"data_dir": folder / "data"})
        self.bus = CopyBus()
        self.bus.folder = folder
        self.store = self.bus.store = Store(self.site)
        self.data = [bytes([number]) * 1000 for number in range(3)]
        self.files = [
            Judged(f"the proof of task {number}", *self.store.put_bytes(data, ".mcap"))
            for number, data in enumerate(self.data)
        ]
        self.told = ""
        self.now_s = 1_000_000.0
        monkeypatch.setattr(scrub.time, "time", lambda: self.now_s)
        self.folder = folder
        self.start()

    def start(self) -> None:
        def tell(text: str) -> None:
            self.told = text

        self.folder.mkdir(exist_ok=True)
        bus: Any = self.bus
        self.scrub = Scrub(self.site, bus, self.folder, self.folder / "reports", lambda: self.files, tell)

    def path(self, number: int) -> Path:
        return Path(self.files[number].uri.removeprefix("file://"))

    def looked_at(self) -> set[str]:
        """Digests of the files that it remembers to have looked at."""
        return set(json.loads((self.folder / "scrub.json").read_text())["looked_s"])

    def days(self, count: float) -> None:
        """So much time passes, looked at eight times a day."""
        for _ in range(round(count * 8)):
            self.now_s += DAY_S / 8
            self.scrub.look()


@pytest.fixture
def sweep(site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Sweep:
    return Sweep(site, tmp_path, monkeypatch)


def lose(path: Path) -> None:
    path.unlink()


def damage(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[500] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("harm", [lose, damage])
def test_what_the_store_lost_after_the_verdict_is_there_again_within_a_pass(
    sweep: Sweep, harm: Callable[[Path], None]
) -> None:
    harm(sweep.path(1))
    sweep.bus.copy = sweep.data[1]
    sweep.days(sweep.site.store.scrub_days + 1)
    assert sweep.path(1).read_bytes() == sweep.data[1]
    assert sweep.told == ""


def test_what_nobody_has_any_more_is_said_until_it_is_there_again(sweep: Sweep) -> None:
    lose(sweep.path(2))
    sweep.days(sweep.site.store.scrub_days + 1)
    assert "the store has lost or damaged the proof of task 2: nobody on the bus has a copy" in sweep.told
    sweep.bus.copy, sweep.bus.store = sweep.data[2], None  # it is handed over instead
    sweep.days(0.25)
    assert sweep.told == ""
    assert sweep.path(2).read_bytes() == sweep.data[2]


def test_a_pass_is_paced_and_goes_on_after_a_restart(sweep: Sweep) -> None:
    days = sweep.site.store.scrub_days
    sweep.days(days / 3 - 0.25)
    assert sweep.scrub.checked == 0
    sweep.days(0.5)
    assert sweep.scrub.checked == 1
    first = sweep.looked_at()
    sweep.start()
    sweep.days(2 * days / 3)
    assert sweep.scrub.checked == 2
    assert sweep.looked_at() == {one.sha256 for one in sweep.files} > first


def test_a_report_comes_again_from_the_oracles_own_copy(sweep: Sweep) -> None:
    data = b'{"acts": []}'
    own = sweep.folder / "reports" / f"{sha256(data).hexdigest()}.json"
    own.parent.mkdir()
    own.write_bytes(data)
    uri = f"{sweep.site.store_url}/{own.name}"
    sweep.files = [Judged("the report on task 1", uri, "0x" + own.stem)]
    sweep.days(sweep.site.store.scrub_days + 1)
    assert sweep.store.stored(uri) == "0x" + own.stem


def test_a_damaged_progress_file_begins_the_sweep_anew(sweep: Sweep) -> None:
    (sweep.folder / "scrub.json").write_text('{"last_s": ')
    sweep.start()
    sweep.days(sweep.site.store.scrub_days + 1)
    assert sweep.scrub.checked == 3


def event(name: str, **args: Any) -> DaoEvent:
    shared = {"seq": 1, "block": 1, "log_index": 0, "tx_hash": "0x", "time_s": 0.0, "task_id": 7}
    return DaoEvent(name=name, args={"attempt": 1, **args}, **shared)


def test_what_was_never_handed_over_is_not_looked_for() -> None:
    submitted = event("ProofSubmitted", uri="file:///s/a.mcap", proof_hash="0xAA")
    ruled = event("Ruled", report="0xBB")
    rejected = event("Reported", reason="fetched: proof_not_found", report_uri="file:///s/b.json")
    assert [one.sha256 for one in judged_files([submitted, rejected, ruled])] == ["0xbb"]
    accepted = event("Reported", reason="accepted", report_uri="file:///s/b.json")
    assert [one.sha256 for one in judged_files([submitted, accepted, ruled])] == ["0xaa", "0xbb"]
    assert [*judged_files([submitted])] == []
