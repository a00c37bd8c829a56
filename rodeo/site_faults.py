"""What no site can be: things outside their room, and two things under one name, port or hour."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from rodeo.lab.config import Pose2
from rodeo.site_problems import Place, close

if TYPE_CHECKING:
    from rodeo.config import Site

_OWN_WALLETS = ("organization", "oracle")


def faults(site: Site) -> dict[Place, str]:
    """Where -> what is wrong there; empty for a site that can be."""
    found: dict[Place, str] = {}
    for place, text in (*_outside(site), *_names(site), *_wallets(site), *_hours(site), *_ports(site)):
        found.setdefault(place, text)
    return found


def _outside(site: Site) -> Iterator[tuple[Place, str]]:
    length_m, width_m = site.lab.size_m
    for place, name, pose in placed(site):
        if not (0 <= pose.x_m <= length_m and 0 <= pose.y_m <= width_m):
            yield (
                (*place, "pose"),
                f"{name} is outside the room: x_m is {pose.x_m:g} of 0 to {length_m:g}, y_m is {pose.y_m:g} "
                f"of 0 to {width_m:g} (lab.size_m)",
            )


def placed(site: Site) -> Iterator[tuple[Place, str, Pose2]]:
    """Everything that stands or lies in the room: where the file says so, its name, its pose."""
    for number, furniture in enumerate(site.lab.furniture):
        yield ("lab", "furniture", number), furniture.name, furniture.pose
    yield ("bin",), site.bin.name, site.bin.pose
    yield ("dock",), site.dock.name, site.dock.pose
    for number, robot in enumerate(site.robots):
        if robot.body == "sim":
            yield ("robots", number), robot.name, robot.pose
    for number, item in enumerate(site.items):
        yield ("items", number), item.id, item.pose


def _names(site: Site) -> Iterator[tuple[Place, str]]:
    in_lab = [((*place, "id" if place[0] == "items" else "name"), name) for place, name, _ in placed(site)]
    yield from _twice(in_lab, "two things in the lab are called {}")
    signing: list[tuple[Place, str]] = [((), name) for name in _OWN_WALLETS]
    signing += [(("robots", number, "wallet"), robot.wallet) for number, robot in enumerate(site.robots)]
    signing += [(("participants", number, "name"), one.name) for number, one in enumerate(site.participants)]
    yield from _twice(signing, "two participants have the keystore {}")


def _twice(named: Iterable[tuple[Place, str]], text: str) -> Iterator[tuple[Place, str]]:
    seen: set[str] = set()
    for place, name in named:
        if name in seen:
            yield place, text.format(f'"{name}"')
        seen.add(name)


def _wallets(site: Site) -> Iterator[tuple[Place, str]]:
    known = ["organization", "oracle", *(r.name for r in site.robots), *(p.name for p in site.participants)]
    told: list[tuple[Place, str]] = [
        (("bridge", "wallets", number), name) for number, name in enumerate(site.bridge.wallets or ())
    ]
    told += [(("bridge", "limits", name), name) for name in site.bridge.limits]
    for place, name in told:
        if name not in known:
            yield place, f"nobody on this site is called {name}{close(name, known)}"


def _hours(site: Site) -> Iterator[tuple[Place, str]]:
    hours: set[int] = set()
    for number, tariff in enumerate(site.economy.electricity):
        if tariff.from_hour in hours:
            place = ("economy", "electricity", number, "from_hour")
            yield place, f"two prices of electricity begin at hour {tariff.from_hour}"
        hours.add(tariff.from_hour)


def _ports(site: Site) -> Iterator[tuple[Place, str]]:
    listening: list[tuple[Place, str, int]] = [
        (("itrash", "http_port"), site.itrash.http_host, site.itrash.http_port),
        (("console", "port"), site.console.host, site.console.port),
    ]
    ports = site.metrics.ports.items()
    listening += [(("metrics", "ports", process), site.metrics.host, port) for process, port in ports]
    chain = urlsplit(site.chain.url)
    if site.chain.backend != "external" and chain.port:
        listening.insert(0, (("chain", "url"), chain.hostname or "", chain.port))
    seen: dict[tuple[str, int], Place] = {}
    for place, host, port in listening:
        if port and (host, port) in seen:
            first = ".".join(map(str, seen[host, port]))
            yield place, f"port {port} of {host} is that of {first} already"
        seen.setdefault((host, port), place)
