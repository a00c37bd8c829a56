"""A proof that cannot be had: who answers for it, and when. The bus is played, the store is a real folder."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from rodeo.bus.messages import Task
from rodeo.checks.report import Report
from rodeo.evidence.store import Store
from rodeo.host.clock import WallClock
from rodeo.site.config import Site
from rodeo.site.sections import DisputesConfig
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.recordings import Take
from rodeo_testing.waiting import HANG_S, wait_until
from services.oracle import away
from services.oracle.away import MissingProofs, ProofAway
from tests.support.copies import CopyBus

DATA = b"a proof" * 100_000


class Clock(WallClock):
    def __init__(self) -> None:
        super().__init__()
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s


class Search:
    """A search in progress for the proof of `task`."""

    def __init__(self, site: Site, folder: Path, task: Task, stores: list[str]) -> None:
        self.bus, self.clock, self.task = CopyBus(), Clock(), task
        self.bus.folder = folder
        self.clock.time_s = task.proof_submitted or 0.0
        self.done = threading.Event()
        self.missing = MissingProofs(
            site,
            self.bus,  # type: ignore[arg-type]
            self.clock,
            folder / "proofs",
            lambda *_: self.done.set(),
            lambda *_: True,
            lambda: stores,
        )
        self.stop = threading.Event()
        self.looks = 0
        self._thread = threading.Thread(target=self.missing.run, args=(self.stop, self._count))
        self._thread.start()

    def _count(self) -> None:
        self.looks += 1

    def goes_on(self) -> bool:
        """Whether it has found nothing after fifty looks more."""
        end = self.looks + 50
        wait_until(lambda: self.looks >= end)
        return not self.done.is_set()

    @property
    def key(self) -> tuple[int, int]:
        return self.task.id, self.task.attempt

    def begin(self) -> None:
        self.missing.seek(self.task, ProofAway("lost", self.task, "executor"))

    def word(self) -> Report:
        assert self.done.wait(HANG_S)
        report = self.missing.last_word(self.key)
        assert report is not None
        return report

    def close(self) -> None:
        self.stop.set()
        self._thread.join()


@pytest.fixture
def search(
    site: Site,
    tmp_path: Path,
    cleaning: Take,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> Callable[..., Search]:
    monkeypatch.setattr(away, "LOOK_S", 0.01)
    monkeypatch.setattr(away, "_PAUSE_S", (0.01, 0.05))
    oracle = site.oracle.model_copy(update={"handover_s": 0.2})
    own = site.model_copy(update={"data_dir": tmp_path / "data", "oracle": oracle})

    def begin(uri: str = "", stores: tuple[str, ...] = ()) -> Search:
        path = tmp_path / "own.mcap"
        path.write_bytes(DATA)
        there = Store(own).put(path)
        sha256 = Store.hash_of(there)
        (tmp_path / "data" / "store" / f"{sha256[2:]}.mcap").unlink()
        fields = {"proof_uri": uri.format(sha256=sha256[2:]) or there, "proof_sha256": sha256}
        made = Search(own, tmp_path, cleaning_chain_record(cleaning, **fields).task, list(stores))
        made.bus.store = Store(own)
        request.addfinalizer(made.close)
        return made

    return begin


def test_what_the_store_lost_is_put_there_again_by_its_executor(search: Callable[..., Search]) -> None:
    one = search()
    one.bus.copy = DATA
    one.begin()
    assert one.done.wait(HANG_S)
    copy = one.missing.copy(one.key)
    assert copy is not None and copy.read_bytes() == DATA
    assert one.bus.store is not None
    assert one.bus.store.fetch(one.task.proof_uri or "", one.task.proof_sha256 or "").exists()
    one.missing.forget(one.key)
    assert not copy.parent.exists()


def test_what_its_executor_cannot_put_anywhere_is_handed_over(
    search: Callable[..., Search], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = search("s3://elsewhere/{sha256}.mcap")
    one.bus.copy, one.bus.store = DATA, None
    taken, take, put = threading.Event(), threading.Event(), Store.put

    def put_late(store: Store, path: Path) -> str:
        taken.set()
        assert take.wait(HANG_S)
        return put(store, path)

    monkeypatch.setattr(Store, "put", put_late)
    one.begin()
    assert one.done.wait(HANG_S)  # the verdict waits for no store
    copy = one.missing.copy(one.key)
    assert copy is not None and copy.read_bytes() == DATA
    assert taken.wait(HANG_S)
    one.missing.forget(one.key)
    take.set()
    wait_until((tmp_path / "data" / "store" / copy.name).is_file)
    wait_until(lambda: not list((tmp_path / "proofs").iterdir()))


@pytest.mark.parametrize("copy", [b"", b"another" * 1000])
def test_what_nobody_hands_over_is_rejected_when_its_executor_was_asked_long_enough(
    search: Callable[..., Search], copy: bytes
) -> None:
    """Undecided an auditor might have it paid, and nobody ever saw it."""
    one = search()
    one.bus.copy, one.bus.store = copy, None
    one.begin()
    report = one.word()
    assert report.outcome == "rejected"
    assert "the executor did not send it" in report.reason


def test_an_executor_is_not_asked_while_the_oracle_is_off_the_bus(search: Callable[..., Search]) -> None:
    one = search()
    one.bus.connected = False
    one.begin()
    assert one.goes_on()
    one.bus.connected = True
    assert one.word().outcome == "rejected"


def test_an_executor_that_could_not_be_asked_until_the_verdict_was_due_has_not_failed(
    search: Callable[..., Search],
) -> None:
    one = search()
    one.bus.connected = False
    one.begin()
    assert one.goes_on()
    one.clock.time_s = one.task.verdict_deadline or 0.0
    report = one.word()
    assert (report.outcome, report.fault) == ("undecided", "the oracle")
    assert "the executor could not be asked" in report.reason


def held_hand_over(monkeypatch: pytest.MonkeyPatch) -> tuple[list[Path], threading.Event]:
    """Files that executors are asked for, and what lets them answer."""
    looks, go_on = list[Path](), threading.Event()

    def hand_over(_bus: object, _org: str, _wanted: str, path: Path, _most: int) -> bool:
        looks.append(path)
        assert go_on.wait(HANG_S)
        path.write_bytes(DATA)
        return True

    monkeypatch.setattr(away, "hand_over", hand_over)
    return looks, go_on


def test_a_proof_that_is_missed_again_while_a_look_goes_on_is_not_looked_for_twice(
    search: Callable[..., Search], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two looks would write one file."""
    one = search()
    looks, go_on = held_hand_over(monkeypatch)
    one.begin()
    wait_until(lambda: looks)
    one.begin()
    assert one.goes_on()
    go_on.set()
    assert one.done.wait(HANG_S)
    copy = one.missing.copy(one.key)
    assert copy is not None and copy.read_bytes() == DATA
    assert looks == [copy]


