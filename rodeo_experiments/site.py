"""The site of one run: the site file's own, on free ports in a folder of its own, with what a run varies."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from rodeo.errors import unreadable
from rodeo.host.files import begin_folder, replace_file
from rodeo.lab.config import Pose2
from rodeo.robot.navigation import Floor
from rodeo.site.chance import generator
from rodeo.site.config import Site, read_tables
from rodeo.site.endpoint import free_port
from rodeo.site.sections import TariffConfig
from rodeo.text.site_problems import toml
from rodeo_experiments.errors import ExperimentFailed, NoFreePlace
from rodeo_experiments.inputs import code_sha256, overrides_sha256, site_sha256
from rodeo_experiments.lab import ROBOTS_APART_M, Point, free_place, keep_clear

_WRITTEN = "# Written by `rodeo experiment`."
_BEGUN = "begun.json"
_CHAIN = "chain.url"
_NO_TARIFF = "cannot read the tariff: a CSV file with columns `from_hour` and `eur_kwh` is needed"
_TRIES = 100
"""To find places for all robots."""


@dataclass(frozen=True)
class Variation:
    """What a run may have otherwise than its site file. None leaves it as it is."""

    seed: int | None = None
    days: int | None = None
    robots: int | None = None
    tariff: Path | None = None
    chain: str | None = None
    slow: bool = False
    """Robots keep to `experiment.slow_limits`."""
    calibrated: bool = False
    """Robots have the base load `experiment.calibrated_idle_power_w`."""
    unlisted: bool = False
    """What people leave is listed nowhere, and `experiment.unlisted` says what else differs."""


def write_site(base: Path, folder: Path, vary: Variation) -> Path:
    """The site file of a new run in `folder`, which is emptied of an earlier run. Raises ConfigError,
    ExperimentFailed, FolderTaken."""
    site = Site.load(base)
    if site.experiment is None or site.clock.start is None:
        raise ExperimentFailed("the site file needs an [experiment] table and clock.start", path=str(base))
    tables = read_tables(base)
    begin_folder(folder, _WRITTEN)
    experiment = tables["experiment"]
    if vary.days is not None:
        # As many a day: the same experiment, only longer or shorter.
        arrivals = round(site.experiment.arrivals * vary.days / site.experiment.days)
        experiment = experiment | {"days": vary.days, "arrivals": arrivals}
    changes: dict[str, Any] = {
        _CHAIN: _chain_url(),
        "console.port": 0,
        "bins": [one | {"http_port": 0} for one in tables.get("bins", [])],
        "robots": _robots(site, tables["robots"], vary),
        "experiment": experiment,
    }
    if vary.unlisted:
        changes |= {"items": [], "things": [*tables.get("things", []), *tables.get("items", [])]}
        changes |= dict(_leaves(site.experiment.unlisted))
    if vary.seed is not None:
        changes["clock.seed"] = vary.seed
    if vary.chain is not None:
        changes["chain.backend"] = vary.chain
    if vary.tariff is not None:
        changes["economy.electricity"] = read_tariff(vary.tariff)
    path = folder / "site.toml"
    path.write_text(
        "\n".join(
            [
                _WRITTEN,
                f"extends = {json.dumps(str(base.resolve()))}",
                f"data_dir = {json.dumps(str((folder / 'data').resolve()))}",
                *(f"{name} = {toml(value)}" for name, value in changes.items()),
                "",
            ]
        )
    )
    return path


def _chain_url() -> str:
    return f"http://127.0.0.1:{free_port()}"


def site_again(path: Path) -> Site:
    """The site of a run that continues. Its chain has a new port: others may have taken the first one."""
    lines = path.read_text().splitlines()
    moved = [f"{_CHAIN} = {toml(_chain_url())}" if one.startswith(f"{_CHAIN} = ") else one for one in lines]
    replace_file(path, "\n".join(moved) + "\n")
    return Site.load(path)


def _leaves(table: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Each setting of a table by its full name."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


class Begun(BaseModel):
    """What a run was begun with, so that it continues as the same one."""

    code_sha256: str
    site_sha256: str

    options: dict[str, Any]
    """By the name on the command line; None where the site file's value holds."""
    overrides: dict[str, str] = Field(default_factory=overrides_sha256)
    times_s: list[float]
    """Site times of the arrivals."""

    @classmethod
    def now(cls, base: Path, options: dict[str, Any], times_s: list[float]) -> Begun:
        return cls(code_sha256=code_sha256(), site_sha256=site_sha256(base), options=options, times_s=times_s)

    def save(self, folder: Path) -> None:
        replace_file(folder / _BEGUN, self.model_dump_json(indent=2) + "\n")

    @classmethod
    def load(cls, folder: Path, base: Path, options: dict[str, Any], complete: bool = False) -> Begun:
        """Raises ExperimentFailed where an option is given that had another value, nothing was begun, or the
        site file `base` or, of a run that is not complete, the code changed since."""
        try:
            begun = cls.model_validate_json((folder / _BEGUN).read_bytes())
        except (OSError, ValidationError) as error:
            raise ExperimentFailed(
                "this folder holds no run that can continue", path=str(folder), reason=str(error)
            ) from error
        for name, value in options.items():
            if value is not None and value != (before := begun.options.get(name)):
                raise ExperimentFailed(
                    f"--resume continues with what a run was begun with: leave out --{name}",
                    given=value,
                    begun_with="the site file's value" if before is None else before,
                )
        for what, before, now in (
            ("the code", begun.code_sha256, code_sha256()),
            ("the site file", begun.site_sha256, site_sha256(Path(begun.options.get("site") or base))),
        ):
            if before != now and not (complete and what == "the code"):
                raise ExperimentFailed(
                    f"{what} has changed since this run was begun: begin it again", path=str(folder)
                )
        if changed := {name for name, _ in overrides_sha256().items() ^ begun.overrides.items()}:
            raise ExperimentFailed(
                "--resume continues with the environment variables that a run was begun with",
                changed=", ".join(sorted(changed)),
            )
        return begun


