"""What happens to a verification stays in its process."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace

import pytest
from rosbags.rosbag2 import StoragePlugin

import rodeo
from rodeo.checks.case import Case, Checks
from rodeo.checks.report import Finding, Report
from rodeo.checks.verify import verify_file, verify_submission
from rodeo.evidence.errors import ProofHashMismatch, ProofNotFound, ProofUriNotAllowed, StoreUnavailable
from rodeo.evidence.recorder import SealedProof
from rodeo.evidence.store import Store
from rodeo.jobs import apart
from rodeo.jobs.apart import (
    ATTEMPTS,
    MEMORY_BYTES,
    Children,
    VerificationFailed,
    VerifierEnded,
    verify_apart,
)
from rodeo.site.config import Site
from rodeo.site.sections import OracleConfig
from rodeo.vision.classification import MODEL_DIR, PREPROCESSING, WEIGHTS
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, Witnesses, seal, write_bag
from rodeo_testing.waiting import HANG_S
from services.oracle.process import SIDE_BY_SIDE
from tests.support.site import LAB

pytestmark = pytest.mark.long

MIB = 1 << 20
ROOT = Path(rodeo.__file__).parents[1]


@pytest.fixture(scope="module")
def sealed(cleaning: Take, tmp_path_factory: pytest.TempPathFactory) -> SealedProof:
    return seal(cleaning, tmp_path_factory.mktemp("sealed") / "proof.mcap", BINDING, ROBOT)


def stored_in(site: Site, folder: Path) -> Site:
    return site.model_copy(update={"data_dir": folder / "data"})


def submitted(
    site: Site,
    take: Take,
    proof: SealedProof,
    tmp_path: Path,
    *,
    limits: OracleConfig | None = None,
    memory_bytes: int = MEMORY_BYTES,
    children: Children | None = None,
    **task: object,
) -> Report:
    """The report on `take`, sealed as `proof`, after it went through the store."""
    at = stored_in(site, tmp_path)
    fields = {"proof_uri": Store(at).put(proof.path), "proof_sha256": proof.sha256} | task
    chain = cleaning_chain_record(take, **fields)
    work = partial(verify_apart, at, chain, tmp_path / "work", threading.Event(), limits=limits)
    report, failed = None, 0
    while report is None:
        try:
            report = work(memory_bytes=memory_bytes, failed=failed, children=children)
        except VerificationFailed as error:
            failed += 1
            assert failed < ATTEMPTS and error.details["task_id"] == chain.task.id
    return report


def test_an_honest_proof_is_fetched_and_accepted(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path
) -> None:
    report = submitted(site, cleaning, sealed, tmp_path)
    assert report.accepted, report.reason
    assert report.acts
    assert [check.name for check in report.checks][:2] == ["fetched", "readable_and_sealed"]
    assert list((tmp_path / "work").iterdir()) == []


@pytest.fixture(scope="module")
def honest(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path_factory: pytest.TempPathFactory
) -> Report:
    return submitted(site, cleaning, sealed, tmp_path_factory.mktemp("honest"))


def test_a_bag_is_rejected_whatever_keeps_the_oracle_from_deciding_it(
    site: Site, cleaning: Take, tmp_path: Path
) -> None:
    """Else a witness that failed, or a file that breaks its reader, would leave it to people."""
    doubtful = Witnesses(mocap_inputs="open_bus")
    bag = write_bag(cleaning, tmp_path / "bag", StoragePlugin.MCAP, witnesses=doubtful) / "bag.mcap"
    assert verify_file(bag, site, cleaning_chain_record(cleaning)).outcome == "rejected"
    broken = tmp_path / "broken.bag"
    broken.write_bytes(b"#ROSBAG V2.0\n" + bytes(1000))
    for file in (bag, broken):
        at = site.model_copy(update={"data_dir": tmp_path / "data"})
        sha256 = "0x" + hashlib.sha256(file.read_bytes()).hexdigest()
        chain = cleaning_chain_record(cleaning, proof_uri=Store(at).put(file), proof_sha256=sha256)
        report = verify_submission(at, chain, tmp_path)
        assert report.outcome == "rejected"
        assert report.reason.startswith("sealed: ")


def test_a_uri_of_another_file_is_a_verdict(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path
) -> None:
    report = submitted(site, cleaning, sealed, tmp_path, proof_sha256="0x" + "ab" * 32)
    assert "proof_hash_mismatch" in report.reason
    assert report.proof_sha256 == "0x" + "ab" * 32


def test_a_uri_outside_the_store_is_a_verdict(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path
) -> None:
    report = submitted(site, cleaning, sealed, tmp_path, proof_uri="file:///etc/passwd")
    assert "proof_uri_not_allowed" in report.reason


def test_what_the_store_lacks_or_damaged_or_may_not_give_is_no_verdict(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path
) -> None:
    """The bytes that were submitted may be had elsewhere."""
    lost = {"proof_uri": f"{(tmp_path / 'data' / 'store').as_uri()}/{'ab' * 32}.mcap"}
    hash_ = {"proof_sha256": "0x" + "ab" * 32}
    with pytest.raises(ProofNotFound):
        submitted(site, cleaning, sealed, tmp_path, **lost, **hash_)
    (tmp_path / "data" / "store" / f"{'ab' * 32}.mcap").write_bytes(b"something else")
    with pytest.raises(ProofHashMismatch) as damaged:
        submitted(site, cleaning, sealed, tmp_path, **lost, **hash_)
    assert damaged.value.details["expected"] == hash_["proof_sha256"]
    with pytest.raises(ProofUriNotAllowed):
        submitted(site, cleaning, sealed, tmp_path, proof_uri=f"s3://elsewhere/{'ab' * 32}.mcap", **hash_)


def ended_by_the_proof(report: Report, outcome: str = "given_up") -> str:
    """What ended the verification, for which nobody is fined. All judges say the same, however it ended."""
    assert (report.outcome, report.fault, report.party) == (outcome, "the oracle", "oracle"), report.reason
    assert f", {ATTEMPTS} times; the oracle is at fault, not the executor" in report.reason
    return report.reason


def test_a_verification_that_hangs_is_given_up(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    chain = cleaning_chain_record(cleaning, proof_sha256=sealed.sha256)
    verify = partial(verify_apart, site, chain, tmp_path, threading.Event(), copy=sealed.path)
    limits = OracleConfig(time_limit_s=0.05)
    with pytest.raises(VerificationFailed):
        verify(limits=limits)
    report = verify(limits=limits, failed=ATTEMPTS - 1)
    assert report is not None and "ended without a report" in ended_by_the_proof(report)
    assert "hung for 0.05 s" in caplog.text


def test_a_store_that_hangs_is_no_fault_of_the_proof(site: Site, cleaning: Take, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        slow = site.model_copy(update={"store": site.store.model_copy(update={"allowed": [url]})})
        hash_ = "ab" * 32
        chain = cleaning_chain_record(cleaning, proof_uri=f"{url}/{hash_}.mcap", proof_sha256="0x" + hash_)
        with pytest.raises(StoreUnavailable, match="did not send the proof in time"):
            verify_apart(
                slow, chain, tmp_path, threading.Event(), limits=OracleConfig(time_limit_s=5.0), failed=1
            )


def use_without_end(_site: Site, what: apart.What, _folder: Path) -> None:
    """As a verification that never ends."""
    apart.limit(what)
    while True:
        pass


def test_a_verification_that_uses_up_its_cpu_time_is_given_up(
    site: Site,
    cleaning: Take,
    sealed: SealedProof,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(apart, "_child", use_without_end)
    report = submitted(site, cleaning, sealed, tmp_path, limits=OracleConfig(cpu_limit_s=1.0))
    ended_by_the_proof(report)
    assert "used more than 1 s of CPU time" in caplog.text


def test_a_store_that_does_not_answer_is_no_verdict(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path
) -> None:
    broken = tmp_path / "data" / "store" / f"{'ab' * 32}.mcap"
    broken.parent.mkdir(parents=True)
    broken.symlink_to(broken)  # a disk that answers with an error
    with pytest.raises(StoreUnavailable):
        submitted(site, cleaning, sealed, tmp_path, proof_uri=broken.as_uri())


class SlowStore:
    """A child that is at nine tenths of its time when the proof is here, and takes as long to verify it."""

    def __init__(self, report: Report, limit_s: float) -> None:
        self.now_s, self._report, self._limit_s = 0.0, report, limit_s
        self._folder = Path()

    def ask(self, _what: apart.What, folder: Path) -> None:
        self._folder = folder

    def is_done(self, longest_s: float) -> bool:
        self.now_s += longest_s
        if self.now_s > 0.9 * self._limit_s:
            (self._folder / "fetched").touch()
        if done := self.now_s > 1.8 * self._limit_s:
            (self._folder / "report.json").write_bytes(self._report.to_bytes())
        return done


def test_the_time_that_a_store_takes_is_not_taken_from_the_proof(
    site: Site, cleaning: Take, honest: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = SlowStore(honest, site.oracle.time_limit_s)
    children = SimpleNamespace(take=lambda: child, give_back=lambda *_: None)
    monkeypatch.setattr(apart, "time", SimpleNamespace(monotonic=lambda: child.now_s))
    chain, stop = cleaning_chain_record(cleaning), threading.Event()
    assert verify_apart(site, chain, tmp_path, stop, children=children) == honest  # type: ignore[arg-type]


def test_one_that_hangs_keeps_no_other_waiting(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path
) -> None:
    assert SIDE_BY_SIDE >= 2
    stop, verdicts = threading.Event(), list[Report | None]()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        slow = site.model_copy(update={"store": site.store.model_copy(update={"allowed": [url]})})
        chain = cleaning_chain_record(
            cleaning, proof_uri=f"{url}/{'ab' * 32}.mcap", proof_sha256="0x" + "ab" * 32
        )
        hanging = threading.Thread(
            target=lambda: verdicts.append(verify_apart(slow, chain, tmp_path / "hanging", stop))
        )
        hanging.start()
        silent.settimeout(HANG_S)
        connection, _ = silent.accept()
        with connection:
            assert submitted(site, cleaning, sealed, tmp_path).accepted
            assert verdicts == []
            stop.set()
            hanging.join()
    assert verdicts == [None]


def test_a_verification_without_memory_is_given_up(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ended_by_the_proof(submitted(site, cleaning, sealed, tmp_path, memory_bytes=40 * MIB))
    assert "crashed with exit status" in caplog.text


def claim_and_crash(site: Site, what: apart.What, folder: Path) -> None:
    """What a child does whose proof claims something and then breaks what checks it."""

    def breaks(_case: Case) -> Finding:
        os._exit(3)

    def broken(checks: Checks) -> Checks:
        return replace(checks, stages=((breaks,),))

    apart.verify_claiming(site, what, folder, checks_of=broken)


def test_what_a_proof_claims_is_listed_although_its_verification_crashed(
    site: Site,
    cleaning: Take,
    sealed: SealedProof,
    tmp_path: Path,
    honest: Report,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """People may accept it yet, and then nobody is paid for the same drop again."""
    monkeypatch.setattr(apart, "_child", claim_and_crash)
    report = submitted(site, cleaning, sealed, tmp_path)
    assert "ended without a report" in ended_by_the_proof(report)
    assert report.acts == honest.acts
    assert any("/drop/" in act for act in report.acts)


@pytest.fixture
def children(site: Site, tmp_path: Path) -> Iterator[Children]:
    children = Children(stored_in(site, tmp_path))
    yield children
    children.end()


def verifying() -> set[BaseProcess]:
    """Children that wait for a proof, those of other tests included."""
    return {child for child in multiprocessing.active_children() if child.name == "verification"}


def test_a_child_of_several_verifies_the_next_proof_until_it_meets_one_that_it_does_not_accept(
    site: Site,
    cleaning: Take,
    sealed: SealedProof,
    tmp_path: Path,
    children: Children,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(apart, "_SIGNAL_GRACE_S", HANG_S)
    others = verifying()
    assert submitted(site, cleaning, sealed, tmp_path, children=children).accepted
    first = verifying() - others
    assert len(first) == 1
    assert submitted(site, cleaning, sealed, tmp_path, children=children).accepted
    assert verifying() - others == first
    of_another = submitted(site, cleaning, sealed, tmp_path, children=children, id=BINDING.task_id + 1)
    assert of_another.outcome == "rejected"
    assert not verifying() - others
    assert [one.exitcode for one in first] == [0]  # it was asked nothing more, which is no error
    assert submitted(site, cleaning, sealed, tmp_path, children=children).accepted
    assert len(verifying() - others - first) == 1


def test_a_child_that_was_killed_while_it_waited_costs_the_next_proof_nothing(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path, children: Children
) -> None:
    others = verifying()
    assert submitted(site, cleaning, sealed, tmp_path, children=children).accepted
    (killed,) = verifying() - others
    killed.kill()
    killed.join()
    assert submitted(site, cleaning, sealed, tmp_path, children=children).accepted


def say_half(_site: Site, what: apart.What, folder: Path) -> None:
    """As a proof that has taken its child over: it leaves a report, and begins a message."""
    assert what.copy is not None
    shutil.copy(what.copy, folder / "report.json")
    for number in map(int, os.listdir("/proc/self/fd")):
        with suppress(OSError):  # that of the listing is closed
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                os.write(number, b"\0")
    signal.pause()


def test_a_child_that_begins_to_say_something_is_not_waited_for(
    site: Site, cleaning: Take, honest: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_child", say_half)
    (tmp_path / "report").write_bytes(honest.to_bytes())
    others = verifying()
    children = Children(site)
    chain, copy = cleaning_chain_record(cleaning), tmp_path / "report"
    assert verify_apart(site, chain, tmp_path / "work", threading.Event(), copy=copy, children=children)
    assert not verifying() - others


def use_most_of_it(_site: Site, what: apart.What, folder: Path) -> None:
    """As a verification that uses more than half of its CPU time, and then accepts."""
    apart.limit(what)
    until_s = time.process_time() + 0.6 * what.cpu_limit_s
    while time.process_time() < until_s:
        pass
    assert what.copy is not None
    shutil.copy(what.copy, folder / "report.json")


def test_each_proof_of_a_child_has_the_whole_cpu_time(
    site: Site, cleaning: Take, honest: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_child", use_most_of_it)
    (tmp_path / "report").write_bytes(honest.to_bytes())
    work = partial(verify_apart, site, cleaning_chain_record(cleaning), tmp_path / "work", threading.Event())
    children, others = Children(site), verifying()
    for _ in range(2):
        assert work(limits=OracleConfig(cpu_limit_s=2.0), copy=tmp_path / "report", children=children)
    assert len(verifying() - others) == 1
    children.end()


def say_nothing(_site: Site, _what: apart.What, _folder: Path) -> None:
    """As a verification that a proof took over."""


def test_a_child_that_says_it_is_done_and_left_no_report_has_failed(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_child", say_nothing)
    others = verifying()
    assert "ended without a report" in ended_by_the_proof(submitted(site, cleaning, sealed, tmp_path))
    assert not verifying() - others


def test_an_oracle_that_stops_gives_no_verdict(site: Site, cleaning: Take, tmp_path: Path) -> None:
    stop = threading.Event()
    stop.set()
    assert verify_apart(site, cleaning_chain_record(cleaning), tmp_path / "work", stop) is None


class NoServer:
    """A context whose fork server ended while it loaded a kind."""

    def __init__(self) -> None:
        self.Pipe = multiprocessing.Pipe

    def Process(self, **_: object) -> NoServer:  # noqa: N802 - as multiprocessing calls it
        return self

    def start(self) -> None:
        raise EOFError("unexpected EOF")


def test_a_fork_server_that_ends_while_it_loads_is_told_by_its_type(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_context_of", lambda site: NoServer())
    with pytest.raises(VerifierEnded) as ended:
        apart.start(site)
    assert "unexpected EOF" in ended.value.details["reason"]


def test_a_verification_that_cannot_be_started_is_undecided(
    site: Site, cleaning: Take, sealed: SealedProof, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_context_of", lambda site: NoServer())
    report = submitted(site, cleaning, sealed, tmp_path)
    assert "did not start" in ended_by_the_proof(report, "undecided")


STARTS = """
import sys
from pathlib import Path

