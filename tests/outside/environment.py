"""Machines and networks with the vices of `environment.toml`, and what becomes of a site there."""

from __future__ import annotations

import asyncio
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from datetime import UTC, datetime
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import patch
from zoneinfo import ZoneInfo

import zenoh

from deploy import router
from rodeo.access.errors import NotLoggedIn
from rodeo.bus.session import Bus
from rodeo.chain.node.rpc import Rpc
from rodeo.errors import RodeoError
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.store import Store
from rodeo.evidence.writer import McapWriter
from rodeo.host import clock, http
from rodeo.host.clock import WallClock
from rodeo.lab.schedule import Schedule
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.endpoint import make_socket_folder
from rodeo.site.sections import ConsoleConfig, StoreConfig
from rodeo_testing.assignments import BINDING, ROBOT
from services.bridge.heads import SubscribedHeads
from services.console.guard import Guard, origins_of
from tests.outside.rows import Row

_ROOT = Path(__file__).parents[2]
_SITE = _ROOT / "deploy" / "sites" / "lab.toml"
_HANG_S = 60.0
_CONTENT = b"a proof"
_START_NS = 1_800_000_000 * 10**9


class NotThere(Exception):
    """What had to work did not."""


def outcome(row: Row, folder: Path) -> str:
    """Empty where it works, else what is said."""
    folder.mkdir()
    try:
        DEEDS[row.how](row.given, folder)
    except (NotThere, RodeoError) as error:
        return f"{getattr(error, 'code', 'refused')}: {error}"
    return ""


# -- proxies -------------------------------------------------------------------------------------------


class _Server:
    """Answers JSON-RPC and files, directly or as a proxy, and says which of the two it was asked as."""

    def __init__(self, host: str = "127.0.0.1") -> None:
        self.asked: list[str] = []
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                self.rfile.read(int(self.headers["content-length"]))
                self._answer(b'{"jsonrpc": "2.0", "id": 1, "result": "0x7a69"}')

            def do_GET(self) -> None:
                self._answer(_CONTENT)

            do_HEAD = do_GET  # noqa: N815 - its name

            def do_CONNECT(self) -> None:
                self._answer(b"")

            def _answer(self, body: bytes) -> None:
                server.asked.append(self.path)
                self.send_response(200)
                self.send_header("content-length", str(len(body)))
                self.end_headers()
                if self.command != "HEAD":
                    self.wfile.write(body)

            def log_message(self, *_args: Any) -> None:
                """Quiet."""

        kind = type("", (ThreadingHTTPServer,), {"address_family": socket.AF_INET6 if ":" in host else 2})
        self._server = kind((host, 0), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


def _node(url: str, _folder: Path) -> None:
    Rpc(url, timeout_s=5.0).batch([("eth_chainId", [])])


def _heads(url: str, _folder: Path) -> None:
    # There are no subscriptions; whoever was asked for them is what counts.
    with suppress(RodeoError):
        SubscribedHeads(url.replace("http:", "ws:")).close()


def _store(url: str, folder: Path) -> None:
    site = Site.load(_SITE).model_copy(update={"data_dir": folder, "store": StoreConfig(url=url)})
    store = Store(site)
    digest = sha256(_CONTENT).hexdigest()
    store.fetch(store.uri_of(digest, ".mcap"), "0x" + digest, folder=folder / "fetched")


_CLIENTS = {"node": _node, "heads": _heads, "store": _store}
_VARIABLES = [f"{name}_proxy" for name in ("http", "https", "all", "no")]


def _client(given: dict[str, Any], folder: Path) -> None:
    server, proxy = _Server("::1" if given.get("host") == "[::1]" else "127.0.0.1"), _Server()
    address = f"127.0.0.1:{proxy.port}"
    changed = dict.fromkeys(given["variables"], address if given.get("bare") else f"http://{address}")
    changed |= {"NO_PROXY": given["no_proxy"]} if "no_proxy" in given else {}
    kept = {name: one for name, one in os.environ.items() if name.lower() not in _VARIABLES}
    try:
        with patch.dict(os.environ, kept | changed, clear=True):
            host = given.get("host", "127.0.0.1")
            _CLIENTS[given["client"]](f"http://{host}:{server.port}", folder)
    finally:
        asked = {"server": server.asked, "proxy": proxy.asked}
        server.close()
        proxy.close()
    if not asked.pop(given["by"]):
        raise NotThere(f"{given['by']} was not asked")
    if any(asked.values()):
        raise NotThere(f"{[*asked]} was asked as well")


# -- folders -------------------------------------------------------------------------------------------


def _folder(given: dict[str, Any], folder: Path) -> None:
    folder.chmod(given.get("parent", 0o755))
    bus = folder / "bus"
    if "folder" in given:
        bus.mkdir()
        bus.chmod(given["folder"])
    if given.get("advised"):
        # As coreutils do it: a number of three digits leaves a folder's setgid bit as it is.
        subprocess.run(["chmod", "700", str(bus)], check=True)
    make_socket_folder(f"unixsock-stream/{bus}/router.sock")
    (bus / "router.sock").touch()


# -- the console ---------------------------------------------------------------------------------------


async def _served(scope: Any, _receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b""})


