"""A verification as a job has the report that an oracle's has, and no other report answers it."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from rodeo.checks.report import Report
from rodeo.evidence.store import Store
from rodeo.jobs.job import BadAnswer, Job, JobFailed, WorkerDiffers
from rodeo.jobs.local import Local
from rodeo.jobs.proofs import Asked, Verify, lab_sha256
from rodeo.jobs.runner import Runner
from rodeo.site.config import Site
from rodeo.site.sections import OracleConfig
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, seal

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def at(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Site:
    return site.model_copy(update={"data_dir": tmp_path_factory.mktemp("data")})


@pytest.fixture(scope="module")
def job(at: Site, cleaning: Take, tmp_path_factory: pytest.TempPathFactory) -> Job:
    proof = seal(cleaning, tmp_path_factory.mktemp("sealed") / "proof.mcap", BINDING, ROBOT)
    uri = Store(at).put(proof.path)
    chain = cleaning_chain_record(cleaning, proof_uri=uri, proof_sha256=proof.sha256)
    return Verify(at, at.data_dir / "work").job(proof.sha256, chain)


@pytest.fixture(scope="module")
def answer(at: Site, job: Job) -> bytes:
    return Verify(at, at.data_dir / "work").do(job, threading.Event())


def test_an_honest_proof_is_accepted_and_its_report_answers_the_job(
    at: Site, job: Job, answer: bytes, tmp_path: Path
) -> None:
    report = Report.model_validate_json(answer)
    assert report.accepted, report.reason
    assert report.to_bytes() == answer
    verify = Verify(at, tmp_path)
    verify.check(job, answer)
    assert verify.doubt(answer) == ""


@pytest.mark.parametrize(
    "other",
    [{"proof_sha256": "0x" + "ab" * 32}, {"task_id": 99}, {"rules_sha256": "0x" + "cd" * 32}],
    ids=str,
)
def test_the_report_on_another_proof_is_no_answer(
    at: Site, job: Job, answer: bytes, tmp_path: Path, other: dict[str, object]
) -> None:
    report = Report.model_validate_json(answer).model_copy(update=other)
    with pytest.raises(BadAnswer) as error:
        Verify(at, tmp_path).check(job, report.to_bytes())
    assert error.value.details == other


@pytest.mark.parametrize("name", ["lab_sha256", "package", "rules"])
def test_a_worker_that_differs_refuses_and_names_what_differs(
    at: Site, job: Job, tmp_path: Path, name: str
) -> None:
    other: object = {"waste_disposal": "0x" + "cd" * 32} if name == "rules" else "another"
    with pytest.raises(WorkerDiffers, match=f"another {name}"):
        Verify(at, tmp_path).do(Job(job.work, {**job.given, name: other}), threading.Event())


def test_a_worker_of_another_version_says_so_where_a_kind_is_not_installed(
    at: Site, job: Job, tmp_path: Path
) -> None:
    lacks = at.model_copy(update={"kinds": [at.kinds[0].model_copy(update={"name": "unknown"})]})
    with pytest.raises(WorkerDiffers, match="another package"):
        Verify(lacks, tmp_path).do(Job(job.work, {**job.given, "package": "another"}), threading.Event())


def test_a_lab_where_something_stands_elsewhere_is_another_lab(site: Site, tmp_path: Path) -> None:
    moved = site.bins[0].model_copy(
        update={"pose": site.bins[0].pose.model_copy(update={"x_m": site.bins[0].pose.x_m + 0.1})}
    )
    assert lab_sha256(site.model_copy(update={"bins": [moved]})) != lab_sha256(site)
    assert lab_sha256(site.model_copy(update={"data_dir": tmp_path, "org": "other"})) == lab_sha256(site)


def test_a_file_with_other_bytes_is_reported_as_not_fetched(at: Site, job: Job, tmp_path: Path) -> None:
    (tmp_path / "changed.mcap").write_bytes(b"something else")
    verify = Verify(at, tmp_path)
    changed = Job(job.work, job.given, tmp_path / "changed.mcap")
    answer = verify.do(changed, threading.Event())
    verify.check(changed, answer)
    assert "proof_hash_mismatch" in verify.doubt(answer)


def test_a_file_that_the_store_would_not_give_is_reported_as_not_fetched(
    at: Site, job: Job, tmp_path: Path
) -> None:
    small = at.model_copy(update={"store": at.store.model_copy(update={"max_bytes": 1})})
    file = Store(at).file(job.given["chain"]["task"]["proof_uri"])
    verify = Verify(small, tmp_path)
    asked = {**job.given, "lab_sha256": verify.lab_sha256}
    report = Report.model_validate_json(verify.do(Job(job.work, asked, file), threading.Event()))
    assert "proof_too_large" in report.reason


def test_a_rejection_of_another_file_is_no_answer_and_what_cannot_be_read_has_the_tasks_hash(
    at: Site, job: Job, answer: bytes, tmp_path: Path
) -> None:
    verify, chain = Verify(at, tmp_path), Asked.model_validate(job.given).chain
    assert chain is not None
    (tmp_path / "damaged.mcap").write_bytes(b"something else")
    asked = verify.file(tmp_path / "damaged.mcap", chain)
    rejected = Report.model_validate_json(answer).model_copy(update={"outcome": "rejected"})
    verify.check(asked, rejected.to_bytes())
    with pytest.raises(BadAnswer, match="another proof"):
        verify.check(asked, rejected.model_copy(update={"proof_sha256": "0x" + "ab" * 32}).to_bytes())


def test_a_file_that_is_read_otherwise_is_another_question(at: Site, tmp_path: Path) -> None:
    verify = Verify(at, tmp_path)
    keys = set()
    for name in ("proof.mcap", "proof.bag"):
        (tmp_path / name).write_bytes(b"the same")
        keys.add(verify.file(tmp_path / name).key)
    assert len(keys) == 2


def test_another_version_is_named_whatever_it_asks(at: Site, tmp_path: Path) -> None:
    with pytest.raises(WorkerDiffers, match="another package"):
        Verify(at, tmp_path).do(Job("verify", {"package": "9.9", "new": 1}), threading.Event())


def test_a_file_that_is_too_large_is_not_read(at: Site, tmp_path: Path) -> None:
    with (tmp_path / "large.mcap").open("wb") as file:
        file.truncate(1 << 40)
    verify = Verify(at, tmp_path / "work")
    report = Report.model_validate_json(verify.do(verify.file(tmp_path / "large.mcap"), threading.Event()))
    assert report.reason.startswith("readable_and_sealed: proof_too_large")


def test_a_verification_that_ends_without_a_report_is_given_up_as_the_oracle_does(
    at: Site, job: Job, tmp_path: Path
) -> None:
    hasty = at.model_copy(update={"oracle": OracleConfig(time_limit_s=0.05)})
    here = Store(at).file(job.given["chain"]["task"]["proof_uri"])  # so that no store was slow
    with Runner(Local([Verify(hasty, tmp_path / "work")]), folder=tmp_path / "kept") as runner:
        (done,) = runner.run([Job(job.work, job.given, here)])
    assert done.answer is not None
    assert Report.model_validate_json(done.answer).outcome == "given_up"
    assert not list((tmp_path / "kept").glob("*.json"))


def test_a_file_of_no_chain_that_hangs_the_checks_has_no_answer(at: Site, job: Job, tmp_path: Path) -> None:
    hasty = at.model_copy(update={"oracle": OracleConfig(time_limit_s=0.05)})
    verify = Verify(hasty, tmp_path / "work")
    file = Store(at).fetch(
        job.given["chain"]["task"]["proof_uri"], job.given["proof_sha256"], folder=tmp_path
    )
    with pytest.raises(JobFailed, match=r"hung for 0\.05 s"):
        verify.do(verify.job(job.given["proof_sha256"], file=file, submitted=False), threading.Event())
