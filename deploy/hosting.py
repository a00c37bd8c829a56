"""A site's processes as something else than the launcher starts them: what units and containers share."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

from rodeo.errors import ConfigError
from rodeo.site import endpoint
from rodeo.site.config import Site, overrides
from rodeo.site.names import bin_process, dock_process
from rodeo.site.processes import ProcessEntry, hosts_of
from rodeo.site.providers import SIMULATOR
from rodeo.site.tls import files, wants_certificates

PASSPHRASE = "passphrase"
NODE_KEY = "node-key"
"""Secrets: what opens the keystores, and the key of the chain's provider."""

NO_KEY = "not-for-this-process"
"""What a process reads as the provider's key that does not ask the node: every process reads a file."""


def load(path: Path) -> Site:
    """The site, as its file alone says it. Raises ConfigError."""
    if given := sorted(overrides()):
        raise ConfigError(
            "what is written starts processes by the site file alone: write there what these variables say",
            variables=given,
        )
    return Site.load(path)


def by_host(site: Site) -> Iterator[tuple[str, list[ProcessEntry]]]:
    """Computers with their processes; the folder of the only one, where the site file names none, is ""."""
    yield from ((f"{host}/" if host else "", entries) for host, entries in hosts_of(site).items())


def words(entry: ProcessEntry, path: Path) -> list[str]:
    """The arguments of Python that start a process."""
    return ["-m", entry.module, "--site", str(path.absolute()), *entry.arguments]


def asks_node(entry: ProcessEntry) -> bool:
    """Whether the process needs the provider's key."""
    return entry.module == "services.bridge"


def default_passphrase(site: Site) -> Path:
    """The file with the passphrase: beside throw-away keys, and away from those that hold money."""
    if site.chain.backend == "external":
        return Path("/etc/rodeo") / f"{site.org}.{PASSPHRASE}"
    return site.data_dir.absolute() / "keys" / PASSPHRASE


def hardware(site: Site, entry: ProcessEntry) -> list[str]:
    """Device files that the process opens: serial lines of meters, cameras of bins."""
    lines: list[str] = []
    for dock in site.docks:
        if dock_process(site, dock.name) == entry.name:
            lines += [dock.meter.address, dock.meter.contactor_address]
    found = [urlsplit(one).path for one in lines if one.startswith("rtu:")]
    for one in site.bins:
        if bin_process(site, one.name) == entry.name and one.camera.source == "video":
            named = one.camera.address
            found.append(f"/dev/video{named}" if named.isdigit() else named)
    return [one for one in dict.fromkeys(found) if one.startswith("/dev/")]


def own_certificates(site: Site, entry: ProcessEntry) -> list[str]:
    """Files of the process's certificate. The list is empty if the bus needs no certificates, and for the
    simulator, which also has certificates of bodies."""
    if not wants_certificates(site) or entry.name == SIMULATOR:
        return []
    own = files(site, entry.name)
    return [str(own.authority), str(own.certificate), str(own.key)]


def written(site: Site) -> list[Path]:
    """Folders that the processes write."""
    found = [site.data_dir.absolute()]
    store = urlsplit(site.store_url)
    if store.scheme == "file" and not Path(unquote(store.path)).is_relative_to(found[0]):
        found.append(Path(unquote(store.path)))
    return found


def read(site: Site, path: Path) -> Iterator[Path]:
    """Files and folders that say what the site is: its file, those that it extends, and what they name."""
    while True:
        yield path
        base = tomllib.loads(path.read_text()).get("extends")
        if base is None:
            break
        path = (path.parent / base).resolve()
    yield from (robot.kinematics for robot in site.robots if robot.kinematics is not None)
    named = [dock.meter.model for dock in site.docks if dock.meter.model.endswith(".toml")]
    named += [one.camera.address for one in site.bins if one.camera.source == "folder"]
    named += [site.mocap.address] if site.mocap.source == "recorded" else []
    yield from map(Path, named)
    # A map names a picture beside it.
    yield from (Path(room.map).parent for room in site.rooms if room.map is not None)


def require_shared_socket(site: Site) -> None:
    """Raises ConfigError where the bus's socket is in a /tmp that each process has for itself."""
    socket = Path(site.bus.router.partition("/")[2])
    if endpoint.is_local(site.bus.router) and not socket.is_relative_to(site.data_dir.absolute()):
        raise ConfigError(
            "the bus's socket must lie in the data folder: shorten data_dir, or set bus.router",
            router=site.bus.router,
            data_dir=str(site.data_dir),
        )
