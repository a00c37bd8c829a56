"""What can be asked: the bridge's index, and files of tasks from the store. Blocks; call it from a thread."""

from __future__ import annotations

import json
import tempfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

from rodeo import topics
from rodeo.bus import Bus, validate
from rodeo.config import Site
from rodeo.errors import MalformedJson
from rodeo.evidence import Store, open_proof
from rodeo.evidence.statement import Statement, read_statement
from rodeo.messages import DaoEvent, Task
from services.console.errors import UnknownFile

Json = dict[str, Any]

MAX_REPORT_BYTES = 1 << 20
_QUERY_S = 5.0
_REPORTS_KEPT = 64


class Reads:
    def __init__(self, bus: Bus, site: Site) -> None:
        self._bus = bus
        self._site = site
        self._store = Store(site)
        self._reports: OrderedDict[str, Json] = OrderedDict()

    def state(self, what: str, **parameters: Any) -> Json:
        """The bridge's answer to `state/<what>`; parameters that are None are left out."""
        wanted = {name: value for name, value in parameters.items() if value is not None}
        key = topics.STATE.name(org=self._site.org, what=what)
        return self._bus.query(key, parameters=wanted, timeout_s=_QUERY_S)

    def tasks(self, limit: int, offset: int = 0, **filters: Any) -> tuple[list[Task], int]:
        """One page, newest first, and how many there are in all."""
        answer = self.state("tasks", limit=limit, offset=offset, **filters)
        return [validate(Task, task) for task in answer["tasks"]], int(answer["total"])

    def history(self, task_id: int) -> list[DaoEvent]:
        """The task's contract events in order."""
        answer = self.state("events", task_id=task_id)
        return [validate(DaoEvent, event) for event in answer["events"]]

    def robot(self, robot: str) -> Json:
        """What the robot's agent says of itself. Raises NoResponder."""
        return self._bus.query(
            topics.ROBOT_ORDER.name(org=self._site.org, robot=robot, order="state"), {}, timeout_s=_QUERY_S
        )

    def task(self, task_id: int) -> Task:
        return validate(Task, self.state(f"task/{task_id}"))

    def report(self, task: Task) -> Json:
        """The report behind the last verdict. Raises UnknownFile, EvidenceError."""
        if not task.report_uri or not task.report_sha256:
            raise UnknownFile("there is no report on this task yet", task_id=task.id)
        kept = self._reports.get(task.report_sha256)
        if kept is not None:
            return kept
        with tempfile.TemporaryDirectory(prefix="rodeo-report-") as folder:
            path = self._store.fetch(task.report_uri, task.report_sha256, MAX_REPORT_BYTES, Path(folder))
            try:
                report = json.loads(path.read_bytes())
            except (ValueError, RecursionError) as error:
                raise MalformedJson(f"the report is not JSON: {error}") from error
        if not isinstance(report, dict):
            raise MalformedJson("the report is not a JSON object")
        self._reports[task.report_sha256] = report
        while len(self._reports) > _REPORTS_KEPT:
            self._reports.popitem(last=False)
        return report

    def statement(self, task: Task) -> Statement:
        """Note and photos that a person handed in. Raises UnknownFile, EvidenceError."""
        with tempfile.TemporaryDirectory(prefix="rodeo-statement-") as folder:
            return read_statement(open_proof(self.proof(task, Path(folder))))

    def proof(self, task: Task, folder: Path) -> Path:
        """A copy of the proof in `folder`, its bytes checked. Raises UnknownFile, EvidenceError."""
        if not task.proof_uri or not task.proof_sha256:
            raise UnknownFile("no proof was submitted for this task yet", task_id=task.id)
        return self._store.fetch(task.proof_uri, task.proof_sha256, folder=folder)
