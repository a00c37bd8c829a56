"""An audit finds the verdicts that would be others today, and no others: from chain, store and lab alone."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import islice
from pathlib import Path
from random import Random
from typing import NamedTuple

import pytest
from sqlalchemy.exc import OperationalError
from typer.testing import CliRunner

from rodeo.chain.deployment import Deployment
from rodeo.errors import RequestError
from rodeo.evidence.errors import StoreUnavailable
from rodeo.site.config import Site
from rodeo.site.sections import OracleConfig
from rodeo_cli.audit import examine
from rodeo_cli.auditing.bounds import upper_bound
from rodeo_cli.auditing.judging import Audit, Verdict
from rodeo_cli.auditing.page import conclusions, page
from rodeo_cli.auditing.reading import Attempt
from rodeo_cli.auditing.summary import Summary
from rodeo_cli.commands import app
from rodeo_kinds.battery_charging.harness.film import KIND
from services.bridge.errors import IndexUnusable
from services.bridge.follower import Follower
from tests.docs.text import ROOT
from tests.support.organization import CHAIN_ID
from tests.support.pool import served
from tests.support.settled import OTHER_RULES, PRICE_IEC, Said, Settled, settling
from tests.support.site import LAB, free_port

pytestmark = pytest.mark.long

TASKS = 30
ENDLESS = "file:///proc/kcore"
"""A file of the auditor's machine, which nobody can read to its end."""
PLANTED = ("file", "rules", "acts")
RIGHT = 4
"""Nothing is planted in the first ones: what a machine is too slow for is shown with them."""


class Audited(NamedTuple):
    settled: Settled
    folder: Path
    planted: dict[int, str]
    """Task -> what is wrong with it."""
    summary: Summary
    environment: dict[str, str]
    """What its site has beside its file."""

    def examine(self, **options: int) -> Summary:
        return examined(self.settled, self.folder, **options)


def examined(settled: Settled, folder: Path, **options: int) -> Summary:
    site = settled.organization.site
    return examine(site, Deployment.load(site.data_dir, CHAIN_ID), folder, **options)


@pytest.fixture(scope="module")
def audited(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Audited]:
    """Thirty paid tasks. The commit decides which three of them are wrong."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, check=True).stdout
    turns = dict(zip(sorted(Random(commit).sample(range(RIGHT, TASKS - 1), 3)), PLANTED, strict=True))
    folder, shelf = tmp_path_factory.mktemp("audited"), f"http://127.0.0.1:{(port := free_port())}"
    allowed = Site.load(LAB).store.model_copy(update={"allowed": [shelf]})
    environment = {"RODEO__CLOCK__SOURCE": "wall", "RODEO__STORE__ALLOWED": json.dumps([shelf])}
    with settling(folder, store=allowed) as settled, serving(settled.store.urls[0], port):
        settled.allow(OTHER_RULES)
        planted: dict[int, str] = {}
        for turn in range(TASKS - 1):  # two of them in the turn in which one film pays twice
            # Whatever an executor names, its proof is looked for in the store.
            named = f"{shelf}/{{file}}" if turn % 2 else ENDLESS
            planted |= settle(settled, turns.get(turn, ""), named)
        assert len(settled.files) == TASKS
        # An outsider has no keys.
        shutil.rmtree(settled.organization.site.data_dir / "keys")
        summary = examined(settled, folder / "audit")
        yield Audited(settled, folder / "audit", planted, summary, environment)


@contextmanager
def serving(store: str, port: int) -> Iterator[None]:
    """The store's folder over HTTP, on this port of this machine."""
    files = partial(Shelf, directory=store.removeprefix("file://"))
    with ThreadingHTTPServer(("127.0.0.1", port), files) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield
        finally:
            server.shutdown()


class Shelf(SimpleHTTPRequestHandler):
    def log_message(self, *_args: object) -> None:
        """Quiet."""


def settle(settled: Settled, wrong: str, named: str) -> dict[int, str]:
    """Settle a task; its number, where something is `wrong` with it."""
    if wrong == "acts":
        *_, second = settled.settle(said=(Said(), Said()))
        return {second: wrong}
    if wrong == "rules":
        (task,) = settled.settle(rules=OTHER_RULES, receipts=False)
        return {task: wrong}
    (task,) = settled.settle(named=None if wrong else named)
    if wrong == "file":
        settled.files[task].write_bytes(b"something else")
        return {task: wrong}
    return {}


def test_the_planted_verdicts_are_found_and_no_others(audited: Audited) -> None:
    wrong = {one.attempt.task_id: one.findings[0].what for one in audited.summary.wrong}
    assert wrong == audited.planted
    assert len(audited.summary.verdicts) == audited.summary.known == TASKS
    assert not audited.summary.failed


SPENT = 'acts_unspent: "{act}" was paid for in task {first} attempt 1 as "{act}"'


class Ruled(NamedTuple):
    """An oracle that lies now and then, and people."""

    settled: Settled
    tasks: dict[str, int]
    """By what became of them."""
    summary: Summary

    def findings(self, what: str) -> list[tuple[str, bool]]:
        """Kind of each finding of the task, and whether the verdict would be another one."""
        (one,) = (one for one in self.summary.verdicts if one.attempt.task_id == self.tasks[what])
        return [(found.what, found.wrong) for found in one.findings]


