"""What `rodeo site remove` removes: the parts of a data folder that RODEO made, and nothing else."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from rodeo.errors import RodeoError
from rodeo.host.instance import LAUNCHER, lock_holder
from rodeo.site.config import Site
from rodeo.site.processes import PROCESSES, processes_of

_KEYS = ("keys", "deployments")
"""On a chain elsewhere the keys hold what their addresses own, and the deployment knows the contracts."""
_OTHERS = ("bus", "contracts", LAUNCHER, "logs", "mocap", "store", "tls")


class SiteRuns(RodeoError):
    """Processes of the site still run."""


@dataclass(frozen=True)
class Part:
    """A folder in the site's data folder."""

    path: Path
    size_bytes: int


@dataclass(frozen=True)
class Removal:
    """The parts that go, those that stay because their keys may hold money, and what RODEO did not make."""

    parts: list[Part]
    kept: list[Path]
    foreign: list[Path]


def removal_of(site: Site, keys: bool) -> Removal:
    """What is removed of `site`; on a chain elsewhere with `keys` its keys, too. Raises SiteRuns."""
    folder = site.data_dir
    names = [LAUNCHER, "contracts", *(process.name for process in processes_of(site))]
    names += [f"{LAUNCHER}/{process.name}" for process in processes_of(site)]
    if running := [name for name in names if lock_holder(folder / name) is not None]:
        raise SiteRuns("the site runs: stop it with `rodeo down` first", running=", ".join(running))
    own = {*_KEYS, *_OTHERS, *(process.name for process in PROCESSES)}
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    ours = [
        one for one in found if one.name.partition(".")[0] in own and one.is_dir() and not one.is_symlink()
    ]
    kept = [one for one in ours if one.name in _KEYS and site.chain.backend == "external" and not keys]
    parts = [Part(one, _size(one)) for one in ours if one not in kept]
    return Removal(parts, kept, [one for one in found if one not in ours])


def remove(site: Site, removal: Removal) -> None:
    """Remove the parts, and the data folder if nothing else is in it."""
    # What shows whose the folder is goes last: this may be interrupted, and then done again.
    for part in sorted(removal.parts, key=lambda one: one.path.name in _KEYS):
        shutil.rmtree(part.path)
    if site.data_dir.is_dir() and not any(site.data_dir.iterdir()):
        site.data_dir.rmdir()


def _size(folder: Path) -> int:
    return sum(one.lstat().st_size for one in folder.rglob("*") if one.is_file() and not one.is_symlink())
