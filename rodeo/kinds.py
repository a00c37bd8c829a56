"""Kinds of work: the parameters of a kind's tasks, who judges it, and where its behaviour and checks are.

A kind is a package that declares a `Kind` under the entry point group `rodeo.kinds`. One that has neither
behaviour nor checks is a table `[[kinds]]` of the site file. A kind's code runs beside keys, so only what the
site file names is imported. A declaration imports neither behaviour nor checks: their libraries, MuJoCo and
OpenCV, are installed only where they are used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

import jsonschema_rs
from pydantic import BaseModel, ValidationError

from rodeo.bus.messages import Task
from rodeo.charging.orders import costliest_iec
from rodeo.errors import InvalidRequest, RodeoError
from rodeo.lab.config import Pose2
from rodeo.site.config import Site
from rodeo.site.sections import KindConfig, RateConfig
from rodeo.site.topics import ROBOT_STATE, Topic
from rodeo.text.pydantic_words import wrong_fields

GROUP = "rodeo.kinds"
"""Entry point group: kind -> its `Kind`."""

EXECUTION_WINDOW_S = 2 * 3600
"""Default execution window, site time."""
MIN_WINDOW_S, MAX_WINDOW_S = 10 * 60, 7 * 24 * 3600
"""The shortest and the longest execution window of a task whose kind sets no others."""

PEOPLES_MIN_WINDOW_S = 3600
"""The shortest execution window of work for people, who accept it in the first half of the window."""

VERDICT_WINDOWS_S = 15 * 60, 7 * 24 * 3600
"""The shortest and the longest verdict window of a task, where nobody sets others."""

GRACE_S = 180
"""Grace period of a kind that declares none and whose shortest window is at least twice as long."""

MAX_GRACE_S, GRACE_STEP_S = 2550, 10
"""Limits of the contracts: a task keeps its grace period in 8 bits."""

DEFAULT_PRICE_IEC = Decimal(100)
"""Reference price of a kind that names no price: what a newcomer's record counts for."""

FORMATS = {
    "item": "the id of an item of the site",
    "robot": "the name of a robot of the site",
    "bin": "the name of a bin of the site",
    "dock": "the name of a dock of the site",
    "place": "the name of a place of the site",
    "map-x": "m east of the map's origin, chosen on the map",
    "map-y": "m north of it",
    "photo": "the name of a photo in the site's store; people choose a file",
    "percent": "a share, 0 to 1, that people read in percent",
    "follows": "what `complete` finds from the rest, so that nobody is asked",
}
"""`format` of a parameter's JSON Schema, for who shows it to people; others are shown by their type."""

PHOTO = r"^[0-9a-f]{64}\.(jpg|png)$"
"""A photo's name in the store (`rodeo.person.photos`)."""

SAME_PLACE_M = 0.25
"""What two people or robots see nearer together than this, m, is taken for one thing."""

Judge = Literal["oracle", "auditor"]
Doubt = Callable[[Mapping[str, Any], Sequence[Task]], str]
"""Why a task with these parameters can probably not be done, judging by the tasks that name its subject, or
by those under way where it names none, the newest first; empty if there is no reason."""
Completion = Callable[[Site, Mapping[str, Any]], dict[str, Any]]
"""Completes the parameters with values that follow from them at a site. Raises InvalidRequest where nobody
could prove the work there: the bridge then locks no reward for it."""
Problems = Callable[[Site, Mapping[str, Any]], dict[str, str]]
"""Field of the parameters -> what to do about it, for parameters that fit the schema but not the site."""


NOT_INSTALLED = (
    "no installed package brings this kind, and nobody else is named who judges it: install its package, or "
    'write judge = "auditor" in its [[kinds]], so that people do'
)


class KindError(RodeoError):
    """A kind that is not installed or not valid."""

    code = "kind_error"
    restart_cures = False


def _no_doubt(_params: Mapping[str, Any], _tasks: Sequence[Task]) -> str:
    return ""


def _as_they_are(_site: Site, params: Mapping[str, Any]) -> dict[str, Any]:
    return dict(params)


