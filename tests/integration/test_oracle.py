"""Verdicts over the bus: real router, chain, bridge and oracle; the executor's recordings come from film."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo.checks.report import Report
from rodeo.commands.devices import PostRoot
from rodeo.dao import Participant
from rodeo.evidence.attestation import attest
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo.money.currency import IEC
from rodeo.recording.copies import Copies
from rodeo.signing import wallets
from rodeo.witness.days import DayLog, day_of
from rodeo.witness.statement import Scope
from rodeo_cli import app
from tests.support.dao import Dao, founded
from tests.support.executor import PLACE, Executor, Film, stored
from tests.support.site import NewSite

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    extra = 'participants = [{ name = "thief", kinds = ["waste_disposal"] }]\noracle.handover_s = 3'
    with founded(new_site(extra), "oracle") as organization:
        organization.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        # Past the bridge, which lets nobody offer the same twice: two tasks can be its at the same time.
        client, account = organization.client(), wallets.load(organization.running.site, "panther1")
        client.send(
            account, client.calls.register_service("waste_disposal", IEC.to_units(Decimal(100)), 0, True, "")
        )
        organization.wait_for(
            lambda: [event.name for event in organization.events].count("ServiceRegistered") == 2,
            "the second service",
        )
        yield organization


@pytest.fixture(scope="module")
def film(dao: Dao) -> Film:
    return Film(dao)


@pytest.fixture
def executor(dao: Dao, film: Film, tmp_path: Path) -> Iterator[Executor]:
    executor = Executor(dao, film, tmp_path)
    yield executor
    executor.give_back()


def honest(executor: Executor, task_id: int) -> dict[str, Any]:
    """Submit an honest proof; the verdict."""
    return executor.verdict(task_id, executor.submit(task_id, *stored(executor, task_id)))


def test_honest_work_is_accepted_and_paid(dao: Dao, executor: Executor) -> None:
    before = dao.balances()
    task_id = executor.assigned()
    verdict = honest(executor, task_id)
    assert (verdict["verdict"], verdict["reason"]) == ("accepted", "accepted")
    dao.wait_for(lambda: "TaskSettled" in dao.names_of(task_id), "settlement")
    after = dao.balances()
    assert after["panther1"] == before["panther1"] + 100
    assert after["organization"] == before["organization"] - 100
    task = dao.task(task_id)
    assert (task["state"], task["verdict"]) == ("settled", "accepted")


def test_the_report_is_what_its_hash_says(executor: Executor, tmp_path: Path) -> None:
    verdict = honest(executor, executor.assigned())
    path = executor.store.fetch(verdict["report_uri"], verdict["report"], folder=tmp_path / "report")
    report = Report.model_validate_json(path.read_bytes())
    assert report.accepted
    assert {"signer", "energy", "compartment"} & {check.name for check in report.checks} == {
        "signer",
        "compartment",
    }


def test_bad_proofs_get_their_own_reasons_and_the_next_is_served(dao: Dao, executor: Executor) -> None:
    task_id = executor.assigned(max_attempts=3)
    uri = executor.store.put(executor.record(task_id))
    attempt = executor.submit(task_id, "0x" + "ab" * 32, uri)
    assert "fetched: proof_hash_mismatch" in executor.verdict(task_id, attempt)["reason"]

    missing = f"{dao.site.store_url}/{'cd' * 32}.mcap"
    attempt = executor.submit(task_id, "0x" + "cd" * 32, missing)
    reason = executor.verdict(task_id, attempt)["reason"]
    assert reason.startswith("fetched: ") and "the executor did not send it" in reason

    path = executor.record(task_id)
    path.write_bytes(path.read_bytes()[:200_000])
    uri = executor.store.put(path)
    attempt = executor.submit(task_id, Store.hash_of(uri), uri)
    verdict = executor.verdict(task_id, attempt)
    assert "readable_and_sealed: truncated_proof" in verdict["reason"]
    dao.wait_for(lambda: "TaskFailed" in dao.names_of(task_id), "the refund")

    assert honest(executor, executor.assigned())["verdict"] == "accepted"


def test_a_uri_that_goes_around_the_bridge_is_refused_by_the_oracle(dao: Dao, executor: Executor) -> None:
    task_id = executor.assigned(max_attempts=1)
    account = wallets.load(dao.site, "panther1")
    client = dao.client()
    client.send(account, client.calls.submit_proof(task_id, 1, b"\xab" * 32, "file:///etc/passwd"))
    assert "fetched: proof_uri_not_allowed" in executor.verdict(task_id, 1)["reason"]


def test_a_proof_of_another_task_is_refused(executor: Executor) -> None:
    first = executor.assigned()
    uri = executor.store.put(executor.record(first))
    sha256 = Store.hash_of(uri)
    assert executor.verdict(first, executor.submit(first, sha256, uri))["verdict"] == "accepted"
    second = executor.assigned(max_attempts=1)
    verdict = executor.verdict(second, executor.submit(second, sha256, uri))
    assert verdict["verdict"] == "rejected"
    assert verdict["reason"].startswith("task_binding")


def test_an_oracle_that_was_killed_decides_what_was_submitted_meanwhile(dao: Dao, executor: Executor) -> None:
    task_id = executor.assigned()
    uri = executor.store.put(executor.record(task_id))
    dao.running.kill("oracle")
    sha256 = Store.hash_of(uri)
    attempt = executor.submit(task_id, sha256, uri)
    dao.running.start("oracle")
    assert executor.verdict(task_id, attempt)["verdict"] == "accepted"


def test_an_oracle_that_is_killed_while_verifying_decides_after_its_restart(
    dao: Dao, executor: Executor
) -> None:
    task_id = executor.assigned()
    uri = executor.store.put(executor.record(task_id))
    # Stopped, it cannot finish before it is killed.
    os.kill(dao.running.children["oracle"].pid, signal.SIGSTOP)
    sha256 = Store.hash_of(uri)
    attempt = executor.submit(task_id, sha256, uri)
    dao.running.kill("oracle")
    dao.running.start("oracle")
    assert executor.verdict(task_id, attempt)["verdict"] == "accepted"


# -- a task is judged by the rules that were current when it was posted -----------------------------------


def test_the_rules_of_a_kind_change_while_a_task_is_open_and_it_is_paid_by_its_own(
    dao: Dao, executor: Executor
) -> None:
    """Nor are tasks judged here by rules that this oracle lacks: at the end of the window people decide."""

    def change(command: str, rules_sha256: str, **more: str) -> None:
        dao.command("organization", command, kind="waste_disposal", rules_sha256=rules_sha256, **more)

    def listed() -> dict[str, dict[str, Any]]:
        done = CliRunner().invoke(app, ["organization", "rules", "--json", "--site", str(dao.running.path)])
        assert done.exit_code == 0, done.output
        entries = json.loads(done.output)["rules"]
        return {one["rules_sha256"]: one for one in entries if one["kind"] == "waste_disposal"}

    ((own, entry),) = listed().items()
    assert (entry["state"], entry["installed"]) == ("newest", True)
    next_rules = "0x" + "5e" * 32
    task_id = executor.assigned()
    needed = f"{entry['open_tasks'] + 1} open task"
    dao.running.wait_for_status("oracle", lambda status: needed in status.activity and own in status.activity)
    change("allow_kind", next_rules, judge="oracle")
    change("retire_rules", own)
    assert [one["state"] for one in listed().values()] == ["newest", "retired"]
    assert dao.task(task_id)["rules_sha256"] == own
    before = dao.balances()["panther1"]
    assert honest(executor, task_id)["verdict"] == "accepted"
    dao.wait_for(lambda: "TaskSettled" in dao.names_of(task_id), "settlement")
    assert dao.balances()["panther1"] == before + 100

    other = executor.assigned(max_attempts=1, verdict_window_s=900)
    assert dao.task(other)["rules_sha256"] == next_rules
    attempt = executor.submit(other, *stored(executor, other))
    warned = dao.running.wait_for_status(
        "oracle", lambda status: any(next_rules in one for one in status.warnings)
    )
    assert warned.ready
    assert "Ruled" not in dao.names_of(other)
    dao.set_clock(dao.task(other)["verdict_deadline"] - 2)
    executor.film.wait(900)  # time does not go back
    verdict = executor.verdict(other, attempt)
    assert verdict["verdict"] == "undecided"
    assert verdict["reason"].startswith("rules: no oracle that has the rules of this task has judged it")
    # Without a report of its own: what an accepted proof is paid for must be readable.
    report = {"report_sha256": verdict["report"], "report_uri": verdict["report_uri"]}
    dao.verdict(other, "accepted", "looks clean", judge="organization", amount_iec="100", **report)
    dao.running.wait_for_status(
        "oracle", lambda status: not any(next_rules in one for one in status.warnings)
    )

    change("allow_kind", own, judge="oracle")
    change("retire_rules", next_rules)
    assert listed()[own]["state"] == "newest"


# -- what the store gets wrong is not the executor's failure --------------------------------------------


@pytest.fixture
def kept(dao: Dao) -> Iterator[dict[str, Path]]:
    """Hash -> what panther1 kept of what it submitted, and gives to whoever asks."""
    copies = dict[str, Path]()
    served = Copies(dao.running.bus, dao.site.org, "panther1", Store(dao.site), copies.get)
    yield copies
    served.close()


def in_store(uri: str) -> Path:
    return Path(uri.removeprefix("file://"))


def test_a_proof_that_the_store_damaged_is_put_there_again_and_paid(
    dao: Dao, executor: Executor, kept: dict[str, Path]
) -> None:
    task_id = executor.assigned()
    path = executor.record(task_id)
    uri = executor.store.put(path)
    sha256 = Store.hash_of(uri)
    in_store(uri).write_bytes(path.read_bytes()[:-100])
    executor.submit(task_id, sha256, uri)
    waiting = dao.running.wait_for_status("oracle", lambda status: "waits for its proof" in status.activity)
    assert waiting.ready and "the bytes do not match the submitted hash" in waiting.activity
    assert "Ruled" not in dao.names_of(task_id)
    kept[sha256] = path  # the executor's process is there again
    assert executor.verdict(task_id, 1)["verdict"] == "accepted"
    assert in_store(uri).read_bytes() == path.read_bytes()


def test_a_proof_in_a_store_that_cannot_be_read_is_handed_over_and_paid(
    dao: Dao, executor: Executor, kept: dict[str, Path]
) -> None:
    task_id = executor.assigned()
    path = executor.record(task_id)
    uri = executor.store.put(path)
    sha256 = Store.hash_of(uri)
    in_store(uri).unlink()
    in_store(uri).symlink_to(in_store(uri))  # a disk that answers with an error
    executor.submit(task_id, sha256, uri)
    broken = dao.running.wait_for_status("oracle", lambda status: not status.ready)
    assert broken.reason.startswith("the store cannot be read: ")
    kept[sha256] = path
    assert executor.verdict(task_id, 1)["verdict"] == "accepted"
    dao.running.wait_ready("oracle")


def test_the_hash_of_nothing_earns_nothing_and_holds_up_nobody_else(
    dao: Dao, executor: Executor, kept: dict[str, Path]
) -> None:
    """Nor does a copy that has another hash help."""
    own = executor.assigned(max_attempts=1)
    service = dao.command("thief", "register_service", kind="waste_disposal", price_iec="1")["service_id"]
    tasks = {
        one: dao.task(one)["executor_name"]
        for one in (dao.post(params=PLACE, max_attempts=1) for _ in range(2))
    }
    theirs = next(task_id for task_id, name in tasks.items() if name == "thief")
    (other,) = set(tasks) - {theirs}
    path = executor.record(own)
    kept["0x" + "cf" * 32] = path
    thief = Participant(dao.running.bus, dao.site.org, "thief")
    thief.submit_proof(theirs, 1, "0x" + "cf" * 32, f"{dao.site.store_url}/{'cf' * 32}.mcap")
    uri = executor.store.put(path)
    executor.submit(own, Store.hash_of(uri), uri)
    assert executor.verdict(own, 1)["verdict"] == "accepted"
    verdict = executor.verdict(theirs, 1)
    assert verdict["verdict"] == "rejected"
    assert "the executor did not send it" in verdict["reason"]
    executor.submit(other, "0x" + "ee" * 32, f"{dao.site.store_url}/{'ee' * 32}.mcap")
    assert executor.verdict(other, 1)["verdict"] == "rejected"
    dao.command("thief", "update_service", service_id=int(service), state="retired")


# -- acts are paid for once ------------------------------------------------------------------------------


@pytest.fixture
def twice(dao: Dao, executor: Executor) -> Iterator[tuple[int, int]]:
    """Two tasks on the same item, both this robot's, and one film for both."""
    first = executor.assigned(max_attempts=1)
    second = dao.post(params=PLACE, max_attempts=1)
    assert [dao.task(task_id)["state"] for task_id in (first, second)] == ["assigned", "assigned"]
    yield first, second
    for task_id in (first, second):
        dao.wait_for(
            lambda task_id=task_id: bool({"TaskSettled", "TaskFailed"} & set(dao.names_of(task_id))),
            "its end",
        )