@pytest.fixture(scope="module")
def ruled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ruled]:
    folder = tmp_path_factory.mktemp("ruled")
    with settling(folder) as settled:
        settle, tasks = settled.settle, dict[str, int]()
        refused, unclear = Said("rejected", SPENT), Said("undecided", "bin_camera: unclear")
        tasks["paid"], tasks["spent"] = settle(said=(Said(), refused))
        of_another = Said("rejected", SPENT.replace("{first}", str(tasks["paid"])))
        (tasks["of another charge"],) = settle(said=[of_another])
        tasks["refused first"], tasks["never paid"] = settle(said=(Said("rejected", "energy: none"), refused))
        (tasks["late"],) = settle(said=[Said("rejected", "fetched: the executor did not send it")])
        (tasks["excused"],) = settle(said=[Said("accepted", "fetched: it is fine")], receipts=False)
        (tasks["unreported"],) = settle(said=[Said(is_reported=False)])
        (tasks["forged report"],) = settle(said=[Said(more="/register/1.0000-9000.0000")])
        (tasks["refused and lost"],) = settle(said=[Said("rejected", "energy: none")])
        settled.files[tasks["refused and lost"]].unlink()
        tasks["people"], tasks["again"] = settle(said=(unclear, Said()))
        (tasks["nobody"],) = settle(said=[unclear])
        settled.have_people_accept(tasks["people"])
        settled.conclude(tasks["nobody"])
        settled.sell_meter()
        yield Ruled(settled, tasks, examined(settled, folder / "audit"))


def test_what_a_device_signed_for_its_owner_of_then_stays_valid(ruled: Ruled) -> None:
    assert ruled.findings("paid") == []


def test_what_was_refused_as_claimed_before_is_right_only_if_that_was_paid_for(ruled: Ruled) -> None:
    assert ruled.findings("spent") == []
    for what in ("of another charge", "refused first", "never paid"):
        assert ruled.findings(what) == [("verdict", True)]


def test_what_people_were_paid_for_is_not_paid_again(ruled: Ruled) -> None:
    assert ruled.findings("people") == []
    assert ruled.findings("again") == [("acts", True)]


def test_what_could_be_judged_and_was_passed_on_is_found(ruled: Ruled) -> None:
    assert ruled.findings("nobody") == [("verdict", True)]


def test_an_oracle_is_not_blamed_for_a_file_that_came_later_and_no_payment_is_excused(ruled: Ruled) -> None:
    (late,) = (one for one in ruled.summary.failed)
    assert late.attempt.task_id == ruled.tasks["late"]
    assert "did not send it" in late.unjudged and not late.wrong
    assert ruled.findings("excused") == [("verdict", True)]


def test_a_refusal_is_not_right_because_the_file_is_gone(ruled: Ruled) -> None:
    assert ruled.findings("refused and lost") == [("file", True)]


def test_what_a_report_claims_beside_the_proof_is_found(ruled: Ruled) -> None:
    assert ruled.findings("forged report") == [("report", True)]


def test_a_payment_without_a_report_is_found(ruled: Ruled) -> None:
    assert ruled.findings("unreported") == [("report", True)]


def test_what_people_decided_is_not_judged_again_nor_counted_in_a_bound(ruled: Ruled) -> None:
    (one,) = (one for one in ruled.summary.verdicts if not one.today and not one.failed)
    assert (one.attempt.task_id, one.unjudged) == (ruled.tasks["people"], "no oracle decided this")
    folder = ruled.settled.organization.site.data_dir / "sampled"
    assert examined(ruled.settled, folder, sample=20).known == len(ruled.tasks) - 1


def test_a_kind_that_the_site_file_does_not_list_is_no_right_verdict(ruled: Ruled, tmp_path: Path) -> None:
    site = ruled.settled.organization.site
    without = site.model_copy(update={"kinds": [one for one in site.kinds if one.name != KIND]})
    some = examine(without, Deployment.load(site.data_dir, CHAIN_ID), tmp_path, sample=2)
    assert [one.unjudged for one in some.failed] == 2 * ["the site file has no checks for this kind"]


def test_each_finding_says_why(audited: Audited) -> None:
    details = {one.findings[0].what: one.findings[0].detail for one in audited.summary.wrong}
    assert "proof_hash_mismatch" in details["file"]
    assert "the chain has accepted; today it is" in details["rules"]
    assert "/register/" in details["acts"] and "was paid for in task" in details["acts"]


def test_the_sums_are_those_on_the_chain(audited: Audited) -> None:
    assert audited.summary.paid_iec == TASKS * PRICE_IEC
    assert audited.summary.contradiction is None


def test_a_second_audit_continues_from_the_answers_of_the_first(audited: Audited) -> None:
    def written() -> dict[str, int]:
        return {one.name: one.stat().st_mtime_ns for one in (audited.folder / "answers").glob("*.json")}

    before = written()
    assert len(before) == TASKS - 1  # a file may be mended
    assert [one.attempt.task_id for one in audited.examine().wrong] == sorted(audited.planted)
    assert written() == before