def _no_problems(_site: Site, _params: Mapping[str, Any]) -> dict[str, str]:
    return {}


@dataclass(frozen=True)
class Recorded:
    """A topic of the executor's recording. The executor's device seals all of it."""

    topic: Topic
    signed_by: str = ""
    """For statements: role of the witness that signed them."""


@dataclass(frozen=True)
class Kind:
    """Declaration of a kind of work, without its code. `behaviour`, `checks` and `harness` are
    "module:attribute"; empty where a kind has none."""

    name: str
    title: str
    description: str
    judge: Judge
    """The judge of a proof. An oracle judges only what has checks."""
    params: type[BaseModel] | None = None
    """Model of a task's parameters; None if `parameters` defines them."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """JSON Schema of the parameters where there is no model."""
    execution_window_s: int = EXECUTION_WINDOW_S
    """Execution window if the task sets none, site time."""
    min_window_s: int = MIN_WINDOW_S
    """The shortest execution window of a task: the work takes this long. Never more than the default."""
    max_window_s: int = MAX_WINDOW_S
    """The longest execution window, because nobody else can earn the reward meanwhile. Never less than the
    default."""
    grace_s: int = 0
    """How long an executor may give a task back, see `grace_period_s`. 0: three minutes, or as long as the
    contracts allow if people do the work: they have to accept it in this time."""
    price_iec: Decimal = Decimal(0)
    """Price that the site's own robots and docks ask."""
    example: Mapping[str, Any] = field(default_factory=dict)
    """Example parameters of a task."""
    recorded: tuple[Recorded, ...] = tuple(map(Recorded, ROBOT_STATE))
    """Topics in an executor's proof."""
    unit: str = "task"
    """Unit of the price."""
    measure: str = ""
    """Unit of what rates pay for; empty where the checks measure no quantity."""
    rates: tuple[RateConfig, ...] = ()
    """What a unit of the measure is paid, by the hour, up to the agreed price; without rates the price is for
    the whole task."""
    provides: Literal["", "energy"] = ""
    """What a robot buys with a task of this kind."""
    behaviour: str = ""
    checks: str = ""
    harness: str = ""
    problems: Problems = _no_problems
    complete: Completion = _as_they_are
    subject: str = ""
    """The parameter that names the task's subject, if it has one."""
    doubt: Doubt = _no_doubt
    models_sha256: tuple[str, ...] = ()
    """Networks whose word counts besides the one that the checks ask."""

    def __post_init__(self) -> None:
        if self.judge == "oracle" and not self.checks:
            raise KindError("the oracle has no checks for this kind: let auditors judge it", kind=self.name)
        if self.rates and not self.measure:
            raise KindError("its checks measure no quantity: remove rates", kind=self.name)

    def lacks(self, site: Site) -> str:
        """What the site has none of, and a proof of this kind needs a statement of; empty if nothing."""
        needed = {one.signed_by for one in self.recorded}
        if "bin" in needed and not site.bins:
            return "bins"
        return "docks" if "meter" in needed and not site.docks else ""

    @property
    def windows_s(self) -> tuple[int, int]:
        """The shortest and the longest execution window of a task."""
        default_s = self.execution_window_s
        return max(60, min(self.min_window_s, default_s)), min(30 * 86_400, max(self.max_window_s, default_s))

    @property
    def grace_period_s(self) -> int:
        """How long an executor may give a task back: `grace_s`, and at most half of the shortest window."""
        longest_s = min(MAX_GRACE_S, self.windows_s[0] // 2) // GRACE_STEP_S * GRACE_STEP_S
        return min(self.grace_s or (longest_s if self.by_people else GRACE_S), longest_s)

    @property
    def reference_price_iec(self) -> Decimal:
        """The most that an attempt counts in its provider's record: what the work costs, or what a newcomer
        counts for where the declaration has no price."""
        return self.price_iec or DEFAULT_PRICE_IEC

    @property
    def by_people(self) -> bool:
        """Whether a proof is a person's statement, which an auditor judges."""
        return not self.checks

    @property
    def records(self) -> tuple[Topic, ...]:
        """Topics that a robot records in its proof unchanged, besides statements."""
        return tuple(one.topic for one in self.recorded if one.topic.recorded and not one.signed_by)

    @property
    def schema(self) -> dict[str, Any]:
        """JSON Schema of the parameters."""
        return self.params.model_json_schema() if self.params else dict(self.parameters)

    def wrong_fields(self, params: Mapping[str, Any]) -> dict[str, str]:
        """Field -> why it does not fit the schema."""
        if self.params is None:
            return {
                ".".join(map(str, error.instance_path)) or "params": error.message
                for error in jsonschema_rs.validator_for(self.schema).iter_errors(dict(params))
            }
        try:
            self.params.model_validate(params)
        except ValidationError as error:
            return wrong_fields(error.errors(), self.params.model_fields)
        return {}

    def wrong_params(self, site: Site, params: Mapping[str, Any]) -> dict[str, str]:
        """Field -> how to correct it, checked against the schema and the site."""
        return self.problems(site, params) or self.wrong_fields(params)

    def validate(self, params: Mapping[str, Any]) -> None:
        """Raises InvalidRequest, which names each wrong field."""
        if wrong := self.wrong_fields(params):
            raise InvalidRequest("the parameters do not fit this kind", kind=self.name, fields=wrong)

    def load_behaviour(self) -> Any:
        """The behaviour of an executor, or None."""
        return _attribute(self, self.behaviour)

    def models(self) -> list[str]:
        """Hashes of the networks whose word counts: of the one that the checks ask, and of others listed.

        Raises KindError where some are listed and the checks ask none, or cannot be imported, or where the
        files of the one that they ask cannot be read.
        """
        checks = self.load_checks()
        if checks is not None and checks.model_sha256 is not None:
            try:
                asked = checks.model_sha256()
            except RodeoError as error:
                raise KindError(
                    "the network that its checks ask cannot be read", kind=self.name, reason=str(error)
                ) from error
            return sorted({asked, *self.models_sha256})
        if self.models_sha256:
            raise KindError("its checks ask no network: remove models_sha256", kind=self.name)
        return []

    def load_checks(self) -> Any:
        """The checks of a proof, or None."""
        return _attribute(self, self.checks)

    def load_harness(self) -> Any:
        """Its honest runs and its forgeries, or None."""
        return _attribute(self, self.harness)


def _attribute(kind: Kind, where: str) -> Any:
    if not where:
        return None
    module, _, name = where.partition(":")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise KindError(
            "cannot import this part of the kind", kind=kind.name, part=where, reason=str(error)
        ) from error


class Kinds(Mapping[str, Kind]):
    """The kinds that a site lists, by name."""

    def __init__(self, site: Site, kinds: Mapping[str, Kind]) -> None:
        self._site = site
        self._kinds = dict(kinds)

    def __getitem__(self, name: str) -> Kind:
        return self._kinds[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._kinds)

    def __len__(self) -> int:
        return len(self._kinds)

    def by_people(self, name: str) -> bool:
        """Whether people do and judge this kind. A kind that the site does not list has no checks here."""
        return name not in self or self[name].by_people

    def completed(self, name: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """The parameters with the values that follow from them at this site. Raises InvalidRequest."""
        return self[name].complete(self._site, params) if name in self else dict(params)

    def providing(self, what: Literal["energy"]) -> Kind | None:
        """The kind that provides it, if the site lists one."""
        return next((kind for kind in self.values() if kind.provides == what), None)


def kinds_of(site: Site) -> Kinds:
    """The kinds that the site file lists. Raises KindError, also for a kind for which the site has no bin or
    dock, and for rates by which a charge could cost more than is paid for it."""
    kinds = {one.name: declared(one) for one in site.kinds}
    for kind in kinds.values():
        if missing := kind.lacks(site):
            raise KindError(
                f"work of this kind needs what the site lacks: write [[{missing}]]", kind=kind.name
            )
        if kind.provides == "energy" and (most_iec := costliest_iec(kind.rates, site)) > kind.price_iec:
            raise KindError(
                "by its rates a full charge costs more than a task pays at most: raise price_iec",
                kind=kind.name,
                full_charge_iec=f"{most_iec:f}",
                price_iec=f"{kind.price_iec:f}",
            )
    return Kinds(site, kinds)


def providing_energy(site: Site) -> Kind:
    """The kind of work with which a robot buys energy. Raises KindError where the site lists none."""
    kind = kinds_of(site).providing("energy")
    if kind is None:
        listed = [one.name for one in site.kinds]
        raise KindError("no kind that the site lists provides energy", listed=listed)
    return kind


@cache
def installed() -> dict[str, EntryPoint]:
    """Every kind that was installed when this was asked first, by name; none is imported."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


@cache
def load(name: str) -> Kind:
    """The declaration of an installed kind. Raises KindError."""
    point = installed().get(name)
    if point is None:
        raise KindError(NOT_INSTALLED, kind=name, installed=sorted(installed()))
    try:
        kind = point.load()
    except (ImportError, AttributeError) as error:
        raise KindError(
            "the kind cannot be imported", kind=name, where=point.value, reason=str(error)
        ) from error
    if not isinstance(kind, Kind) or kind.name != name:
        raise KindError("the entry point is not a Kind of this name", kind=name, where=point.value)
    return kind


def declared(config: KindConfig) -> Kind:
    """The declaration of the package or of the table, with the site file's overrides. Raises KindError."""
    if config.judge is None:
        kind = load(config.name)
    else:
        title = config.title or config.name.replace("_", " ").capitalize()
        kind = Kind(
            config.name,
            title,
            config.description,
            config.judge,
            parameters=config.parameters,
            min_window_s=PEOPLES_MIN_WINDOW_S,
        )
    said: dict[str, Any] = {
        "price_iec": config.price_iec,
        "execution_window_s": config.execution_window_s,
        "min_window_s": config.min_window_s,
        "max_window_s": config.max_window_s,
        "grace_s": config.grace_s,
        "models_sha256": tuple(config.models_sha256) or None,
        "rates": tuple(config.rates) or None,
    }
    kind = replace(kind, **{name: value for name, value in said.items() if value is not None})
    if config.grace_s and config.grace_s > kind.grace_period_s:
        raise KindError(
            "a grace period is at most half of the shortest execution window",
            kind=kind.name,
            grace_s=config.grace_s,
            max_s=kind.grace_period_s,
        )
    return kind


def fields(kind: Kind, form: str) -> list[str]:
    """The names of the kind's parameters of this format."""
    return [name for name, one in kind.schema.get("properties", {}).items() if one.get("format") == form]


def choose(what: str, known: Sequence[str]) -> str:
    """What to do about a choice that the site does not have."""
    return f"choose one of this site: {', '.join(known)}" if known else f"this site has no {what}"


def with_place(site: Site, params: Mapping[str, Any]) -> dict[str, Any]:
    """A `Kind.complete`: adds `x_m` and `y_m` of the site's place that `place` names, if any."""
    pose = _place(site, params)
    return dict(params) if pose is None else {"x_m": pose.x_m, "y_m": pose.y_m, **params}


def place_problems(site: Site, params: Mapping[str, Any]) -> dict[str, str]:
    """A `Kind.problems`: a `place` that the site does not have, or that is elsewhere than `x_m` and `y_m`."""
    known = [one.name for one in site.places]
    if params.get("place") not in (None, *known):
        return {"place": choose("place", known)}
    pose = _place(site, params)
    if pose is None or (params.get("x_m", pose.x_m), params.get("y_m", pose.y_m)) == (pose.x_m, pose.y_m):
        return {}
    return {"place": f"{params['place']} is at x {pose.x_m:g} y {pose.y_m:g}: leave out x_m and y_m"}


def _place(site: Site, params: Mapping[str, Any]) -> Pose2 | None:
    return next((one.pose for one in site.places if one.name == params.get("place")), None)


def is_number(value: object) -> bool:
    """Whether it is a finite number and not a bool."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
