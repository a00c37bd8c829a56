"""How far the deployment of a site's contracts is, for everybody who waits for it.

The process that deploys holds the lock of `data_dir/contracts` and keeps a file there up to date. The kernel
lets go of the lock however that process ends, so nobody waits for one that is gone.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import BaseModel, ValidationError

from rodeo.host.files import replace_file
from rodeo.host.instance import LAUNCHER, lock_holder, lock_instance
from rodeo.site.config import Site

_PROGRESS = "progress.json"

_WAIT_S = 3600.0
"""Wall time for which a second deployment of the same site waits for the first."""


class Deploying(BaseModel):
    """A deployment under way, as the process that does it wrote it last."""

    pid: int
    done: int = 0
    """Steps that are done."""
    of: int = 0
    """All steps; 0 before they are counted."""
    doing: str = ""

    def __str__(self) -> str:
        if not self.of:
            return "deploying contracts"
        return f"deploying contracts, {min(self.done + 1, self.of)} of {self.of}: {self.doing}"


class Steps:
    """Counts the steps of a deployment, and writes each into `path`; nowhere without one."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._now = Deploying(pid=os.getpid())
        self._begun = 0

    def plan(self, count: int) -> None:
        """There are `count` more steps than was known."""
        self._now.of += count

    def begin(self, doing: str, count: int = 1) -> None:
        """What was begun before is done, and these `count` steps begin."""
        self._now.done += self._begun
        self._begun, self._now.doing = count, doing
        if self._path is not None:
            replace_file(self._path, self._now.model_dump_json())


@contextmanager
def deploying(site: Site, stop: threading.Event) -> Iterator[Steps]:
    """Around a deployment: one that another process has begun is waited for. Raises AlreadyRunning when
    stopped meanwhile, and DiskFull."""
    folder = _folder(site)
    lock = lock_instance(folder, _WAIT_S, stop)
    steps = Steps(folder / _PROGRESS)
    try:
        steps.begin("", 0)
        yield steps
    finally:
        os.close(lock)


def deployment_under_way(site: Site) -> Deploying | None:
    """The deployment that runs now, or that a launcher of this site is about to begin; None otherwise."""
    path = _folder(site) / _PROGRESS
    if (pid := lock_holder(path.parent)) is None:
        begins = site.chain.backend != "external" and not path.exists()
        pid = lock_holder(site.data_dir / LAUNCHER) if begins else None
        return None if pid is None else Deploying(pid=pid)
    try:
        told = Deploying.model_validate_json(path.read_bytes())
    except (FileNotFoundError, ValidationError):
        return Deploying(pid=pid)
    # What another process wrote before says nothing of this one.
    return told if told.pid == pid else Deploying(pid=pid)


def forget_deployment(site: Site) -> None:
    """A launcher is about to deploy: what is known of an earlier deployment says nothing of this one."""
    (_folder(site) / _PROGRESS).unlink(missing_ok=True)


def _folder(site: Site) -> Path:
    return site.data_dir / "contracts"
