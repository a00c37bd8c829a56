"""Verifications as jobs: what the chain says, which proof, and by which rules in which lab."""

from __future__ import annotations

import math
import tempfile
import threading
from collections.abc import Callable, Mapping
from functools import cache, cached_property
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from rodeo.bus.messages import Task
from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Check, Report
from rodeo.errors import DiskFull, Interrupted, InvalidRequest, unreadable
from rodeo.evidence.errors import (
    EvidenceError,
    ProofHashMismatch,
    ProofTooLarge,
    ProofUriNotAllowed,
    StoreUnavailable,
)
from rodeo.jobs import apart
from rodeo.jobs.job import BadAnswer, Job, JobFailed, WorkerDiffers, hex_of, tail
from rodeo.site.config import Site
from rodeo.text.foreign_text import in_words, quoted

VERIFY = "verify"
_LAB = ("lab", "bins", "docks", "robots", "items", "kinds")
"""Tables of the site file that a verification reads, beside the clock's speed and the token."""
_OF_A_MACHINE = {"fetched", apart.ENDED}
"""Checks that fail where a machine does not reach the store, finds other bytes there, or is too slow."""


def lab_sha256(site: Site) -> str:
    """0x and the SHA-256 of all that a verification reads of the site."""
    said = {name: site.model_dump(mode="json", include={name})[name] for name in _LAB}
    for robot, told in zip(site.robots, said["robots"], strict=True):
        if robot.kinematics is not None:  # its content counts, wherever it lies
            told["kinematics"] = _sha256(robot.kinematics)
    clock, token = site.clock, site.economy.token
    said |= {
        "clock": [clock.source, clock.speed, clock.idle_speed],
        "token": token and token.model_dump(mode="json"),
        "max_bytes": site.store.max_bytes,
    }
    return "0x" + hex_of(said)


class Asked(BaseModel):
    """What a verification is given."""

    model_config = ConfigDict(frozen=True)

    chain: ChainRecord | None
    """None for a file that is checked without a chain."""
    submitted: bool
    """Whether the proof is judged as an oracle would, and not any file, which may be a bag."""
    proof_sha256: str
    rules: dict[str, str | None]
    """Kind -> hash of its rules: of the task's kind, or of all where no chain names one."""
    lab_sha256: str
    package: str
    """Version of RODEO."""
    suffix: str
    """The end of a given file's name, by which it is read as a bag or not; "/" for a folder, and empty for
    what was submitted."""


