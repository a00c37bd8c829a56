"""What no site can be, and where its file says so."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from decimal import Decimal
from urllib.parse import urlsplit

from pydantic import BaseModel

from rodeo.lab.config import Pose2
from rodeo.money.currency import InvalidAmount
from rodeo.site import minds, processes, ros_names
from rodeo.site.file import SiteFile
from rodeo.site.names import (
    BRIDGE,
    MAX_CASE_S,
    ORACLE,
    bridge_process,
    bridge_wallets,
    min_verdict_window_s,
    oracle_names,
    panel,
    tracked,
    votes_needed,
)
from rodeo.site.sections import (
    MIN_VOTERS,
    AgentConfig,
    ChainConfig,
    ClockConfig,
    FromHour,
    RateConfig,
    interface_fault,
)
from rodeo.text.site_problems import Place, close

_OWN_WALLETS = ("organization", ORACLE)
_SLACK_M = 1e-6


def faults(site: SiteFile) -> dict[Place, str]:
    """Where -> what is wrong there; empty for a site that can be."""
    found: dict[Place, str] = {}
    rules = (
        _outside,
        _rooms,
        _names,
        _wallets,
        _bridges,
        _seen,
        lambda one: minds.faults(one.robots, one.participants, one.clock.speed),
        lambda one: ros_names.faults(one.org, one.ros, one.robots, one.participants, [*one.bins, *one.docks]),
        _interfaces,
        _motion_capture,
        _amounts,
        _governance,
        _oracles,
        _disputes,
        _windows,
        _hours,
        _ports,
        processes.host_faults,
        lambda one: _charging_and_care(one.agent, [kind.name for kind in one.kinds]),
        lambda one: _time(one.chain, one.clock),
    )
    for place, text in (one for rule in rules for one in rule(site)):
        found.setdefault(place, text)
    return found


def _outside(site: SiteFile) -> Iterator[tuple[Place, str]]:
    length_m, width_m = site.lab.size_m
    for place, name, pose in placed(site):
        if not (0 <= pose.x_m <= length_m and 0 <= pose.y_m <= width_m):
            yield (
                (*place, "pose"),
                f"{name} is outside the room: x_m is {pose.x_m:g} of 0 to {length_m:g}, y_m is {pose.y_m:g} "
                f"of 0 to {width_m:g} (lab.size_m)",
            )


def _rooms(site: SiteFile) -> Iterator[tuple[Place, str]]:
    length_m, width_m = site.lab.size_m
    for number, room in enumerate(site.rooms):
        if room.corner_m is None or room.size_m is None:
            continue
        (west, south), (x_m, y_m) = room.corner_m, room.size_m
        if west < 0 or south < 0 or west + x_m > length_m + _SLACK_M or south + y_m > width_m + _SLACK_M:
            yield (
                ("rooms", number),
                f"{room.name} reaches out of the lab, which is {length_m:g} m by {width_m:g} m (lab.size_m)",
            )
    named = [(("rooms", number, "name"), room.name) for number, room in enumerate(site.rooms)]
    yield from _twice(named, "two rooms are called {}")


_LYING = ("items", "things")
"""Tables of what lies in the lab."""


def placed(site: SiteFile) -> Iterator[tuple[Place, str, Pose2]]:
    """Everything that stands, lies or has a name in the room: where the file says so, its name, its pose."""
    for number, furniture in enumerate(site.lab.furniture):
        yield ("lab", "furniture", number), furniture.name, furniture.pose
    for number, bin_ in enumerate(site.bins):
        yield ("bins", number), bin_.name, bin_.pose
    for number, dock in enumerate(site.docks):
        yield ("docks", number), dock.name, dock.pose
    for number, place in enumerate(site.places):
        yield ("places", number), place.name, place.pose
    for number, robot in enumerate(site.robots):
        if robot.body == "sim":
            yield ("robots", number), robot.name, robot.pose
    for table in _LYING:
        for number, item in enumerate(getattr(site, table)):
            yield (table, number), item.id, item.pose


def _names(site: SiteFile) -> Iterator[tuple[Place, str]]:
    for field in ("name", "namespace"):
        robots = [(("robots", number, field), getattr(one, field)) for number, one in enumerate(site.robots)]
        if twice := list(_twice(robots, f"two robots have the same {field}, {{}}")):
            yield from twice
            break  # a namespace follows from the name
    in_lab = [((*place, "id" if place[0] in _LYING else "name"), name) for place, name, _ in placed(site)]
    yield from _twice(in_lab, "two things in the lab are called {}")
    signing: list[tuple[Place, str]] = [((), name) for name in _OWN_WALLETS]
    signing += [(("robots", number, "wallet"), robot.wallet) for number, robot in enumerate(site.robots)]
    signing += [(("oracles", number, "name"), one.name) for number, one in enumerate(site.oracles)]
    signing += [(("participants", number, "name"), one.name) for number, one in enumerate(site.participants)]
    yield from _twice(signing, "two participants have the keystore {}")


def _twice(named: Iterable[tuple[Place, str]], text: str) -> Iterator[tuple[Place, str]]:
    seen: set[str] = set()
    for place, name in named:
        if name in seen:
            yield place, text.format(f'"{name}"')
        seen.add(name)


def _wallets(site: SiteFile) -> Iterator[tuple[Place, str]]:
    others = [*(r.name for r in site.robots), *(p.name for p in site.participants)]
    known = ["organization", *oracle_names(site), *others]
    told: list[tuple[Place, str]] = [
        (("bridges", number, "wallets", entry), name)
        for number, one in enumerate(site.bridges)
        for entry, name in enumerate(one.wallets or ())
    ]
    told += [
        (("bridge", "shared_wallets", number), name) for number, name in enumerate(site.bridge.shared_wallets)
    ]
    told += [(("bridge", "limits", name), name) for name in site.bridge.limits]
    if site.governance.guardian is not None:
        told.append((("governance", "guardian"), site.governance.guardian))
    elsewhere = {one.name for one in site.participants if one.address is not None}
    for name, limits in site.bridge.limits.items():
        if name in elsewhere and (limits.daily_iec, limits.daily_fee_eth) != (None, None):
            yield ("bridge", "limits", name), f"{name} signs for itself, so no bridge limits what it spends"
    for place, name in told:
        if name not in known:
            yield place, f"nobody on this site is called {name}{close(name, known)}"


def _bridges(site: SiteFile) -> Iterator[tuple[Place, str]]:
    names: list[tuple[Place, str]] = [((), BRIDGE)]
    names += [(("bridges", number, "name"), one.name) for number, one in enumerate(site.bridges)]
    yield from _twice(names, "two bridges are called {}")
    holders: dict[str, str] = {}
    for number, one in enumerate(site.bridges):
        place: Place = ("bridges", number, *(() if one.wallets is None else ("wallets",)))
        managed = bridge_wallets(site)[bridge_process(site, one.name)]
        for name in managed:
            if name in holders:
                yield place, f"{holders[name]} manages the wallet of {name}: list the wallets of each"
            holders.setdefault(name, one.name)
        if not site.oracles and {"organization", ORACLE} <= set(managed):
            yield place, ONE_HOST.format(one.name)


def _seen(site: SiteFile) -> Iterator[tuple[Place, str]]:
    """A wallet that posts what robots see is here, no robot's, and has a limit for a day."""
    doing = {one.name: one.kinds or () for one in site.participants if one.address is None}
    for number, kind in enumerate(site.kinds):
        if (name := kind.post_seen_as) is None:
            continue
        place: Place = ("kinds", number, "post_seen_as")
        if name not in ("organization", *doing) or name not in bridge_wallets(site)[BRIDGE]:
            yield place, f"the site's own bridge has no wallet of a participant {name}, who is no robot"
        elif kind.name in doing.get(name, ()):
            yield place, f"{name} does {kind.name} itself: nobody pays himself for what he found"
        elif (limits := site.bridge.limits.get(name)) is None or limits.daily_iec is None:
            yield place, f"robots would spend all that {name} has: set bridge.limits.{name}.daily_iec"