class _Nobody:
    def session(self, _token: str | None, touch: bool = False) -> None:
        raise NotLoggedIn("nobody")


def _console(given: dict[str, Any], _folder: Path) -> None:
    origins = origins_of(ConsoleConfig(origin=given["origin"]), 8088)
    guard = Guard(_served, cast(Any, _Nobody()), origins, lambda _client: None)
    headers = {"host": given.get("host"), "origin": given.get("from")}
    scope = {
        "type": "http",
        "method": given.get("method", "GET"),
        "path": given["path"],
        "query_string": b"",
        "headers": [(name.encode(), one.encode()) for name, one in headers.items() if one],
    }
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(guard(scope, receive, send))
    if sent[0]["status"] != 200:
        raise NotThere(f"answered {sent[0]['status']}: {sent[1].get('body')}")


# -- clocks and addresses ------------------------------------------------------------------------------


def _clock(given: dict[str, Any], _folder: Path) -> None:
    """The machine's clock steps as soon as somebody waits; what it counts meanwhile is nothing."""
    stepped = SimpleNamespace(s=0.0)
    real = clock.time
    faked = SimpleNamespace(
        time=lambda: real.time() + stepped.s,
        time_ns=lambda: real.time_ns() + int(stepped.s * 1e9),
        monotonic=real.monotonic,
    )
    with patch.object(clock, "time", faked), patch.object(clock, "WALL_SLICE_S", 0.05):
        machine = WallClock()
        until_s = machine.now_s() + given["wait_s"]
        waits: list[Callable[[], object]] = [
            lambda: machine.wait_until(until_s),
            lambda: machine.wait_for(lambda: False, until_s=until_s),
        ]
        waiting = [threading.Thread(target=wait, daemon=True) for wait in waits]
        for one in waiting:
            one.start()
        stepped.s = given["step_s"]
        for one in waiting:
            one.join(5.0)
        if any(one.is_alive() for one in waiting):
            raise NotThere("it still waits")


def _listen(given: dict[str, Any], _folder: Path) -> None:
    families = {one: socket.AF_INET6 if ":" in one else socket.AF_INET for one in given["addresses"]}
    real = socket.getaddrinfo

    def resolved(host: Any, port: Any, *more: Any, **named: Any) -> Any:
        if host != "localhost":
            return real(host, port, *more, **named)
        wanted = named.get("family") or (more[0] if more else 0)
        return [
            (family, socket.SOCK_STREAM, 6, "", (one, port, 0, 0)[: 2 if family == socket.AF_INET else 4])
            for one, family in families.items()
            if wanted in (0, family)
        ] or real("", port)

    with patch.object(socket, "getaddrinfo", resolved):
        listener = http.listen("localhost", 0, "a test")
        address = listener.getsockname()[0]
        listener.close()
    if address not in families:
        raise NotThere(f"it listens on {address}")