def test_blocks_bound_what_is_audited(audited: Audited) -> None:
    first, last = (one.attempt.block for one in audited.summary.verdicts[4:8:3])
    some = audited.examine(first=first, last=last)
    assert [one.attempt.task_id for one in some.verdicts] == [
        one.attempt.task_id for one in audited.summary.verdicts[4:8]
    ]
    with pytest.raises(RequestError, match="no blocks in this range"):
        audited.examine(first=last, last=first)
    with pytest.raises(RequestError, match="no blocks in this range"):
        audited.examine(first=audited.summary.block + 1)


def test_ctrl_c_says_how_far_it_came(
    audited: Audited, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    judge = Audit.judge

    def stopped(self: Audit, attempts: Iterable[Attempt]) -> Iterator[Verdict]:
        yield from islice(judge(self, attempts), 2)
        raise KeyboardInterrupt

    monkeypatch.setattr(Audit, "judge", stopped)
    with pytest.raises(KeyboardInterrupt):
        audited.examine()
    assert f"judging again: 2 of {TASKS}" in capsys.readouterr().err


def test_an_index_that_cannot_be_written_is_named(
    audited: Audited, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> bool:
        raise OperationalError("commit", {}, Exception("database or disk is full"))

    monkeypatch.setattr(Follower, "step", full)
    with pytest.raises(IndexUnusable, match="cannot be written"):
        examined(audited.settled, tmp_path)


def test_a_store_that_is_not_there_is_no_wrong_verdict(audited: Audited) -> None:
    store = audited.settled.organization.site.data_dir / "store"
    store.rename(away := store.with_name("away"))
    try:
        with pytest.raises(StoreUnavailable, match="folder is not there"):
            audited.examine()
    finally:
        away.rename(store)


def test_what_is_wrong_comes_before_what_is_only_noted(audited: Audited) -> None:
    looked = audited.summary.worth_a_look
    wrong = [one.wrong for one in looked]
    assert wrong == sorted(wrong, reverse=True) and sum(wrong) == len(audited.summary.wrong)


def test_a_sample_bounds_the_share_of_wrong_verdicts(audited: Audited) -> None:
    some = audited.examine(sample=10)
    assert (len(some.verdicts), some.known) == (10, TASKS)
    again = audited.examine(sample=10, last=some.block)
    assert [one.attempt for one in again.verdicts] == [one.attempt for one in some.verdicts]
    assert some.most_wrong == upper_bound(len(some.wrong), 10)
    assert "With 95 % confidence" in " ".join(conclusions(some))


def test_a_machine_that_is_too_slow_finds_no_wrong_verdict_and_bounds_nothing(
    audited: Audited, tmp_path: Path
) -> None:
    site = audited.settled.organization.site
    hasty = site.model_copy(update={"oracle": OracleConfig(time_limit_s=0.01)})
    deployment = Deployment.load(site.data_dir, CHAIN_ID)
    last = audited.summary.verdicts[RIGHT - 1].attempt.block
    some = examine(hasty, deployment, tmp_path, last=last, sample=2)
    said = [one.unjudged for one in some.failed]
    slow = ("verification_ended: ", "the store did not send the proof in time")
    assert len(said) == 2 and all(one.startswith(slow) for one in said), said
    assert not some.wrong
    assert some.most_wrong == 1.0


def test_the_page_loads_nothing_and_names_what_is_wrong(audited: Audited) -> None:
    text = page(audited.summary)
    assert "<svg" in text and "proof_hash_mismatch" in text
    assert not any(word in text for word in ("<script", "http:", "https:", "src=", "@import"))


def test_the_command_has_a_pool_find_the_same_although_a_worker_is_killed_and_exits_with_1(
    audited: Audited, tmp_path: Path
) -> None:
    data, site = audited.settled.organization.site.data_dir, audited.folder.parent / "site.toml"
    words = ["audit", "--site", site, "--deployment", Deployment.path(data, CHAIN_ID)]
    words += ["--out", tmp_path / "audit", "--report", tmp_path / "audit.html", "--json"]
    killed, environment = tmp_path / "killed", audited.environment
    deadly = {"DASK_DISTRIBUTED__WORKER__PRELOAD": "tests.support.deadly", "DEADLY_ONCE": str(killed)}
    with served(tmp_path, site, **environment, **deadly) as address:
        words += ["--pool", address, "--pool-tls", tmp_path / "tls"]
        done = CliRunner(env=environment).invoke(app, [str(word) for word in words])
    assert done.exit_code == 1, done.output
    assert killed.exists()
    said = json.loads(done.stdout)
    found = {one["task_id"]: one["findings"][0]["what"] for one in said["verdicts"] if one["wrong"]}
    assert found == audited.planted
    # Other bytes than the chain names are a finding once this machine has them, too.
    by = {one["task_id"]: one["by"] for one in said["verdicts"]}
    assert by == {task: "local" if audited.planted.get(task) == "file" else "dask" for task in by}
    assert (tmp_path / "audit.html").read_text().startswith("<!doctype html>")
