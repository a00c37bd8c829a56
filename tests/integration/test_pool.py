"""What becomes of jobs whose workers die, freeze, lie, send too much, or are of another version."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from hashlib import sha256
from pathlib import Path

import pytest

from deploy.certificates import ensure_certificates
from rodeo.checks.report import Report
from rodeo.errors import Interrupted
from rodeo.evidence.errors import StoreUnavailable
from rodeo.evidence.recorder import SealedProof
from rodeo.evidence.store import Store
from rodeo.jobs.job import BadAnswer, EngineGone, Job, JobFailed, WorkerDiffers, WorkerLost
from rodeo.jobs.local import Local
from rodeo.jobs.proofs import Verify
from rodeo.jobs.runner import Done, Runner
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning
from rodeo_pool.authority import ensure
from rodeo_pool.engine import Dask
from rodeo_pool.errors import PoolFilesMissing, PoolUnavailable
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, seal
from rodeo_testing.waiting import wait_until
from tests.support import s3
from tests.support.pool import Deed, started
from tests.support.site import LAB

pytestmark = [pytest.mark.long, pytest.mark.alone]

MAX_BYTES = 4 << 20
PRELOAD = {"DASK_DISTRIBUTED__WORKER__PRELOAD": "tests.support.pool"}
CLOSED, LARGE, OTHER, LACKING = bytes(1), bytes(MAX_BYTES + 1), bytes(2), bytes(3)
"""What lies where no worker may read, is too large, has another file's name, or is not there."""


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pool") / "tls"
    ensure(folder)
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """The site of client and workers. Its store is in S3, and only workers have credentials."""
    stores = {"RODEO__STORE__URL": "s3://proofs", "RODEO__STORE__ALLOWED": '["s3://closed"]'}
    environment = stores | {"RODEO__STORE__MAX_BYTES": str(MAX_BYTES), "RODEO__CLOCK__SOURCE": "wall"}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        yield Site.load(LAB).model_copy(update={"data_dir": tmp_path_factory.mktemp("data")})


@pytest.fixture(scope="module")
def proof(site: Site, tmp_path_factory: pytest.TempPathFactory) -> tuple[Take, SealedProof]:
    take = film_cleaning(site, "item1")
    return take, seal(take, tmp_path_factory.mktemp("sealed") / "proof.mcap", BINDING, ROBOT)


@pytest.fixture(scope="module")
def readers(proof: tuple[Take, SealedProof]) -> Iterator[dict[str, str]]:
    """The workers' credentials."""
    files = {hashed(data): data for data in (proof[1].path.read_bytes(), LARGE)} | {hashed(OTHER): b"other"}
    with s3.serving() as url, pytest.MonkeyPatch.context() as patch:
        for bucket, holds in {"proofs": files, "closed": {hashed(CLOSED): CLOSED}}.items():
            s3.make_bucket(url, bucket, {f"{name[2:]}.mcap": data for name, data in holds.items()})
        s3.without_credentials(patch, url)
        with s3.closed(url, "proofs") as credentials:
            yield credentials


def hashed(data: bytes) -> str:
    return "0x" + sha256(data).hexdigest()


@pytest.fixture(scope="module")
def address(tls: Path, site: Site, readers: dict[str, str]) -> Iterator[str]:
    with started("tests.support.pool", tls, LAB, **PRELOAD, **readers) as at:
        yield at


@pytest.fixture(scope="module")
def verify(site: Site) -> Verify:
    return Verify(site, site.data_dir / "verifying")


@pytest.fixture(scope="module")
def engine(tls: Path, address: str, verify: Verify) -> Iterator[Dask]:
    dask = Dask(address, tls, {Deed.name: Deed(), Verify.name: verify}, MAX_BYTES)
    yield dask
    dask.close()


def job(deed: str, number: int = 0, **given: str) -> Job:
    return Job(Deed.name, {"deed": deed, "number": number, **given})