ONE_HOST = (
    "the wallets of the organization and of its oracle are both on {}: whoever takes over that computer can "
    "post tasks and accept their proofs; give them to different [[bridges]]"
)
"""What is wrong, or doubtful, with a site that has several bridges."""


def _interfaces(site: SiteFile) -> Iterator[tuple[Place, str]]:
    for number, robot in enumerate(site.robots):
        if why := interface_fault(robot):
            yield ("robots", number, "interface"), why


def _motion_capture(site: SiteFile) -> Iterator[tuple[Place, str]]:
    wanted = site.mocap
    if wanted.latency_s and (wanted.source or site.clock.source) == "sim":
        yield ("mocap", "latency_s"), "simulated motion capture is never late: remove it"
    if wanted.source is not None and not site.lab.mocap:
        yield ("mocap", "source"), "lab.mocap = false says that there is none: remove one of the two"
    others = [site.org, *(one.name for one in site.bins), *(one.name for one in site.docks)]
    if wanted.source == "ros2" and (why := ros_names.driver_fault(wanted.address, site.robots, others)):
        yield ("mocap", "address"), why
    known, told = tracked(site), list(wanted.bodies.values())
    for name, there in wanted.bodies.items():
        place: Place = ("mocap", "bodies", name)
        if name not in known:
            yield place, f"motion capture follows nothing called {name}{close(name, known)}"
        elif told.count(there) > 1:
            yield place, f'two bodies are called "{there}" there'


