"""The oracle's side: proofs that the store loses, indexes that are behind, a judge that dies at work."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from hashlib import file_digest
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import zenoh

from bench.faults.case import BASE, case
from bench.faults.lab import PLACE, WORKERS, Lab, need
from rodeo.dao import Participant
from rodeo.evidence.store import Store
from rodeo.signing import wallets
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import film_cleaning
from rodeo_testing.recordings import Take, Witnesses, seal
from tests.support.clock import publish_clock

JUDGED = (*BASE, "oracle")


@functools.cache
def film(path: Path) -> Take:
    """One honest cleaning of the lab at this site file; a second of it takes as long to compute."""
    return film_cleaning(Site.load(path), "item1")


class Executor:
    """panther1 in the case's process: honest work from film, whose recording it keeps."""

    def __init__(self, lab: Lab) -> None:
        self.lab = lab
        self.wallet = Participant(lab.bus, lab.site.org, "panther1")
        self.device = wallets.load(lab.site, "panther1-device")
        self.kept: dict[str, Path] = {}
        self._copies: Any = None

    def set_clock(self, time_s: float) -> None:
        """Until the chain would stamp its next block with it."""

        def stamped() -> bool:
            publish_clock(self.lab.bus, self.lab.site.bus.domain_id, time_s)
            block = self.lab.client().w3.eth.get_block("pending")
            return int(block.get("timestamp", 0)) >= int(time_s)

        self.lab.wait(stamped, "the chain did not follow the clock")

    def record(self, label: str) -> Path:
        """Do the work of a new task, and seal the recording."""
        take = film(self.lab.path)
        self.set_clock(take.start_s - 5)
        self.lab.post(label, params=PLACE)
        task = self.wallet.task(self.lab.assigned(label)["id"])
        # The work afterwards is for others: this one may hang.
        self.lab.offer(*WORKERS)
        path = self.lab.folder / f"{label}.mcap"
        witnesses = Witnesses(
            mocap=wallets.load(self.lab.site, "mocap-device"),
            bin=wallets.load(self.lab.site, "itrash-device"),
            robot=self.device,
        )
        seal(take, path, self.wallet.binding(task, "panther1"), self.device, witnesses)
        self.set_clock(take.end_s + 5)
        with path.open("rb") as file:
            self.kept["0x" + file_digest(file, "sha256").hexdigest()] = path
        return path

    def put(self, path: Path) -> tuple[str, str, Path]:
        """Its hash, its URI, and where the store has it."""
        uri = Store(self.lab.site).put(path)
        return "0x" + Path(uri).stem, uri, Path(urlsplit(uri).path)

    def serve_copies(self) -> None:
        """What an agent does as long as it runs: answer for its own copies."""
        # Imported here: only some of the cases need it.
        from rodeo.recording.copies import Copies  # type: ignore[import-not-found,import-untyped,unused-ignore]

        self._copies = Copies(
            self.lab.bus, self.lab.site.org, "panther1", Store(self.lab.site), self.kept.get
        )


def _accepted(lab: Lab, label: str) -> None:
    task = lab.wait_ended(label)
    need(
        (task["state"], task["verdict"]) == ("settled", "accepted"),
        f"honest work is {task['state']}: {task['reason']}",
    )


@case(
    "a proof's bytes in the store are damaged before the oracle reads them, while its executor is away",
    said=r"damaged|other bytes|not those|waiting for .*proof",
    processes=JUDGED,
    asks=False,
    workers=False,
)
def proof_damaged_in_store(lab: Lab) -> Iterator[None]:
    executor = Executor(lab)
    sha256, uri, stored = executor.put(executor.record("meanwhile"))
    data = bytearray(stored.read_bytes())
    data[len(data) // 2] ^= 0xFF
    stored.write_bytes(data)
    lab.submit("meanwhile", sha256, uri)
    yield
    executor.serve_copies()
    yield
    _accepted(lab, "meanwhile")


@case(
    "a proof is gone from the store before the oracle reads it, while its executor is away",
    said=r"no such file|not in the store|gone|lost|waiting for .*proof",
    processes=JUDGED,
    asks=False,
    workers=False,
)
def proof_missing_in_store(lab: Lab) -> Iterator[None]:
    executor = Executor(lab)
    sha256, uri, stored = executor.put(executor.record("meanwhile"))
    stored.unlink()
    lab.submit("meanwhile", sha256, uri)
    yield
    executor.serve_copies()
    yield
    _accepted(lab, "meanwhile")


@case(
    "the oracle's configuration names another store than the executor's",
    said=r"allowed|may not read|another store|not a file of",
    processes=JUDGED,
    asks=False,
    workers=False,
)
def store_that_the_oracle_may_not_read(lab: Lab) -> Iterator[None]:
    executor = Executor(lab)
    sha256, uri, _stored = executor.put(executor.record("meanwhile"))
    wrong = lab.variant("wrong", f"store.url = {json.dumps((lab.folder / 'other').as_uri())}\n", data=False)
    lab.down("oracle")
    lab.up("oracle", site=wrong)
    lab.wait(lambda: lab.ready("oracle"), "the oracle does not start")
    lab.submit("meanwhile", sha256, uri)
    yield
    lab.down("oracle")
    lab.up("oracle")
    yield
    _accepted(lab, "meanwhile")


@case("the oracle is killed while it verifies", processes=JUDGED, asks=False, workers=False)
def killed_oracle_while_verifying(lab: Lab) -> Iterator[None]:
    executor = Executor(lab)
    sha256, uri, _stored = executor.put(executor.record("meanwhile"))
    lab.submit("meanwhile", sha256, uri)
    lab.wait_said(r"oracle: verifying task")
    lab.kill("oracle")
    yield
    yield
    _accepted(lab, "meanwhile")


@case(
    "the index answers that a task is assigned although its proof is submitted, for 15 s",
    said=r"does not know of the submission|behind",
    processes=JUDGED,
    asks=False,
    workers=True,
    held_s=15.0,
)
def index_behind(lab: Lab) -> Iterator[None]:
    lab.post("meanwhile")
    task = lab.assigned("meanwhile")
    key = topics.STATE.name(org=lab.site.org, what=f"task/{task['id']}")
    old = json.dumps(task)

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, old)

    stale = lab.bus.session.declare_queryable(key, answer, complete=True)
    lab.submit("meanwhile", *lab.store(b"no recording: meanwhile"), task=task)
    yield
    stale.undeclare()
    yield
    lab.wait_ended("meanwhile")


@case(
    "a proof is lost from the store after its verdict",
    said=r"gone|lost|missing|no such file|damaged",
    processes=JUDGED,
    asks=False,
    workers=False,
    extra="store.scrub_days = 0.00005\n",
)
def proof_lost_after_the_verdict(lab: Lab) -> Iterator[None]:
    executor = Executor(lab)
    sha256, uri, stored = executor.put(executor.record("judged"))
    lab.submit("judged", sha256, uri)
    _accepted(lab, "judged")
    stored.unlink()
    yield
    executor.serve_copies()
    yield
    lab.wait(stored.exists, "the proof was not put again from its executor's copy")


@case("the report of a verdict is lost from the store", processes=JUDGED, asks=False, workers=False)
def report_lost(lab: Lab) -> Iterator[None]:
    executor = Executor(lab)
    sha256, uri, _stored = executor.put(executor.record("judged"))
    lab.submit("judged", sha256, uri)
    _accepted(lab, "judged")
    for report in Path(urlsplit(lab.site.store_url).path).glob("*.json"):
        report.unlink()
    lab.kill("oracle")
    yield
    yield