def done(engine: Dask, folder: Path, *jobs: Job) -> list[Done]:
    """What came of the jobs; the local engine does what the pool fails at. The engine stays open."""
    runner = Runner(Local([Deed()]), engine, folder=folder)
    folder.mkdir(exist_ok=True)
    return list(runner.run(jobs))


def test_each_job_is_done_once_whoever_asks_for_it_and_a_small_file_is_sent(
    engine: Dask, tmp_path: Path
) -> None:
    file = tmp_path / "proof.mcap"
    file.write_bytes(b"recorded")
    jobs = [*(job("answer", number % 20) for number in range(40)), Job(Deed.name, {"deed": "answer"}, file)]
    found = done(engine, tmp_path / "kept", *jobs)
    assert sorted(one.job.key for one in found) == sorted(one.key for one in jobs)
    assert {one.by for one in found} == {"dask", "kept"}
    assert not [one for one in found if one.lost or one.answer is None]
    assert {one.by for one in done(engine, tmp_path / "kept", *jobs)} == {"kept"}


def test_a_file_larger_than_the_store_allows_is_not_sent(engine: Dask, tmp_path: Path) -> None:
    file = tmp_path / "proof.mcap"
    file.write_bytes(bytes(MAX_BYTES + 1))
    with pytest.raises(JobFailed, match="too large to be sent"):
        engine.do(Job(Deed.name, {"deed": "answer"}, file), threading.Event())


@pytest.mark.parametrize(
    ("deed", "error", "words"),
    [
        ("die", WorkerLost, "died or froze"),
        ("freeze", WorkerLost, "died or froze"),
        ("another", BadAnswer, "of another job"),
        ("large", BadAnswer, "too large"),
        ("differ", WorkerDiffers, "another package"),
        ("lack", JobFailed, "lacks a package"),
        ("surprise", JobFailed, "ZeroDivisionError"),
    ],
)
def test_what_a_worker_does_wrong_is_named_and_the_job_is_done_again(
    engine: Dask, tmp_path: Path, deed: str, error: type[Exception], words: str
) -> None:
    wrong = job(deed, once=str(tmp_path / "once"))
    (found,) = done(engine, tmp_path, wrong)
    first = next(one for one in found.lost if type(one) is error)
    assert words in str(first) and first.details["machine"] == "127.0.0.1"
    assert found.answer is not None


def test_a_job_that_one_worker_fails_at_is_done_by_another(address: str, tls: Path, tmp_path: Path) -> None:
    jobs = [job("lack", number, worker=str(tmp_path / "lacks")) for number in range(20)]
    with ExitStack() as stack:
        engines: list[Dask] = []

        def both() -> bool:  # what other tests have killed comes back first
            with suppress(PoolUnavailable):
                engine = Dask(address, tls, {Deed.name: Deed()}, MAX_BYTES)
                engines.append(stack.enter_context(closing(engine)))
            return engines != [] and engines[-1].places == 4

        wait_until(both)
        found = done(engines[-1], tmp_path / "answers", *jobs)
    assert {one.by for one in found} == {"dask"}
    assert {len(one.lost) for one in found} == {0, 1}


def test_a_job_that_kills_two_workers_is_done_here_and_none_is_lost_or_doubled(
    engine: Dask, tmp_path: Path
) -> None:
    jobs = [job("die"), *(job("answer", number) for number in range(20))]
    found = done(engine, tmp_path, *jobs)
    assert sorted(one.job.key for one in found) == sorted(one.key for one in jobs)
    killed = next(one for one in found if one.job.key == jobs[0].key)
    assert killed.by == "local"
    assert [type(one) for one in killed.lost] == [WorkerLost, WorkerLost]
    assert not [one for one in found if one.answer is None]


def submitted(proof: tuple[Take, SealedProof], verify: Verify, uri: str, sha256: str) -> Job:
    return verify.job(sha256, cleaning_chain_record(proof[0], proof_uri=uri, proof_sha256=sha256))