def spent(verdict: dict[str, Any], by: int) -> None:
    assert verdict["verdict"] == "rejected"
    assert verdict["reason"].startswith("acts_unspent: "), verdict["reason"]
    assert f"was paid for in task {by} attempt 1" in verdict["reason"]


def test_of_two_proofs_of_one_act_the_one_submitted_first_is_paid(
    executor: Executor, twice: tuple[int, int]
) -> None:
    first, second = twice
    proofs = {task_id: stored(executor, task_id) for task_id in twice}
    executor.submit(second, *proofs[second])
    executor.submit(first, *proofs[first])  # both in line
    assert executor.verdict(second, 1)["verdict"] == "accepted"
    spent(executor.verdict(first, 1), by=second)


def test_what_was_paid_for_is_known_after_a_restart_and_awaited_while_the_store_has_lost_it(
    dao: Dao, executor: Executor, twice: tuple[int, int]
) -> None:
    first, second = twice
    proofs = {task_id: stored(executor, task_id) for task_id in twice}
    executor.submit(first, *proofs[first])
    verdict = executor.verdict(first, 1)
    assert verdict["verdict"] == "accepted"
    dao.running.kill("oracle")
    report = Path(dao.site.store_url.removeprefix("file://"), verdict["report_uri"].rpartition("/")[2])
    lost = report.rename(report.with_suffix(".lost"))
    (dao.site.data_dir / "oracle" / "reports" / report.name).unlink()  # its own copy is lost, too
    executor.submit(second, *proofs[second])
    dao.running.start("oracle")
    dao.running.wait_for_status("oracle", lambda status: "could not be read" in status.activity)
    assert "Ruled" not in dao.names_of(second)
    lost.rename(report)
    spent(executor.verdict(second, 1), by=first)


