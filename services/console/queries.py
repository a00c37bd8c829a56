"""What can be asked: the bridge's index, and files of tasks from the store. Blocks; call it from a thread."""

from __future__ import annotations

import json
import math
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Task
from rodeo.bus.queries import A, Query
from rodeo.bus.session import Bus
from rodeo.display.earnings import Line, earnings
from rodeo.display.story import Step, story
from rodeo.errors import MalformedJson
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo.person.review import Review, Reviewer
from rodeo.person.statement import Statement, fetch_statement
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.text.strict_json import Json
from services.console.attempts import Attempt, attempts
from services.console.errors import UnknownFile
from services.console.replay import pictures

T = TypeVar("T")

MAX_REPORT_BYTES = 1 << 20
_QUERY_S = 5.0
_PAGE_TASKS, _PAGE_TRANSACTIONS = 500, 100
_REPORTS_KEPT = 64
_SEALS_KEPT = 256
_ALBUMS_KEPT = 16
"""An album may have megabytes."""

Evidence = Task | Attempt
"""What names a proof and the report on it: a task its last, an attempt its own."""


@dataclass(frozen=True)
class Seal:
    """Contents of a proof's seals, once checked."""

    signer: str | None
    """Address of the device key."""
    size_bytes: int
    messages: int
    seals: int


