"""Many runs of an experiment as jobs. A job is a whole site: its tables, when things arrive, and the code.

Equal questions have equal counts and balances as their answer, whichever machine computes it. So a run that
was interrupted begins anew: one that continues differs by what was going on, a charge for example. `python -m
rodeo_experiments.study FOLDER` is the child that conducts one run.
"""

from __future__ import annotations

import gzip
import io
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import zlib
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from rodeo.errors import ConfigError, Interrupted, unreadable
from rodeo.host.files import replace_file
from rodeo.host.instance import lock_instance
from rodeo.jobs.job import MOST_BYTES, BadAnswer, Job, JobFailed, WorkerDiffers, tail
from rodeo.runtime.process import die_with
from rodeo.site.config import Site, read_tables
from rodeo.site.endpoint import free_port
from rodeo.text.site_problems import toml
from rodeo_experiments.arrivals import plan
from rodeo_experiments.conduct import Conduct, parameters
from rodeo_experiments.errors import ExperimentFailed
from rodeo_experiments.inputs import code_sha256, files_sha256, overrides_sha256
from rodeo_experiments.record import Run
from rodeo_experiments.results import Figures
from rodeo_experiments.site import Variation, write_site

_LIBRARIES = ("mujoco", "numpy", "eclipse-zenoh", "py-evm")
_RUN_BYTES = 64 << 20
"""Size of the largest record of a run."""
_LOOK_S = 0.5
_END_S = 60.0
"""Wall time for a site's end before it is killed."""
ASKED = "asked.json"
"""The file that tells a run's child what was asked."""
_OWN = ("clock.seed", "chain.url", "data_dir", "extends")
"""Settings of which each run has its own value."""


def settings(texts: Sequence[str]) -> list[dict[str, Any]]:
    """Every combination of what texts `name=value,value` set. A value is TOML, or else a text.

    Raises ExperimentFailed.
    """
    named: dict[str, list[Any]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        if not (name and equals and values):
            raise ExperimentFailed("write a setting as name=value,value", found=text)
        if any(f"{own}.".startswith(f"{name}.") for own in _OWN):
            raise ExperimentFailed(f"each run has its own {', '.join(_OWN)}: see --seeds", found=text)
        if name in named:
            raise ExperimentFailed("a setting is named twice: write name=value,value", found=text)
        named[name] = _read(values)
    return [dict(zip(named, one, strict=True)) for one in itertools.product(*named.values())]


def _read(values: str) -> list[Any]:
    try:
        read: list[Any] = tomllib.loads(f"values = [{values}]")["values"]
    except tomllib.TOMLDecodeError:
        return values.split(",")
    return read


class Asked(BaseModel):
    """What a run is given."""

    model_config = ConfigDict(frozen=True)

    tables: dict[str, Any]
    """The site file's, without what is each machine's own."""
    times_s: list[float]
    """Site times of the arrivals."""
    code_sha256: str
    versions: dict[str, str]
    """Versions of the libraries that counts depend on."""
    overrides: dict[str, str]
    """See `overrides_sha256`."""
    files: dict[str, str]
    """See `files_sha256`."""

    @classmethod
    def of(cls, base: Path, vary: Variation, changes: dict[str, Any], source: str) -> Self:
        """A run of the site file `base`, varied, with `changes` by the names of settings. Raises ConfigError
        for the file, and ExperimentFailed for what is changed in it."""
        with tempfile.TemporaryDirectory() as folder:
            changed, varied = Path(folder, "changed.toml"), Path(folder, "varied")
            replace_file(changed, _lines(_changed(read_tables(base), changes)))
            try:
                # A variation may read what is set, as the calibrated base load, and sets nothing of it.
                tables = _changed(read_tables(write_site(changed, varied, vary)), changes)
                site = Site.load(_write(tables, varied))
            except ConfigError as error:
                raise ExperimentFailed(
                    "the site is not valid with these settings", problem=_problem(error), **changes
                ) from error
        assert site.experiment is not None
        for table, name in ((tables, "data_dir"), (tables["chain"], "url")):
            table.pop(name, None)
        return cls(
            tables=tables,
            times_s=plan(site, site.experiment, source),
            **_here(tables),
        )

    @property
    def job(self) -> Job:
        return Job(Runs.name, self.model_dump(mode="json"))


class Runs:
    """Runs of experiments, each a site in a folder of its own. The answer is the record, compressed.

    Args:
        folder: where runs that are not over are kept.
    """

    name = "run"
    longest_s = 7 * 86_400.0

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def do(self, job: Job, stop: threading.Event) -> bytes:
        for name, here in _here(job.given.get("tables", {})).items():
            if job.given.get(name) != here:
                raise WorkerDiffers(f"this worker has another {name} than the run asks for")
        asked = Asked.model_validate(job.given)
        folder = self._folder / job.key[:16]
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / ASKED, asked.model_dump_json())
        record = folder / "run.json"
        status = 0 if record.exists() else _conduct(folder, stop)
        if stop.is_set() and not record.exists():
            shutil.rmtree(folder / "run", ignore_errors=True)
            raise Interrupted("stopped while a run was conducted", job=job.key)
        if not record.exists():
            raise JobFailed("the run did not reach its end", log=tail(folder / "log"), exit_status=status)
        answer = gzip.compress(record.read_bytes(), mtime=0)
        if len(answer) > MOST_BYTES:
            words = "the run's record is too large to be sent; it is kept"
            raise JobFailed(words, record=str(record), bytes=len(answer), allowed=MOST_BYTES)
        shutil.rmtree(folder)
        return answer

    def check(self, job: Job, answer: bytes) -> None:
        asked, run = Asked.model_validate(job.given), record_of(answer)
        with tempfile.TemporaryDirectory() as folder:
            site = Site.load(_write(asked.tables, Path(folder)))
        assert site.experiment is not None
        wanted = parameters(site) | {"seed": site.clock.seed, "days": site.experiment.days}
        said = run.parameters | {"seed": run.seed, "days": run.days}
        if differ := [name for name, value in wanted.items() if said.get(name) != value]:
            raise BadAnswer("the record is of another run", differ=", ".join(differ))
        try:
            Figures(run).problems(len(asked.times_s))
            Figures(run).results()
        except Exception as error:  # a figure of whatever it says may fail anywhere
            raise BadAnswer("the record says what cannot be", reason=repr(error)) from error

    def doubt(self, _answer: bytes) -> str:
        return ""

    def close(self) -> None:
        """A run's processes ended with it."""