def _amounts(site: SiteFile) -> Iterator[tuple[Place, str]]:
    currency = site.economy.currency
    for place, amount in _amounts_in(site, ()):
        try:
            currency.to_units(amount)
        except InvalidAmount as error:
            yield place, f"{error.message}: {amount} IEC"


def _amounts_in(part: object, place: Place) -> Iterator[tuple[Place, Decimal]]:
    """Where an amount is, and which. Rates may be finer than the token: what is paid by them is rounded."""
    entries: Iterable[tuple[str | int, object]] = ()
    match part:
        case RateConfig():
            return
        case BaseModel():
            entries = part
        case dict():
            entries = part.items()
        case list() | tuple():
            entries = enumerate(part)
    for name, value in entries:
        if isinstance(value, Decimal):
            if name == "iec" or str(name).endswith("_iec"):
                yield (*place, name), value
        else:
            yield from _amounts_in(value, (*place, name))


def _governance(site: SiteFile) -> Iterator[tuple[Place, str]]:
    governance = site.governance
    known = [*(r.name for r in site.robots), *(p.name for p in site.participants)]
    for number, name in enumerate(governance.members):
        if name not in known:
            why = f"nobody on this site is called {name}{close(name, known)}"
            yield ("governance", "members", number), why
    if governance.kind == "administrator" and governance.members:
        yield (
            ("governance", "members"),
            'members decide only with kind = "vote": set it, or leave members out',
        )
    if governance.kind == "vote" and len(set(governance.members)) < MIN_VOTERS:
        yield (
            ("governance", "members"),
            f"{len(set(governance.members))} members cannot decide by vote: name at least {MIN_VOTERS}",
        )
    if governance.kind == "vote" and not governance.delay_s:
        yield ("governance", "delay_s"), "decisions by vote take effect after a delay: set more than 0"


def _oracles(site: SiteFile) -> Iterator[tuple[Place, str]]:
    parties = [*(r.name for r in site.robots), *(p.name for p in site.participants)]
    for number, one in enumerate(site.oracles):
        if one.owner is not None and one.owner not in parties:
            place = ("oracles", number, "owner")
            yield place, f"nobody on this site is called {one.owner}{close(one.owner, parties)}"
    listed = len(site.oracles)
    if listed == 1:
        yield ("oracles",), "one oracle needs no [[oracles]]: leave the table out, or name at least two"
    if not 1 <= panel(site) <= listed and (site.oracles or site.oracle.panel is not None):
        yield ("oracle", "panel"), f"the panel has {panel(site)} places, and [[oracles]] lists {listed}"
    for number, kind in enumerate(site.kinds):
        if kind.votes is not None and not panel(site) < 2 * kind.votes <= 2 * panel(site):
            yield (
                ("kinds", number, "votes"),
                f"{kind.votes} votes are not more than half of a panel of {panel(site)} oracles, or are more "
                "than all of them",
            )