class Queries:
    def __init__(self, bus: Bus, site: Site) -> None:
        self._bus = bus
        self._site = site
        self._store = Store(site)
        self._reviewer = Reviewer(site, self)
        self._reports: OrderedDict[str, Json] = OrderedDict()
        self._seals: OrderedDict[str, Seal] = OrderedDict()
        self._albums: OrderedDict[str, list[Json]] = OrderedDict()
        self._earnings_lock = threading.Lock()
        self._earnings_chain = ""
        self._transactions: dict[str, queries.Transaction] = {}
        """By hash, of that chain: transactions that `earnings` has queried already."""
        self._since_s = math.inf
        """Block time since which it has."""

    def ask(self, query: Query[A], **parameters: Any) -> A:
        """The bridge's answer; parameters that are None are left out."""
        return queries.ask(self._bus, self._site.org, query, timeout_s=_QUERY_S, **parameters)

    def state(self, what: str, **parameters: Any) -> Json:
        """The bridge's answer to `state/<what>`; parameters that are None are left out."""
        wanted = {name: value for name, value in parameters.items() if value is not None}
        key = topics.STATE.name(org=self._site.org, what=what)
        return self._bus.query(key, parameters=wanted, timeout_s=_QUERY_S)

    def tasks(self, limit: int, offset: int = 0, **filters: Any) -> tuple[list[Task], int]:
        """One page, newest first, and how many there are in all."""
        answer = self.ask(queries.TASKS, limit=limit, offset=offset, **filters)
        return answer.tasks, answer.total

    def earnings(self, most_tasks: int | None = None) -> list[Line]:
        """What everybody earned and spent by all tasks or the newest, by week and kind of work. Asks for what
        transactions are new since last time."""
        with self._earnings_lock:
            chain = self.ask(queries.CHAIN).genesis_hash
            if chain != self._earnings_chain:
                self._earnings_chain, self._transactions, self._since_s = chain, {}, math.inf
            found = queries.pages(lambda at: self.tasks(_PAGE_TASKS, at)[0])
            tasks = [*islice((one for page in found for one in page), most_tasks)]
            first_s = min((one.registered for one in tasks), default=0.0) if most_tasks else 0.0
            new: dict[str, queries.Transaction] = {}
            for page in queries.pages(self._transactions_page):
                fresh = [one for one in page if one.tx_hash not in self._transactions]
                new |= {one.tx_hash: one for one in fresh}
                older_are_known = len(fresh) < len(page) and self._since_s <= first_s
                if older_are_known or page[-1].time_s < first_s:
                    break
            transactions = {**self._transactions, **new}
            # All at once, so that nothing older is missing. Transactions of unknown gas are queried again.
            self._transactions |= {name: one for name, one in new.items() if one.gas_used is not None}
            self._since_s = min(self._since_s, first_s)
            return earnings(tasks, transactions.values(), self._site.economy.electricity)

    def _transactions_page(self, offset: int) -> list[queries.Transaction]:
        return self.ask(queries.TRANSACTIONS, limit=_PAGE_TRANSACTIONS, offset=offset).transactions

    def history(self, task_id: int) -> list[DaoEvent]:
        """The task's contract events in order."""
        return self.ask(queries.EVENTS, task_id=task_id).events

    def story(self, events: list[DaoEvent]) -> list[Step]:
        """The story of the dispute in a task's events."""
        wallets = self.ask(queries.WALLETS).wallets
        return story(events, self.ask(queries.ORGANIZATION), wallets)

    def robot(self, robot: str) -> Json:
        """The robot agent's own report. Raises NoResponder."""
        return self._bus.query(
            topics.ROBOT_ORDER.name(org=self._site.org, robot=robot, order="state"), {}, timeout_s=_QUERY_S
        )

    def task(self, task_id: int) -> Task:
        return self.ask(queries.TASK, id=task_id)

    def evidence(self, task_id: int, attempt: int | None = None) -> Evidence:
        """The proof of the task's last attempt or of the one that is named. Raises UnknownFile."""
        if attempt is None:
            return self.task(task_id)
        for one in attempts(self.history(task_id)):
            if one.number == attempt:
                return one
        raise UnknownFile("the task has no such attempt", task_id=task_id, attempt=attempt)

    def report(self, evidence: Evidence) -> Json:
        """The report behind its verdict. Raises UnknownFile, EvidenceError."""
        uri, sha256 = evidence.report_uri, evidence.report_sha256
        if not uri or not sha256:
            raise UnknownFile("there is no report on this proof")
        kept = self._reports.get(sha256)
        if kept is not None:
            return kept
        with tempfile.TemporaryDirectory(prefix="rodeo-report-") as folder:
            path = self._store.fetch(uri, sha256, MAX_REPORT_BYTES, Path(folder))
            try:
                report = json.loads(path.read_bytes())
            except (ValueError, RecursionError) as error:
                raise MalformedJson(f"the report is not JSON: {error}") from error
        if not isinstance(report, dict):
            raise MalformedJson("the report is not a JSON object")
        return _keep(self._reports, sha256, report, _REPORTS_KEPT)

    def seal(self, evidence: Evidence) -> Seal:
        """The signer of the proof, every seal of it checked. Raises UnknownFile, EvidenceError."""
        kept = self._seals.get(evidence.proof_sha256 or "")
        if kept is not None:
            return kept
        return self._read(evidence)[0]

    def pictures(self, evidence: Evidence) -> list[Json]:
        """The pictures in the recording, as `replay.pictures` has them. Raises UnknownFile, EvidenceError."""
        kept = self._albums.get(evidence.proof_sha256 or "")
        return self._read(evidence)[1] if kept is None else kept

    def _read(self, evidence: Evidence) -> tuple[Seal, list[Json]]:
        """Both at once: reading a recording takes a second, and a page shows both."""
        with self.proof(evidence) as path:
            proof = open_proof(path)
        seal = Seal(proof.signer, proof.size_bytes, proof.messages, proof.seals)
        album = _keep(self._albums, proof.sha256, pictures(proof, self._site), _ALBUMS_KEPT)
        return _keep(self._seals, proof.sha256, seal, _SEALS_KEPT), album

    def statement(self, task: Task) -> Statement:
        """Note and photos that a person handed in. Raises UnknownFile, EvidenceError."""
        return fetch_statement(self._store, *_proof_of(task))

    def review(self, task: Task) -> Review:
        """What is known of that statement. Raises NotSubmitted, EvidenceError, and what the index raises."""
        return self._reviewer.review(task)

    @contextmanager
    def proof(self, evidence: Evidence) -> Iterator[Path]:
        """A copy of the proof for a while, its bytes checked. Raises UnknownFile, EvidenceError."""
        uri, sha256 = _proof_of(evidence)
        with tempfile.TemporaryDirectory(prefix="rodeo-proof-") as folder:
            yield self._store.fetch(uri, sha256, folder=Path(folder))


def _proof_of(evidence: Evidence) -> tuple[str, str]:
    """URI and hash. Raises UnknownFile."""
    if not evidence.proof_uri or not evidence.proof_sha256:
        raise UnknownFile("no proof was submitted for this attempt")
    return evidence.proof_uri, evidence.proof_sha256


def _keep(cache: OrderedDict[str, T], sha256: str, value: T, limit: int) -> T:
    cache[sha256] = value
    while len(cache) > limit:
        cache.popitem(last=False)
    return value
