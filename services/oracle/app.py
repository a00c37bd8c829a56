"""The oracle's process: every submitted proof gets one verdict, whatever is in it.

Submissions are learnt from the event stream, read from its beginning at every start: that also tells which
proof hashes were used before. Whether one still waits for a verdict is asked from the index when its turn
comes, so nothing needs to be remembered across restarts.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
from collections.abc import Callable
from typing import TypeVar

from rodeo.bus import DaoEvents
from rodeo.config import Site
from rodeo.dao import Participant
from rodeo.errors import BusError, RemoteError
from rodeo.evidence import Store
from rodeo.evidence.errors import StoreUnavailable
from rodeo.logs import about_task
from rodeo.messages import DaoEvent, PostVerdict, Task
from rodeo.service import Service
from services.oracle.case import Device, Ledger
from services.oracle.report import Report
from services.oracle.worker import verify_apart

log = logging.getLogger(__name__)

RETRY_S = 1.0
"""Wall time between attempts to reach the bridge or the store."""
SIDE_BY_SIDE = max(2, (os.cpu_count() or 1) - 1)
"""Proofs verified at the same time; one core stays for everybody else, but none waits for one that hangs."""
_PASSING = frozenset({"bridge_not_ready", "chain_unavailable", "transaction_timeout", "rpc_failed"})
"""What the bridge answers while it cannot; everything else is its last word."""

Answer = TypeVar("Answer")


def run(site: Site, stop: threading.Event) -> None:
    """Serve until `stop` is set."""
    with Service("oracle", site, stop) as service:
        Oracle(service).serve()


class Oracle:
    def __init__(self, service: Service) -> None:
        self._service = service
        self._site = service.site
        self._stop = service.stop
        self._store = Store(service.site)
        self._wallet = Participant(service.bus, service.site.org, "oracle")
        self._submissions: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()
        """(task, attempt) in chain order."""
        self._first_use: dict[str, tuple[int, int]] = {}
        """Proof hash -> the task and attempt that submitted it first."""
        self._running: dict[int, str] = {}
        self._decided = 0
        self._lock = threading.Lock()

    def serve(self) -> None:
        events = DaoEvents(self._service.bus, self._site.org, self._on_event)
        workers = [
            threading.Thread(target=self._work, args=(number,), name=f"verifier {number}", daemon=True)
            for number in range(SIDE_BY_SIDE)
        ]
        for worker in workers:
            worker.start()
        self._service.ready()
        self._stop.wait()
        events.close()
        for worker in workers:
            worker.join(timeout=2 * RETRY_S)

    def _on_event(self, event: DaoEvent) -> None:
        if event.name != "ProofSubmitted" or event.task_id is None:
            return
        submission = event.task_id, int(event.args["attempt"])
        self._first_use.setdefault(str(event.args["proof_hash"]).lower(), submission)
        self._submissions.put(submission)

    def _work(self, number: int) -> None:
        while not self._stop.is_set():
            try:
                task_id, attempt = self._submissions.get(timeout=RETRY_S)
            except queue.Empty:
                continue
            with about_task(task_id):
                try:
                    self._decide(number, task_id, attempt)
                except Exception:
                    # The next proof must get its verdict whatever happened to this one.
                    log.exception("task %d attempt %d got no verdict", task_id, attempt)

    def _decide(self, number: int, task_id: int, attempt: int) -> None:
        """Verify one submission and post the verdict, unless it has one. Waits for bridge and store."""
        ledger = self._until_answered(lambda: self._ledger(task_id))
        if ledger is None or ledger.task.state != "submitted" or ledger.task.attempt != attempt:
            return
        if not self._until_answered(lambda: self._is_ours(ledger.task.kind)):
            log.info("task %d attempt %d is for an auditor to judge", task_id, attempt)
            return
        self._show(number, f"verifying task {task_id}")
        report = verify_apart(
            self._site,
            ledger,
            self._service.data_dir / "verifying",
            self._site.oracle.time_limit_s,
            self._stop,
        )
        if report is None:
            return
        log.info("task %d attempt %d: %s", task_id, attempt, report.reason)
        stored = self._until_answered(lambda: self._store.put_bytes(report.to_bytes(), ".json"))
        if stored is None:
            return
        uri, sha256 = stored
        self._until_answered(lambda: self._post(ledger.task, report, sha256, uri))
        self._decided += 1
        self._show(number, None)

    def _is_ours(self, kind: str) -> bool:
        """Whether the organization has the oracle judge tasks of this kind."""
        kinds = self._wallet.state("organization")["kinds"]
        return any(one["kind"] == kind and one["review"] == "oracle" for one in kinds)

    def _ledger(self, task_id: int) -> Ledger:
        task = self._wallet.task(task_id)
        chain = self._wallet.state("chain")
        used = self._first_use.get((task.proof_sha256 or "").lower())
        return Ledger(
            chain_id=chain["chain_id"],
            task_manager=chain["contracts"]["TaskManager"],
            task=task,
            devices=[Device.model_validate(device) for device in self._wallet.state("devices")["devices"]],
            first_use=None
            if used in (None, (task.id, task.attempt))
            else f"task {used[0]} attempt {used[1]}",
        )

    def _post(self, task: Task, report: Report, report_sha256: str, report_uri: str) -> bool:
        """Post the verdict; False when the task was decided meanwhile."""
        verdict = PostVerdict(
            # A verification repeated after a crash may find other words for the same proof.
            request_id=f"verdict-{task.id}-{task.attempt}-{report_sha256}",
            task_id=task.id,
            attempt=task.attempt,
            proof_sha256=task.proof_sha256 or "",
            accepted=report.accepted,
            reason=report.reason,
            report_sha256=report_sha256,
            report_uri=report_uri,
        )
        try:
            self._wallet.command("post_verdict", verdict)
        except RemoteError as error:
            if error.code != "wrong_state":
                raise
            log.info("task %d attempt %d was decided meanwhile", task.id, task.attempt)
            return False
        return True

    def _until_answered(self, ask: Callable[[], Answer]) -> Answer | None:
        """The answer of `ask`, which is repeated while bridge or store are away; None when stopped."""
        while not self._stop.is_set():
            try:
                return ask()
            except (BusError, RemoteError, StoreUnavailable) as error:
                if isinstance(error, RemoteError) and error.code not in _PASSING:
                    raise
                log.warning("waiting: %s", error)
                self._stop.wait(RETRY_S)
        return None

    def _show(self, number: int, activity: str | None) -> None:
        with self._lock:
            if activity is None:
                self._running.pop(number, None)
            else:
                self._running[number] = activity
            text = ", ".join(self._running.values()) or "idle"
        self._service.activity(text, decided=self._decided)