import rodeo
from rodeo.site.config import Site
from rodeo.jobs.apart import start

if __name__ == "__main__":
    assert rodeo.__file__.startswith(sys.argv[1])
    rules = start(Site.load(Path(sys.argv[2])))
    print(*sorted(name for name, found in rules.items() if found))
"""


@pytest.mark.parametrize(
    ("name", "content", "judged"),
    [
        (WEIGHTS, b"no network", "battery_charging waste_disposal"),
        (PREPROCESSING, b"{}", "battery_charging waste_disposal"),
        (WEIGHTS, None, "battery_charging"),
    ],
    ids=["no network", "no preprocessing", "missing"],
)
def test_a_network_that_cannot_be_loaded_keeps_no_other_kind_from_being_judged(
    tmp_path: Path, name: str, content: bytes | None, judged: str
) -> None:
    """Cleanings have rules that nobody announced then, or none."""
    shutil.copytree(Path(rodeo.__file__).parent, tmp_path / "rodeo")
    file = tmp_path / "rodeo" / MODEL_DIR.relative_to(Path(rodeo.__file__).parent) / name
    file.unlink()
    if content is not None:
        file.write_bytes(content)
    (tmp_path / "starts.py").write_text(STARTS)
    answer = subprocess.run(
        [sys.executable, tmp_path / "starts.py", tmp_path, LAB],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"},
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert answer.stdout.strip() == judged, answer.stderr
    assert "the installed network cannot be loaded" in answer.stderr