def _command(given: dict[str, Any], folder: Path) -> None:
    env = {name: one for name, one in os.environ.items() if name not in given.get("unset", ())}
    env |= given.get("set", {}) | {"PYTHONPATH": str(_ROOT)}
    text = _SITE.read_text().replace('data_dir = "', f'data_dir = "{folder}/', 1)
    site = folder / "sité.toml"
    site.write_text(text, encoding="utf-8")
    run = [sys.executable, "-m", "rodeo_cli", "site", "check", str(site)]
    done = subprocess.run(run, env=env, cwd=folder, capture_output=True, timeout=_HANG_S, check=False)
    if done.returncode or b"Traceback" in done.stderr:
        raise NotThere((done.stderr or done.stdout).decode(errors="replace")[-300:])


# -- the bus -------------------------------------------------------------------------------------------


class _Way:
    """The way from a robot to its router, which breaks when the robot gets another address."""

    def __init__(self, port: int) -> None:
        self._port, self._open = port, list[socket.socket]()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._port))
                self._open += [near, far]
                for one, other in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=(one, other), daemon=True).start()

    @staticmethod
    def _pass_on(one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(65536):
                other.sendall(data)
        for end in (one, other):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def breaks(self) -> None:
        for one in self._open:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.close()
        self.breaks()
        for one in self._open:
            one.close()


def _router(endpoint: str) -> zenoh.Session:
    config = zenoh.Config.from_file(str(router.CONFIG))
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def _port(host: str) -> int:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as free:
        free.bind((host, 0))
        return int(free.getsockname()[1])


def _bus(given: dict[str, Any], _folder: Path) -> None:
    """A robot speaks with its site over a router at this address, and may get another one itself."""
    host = given.get("host", "127.0.0.1")
    port = _port(host)
    shown = f"[{host}]" if ":" in host else host
    with closing(_router(f"tcp/{shown}:{port}")), ExitStack() as stack:
        robots = f"tcp/{shown}:{port}"
        if given.get("moves"):
            way = stack.enter_context(closing(_Way(port)))
            robots = f"tcp/127.0.0.1:{way.port}"
        robot, site = (
            stack.enter_context(Bus.open(one, timeout_s=_HANG_S)) for one in (robots, f"tcp/{shown}:{port}")
        )
        heard: dict[str, queue.Queue[Any]] = {"robot": queue.Queue(), "site": queue.Queue()}
        robot.subscribe_json("to/robot", lambda _key, said: heard["robot"].put(said))
        site.subscribe_json("to/site", lambda _key, said: heard["site"].put(said))
        _until_heard(robot, site, heard)
        if given.get("moves"):
            way.breaks()
            _until_heard(robot, site, heard)


def _until_heard(robot: Bus, site: Bus, heard: dict[str, queue.Queue[Any]]) -> None:
    """Both ways, again and again while a connection is made."""
    for bus, to in ((site, "robot"), (robot, "site")):
        while not heard[to].empty():
            heard[to].get()
        for _ in range(round(_HANG_S / 0.1)):
            bus.put_json(f"to/{to}", {"said": True})
            with suppress(queue.Empty):
                heard[to].get(timeout=0.1)
                break
        else:
            raise NotThere(f"the {to} hears nothing")


_LISTENER = """
import sys, threading, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", sys.argv[1])
session = zenoh.open(config)
subscriber = session.declare_subscriber("news", lambda sample: print("heard", flush=True))
print("there", flush=True)
threading.Event().wait()
"""


def _frozen(given: dict[str, Any], folder: Path) -> None:
    """A subscriber on the site's socket is stopped, while others hear what it does not read."""
    folder.chmod(0o700)
    endpoint, wanted = f"unixsock-stream/{folder}/r.sock", given["messages"]
    there, all_heard, numbers = threading.Event(), threading.Event(), list[int]()

    def hear(_key: str, payload: bytes) -> None:
        there.set()
        if (number := int(payload[:8])) < wanted:
            numbers.append(number)
        if len(numbers) == wanted:
            all_heard.set()

    with closing(_router(endpoint)), Bus.open(endpoint) as publisher, Bus.open(endpoint) as other:
        other.subscribe_bytes("news", hear, inline=True)
        command = [sys.executable, "-c", _LISTENER, json.dumps([endpoint])]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as frozen:
            try:
                _hears(publisher, frozen)
                if not there.wait(_HANG_S):
                    raise NotThere("another hears nothing")
                frozen.send_signal(signal.SIGSTOP)
                for number in range(wanted):
                    publisher.put_bytes("news", b"%08d" % number + bytes(given["bytes"]))
                if not all_heard.wait(_HANG_S) or numbers != [*range(wanted)]:
                    raise NotThere(f"{len(numbers)} of {wanted} messages were heard by another")
                frozen.send_signal(signal.SIGCONT)
                _hears(publisher, frozen)
            finally:
                frozen.kill()


def _hears(publisher: Bus, listener: subprocess.Popen[bytes]) -> None:
    """Publish until the listener says that it hears something."""
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.1):
            publisher.put_bytes("news", b"%08d" % 10**7)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        assert listener.stdout is not None
        while b"heard" not in (said := listener.stdout.readline()):
            if not said:
                raise NotThere("the subscriber ended")
    finally:
        ended.set()
        thread.join()


