"""Each job is done once, elsewhere where that works, and its answer is checked wherever it was made."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from rodeo.errors import FolderTaken, Interrupted, InvalidRequest
from rodeo.jobs.job import (
    MOST_BYTES,
    BadAnswer,
    Engine,
    EngineGone,
    Job,
    JobError,
    JobFailed,
    WorkerDiffers,
    WorkerLost,
)
from rodeo.jobs.local import Local
from rodeo.jobs.runner import TRIES, Runner
from rodeo_testing.waiting import HANG_S


@dataclass
class Doubling:
    """A work whose answer is its number twice."""

    name: str = "double"
    longest_s: float = HANG_S
    done: list[int] = field(default_factory=list)
    fails_at: int | None = None

    def do(self, job: Job, stop: threading.Event) -> bytes:
        self.done.append(job.given["number"])
        if job.given["number"] == self.fails_at:
            raise JobFailed("it ended without an answer", log="the last line")
        return str(2 * job.given["number"]).encode()

    def check(self, job: Job, answer: bytes) -> None:
        if answer != str(2 * job.given["number"]).encode():
            raise BadAnswer("this is not twice the number", answer=answer[:20])

    def doubt(self, _answer: bytes) -> str:
        return ""

    def close(self) -> None:
        """Nothing waits."""


@dataclass
class Elsewhere:
    """An engine whose workers answer as they please."""

    answers: Callable[[Job], bytes]
    name: str = "elsewhere"
    places: int = 2
    closed: bool = False

    def do(self, job: Job, stop: threading.Event, failed: int = 0) -> bytes:
        return self.answers(job)

    def close(self) -> None:
        self.closed = True


def doubled(
    folder: Path, numbers: range | list[int], work: Doubling, elsewhere: Engine | None = None
) -> dict[int, bytes | None]:
    with Runner(Local([work], 2), elsewhere, folder=folder) as runner:
        return {
            done.job.given["number"]: done.answer
            for done in runner.run(Job("double", {"number": number}) for number in numbers)
        }


def test_every_job_has_its_answer_and_is_done_once(tmp_path: Path) -> None:
    work = Doubling()
    assert doubled(tmp_path, [*range(50), *range(50)], work) == {n: str(2 * n).encode() for n in range(50)}
    assert sorted(work.done) == list(range(50))


def test_what_was_answered_before_is_not_done_again_unless_its_file_is_damaged(tmp_path: Path) -> None:
    doubled(tmp_path, range(5), Doubling())
    (tmp_path / f"{Job('double', {'number': 3}).key}.json").write_text("7")
    work = Doubling()
    assert doubled(tmp_path, range(6), work)[3] == b"6"
    assert sorted(work.done) == [3, 5]


def lost(_: Job) -> bytes:
    raise WorkerLost("the worker died", worker="w1")


@pytest.mark.parametrize(
    "answers",
    [lost, lambda _: b"1", lambda _: bytes(MOST_BYTES + 1)],
    ids=["dies", "answers another job", "answers without end"],
)
def test_a_job_that_workers_fail_at_twice_is_done_here(
    tmp_path: Path, answers: Callable[[Job], bytes]
) -> None:
    work, elsewhere = Doubling(), Elsewhere(answers)
    with Runner(Local([work]), elsewhere, folder=tmp_path) as runner:
        (done,) = runner.run([Job("double", {"number": 4})])
    assert (done.answer, done.by, len(done.lost)) == (b"8", "local", TRIES)
    assert work.done == [4]
    assert elsewhere.closed


def test_a_job_that_one_worker_fails_at_is_given_to_the_next(tmp_path: Path) -> None:
    tries: list[Job] = []

    def second_time(job: Job) -> bytes:
        tries.append(job)
        return b"8" if len(tries) == 2 else lost(job)

    work = Doubling()
    with Runner(Local([work]), Elsewhere(second_time), folder=tmp_path) as runner:
        (done,) = runner.run([Job("double", {"number": 4})])
    assert (done.answer, done.by, work.done) == (b"8", "elsewhere", [])


@pytest.mark.parametrize("kind", [WorkerDiffers, EngineGone])
def test_what_fails_for_every_job_is_named_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: type[JobError]
) -> None:
    def fails(_: Job) -> bytes:
        raise kind("another package", here="0.0.9")

    assert doubled(tmp_path, range(5), Doubling(), Elsewhere(fails))[4] == b"8"
    assert [record.getMessage().partition(": ")[2] for record in caplog.records] == [
        "another package (here='0.0.9')"
    ]


def test_once_an_engine_is_gone_this_machine_does_as_many_jobs_at_a_time_as_it_can(tmp_path: Path) -> None:
    together = threading.Barrier(2)

    class InPairs(Doubling):
        def do(self, job: Job, stop: threading.Event) -> bytes:
            if job.given["number"]:  # with the first one the engine is found to be gone
                together.wait(HANG_S)
            return super().do(job, stop)

    def ends(_: Job) -> bytes:
        raise EngineGone("no workers any more")

    assert len(doubled(tmp_path, range(5), InPairs(), Elsewhere(ends, places=1))) == 5
    assert not together.broken


def test_a_job_is_not_begun_after_the_stop() -> None:
    stop, work = threading.Event(), Doubling()
    stop.set()
    with pytest.raises(Interrupted):
        Local([work]).do(Job("double", {"number": 1}), stop)
    assert work.done == []


def test_an_engine_that_is_gone_is_not_asked_again(tmp_path: Path) -> None:
    asked: list[Job] = []

    def ends(job: Job) -> bytes:
        asked.append(job)
        raise EngineGone("no workers any more")

    assert len(doubled(tmp_path, range(5), Doubling(), Elsewhere(ends))) == 5
    assert 1 <= len(asked) <= 2  # two jobs may be under way


def test_two_commands_do_not_do_jobs_in_one_folder(tmp_path: Path) -> None:
    with (
        Runner(Local([Doubling()]), folder=tmp_path),
        pytest.raises(FolderTaken, match="name another folder"),
    ):
        doubled(tmp_path, range(1), Doubling())
    assert doubled(tmp_path, range(1), Doubling()) == {0: b"0"}


def test_where_answers_cannot_be_kept_the_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidRequest, match="cannot be kept"):
        doubled(tmp_path / "file", range(1), Doubling())
    (tmp_path / f"{Job('double', {'number': 0}).key}.json").mkdir()
    with pytest.raises(InvalidRequest, match="cannot be kept"):
        doubled(tmp_path, range(1), Doubling())


def test_what_strangers_write_has_a_key() -> None:
    keys = {Job("double", {"number": number}).key for number in (2**60, 2**60 + 1, 1e300, "\udcff")}
    assert len(keys) == 4


class OfNow(Doubling):
    """Another machine, or the same one later, may answer otherwise."""

    def doubt(self, _answer: bytes) -> str:
        return "the store lacked it"


def test_an_answer_that_another_machine_may_not_give_counts_from_this_one_and_is_not_kept(
    tmp_path: Path,
) -> None:
    with Runner(Local([OfNow()]), Elsewhere(lambda _: b"8"), folder=tmp_path) as runner:
        (done,) = runner.run([Job("double", {"number": 4})])
    assert (done.answer, done.by) == (b"8", "local")
    assert [error.details["answer"] for error in done.lost] == TRIES * ["the store lacked it"]
    assert list(tmp_path.glob("*.json")) == []


def test_a_job_that_fails_comes_back_with_its_log_and_the_others_continue(tmp_path: Path) -> None:
    with Runner(Local([Doubling(fails_at=1)], 1), folder=tmp_path) as runner:
        found = list(runner.run(Job("double", {"number": number}) for number in range(3)))
    assert [one.answer for one in found] == [b"0", None, b"4"]
    error = found[1].error
    assert isinstance(error, JobError)
    assert error.log == "the last line"


class Waiting(Doubling):
    """Until it is stopped."""

    def do(self, job: Job, stop: threading.Event) -> bytes:
        self.done.append(1)
        assert stop.wait(HANG_S)
        raise Interrupted("stopped")


def test_ctrl_c_stops_all_jobs(tmp_path: Path) -> None:
    work = Waiting()

    def jobs() -> object:
        yield Job("double", {"number": 1})
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), Runner(Local([work], 2), folder=tmp_path) as runner:
        list(runner.run(jobs()))  # type: ignore[arg-type]
    assert work.done == [1]
    assert list(tmp_path.glob("*.json")) == []


def test_no_more_jobs_are_read_than_there_are_places(tmp_path: Path) -> None:
    read = 0

    def jobs() -> object:
        nonlocal read
        for number in range(100):
            read += 1
            yield Job("double", {"number": number})

    with Runner(Local([Doubling()], 2), folder=tmp_path) as runner:
        for ended, _ in enumerate(runner.run(jobs()), start=1):  # type: ignore[arg-type]
            assert read <= ended + 2


def test_an_engine_whose_workers_join_later_is_given_more(tmp_path: Path) -> None:
    together = threading.Barrier(3)

    def answers(job: Job) -> bytes:
        elsewhere.places = 3
        if job.given["number"]:
            together.wait(HANG_S)
        return str(2 * job.given["number"]).encode()

    elsewhere = Elsewhere(answers, places=1)
    assert len(doubled(tmp_path, range(4), Doubling(), elsewhere)) == 4
    assert not together.broken
