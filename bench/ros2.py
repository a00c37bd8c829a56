"""What the organization costs over ROS 2 (`services.ros_dao`), beside the same on the plain bus.

`ros2_command_ratio_p50`: time of a payment up to the hash of its transaction, over that of the same command
sent to the bridge; the median of both, in turns.
`ros2_query_ratio_p50`: the same of three questions in turns: an account, a task, and a page of 20 tasks.
`ros2_event_ms_p99`: from an event on the plain bus to the topic at a node, at EVENTS_S events a second.
`ros2_events_lost`, `ros2_events_doubled`: of EVENTS, at a node that is cut off for CUT_S in the middle.
`ros2_cpu_share_idle`, `ros2_cpu_share_events`: cores of the process with ten participants, without events and
at EVENTS_S a second. The events and what is listed come from a stand-in for the bridge.
"""

from __future__ import annotations

import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from bench.cpu import cpu_s
from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus
from rodeo.commands.treasury import Transfer
from rodeo.dao import Participant
from rodeo.errors import RodeoError
from rodeo.host.clock import WallClock
from rodeo.interfaces.package import register
from rodeo.ros2 import types, wire
from rodeo.ros2.node import Node
from rodeo.ros2.service import Client
from rodeo.site import topics
from rodeo_testing import answers
from tests.support.dao import Dao
from tests.support.site import RunningSite, write_site

COMMANDS, QUERIES, TASKS = 100, 300, 40
EVENTS, EVENTS_S, CUT_S = 10_000, 250, 10.0
IDLE_S = 10.0
NAMES = ("panther1", *(f"anna-{number}" for number in range(9)))
SITE = f"ros = [{{ owner = 'all', participants = {list(NAMES)} }}]\n" + "".join(
    f'[[participants]]\nname = "{name}"\n' for name in NAMES[1:]
)
PREFIX = "lab/panther1"
CHAIN = "0x01"


def run() -> dict[str, float | None]:
    """Measure on sites of its own, on free ports, in folders that are removed."""
    register()
    return _ratios() | _events()


@contextmanager
def _site() -> Iterator[RunningSite]:
    with (
        tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder,
        RunningSite(write_site(Path(folder), extra=SITE)) as running,
    ):
        yield running


def _node(bus: Bus, name: str) -> Node:
    return Node(bus.session, name, "", 0, WallClock())


def _client(node: Node, service: str) -> Client:
    typename = "rodeo_msgs/srv/" + "".join(word.capitalize() for word in service.split("_"))
    client = node.client(f"{PREFIX}/{service}", typename)
    if not client.wait_for_server(60.0):
        raise RuntimeError(f"no {service}")
    return client


def _ratios() -> dict[str, float]:
    with _site() as running:
        dao = Dao(running)
        dao.start()
        running.start("ros_dao")
        for _ in range(TASKS):
            dao.post("1", allow_wait=True)
        node, plain = _node(running.bus, "bench"), Participant(running.bus, running.site.org, "panther1")
        pay, wallet = _client(node, "transfer"), _client(node, "get_wallet")
        task, page = _client(node, "get_task"), _client(node, "get_tasks")

        def asked(client: Client, service: str, **fields: Any) -> None:
            answer = client.call(types.new(f"rodeo_msgs/srv/{service}_Request", **fields), 60.0)
            if answer.problem:
                raise RuntimeError(str(answer.problem[0]))

        command = _ratio(
            COMMANDS,
            [
                (
                    lambda: plain.command("transfer", Transfer(to="anna-1", amount_iec=Decimal("0.01"))),
                    lambda: asked(pay, "Transfer", to="anna-1", amount_iec="0.01"),
                )
            ],
        )
        query = _ratio(
            QUERIES // 3,
            [
                (
                    lambda: plain.ask(queries.WALLET, account="panther1"),
                    lambda: asked(wallet, "GetWallet", account=["panther1"]),
                ),
                (lambda: plain.ask(queries.TASK, id=1), lambda: asked(task, "GetTask", id=1)),
                (
                    lambda: plain.ask(queries.TASKS, limit=20),
                    lambda: asked(page, "GetTasks", limit=np.array([20])),
                ),
            ],
        )
        node.close()
        dao.close()
        return {"ros2_command_ratio_p50": command, "ros2_query_ratio_p50": query}


def _ratio(times: int, pairs: list[tuple[Callable[[], object], Callable[[], object]]]) -> float:
    """Median of the second of each pair over that of the first, in turns."""
    took: tuple[list[float], list[float]] = ([], [])
    for pair in pairs:
        for one in pair:
            one()
    for _ in range(times):
        for pair in pairs:
            for one, known in zip(pair, took, strict=True):
                started_s = time.perf_counter()
                one()
                known.append(time.perf_counter() - started_s)
    plain, ros = map(statistics.median, took)
    return ros / plain