# -- disks and calendars -------------------------------------------------------------------------------


def _disk(given: dict[str, Any], folder: Path) -> None:
    """A robot records, and its disk takes nothing until all has been said."""
    folder.chmod(0o700)
    path, said_all, add = folder / "a.mcap", threading.Event(), McapWriter.add_message

    def slow(writer: McapWriter, *record: Any) -> bytes:
        if threading.current_thread() is not threading.main_thread():
            said_all.wait(_HANG_S)
        return add(writer, *record)

    cdr = types.serialize(types.new(topics.BATTERY_STATE.type))
    with patch.object(McapWriter, "add_message", slow):
        recorder = Recorder(path, BINDING, ROBOT, cast(Any, SimpleNamespace(now_ns=lambda: _START_NS)))
        for number in range(given["messages"]):
            at_ns = _START_NS + number * 20_000_000
            recorder.write_ros("battery", topics.BATTERY_STATE.type, cdr, at_ns, at_ns, number)
        said_all.set()
        sealed = recorder.close()
    if (count := open_proof(sealed.path).count("/battery")) != given["messages"]:
        raise NotThere(f"{count} messages are in the recording")


def _schedule(given: dict[str, Any], _folder: Path) -> None:
    """Working hours on a day on which the clocks change."""
    schedule = Schedule(given["hours"], given["zone"])
    zone = ZoneInfo(given["zone"])
    at_s = datetime.fromisoformat(given["from"]).replace(tzinfo=zone).timestamp()
    changes = list[str]()
    for _ in given["changes"]:
        at_s = schedule.next_change_s(at_s)
        changes.append(f"{datetime.fromtimestamp(at_s, UTC):%dT%H:%M}")
    if changes != given["changes"]:
        raise NotThere(f"the hours begin and end at {changes}")


DEEDS: dict[str, Callable[[dict[str, Any], Path], None]] = {
    "bus": _bus,
    "frozen": _frozen,
    "disk": _disk,
    "schedule": _schedule,
    "client": _client,
    "folder": _folder,
    "console": _console,
    "clock": _clock,
    "listen": _listen,
    "command": _command,
}