def _disputes(site: SiteFile) -> Iterator[tuple[Place, str]]:
    wanted = site.disputes
    if wanted is None:
        return
    if not site.oracles:
        yield ("disputes",), "verdicts of one oracle cannot be challenged: name several [[oracles]]"
    known = [*(r.name for r in site.robots), *(p.name for p in site.participants)]
    votes = max((votes_needed(site, one.name) for one in site.kinds), default=votes_needed(site, ""))
    place: Place = ("disputes",)
    said, who = votes if site.oracles else 0, "oracles"
    for one in wanted.instances:
        for number, name in enumerate(one.judges):
            if name not in known:
                yield (*place, "judges", number), f"nobody on this site is called {name}{close(name, known)}"
        listed = len(set(one.judges))
        if not listed < 2 * one.votes <= 2 * listed:
            yield (
                (*place, "votes"),
                f"{one.votes} votes are not more than half of {listed} judges, or are more than all of them",
            )
        if one.votes <= said:
            yield (*place, "votes"), f"a verdict of {said} {who} is overturned by more than {said} judges"
        said, who, place = one.votes, "judges", (*place, "appeal")
    if (appeal := wanted.appeal) is not None:
        for number, name in enumerate(appeal.judges):
            if name in wanted.judges:
                yield ("disputes", "appeal", "judges", number), f"{name} would decide about its own decision"
        if appeal.stake_iec <= wanted.stake_iec:
            yield (
                ("disputes", "appeal", "stake_iec"),
                f"an appeal takes more than the challenge before it: more than {wanted.stake_iec} IEC",
            )


def _windows(site: SiteFile) -> Iterator[tuple[Place, str]]:
    """What the judges of the contracts want of verdict and audit window."""
    economy, needed_s = site.economy, min_verdict_window_s(site)
    case_s = economy.verdict_window_s + economy.audit_window_s
    if economy.verdict_window_s < needed_s:
        why = "the oracles' time, and all windows of [disputes]" if site.disputes else "judges take no less"
        yield ("economy", "verdict_window_s"), f"a verdict window has to be at least {needed_s} s: {why}"
    elif case_s > MAX_CASE_S:
        yield (
            ("economy", "audit_window_s"),
            f"verdict and audit window are {case_s} s together, and no judge takes a case of more than "
            f"{MAX_CASE_S} s ({MAX_CASE_S // 86_400} days): lower one of them",
        )


def _hours(site: SiteFile) -> Iterator[tuple[Place, str]]:
    lists: list[tuple[Place, str, Sequence[FromHour]]] = [
        (("economy", "electricity"), "electricity tariffs", site.economy.electricity)
    ]
    lists += [(("kinds", number, "rates"), "rates", kind.rates) for number, kind in enumerate(site.kinds)]
    for place, what, entries in lists:
        hours: set[int] = set()
        for number, one in enumerate(entries):
            if one.from_hour in hours:
                yield (*place, number, "from_hour"), f"two {what} begin at hour {one.from_hour}"
            hours.add(one.from_hour)


def _charging_and_care(agent: AgentConfig, listed: list[str]) -> Iterator[tuple[Place, str]]:
    if agent.charge_target <= agent.charge_below:
        yield (
            ("agent", "charge_target"),
            f"a robot that charges below {agent.charge_below:g} (charge_below) charges up to more",
        )
    for number, care in enumerate(agent.maintenance):
        place = "agent", "maintenance", number
        if care.kind not in listed:
            write = f'. Write: [[kinds]] name = "{care.kind}", judge = "auditor"'
            yield (*place, "kind"), f"no [[kinds]] lists {care.kind}{close(care.kind, listed) or write}"
        if care.rise is not None and care.rise.up_to_iec < care.reward_iec:
            text = f"the reward, {care.reward_iec} IEC, cannot rise to {care.rise.up_to_iec} IEC: write more"
            yield (*place, "rise"), text


def _time(chain: ChainConfig, clock: ClockConfig) -> Iterator[tuple[Place, str]]:
    if chain.backend == "external" and not clock.keeps_wall_time:
        yield (
            ("clock", "idle_speed" if clock.speed == 1 else "speed"),
            "an external chain runs on wall time: set clock.speed and clock.idle_speed to 1",
        )


def _ports(site: SiteFile) -> Iterator[tuple[Place, str]]:
    listening: list[tuple[Place, str, int]] = [
        (("bins", number, "http_port"), one.http_host, one.http_port) for number, one in enumerate(site.bins)
    ]
    listening.append((("console", "port"), site.console.host, site.console.port))
    ports = site.metrics.ports.items()
    listening += [(("metrics", "ports", process), site.metrics.host, port) for process, port in ports]
    chain = urlsplit(site.chain.url)
    if site.chain.backend != "external" and chain.port:
        listening.insert(0, (("chain", "url"), chain.hostname or "", chain.port))
    seen: dict[tuple[str, int], Place] = {}
    for place, host, port in listening:
        if port and (host, port) in seen:
            first = ".".join(map(str, seen[host, port]))
            yield place, f"port {port} of {host} is already used by {first}"
        seen.setdefault((host, port), place)