@pytest.mark.parametrize("thief_first", [True, False])
def test_a_copied_proof_hash_earns_nothing_and_costs_its_owner_nothing(
    dao: Dao, executor: Executor, thief_first: bool
) -> None:
    """The thief has a task of its own, and submits what the honest robot put into the store."""
    own = executor.assigned()
    service = dao.command("thief", "register_service", kind="waste_disposal", price_iec="1")["service_id"]
    proof = stored(executor, own)
    # The chain's time has passed on to the end of the work; the thief's task is younger, and that is all.
    filler = dao.post(params=PLACE, max_attempts=1)
    stolen = dao.post(params=PLACE, max_attempts=1)
    tasks = {task_id: dao.task(task_id)["executor_name"] for task_id in (filler, stolen)}
    theirs = next(task_id for task_id, name in tasks.items() if name == "thief")
    thief = Participant(dao.running.bus, dao.site.org, "thief")
    if thief_first:
        thief.submit_proof(theirs, 1, *proof)
        assert executor.verdict(theirs, 1)["reason"].startswith("task_binding")
        assert executor.verdict(own, executor.submit(own, *proof))["verdict"] == "accepted"
    else:
        assert executor.verdict(own, executor.submit(own, *proof))["verdict"] == "accepted"
        thief.submit_proof(theirs, 1, *proof)
        assert executor.verdict(theirs, 1)["reason"].startswith("task_binding")
    (other,) = set(tasks) - {theirs}
    executor.submit(other, "0x" + "ee" * 32, f"{dao.site.store_url}/{'ee' * 32}.mcap")
    assert executor.verdict(other, 1)["verdict"] == "rejected"
    dao.command("thief", "update_service", service_id=int(service), state="retired")