def _told(answer: dict[str, Any], _request: object) -> dict[str, Any]:
    return answer


class _Bridge:
    """Answers what `ros_dao` asks, and publishes events."""

    def __init__(self, bus: Bus, org: str) -> None:
        self._bus = bus
        self._org = org
        self.events: list[DaoEvent] = []
        self.sent_s: dict[int, float] = {}
        empty = {"tasks": {"tasks": [], "total": 0}, "services": {"services": [], "total": 0}}
        told: dict[str, Any] = {**empty, "wallets": {"wallets": [], "supply_iec": "0"}}
        for what, one in told.items():
            bus.serve(topics.STATE.name(org=org, what=what), partial(_told, one))
        bus.serve(topics.STATE.name(org=org, what="chain"), lambda _request: answers.chain(last_seq=0))
        bus.serve(topics.STATE.name(org=org, what="events"), self._page)

    def _page(self, request: Any) -> dict[str, Any]:
        after, limit = int(request.parameters.get("after", 0)), int(request.parameters.get("limit", 500))
        known = self.events[after : after + limit]
        listed = [event.model_dump(mode="json") for event in known]
        return {"events": listed, "last_seq": len(self.events), "chain": CHAIN}

    def publish(self) -> None:
        seq = len(self.events) + 1
        where = {"block": seq // 3, "log_index": seq % 3, "tx_hash": f"0x{seq:064x}", "time_s": float(seq)}
        event = DaoEvent(seq=seq, name="Transfer", task_id=None, args={"value": seq}, chain=CHAIN, **where)
        self.events.append(event)
        self.sent_s[seq] = time.perf_counter()
        self._bus.put_json(topics.EVENT.name(org=self._org, event=event.name), event)


class _Log:
    """A node that reads every event: the topic wakes it, and it asks for those that it does not know."""

    def __init__(self) -> None:
        self.seen: list[int] = []
        self.heard_s: dict[int, float] = {}
        self._woken = threading.Event()

    def listen(self, bus: Bus) -> Node:
        node = _node(bus, "log")
        client = _client(node, "get_events")
        node.subscription(f"{PREFIX}/events", "rodeo_msgs/msg/DaoEvent", self._wake, wire.LATCHED)
        threading.Thread(target=self._read, args=(bus, client), daemon=True).start()
        return node

    def _wake(self, event: Any, _info: Any) -> None:
        self.heard_s.setdefault(event.seq, time.perf_counter())
        self._woken.set()

    def _read(self, bus: Bus, client: Client) -> None:
        request = "rodeo_msgs/srv/GetEvents_Request"
        while not bus.session.is_closed():
            self._woken.wait(1.0)
            self._woken.clear()
            after = self.seen[-1] if self.seen else 0
            try:
                answer = client.call(types.new(request, after=after), 5.0).answer
            except (RodeoError, zenoh.ZError):
                if not bus.session.is_closed():
                    raise
                return
            if answer and not bus.session.is_closed():
                self.seen += [int(event.seq) for event in answer[0].events]
                if answer[0].events:
                    self._woken.set()


def _events() -> dict[str, float | None]:
    with _site() as running:
        running.start("router")
        bridge, log = _Bridge(running.bus, running.site.org), _Log()
        running.start("ros_dao")
        pid = running.children["ros_dao"].pid
        pause = threading.Event()
        before_s = cpu_s(pid)
        pause.wait(IDLE_S)
        idle = (cpu_s(pid) - before_s) / IDLE_S
        bus = Bus.open(running.site.bus.router, timeout_s=60.0)
        log.listen(bus)
        before_s, started_s = cpu_s(pid), time.perf_counter()
        cut_s: float | None = None
        for number in range(EVENTS):
            bridge.publish()
            if number == EVENTS // 2:
                bus.close()
                cut_s = time.perf_counter()
            if cut_s is not None and time.perf_counter() - cut_s >= CUT_S:
                bus = Bus.open(running.site.bus.router, timeout_s=60.0)
                log.listen(bus)
                cut_s = None
            pause.wait(max(0.0, started_s + (number + 1) / EVENTS_S - time.perf_counter()))
        share = (cpu_s(pid) - before_s) / (time.perf_counter() - started_s)
        end_s = time.monotonic() + 60.0
        while (not log.seen or log.seen[-1] < EVENTS) and time.monotonic() < end_s:
            pause.wait(0.1)
        bus.close()
        late_ms = sorted(1e3 * (heard - bridge.sent_s[seq]) for seq, heard in log.heard_s.items())
        return {
            "ros2_event_ms_p99": late_ms[int(0.99 * len(late_ms))],
            "ros2_events_lost": EVENTS - len(set(log.seen)),
            "ros2_events_doubled": len(log.seen) - len(set(log.seen)),
            "ros2_cpu_share_idle": idle,
            "ros2_cpu_share_events": share,
        }