def test_a_worker_reads_a_proof_from_s3_with_credentials_that_its_client_does_not_have(
    engine: Dask, verify: Verify, proof: tuple[Take, SealedProof], site: Site, tmp_path: Path
) -> None:
    uri = f"s3://proofs/{proof[1].sha256[2:]}.mcap"
    with pytest.raises(StoreUnavailable, match="NoCredentialsError"):
        Store(site).fetch(uri, proof[1].sha256, folder=tmp_path)
    asked = submitted(proof, verify, uri, proof[1].sha256)
    answer = engine.do(asked, threading.Event())
    verify.check(asked, answer)
    assert Report.model_validate_json(answer).accepted


@pytest.mark.parametrize(
    ("bucket", "data", "words"),
    [
        ("closed", CLOSED, "PermissionError"),
        ("proofs", LARGE, "proof_too_large"),
        ("proofs", OTHER, "proof_hash_mismatch"),
        ("proofs", LACKING, "proof_not_found"),
    ],
)
def test_what_no_worker_can_fetch_is_named_and_no_verdict_before_this_machine_says_so(
    engine: Dask,
    verify: Verify,
    proof: tuple[Take, SealedProof],
    tmp_path: Path,
    bucket: str,
    data: bytes,
    words: str,
) -> None:
    sha256 = hashed(data)
    asked = submitted(proof, verify, f"s3://{bucket}/{sha256[2:]}.mcap", sha256)
    (found,) = Runner(Local([verify]), engine, folder=tmp_path).run([asked])
    assert [words in str(one) for one in found.lost] == [True, True]
    assert found.answer is None and "NoCredentialsError" in str(found.error)


def test_a_stop_ends_the_job_on_its_worker(engine: Dask, tmp_path: Path) -> None:
    began, ended, stop = tmp_path / "began", tmp_path / "ended", threading.Event()
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(engine.do, job("wait", began=str(began), ended=str(ended)), stop)
        wait_until(began.exists, "no worker began")
        stop.set()
        with pytest.raises(Interrupted):
            waiting.result()
    wait_until(ended.exists, "the worker went on")


def test_a_sites_certificate_is_refused(address: str, tmp_path: Path) -> None:
    site = Site.load(LAB).model_copy(update={"data_dir": tmp_path})
    ensure_certificates(site)
    folder = tmp_path / "tls"
    for suffix in ("pem", "key"):
        (folder / f"operator.{suffix}").rename(folder / f"client.{suffix}")
    with pytest.raises(PoolUnavailable):
        Dask(address, folder, {}, MAX_BYTES)


def test_a_client_without_a_certificate_is_told_which_file_is_missing(address: str, tmp_path: Path) -> None:
    with pytest.raises(PoolFilesMissing) as missing:
        Dask(address, tmp_path, {}, MAX_BYTES)
    assert missing.value.details["path"] == str(tmp_path / "ca.pem")


def test_a_pool_that_ends_leaves_its_jobs_to_this_machine(engine: Dask, tmp_path: Path) -> None:
    found = done(engine, tmp_path, job("end"), *(job("answer", number) for number in range(6)))
    assert [one.answer for one in found if one.by == "local"]
    assert not [one for one in found if one.answer is None]
    with pytest.raises(EngineGone):
        engine.do(job("answer", 7), threading.Event())


def test_a_scheduler_that_hangs_leaves_its_jobs_to_this_machine(tls: Path, tmp_path: Path) -> None:
    hangs = tmp_path / "hangs"
    with started("tests.support.pool", tls, LAB, **PRELOAD) as address:
        engine = Dask(address, tls, {Deed.name: Deed()}, MAX_BYTES)
        try:
            jobs = [job("answer", number) for number in range(6)]
            found = done(engine, tmp_path / "answers", job("hang", hangs=str(hangs)), *jobs)
            engine.close()  # it cannot hear of that
        finally:
            os.kill(int(hangs.read_text()), signal.SIGKILL)
    assert {one.by for one in found} <= {"dask", "local"} and not [one for one in found if one.answer is None]
    (hung,) = [one for one in found if one.job.given["deed"] == "hang"]
    assert "scheduler does not answer" in str(hung.lost[0])