# The last test: afterwards no bin of this site is believed any more.


def test_what_comes_after_a_verdict_is_a_warning_and_before_one_a_doubt(
    dao: Dao, executor: Executor, tmp_path: Path
) -> None:
    """The bin's own log of the day lacks its statements, and its key is revoked."""
    task_id = executor.assigned()
    path = executor.record(task_id)
    uri = executor.store.put(path)
    sha256 = Store.hash_of(uri)
    assert executor.verdict(task_id, executor.submit(task_id, sha256, uri))["verdict"] == "accepted"
    before = verified(dao, path)
    assert (before["outcome"], before["warnings"]) == ("accepted", [])
    assert {check["passed"] for check in before["checks"] if check["name"] in ("signer", "nonce")} == {True}

    device = wallets.load(dao.site, "itrash-device")
    said = next(one for one in open_proof(path).attestations() if one.signer == device.address)
    scope = {name: said.payload[name] for name in Scope.model_fields}
    log = DayLog(
        **scope,
        device="itrash",
        address=device.address,
        day=day_of(said.payload["time_s"]),
        first=said.payload["seq"],
        statements=("0x" + "ab" * 32,),
    )
    signed = attest(log.model_dump(mode="json"), device)
    log_uri, root = executor.store.put_bytes(signed.model_dump_json().encode(), ".json")
    organization = Participant(dao.running.bus, dao.site.org, "organization")
    day = PostRoot(device=device.address, day=log.day, root=root, uri=log_uri)
    organization.command("post_root", day)
    after = verified(dao, path)
    assert after["outcome"] == "accepted"
    assert ["are missing from the day's log" in warning for warning in after["warnings"]] == [True]

    doubted = honest(executor, executor.assigned())
    assert doubted["verdict"] == "undecided"
    assert "in_daily_log: 2 statements of the bin itrash" in doubted["reason"]

    dao.command("organization", "revoke_device", device=device.address, reason="compromised")
    later_on = verified(dao, path)
    assert later_on["outcome"] == "accepted"
    assert any("was revoked as compromised" in warning for warning in later_on["warnings"])


def verified(dao: Dao, path: Path) -> dict[str, Any]:
    """What `rodeo verify` says of a file."""
    done = CliRunner().invoke(app, ["verify", str(path), "--site", str(dao.running.path), "--json"])
    found: dict[str, Any] = json.loads(done.stdout)
    return found
