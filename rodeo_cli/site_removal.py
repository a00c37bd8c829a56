"""What `rodeo site remove` removes: the parts of a data folder that RODEO made, and nothing else."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from rodeo.errors import RodeoError
from rodeo.host.instance import LAUNCHER, lock_holder
from rodeo.site.config import Site
from rodeo.site.processes import processes_of

_KEYS = ("keys", "deployments")
"""On a chain elsewhere the keys hold what their addresses own, and the deployment knows the contracts."""
_OTHERS = ("bus", "contracts", LAUNCHER, "logs", "ros2", "statements", "store", "tls")


class NotOnlyOurs(RodeoError):
    """The data folder holds what RODEO did not make, or is none."""


class SiteRuns(RodeoError):
    """Processes of the site still run."""


@dataclass(frozen=True)
class Part:
    """A folder in the site's data folder."""

    path: Path
    size_bytes: int


@dataclass(frozen=True)
class Removal:
    """The parts that go, and those that stay because their keys may hold money."""

    parts: list[Part]
    kept: list[Path]


def removal_of(site: Site, keys: bool) -> Removal:
    """What is removed of `site`; on a chain elsewhere with `keys` its keys, too.

    Raises SiteRuns, and NotOnlyOurs where anything lies in the data folder that this site's processes do not
    make: the folder may be another project's, with `logs` of its own, and it may hold copies of keys.
    """
    folder = site.data_dir
    processes = [process.name for process in processes_of(site)]
    locked = [LAUNCHER, "contracts", *processes, *(f"{LAUNCHER}/{name}" for name in processes)]
    if running := [name for name in locked if lock_holder(folder / name) is not None]:
        raise SiteRuns("the site runs: stop it with `rodeo down` first", running=", ".join(running))
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    own = {*_KEYS, *_OTHERS, *processes}
    if foreign := [one.name for one in found if one.name not in own or one.is_symlink() or not one.is_dir()]:
        raise NotOnlyOurs(
            "RODEO did not make all that lies in this folder, so nothing was removed: move that elsewhere",
            folder=str(folder),
            found=", ".join(foreign),
        )
    ran = any((folder / name / "lock").is_file() for name in locked)
    if found and not ran and not any((folder / "deployments").glob("[0-9]*.json")):
        raise NotOnlyOurs("no site has run in this folder: nothing was removed", folder=str(folder))
    kept = [one for one in found if one.name in _KEYS and site.chain.backend == "external" and not keys]
    return Removal([Part(one, _size(one)) for one in found if one not in kept], kept)


def remove(site: Site, removal: Removal) -> None:
    """Remove the parts, and the data folder if nothing else is in it."""
    # The keys, which show whose folder it is, are removed last: an interrupted removal can be repeated.
    for part in sorted(removal.parts, key=lambda one: one.path.name in _KEYS):
        shutil.rmtree(part.path)
    if site.data_dir.is_dir() and not any(site.data_dir.iterdir()):
        site.data_dir.rmdir()


def _size(folder: Path) -> int:
    return sum(one.lstat().st_size for one in folder.rglob("*") if one.is_file() and not one.is_symlink())