def test_a_look_for_a_submission_that_was_forgotten_meanwhile_leaves_nothing(
    search: Callable[..., Search], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = search()
    looks, go_on = held_hand_over(monkeypatch)
    one.begin()
    wait_until(lambda: looks)
    one.missing.forget(one.key)
    (folder,) = (tmp_path / "proofs").iterdir()
    go_on.set()
    wait_until(lambda: not folder.exists())
    assert one.missing.copy(one.key) is None and not one.done.is_set()


@pytest.mark.parametrize("fault", ["the store", "the oracle"])
def test_a_store_that_cannot_be_read_until_the_verdict_is_due_leaves_it_to_people(
    search: Callable[..., Search], fault: str
) -> None:
    if fault == "the store":
        one = search()
        path = Path((one.task.proof_uri or "").removeprefix("file://"))
        path.symlink_to(path)  # a disk that answers with an error
    else:
        one = search("s3://elsewhere/{sha256}.mcap", ("s3://elsewhere/",))
    one.begin()
    assert one.goes_on()
    assert one.missing.summary()
    one.clock.time_s = (one.task.verdict_deadline or 0.0) - 100.0
    report = one.word()
    assert (report.outcome, report.fault) == ("undecided", fault)


def test_a_verdict_that_can_be_challenged_is_due_before_all_that_may_follow(
    site: Site, cleaning: Take
) -> None:
    task = cleaning_chain_record(cleaning).task
    assert task.verdict_deadline is not None
    disputes = DisputesConfig(judges=["organization"], votes=1, window_s=600, decision_s=900)
    challenged = site.model_copy(update={"disputes": disputes})
    long = task.model_copy(update={"verdict_window_s": disputes.longest_s + 240})
    assert away.due_s(long, challenged) == task.verdict_deadline - disputes.longest_s - 60
    # Posted when its kind had no disputes: the contracts judge it at once.
    short = task.model_copy(update={"verdict_window_s": disputes.longest_s - 1})
    assert away.due_s(short, challenged) == away.due_s(short, site)


def test_a_store_that_nobody_at_the_site_reads_is_its_executors_choice(search: Callable[..., Search]) -> None:
    one = search("s3://nowhere/{sha256}.mcap", ("s3://elsewhere",))
    one.begin()
    assert one.word().outcome == "rejected"