def _robots(site: Site, tables: list[dict[str, Any]], vary: Variation) -> list[dict[str, Any]]:
    """The site's robots; or so many of the first one's make, each at a place of its own on free floor."""
    assert site.experiment is not None
    robots = tables[: vary.robots]
    if vary.robots is not None and vary.robots > len(tables):
        name = site.robots[0].name.rstrip("0123456789")
        robots = [
            tables[0] | {"name": f"{name}{number}", "pose": pose.model_dump()}
            for number, pose in enumerate(_places(site, vary.robots), start=1)
        ]
    if vary.slow:
        robots = [one | {"limits": one.get("limits", {}) | site.experiment.slow_limits} for one in robots]
    if vary.calibrated:
        if site.experiment.calibrated_idle_power_w is None:
            raise ExperimentFailed(
                "a calibrated run needs experiment.calibrated_idle_power_w in the site file: set it, or use "
                "--no-calibrated"
            )
        load = {"idle_power_w": site.experiment.calibrated_idle_power_w}
        robots = [one | {"battery": one.get("battery", {}) | load} for one in robots]
    return robots


def _places(site: Site, count: int) -> list[Pose2]:
    """Where robots rest and are in nobody's way. Raises NoFreePlace."""
    chance = generator(site, "arrivals", "robots", repeatable=True)
    floor = Floor(site)
    for _ in range(_TRIES):
        places: list[Point] = []
        try:
            for _robot in range(count):
                places.append(free_place(site, floor, chance, places, apart_m=ROBOTS_APART_M))
        except NoFreePlace:
            continue
        poses = [Pose2(x_m=x_m, y_m=y_m) for x_m, y_m in places]
        if keep_clear(site, poses):
            return poses
    raise NoFreePlace(
        "found no places where so many robots leave each other's ways free: use fewer, or a site file "
        "(--site) with a larger lab.size_m",
        robots=count,
        size_m=site.lab.size_m,
        tries=_TRIES,
    )


def read_tariff(path: Path) -> list[dict[str, Any]]:
    """A CSV file with the columns `from_hour` (UTC) and `eur_kwh`. Raises ExperimentFailed."""
    try:
        with path.open(newline="") as file:
            rows = [
                TariffConfig.model_validate({name: row[name] for name in TariffConfig.model_fields})
                for row in csv.DictReader(file)
            ]
    except KeyError as error:
        raise ExperimentFailed(_NO_TARIFF, path=str(path), lacks=str(error)) from error
    except (OSError, ValueError) as error:
        raise ExperimentFailed(_NO_TARIFF, path=str(path), reason=unreadable(error)) from error
    if not rows:
        raise ExperimentFailed(_NO_TARIFF, path=str(path), reason="it has no rows")
    return [{"from_hour": row.from_hour, "eur_kwh": float(row.eur_kwh)} for row in rows]