def record_of(answer: bytes) -> Run:
    """The record in an answer. Raises BadAnswer."""
    try:
        with gzip.open(io.BytesIO(answer)) as stream:
            data = stream.read(_RUN_BYTES + 1)
        if len(data) > _RUN_BYTES:
            raise BadAnswer("the record is too large", allowed=_RUN_BYTES)
        return Run.model_validate_json(data)
    except (OSError, EOFError, zlib.error, ValidationError) as error:
        reason = unreadable(error) if isinstance(error, OSError | ValidationError) else str(error)
        raise BadAnswer("the answer is no record of a run", reason=reason) from error


def _here(tables: dict[str, Any]) -> dict[str, Any]:
    """What a run of these tables depends on besides, on this machine."""
    return {
        "code_sha256": code_sha256(),
        "versions": {name: version(name) for name in _LIBRARIES},
        "overrides": overrides_sha256(),
        "files": files_sha256(tables),
    }


def _problem(error: ConfigError) -> str:
    """What is wrong, without the site file that was written for a moment."""
    fields = error.details.get("fields")
    return "; ".join(f"{name}: {text}" for name, text in fields.items()) if fields else error.message


def _changed(tables: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """With each setting, by its name, as JSON. Raises ExperimentFailed."""
    for name, value in changes.items():
        _change(tables, name, value)
    plain: dict[str, Any] = json.loads(json.dumps(tables, default=str))
    return plain


def _change(table: Any, name: str, value: Any) -> None:
    """Set `a.b` in a table, or in each table of a list. Raises ExperimentFailed."""
    first, _, rest = name.partition(".")
    for one in table if isinstance(table, list) else [table]:
        if not isinstance(one, dict):
            raise ExperimentFailed("no such setting: it is no table", setting=name)
        if rest:
            _change(one.setdefault(first, {}), rest, value)
        else:
            one[first] = value


def _write(tables: dict[str, Any], folder: Path) -> Path:
    """A site file for these tables, with a port and a folder of this machine."""
    own = {
        "data_dir": str((folder / "data").resolve()),
        "chain": tables.get("chain", {}) | {"url": f"http://127.0.0.1:{free_port()}"},
    }
    path = folder / "site.toml"
    replace_file(path, _lines(tables | own))
    return path


def _lines(tables: dict[str, Any]) -> str:
    return "".join(f"{name} = {toml(value)}\n" for name, value in tables.items())


def begin(folder: Path) -> tuple[Path, list[float]]:
    """Site file and arrivals of the run that begins in `folder`, whatever was left there."""
    asked, run = Asked.model_validate_json((folder / ASKED).read_bytes()), folder / "run"
    if run.exists():  # what still ends there may write a little longer
        shutil.rmtree(run.rename(Path(tempfile.mkdtemp(dir=folder)) / "run"), ignore_errors=True)
    run.mkdir()
    return _write(asked.tables, run), asked.times_s


def _conduct(folder: Path, stop: threading.Event) -> int:
    """Have a child conduct the run in `folder`; its exit status."""
    with (folder / "log").open("ab") as log:
        child = subprocess.Popen(
            [sys.executable, "-m", "rodeo_experiments.study", str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    ended_s = time.monotonic() + Runs.longest_s
    while child.poll() is None and not stop.wait(_LOOK_S) and time.monotonic() < ended_s:
        pass
    if child.poll() is None:
        child.terminate()
    try:
        return child.wait(_END_S)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        return child.wait()


def _child(folder: Path) -> None:
    def interrupt(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the end of its site is not to be interrupted
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    die_with(os.getppid(), signal.SIGTERM)
    lock_instance(folder, _END_S)  # the child of a command that was killed may still be ending
    if (folder / "run.json").exists():
        return
    site, times_s = begin(folder)
    said_s = 0.0

    def say(text: str, share: float) -> None:
        nonlocal said_s
        if time.monotonic() - said_s > 60:
            said_s = time.monotonic()
            print(f"{100 * share:3.0f} % {text}", flush=True)

    Conduct(site, times_s, site.parent, say).run().save(folder / "run.json")


if __name__ == "__main__":
    _child(Path(sys.argv[1]))