class Verify:
    """Verifies proofs. The answer is the report, as `Report.to_bytes` writes it.

    Args:
        site: whose lab, store and limits count.
        scratch: folder for what a verification needs meanwhile.
    """

    name = VERIFY

    def __init__(self, site: Site, scratch: Path) -> None:
        self._site, self._scratch = site, scratch
        self._children = apart.Children(site)
        self._starting = threading.Lock()
        self._rules: Mapping[str, str | None] | None = None
        self.longest_s = apart.ATTEMPTS * site.oracle.time_limit_s

    @property
    def rules(self) -> Mapping[str, str | None]:
        """Kind -> hash of the rules that are installed here. Raises VerifierEnded."""
        with self._starting:
            if self._rules is None:
                self._rules = apart.start(self._site)
            return self._rules

    @cached_property
    def lab_sha256(self) -> str:
        return lab_sha256(self._site)

    def job(
        self,
        proof_sha256: str,
        chain: ChainRecord | None = None,
        file: Path | None = None,
        submitted: bool = True,
    ) -> Job:
        """The question what the rules that are installed here say of this proof: of the one at the URI that
        `chain` names, or at `file`, where it was fetched already."""
        rules = dict(self.rules)
        if chain is not None:
            task = chain.task
            rules = {task.kind: rules.get(task.kind)}
            # Its report is by these rules, whichever it was posted under.
            task = task.model_copy(update={"rules_sha256": rules[task.kind]})
            chain = chain.model_copy(update={"task": task})
        asked = Asked(
            chain=chain,
            submitted=submitted,
            proof_sha256=proof_sha256,
            rules=rules,
            lab_sha256=self.lab_sha256,
            package=_package(),
            suffix="" if submitted or file is None else "/" if file.is_dir() else file.suffix,
        )
        return Job(VERIFY, asked.model_dump(mode="json"), file)

    def file(self, path: Path, chain: ChainRecord | None = None) -> Job:
        """The question about any file or bag: nobody need have submitted it. Raises InvalidRequest."""
        try:
            sha256 = _sha256(path, self._site.store.max_bytes)
        except OSError as error:
            raise InvalidRequest("the file cannot be read", path=str(path), reason=str(error)) from error
        return self.job(sha256, chain, path, submitted=False)

    def do(self, job: Job, stop: threading.Event) -> bytes:
        _require("package", _package(), job.given.get("package"))  # first: another one asks otherwise
        asked = Asked.model_validate(job.given)
        self._compare(asked)
        if asked.submitted and job.file is not None and (error := self._unlike(job.file, asked.proof_sha256)):
            return _not_fetched(asked, error).to_bytes()
        self._scratch.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._scratch) as folder:
            report = self._report(asked, job.file, Path(folder), stop)
        if report is None:
            raise Interrupted("stopped while a proof was verified", proof_sha256=asked.proof_sha256)
        return report.to_bytes()

    def check(self, job: Job, answer: bytes) -> None:
        asked = Asked.model_validate(job.given)
        try:
            report = Report.model_validate_json(answer)
        except ValidationError as error:
            raise BadAnswer("the answer is no report", reason=unreadable(error)) from error
        task = None if asked.chain is None else asked.chain.task
        wanted: dict[str, Any] = {}
        if asked.submitted or report.accepted or not self._is_unread(report, task, job.file):
            wanted["proof_sha256"] = asked.proof_sha256
        if task:
            wanted |= {"task_id": task.id, "attempt": task.attempt, "kind": task.kind}
        if report.kind in asked.rules:
            wanted["rules_sha256"] = asked.rules[report.kind]
        wrong = {
            name: getattr(report, name) for name, value in wanted.items() if getattr(report, name) != value
        }
        if wrong:
            raise BadAnswer("the report is on another proof", **wrong)

    @staticmethod
    def _is_unread(report: Report, task: Task | None, file: Path | None) -> bool:
        """Whether the report on any file names another hash than the file's: one that cannot be read has
        none, or that of the task, and a folder has one of its bag."""
        is_bag = file is not None and file.is_dir()
        return is_bag or report.proof_sha256 == (task.proof_sha256 if task else None)

    def doubt(self, answer: bytes) -> str:
        report = Report.model_validate_json(answer)
        ends = {check.name for check in report.checks if check.passed is False}
        return report.reason if ends & _OF_A_MACHINE else ""

    def close(self) -> None:
        self._children.end()

    def _compare(self, asked: Asked) -> None:
        """Raises WorkerDiffers."""
        # In this order: another lab may have kinds that are not installed here.
        own: dict[str, Callable[[], object]] = {
            "lab_sha256": lambda: self.lab_sha256,
            "rules": lambda: {kind: self.rules.get(kind) for kind in asked.rules},
        }
        for name, here in own.items():
            _require(name, here(), getattr(asked, name))

    def _unlike(self, file: Path, sha256: str) -> EvidenceError | None:
        """Why the store would not give this file as the one with that hash."""
        if (size := file.stat().st_size) > (most := self._site.store.max_bytes):
            return ProofTooLarge(
                "the file is larger than allowed", limit="file_bytes", value=size, allowed=most
            )
        if (found := _sha256(file)) != sha256:
            return ProofHashMismatch("the bytes do not match the submitted hash", found=found)
        return None

    def _report(self, asked: Asked, file: Path | None, folder: Path, stop: threading.Event) -> Report | None:
        """Raises JobFailed, WorkerDiffers."""
        log = folder / "log"
        ended = ""
        for failed in range(apart.ATTEMPTS):
            try:
                return apart.verify_apart(
                    self._site,
                    asked.chain,
                    folder,
                    stop,
                    copy=file,
                    failed=failed,
                    submitted=asked.submitted,
                    log_to=log,
                    children=self._children,
                )
            except apart.VerificationFailed as error:
                ended = str(error)
            except ProofUriNotAllowed as error:
                raise WorkerDiffers(str(error)) from error
            except (StoreUnavailable, DiskFull) as error:
                raise JobFailed(str(error), log=tail(log)) from error
            except EvidenceError as error:
                return _not_fetched(asked, error)
        raise JobFailed(ended, log=tail(log))


def _require(name: str, here: object, asked: object) -> None:
    """Raises WorkerDiffers."""
    if here != asked:
        raise WorkerDiffers(f"this worker has another {name} than the job asks for", here=here, asked=asked)


@cache
def _package() -> str:
    return version("rodeo-dao")


def _not_fetched(asked: Asked, error: EvidenceError) -> Report:
    """The report on a submission whose bytes the store lacks, or has others of."""
    assert asked.chain is not None
    task = asked.chain.task
    found = Check(
        name="fetched",
        passed=False,
        source=quoted(task.proof_uri or ""),
        detail=f"{error.code}: {in_words(error)}",
    )
    return apart.report_on(task, found)


def _sha256(path: Path, most_bytes: float = math.inf) -> str:
    """0x and the hash of a file's bytes, or of the files of a bag that is a folder. What is larger than
    `most_bytes` is not read: of that, only the size counts."""
    if path.is_dir():
        files = [one for one in path.rglob("*") if one.is_file()]
        return "0x" + hex_of({str(one.relative_to(path)): _sha256(one, most_bytes) for one in files})
    if (size := path.stat().st_size) > most_bytes:
        return "0x" + hex_of(size)
    with path.open("rb") as file:
        return "0x" + file_digest(file, "sha256").hexdigest()
