"""What the robot asks for its work now: its pricing, fed with its measurements, and rarely changed."""

from __future__ import annotations

import logging
from collections import defaultdict
from decimal import Decimal
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.charging.tariff import hourly_mean_iec
from rodeo.errors import DiskFull
from rodeo.host.clock import Clock
from rodeo.host.files import replace_file
from rodeo.kinds import Kind, providing_energy
from rodeo.lab.config import RobotConfig
from rodeo.money.pricing import CostPlus, Experience, Fixed, Learned, Moving, Situation
from rodeo.site.config import Site
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.upkeep import Upkeep

log = logging.getLogger(__name__)

_PAGE = 100
"""Tasks that `Participant.tasks` returns at most."""


class Period(BaseModel):
    """Site times between which the service was on offer, or at work, at one price."""

    model_config = ConfigDict(extra="forbid")

    price_iec: Decimal
    begin_s: float
    end_s: float
    open: bool = True
    """Whether it continues."""


class Asked(BaseModel):
    """What is remembered of one kind."""

    model_config = ConfigDict(extra="forbid")

    changed_s: float = 0.0
    periods: list[Period] = []


class _Kept(BaseModel):
    model_config = ConfigDict(extra="forbid")

    genesis_hash: str = ""
    kinds: dict[str, Asked] = {}


class Prices:
    """One thread. A file that is lost or damaged costs experience and nothing else."""

    def __init__(
        self,
        site: Site,
        robot: RobotConfig,
        dao: RobotParticipant,
        upkeep: Upkeep,
        clock: Clock,
        folder: Path,
    ) -> None:
        self._site = site
        self._robot = robot
        self._dao = dao
        self._upkeep = upkeep
        self._clock = clock
        self._energy = providing_energy(site)
        self._path = folder / "prices.json"
        self._kept = _load(self._path)

    def asked(self, kind: Kind) -> Decimal:
        """The price to offer now. Raises what `Participant.tasks` raises."""
        pricing = self._robot.pricing.of(kind.name)
        if isinstance(pricing, Fixed):
            return pricing.price(Situation(list_iec=kind.price_iec))
        now_s, known = self._clock.now_s(), self._known(kind.name)
        if known.periods and known.periods[-1].open:
            known.periods[-1].end_s = now_s
        offered = known.periods[-1].price_iec if known.periods else None
        price = offered
        if offered is None or now_s - known.changed_s >= pricing.min_update_s:
            wanted = pricing.price(self._situation(kind, pricing, known))
            if offered is None or pricing.is_worth(wanted, offered):
                log.info("%s costs %s IEC from now on", kind.name, wanted)
                known.changed_s, price = now_s, wanted
        assert price is not None
        if price != offered or not known.periods[-1].open:
            known.periods.append(Period(price_iec=price, begin_s=now_s, end_s=now_s))
            memory_s = 3600 * pricing.memory_h if isinstance(pricing, Learned) else 0.0
            known.periods = [one for one in known.periods if one.end_s >= now_s - memory_s]
            self._save()
        return price

    def withdrawn(self, kind: str) -> None:
        """The service is paused, or will be at once."""
        known = self._kept.kinds.get(kind)
        if known is not None and known.periods and known.periods[-1].open:
            known.periods[-1].open, known.periods[-1].end_s = False, self._clock.now_s()
            self._save()

    def _known(self, kind: str) -> Asked:
        """What is remembered, of this chain: experience from another one has no tasks here."""
        genesis = self._dao.ask(queries.CHAIN).genesis_hash
        if self._kept.genesis_hash != genesis:
            self._kept = _Kept(genesis_hash=genesis)
        return self._kept.kinds.setdefault(kind, Asked())

    def _situation(self, kind: Kind, pricing: Moving, known: Asked) -> Situation:
        energy_wh, way_km = self._upkeep.measured(kind.name) or (None, 0.0)
        care = sum(float(one.reward_iec) / one.every_km for one in self._site.agent.maintenance)
        return Situation(
            list_iec=kind.price_iec,
            energy_wh=energy_wh,
            way_km=way_km,
            iec_per_wh=self._iec_per_wh() if isinstance(pricing, CostPlus) else 0.0,
            care_iec_per_km=care,
            history=self._history(kind.name, pricing, known) if isinstance(pricing, Learned) else {},
        )

    def _iec_per_wh(self) -> float:
        """What the energy that it bought last cost; before, what a usual charge would cost. With rates, the
        day's mean."""
        if self._energy.rates:
            return float(hourly_mean_iec(self._energy.rates)) / 1000
        bought = self._dao.tasks(kind=self._energy.name, creator=self._dao.name, state="settled")
        paid = [one for one in bought if float(one.params.get("energy_wh", 0)) > 0 and one.paid_iec > 0]
        if paid:
            return float(paid[0].reward_iec) / float(paid[0].params["energy_wh"])
        agent, battery = self._site.agent, self._robot.battery
        usual_wh = max(agent.charge_target - agent.charge_below, 0.1) * battery.capacity_wh
        return float(self._energy.price_iec) / usual_wh

    def _history(self, kind: str, pricing: Learned, known: Asked) -> dict[Decimal, Experience]:
        done = self._dao.tasks(kind=kind, executor=self._dao.name, state="settled")
        since_s = self._clock.now_s() - 3600 * pricing.memory_h
        if len(done) == _PAGE:
            since_s = max(since_s, done[-1].registered)
        return experience(known.periods, done, since_s)

    def _save(self) -> None:
        try:
            replace_file(self._path, self._kept.model_dump_json())
        except DiskFull as error:
            log.warning("cannot save the prices yet: %s", error)


def experience(periods: list[Period], done: list[Task], since_s: float) -> dict[Decimal, Experience]:
    """Price -> for how long it was asked since `since_s`, and what it earned."""
    offered_s: defaultdict[Decimal, float] = defaultdict(float)
    paid_iec: defaultdict[Decimal, Decimal] = defaultdict(Decimal)
    for one in periods:
        offered_s[one.price_iec] += max(0.0, one.end_s - max(one.begin_s, since_s))
    for task in done:
        if task.price_iec is not None and (task.settled or 0.0) >= since_s:
            paid_iec[task.price_iec] += task.paid_iec
    return {price: Experience(offered_s[price], paid_iec[price]) for price in {*offered_s, *paid_iec}}


def _load(path: Path) -> _Kept:
    try:
        return _Kept.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return _Kept()
    except (OSError, ValidationError) as error:
        log.warning("starting without the earlier prices: %s", error)
        return _Kept()
