"""What happens to a verification stays in its process."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

from rodeo.config import Site
from rodeo.evidence import Store
from services.oracle.app import SIDE_BY_SIDE
from services.oracle.report import Report
from services.oracle.worker import MEMORY_BYTES, verify_apart
from tests.support.assignments import BINDING, MOCAP, ROBOT, cleaning_ledger
from tests.support.recordings import Take, seal, signed_poses

MIB = 1 << 20


def submitted(
    site: Site,
    take: Take,
    tmp_path: Path,
    *,
    time_limit_s: float = 60.0,
    memory_bytes: int = MEMORY_BYTES,
    **task: object,
) -> Report:
    """The report on `take` after it went through the store."""
    at = site.model_copy(update={"data_dir": tmp_path / "data"})
    proof = seal(signed_poses(take, MOCAP), tmp_path / "proof.mcap", BINDING, ROBOT)
    fields = {"proof_uri": Store(at).put(proof.path), "proof_sha256": proof.sha256} | task
    chain = cleaning_ledger(take, **fields)
    report = verify_apart(at, chain, tmp_path / "work", time_limit_s, threading.Event(), memory_bytes)
    assert report is not None
    return report


def test_an_honest_proof_is_fetched_and_accepted(site: Site, cleaning: Take, tmp_path: Path) -> None:
    report = submitted(site, cleaning, tmp_path)
    assert report.accepted, report.reason
    assert [check.name for check in report.checks][:2] == ["fetched", "readable_and_sealed"]
    assert list((tmp_path / "work").iterdir()) == []


def test_another_hash_than_the_submitted_is_a_verdict(site: Site, cleaning: Take, tmp_path: Path) -> None:
    report = submitted(site, cleaning, tmp_path, proof_sha256="0x" + "ab" * 32)
    assert "proof_hash_mismatch" in report.reason
    assert report.proof_sha256 == "0x" + "ab" * 32


def test_a_uri_outside_the_store_is_a_verdict(site: Site, cleaning: Take, tmp_path: Path) -> None:
    report = submitted(site, cleaning, tmp_path, proof_uri="file:///etc/passwd")
    assert "proof_uri_not_allowed" in report.reason


def test_a_missing_file_is_a_verdict(site: Site, cleaning: Take, tmp_path: Path) -> None:
    uri = (tmp_path / "data" / "store").as_uri() + f"/{'ab' * 32}.mcap"
    report = submitted(site, cleaning, tmp_path, proof_uri=uri)
    assert "proof_not_found" in report.reason


def test_a_verification_that_hangs_is_ended_with_a_verdict(
    site: Site, cleaning: Take, tmp_path: Path
) -> None:
    report = submitted(site, cleaning, tmp_path, time_limit_s=0.05)
    assert not report.accepted
    assert "took longer than 0.05 s" in report.reason


def test_one_that_hangs_keeps_no_other_waiting(site: Site, cleaning: Take, tmp_path: Path) -> None:
    assert SIDE_BY_SIDE >= 2
    stop, verdicts = threading.Event(), list[Report | None]()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        slow = site.model_copy(update={"store": site.store.model_copy(update={"allowed": [url]})})
        chain = cleaning_ledger(cleaning, proof_uri=f"{url}/{'ab' * 32}.mcap", proof_sha256="0x" + "ab" * 32)
        hanging = threading.Thread(
            target=lambda: verdicts.append(verify_apart(slow, chain, tmp_path / "hanging", 600.0, stop))
        )
        hanging.start()
        silent.settimeout(60.0)
        connection, _ = silent.accept()
        with connection:
            assert submitted(site, cleaning, tmp_path).accepted
            assert verdicts == []
            stop.set()
            hanging.join()
    assert verdicts == [None]


def test_a_verification_that_dies_is_a_verdict(site: Site, cleaning: Take, tmp_path: Path) -> None:
    report = submitted(site, cleaning, tmp_path, memory_bytes=40 * MIB)
    assert not report.accepted
    assert report.reason.startswith("verification_ended: the verification crashed")


def test_an_oracle_that_stops_gives_no_verdict(site: Site, cleaning: Take, tmp_path: Path) -> None:
    stop = threading.Event()
    stop.set()
    assert verify_apart(site, cleaning_ledger(cleaning), tmp_path / "work", 60.0, stop) is None
