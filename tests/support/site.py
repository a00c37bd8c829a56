"""Sites for tests: a site file on free ports, and its real processes started, killed and restarted."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import ClassVar, Self

from rodeo.bus.messages import Status
from rodeo.bus.session import Bus
from rodeo.errors import BusError
from rodeo.host.instance import PARENT_VARIABLE
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.processes import processes_of
from rodeo.site.tls import OPERATOR, identity
from rodeo_testing import BINS
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.nursery import Fork, Nursery
from tests.support.snapshot import found, give_wallets, has_snapshot

LAB = Path(__file__).parents[2] / "deploy" / "sites" / "lab.toml"

LAB_PROCESSES = tuple(processes_of(Site.load(LAB)))

NewSite = Callable[..., Path]

_handed_out: set[int] = set()


def free_port() -> int:
    """A port that nobody listens on, and that no other test of this run was given."""
    while True:
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            port = int(listener.getsockname()[1])
        if port not in _handed_out:
            _handed_out.add(port)
            return port


def write_site(folder: Path, chain_backend: str = "eth-tester", extra: str = "") -> Path:
    """The lab on free ports with its data in `folder`; `extra` is TOML (dotted keys first, then tables)."""
    path = folder / "site.toml"
    path.write_text(
        f"""extends = {json.dumps(str(LAB))}
data_dir = {json.dumps(str(folder / "data"))}
chain.url = "http://127.0.0.1:{free_port()}"
chain.backend = "{chain_backend}"
{"" if "[[bins]]" in extra else BINS}
console.port = {free_port()}
{extra}
"""
    )
    return path


REAL = """
clock.source = "wall"
chain.secret_file = "node-key"
bus.router = "tls/192.168.1.10:7447"
[[docks]]
name = "charger"
pose = { x_m = 3.75, y_m = 2.0 }
meter = { source = "modbus", address = "rtu:///dev/ttyUSB0" }
"""


def write_real_site(folder: Path, keys: str) -> Path:
    """A site of real devices on somebody's chain, in a new `folder`; `keys` are dotted ones."""
    folder.mkdir()
    (folder / "node-key").write_text("the provider's key\n")
    path = write_site(folder, "external", keys + REAL)
    url = 'chain.url = "https://node.example/v3/{secret}"'
    path.write_text(re.sub("chain.url = .*", url, path.read_text()))
    return path


def readyz(metrics_url: str) -> tuple[int, str]:
    """HTTP status and text of a process's readiness, which needs no bus."""
    try:
        with urllib.request.urlopen(f"{metrics_url}/readyz", timeout=HANG_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


class RunningSite:
    """A site's processes as children of the test."""

    nursery: ClassVar[Nursery | None] = None
    """Forks the processes; without one each starts from nothing, as it does on a robot."""

    def __init__(self, path: Path, wallets: bool = True) -> None:
        self.path = path
        self.site = Site.load(path)
        self.children: dict[str, subprocess.Popen[bytes] | Fork] = {}
        self._bus: Bus | None = None
        if wallets:
            give_wallets(self.site)

    @property
    def bus(self) -> Bus:
        """A session on the site's router, which must have been started."""
        if self._bus is None:
            shown = identity(self.site, OPERATOR)
            self._bus = Bus.open(self.site.bus.router, timeout_s=HANG_S, identity=shown)
        return self._bus

    def start(self, *names: str, ready: bool = True) -> None:
        """Start processes by name; with `ready`, return when each says that it is."""
        known = {process.name: process for process in processes_of(self.site)}
        for name in names:
            self.children[name] = self.spawn(name, known[name].module, known[name].arguments)
        if ready:
            self.wait_ready(*names)

    def start_founded(self, *others: str, ready: bool = True) -> None:
        """Start the router, the chain with the organization on it, and `others`."""
        names = [name for name in dict.fromkeys(("router", "chain", *others)) if name not in self.children]
        if is_found := has_snapshot(self.site):
            found(self.site)
        self.start(*names, ready=False)
        if not is_found:
            self.deploy_contracts()
        if ready:
            self.wait_ready(*names)

    def deploy_contracts(self) -> None:
        step = self.spawn("contracts", "deploy.contracts")
        assert step.wait(timeout=HANG_S) == 0, self.log("contracts")

    def kill(self, name: str) -> None:
        """SIGKILL: what a power cut leaves behind."""
        child = self.children.pop(name)
        child.kill()
        child.wait()

    def wait_ready(self, *names: str) -> None:
        waiting = set(names)
        done = threading.Event()

        def on_status(_key: str, data: dict[str, object]) -> None:
            status = Status.model_validate(data)
            child = self.children.get(status.process)
            if status.ready and child is not None and status.pid == child.pid:
                waiting.discard(status.process)
                if not waiting:
                    done.set()

        subscriber = self.bus.subscribe_json(topics.STATUS.pattern(org=self.site.org), on_status)
        try:
            assert done.wait(HANG_S), self._whole_story(waiting)
        finally:
            subscriber.undeclare()

    def _whole_story(self, waiting: set[str]) -> str:
        """The processes that are not ready, and the ends of their logs and the simulator's, which may wait
        for one itself."""
        names = sorted(waiting | {"robot_sim"})
        for name in names:
            if isinstance(child := self.children.get(name), Fork):
                child.tell_stacks()
                wait_until(partial(self._told_stacks, name), "no stacks")
        told = [f"{name}:\n{self.log(name, 20_000)}" for name in names]
        return "\n".join([f"not ready: {sorted(waiting)}", *told])

    def _told_stacks(self, name: str) -> bool:
        return "most recent call first" in self.log(name)

    def status(self, name: str) -> Status:
        """What process `name` answers now, as soon as it answers."""
        return self.wait_for_status(name, lambda _status: True)

    def wait_for_status(self, name: str, holds: Callable[[Status], bool]) -> Status:
        """The status of process `name` once this holds for it."""
        key, seen = topics.STATUS.name(org=self.site.org, process=name), list[Status]()

        def reached() -> bool:
            with suppress(BusError):
                seen[:] = [Status.model_validate(self.bus.query(key))]
                return holds(seen[0])
            return False

        wait_until(reached, lambda: f"{name}: {seen}\n{self.log(name)}")
        return seen[0]

    def log(self, name: str, length: int = 4000) -> str:
        """The last `length` characters of what process `name` wrote."""
        path = self.site.data_dir / "logs" / f"{name}.log"
        return path.read_text(errors="replace")[-length:] if path.exists() else "(no log)"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self.stop()

    def stop(self) -> None:
        if self._bus is not None:
            self._bus.close()
            self._bus = None
        for child in reversed(self.children.values()):
            child.send_signal(signal.SIGTERM)
        for name, child in self.children.items():
            try:
                child.wait(timeout=HANG_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
                raise AssertionError(f"{name} did not stop on SIGTERM\n{self.log(name)}") from None
        self.children.clear()

    def spawn(
        self, name: str, module: str, arguments: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes] | Fork:
        """Start a module in a process of its own, whose log is called `name`."""
        logs = self.site.data_dir / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        given = ["--site", str(self.path), *arguments]
        env = {**os.environ, PARENT_VARIABLE: str(os.getpid())}
        with open(logs / f"{name}.log", "ab") as output:
            if self.nursery is not None:
                return self.nursery.start(module, given, output, env)
            return subprocess.Popen(
                [sys.executable, "-m", module, *given],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=env,
            )
