"""A bridge over a long run: many participants, and processes that are killed (`bench.soak`)."""

from __future__ import annotations

import os
import random
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any, TypeVar

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, DaoEvents
from rodeo.chain.client import ChainClient
from rodeo.chain.deployment import Deployment
from rodeo.commands import Command
from rodeo.commands.judging import Rule
from rodeo.commands.services import RegisterService
from rodeo.commands.tasks import RegisterTask, SubmitProof
from rodeo.commands.treasury import Transfer
from rodeo.errors import BusError, RemoteError, RodeoError
from rodeo.runtime.process import is_transient
from rodeo.site import topics
from services.bridge.index import UNDONE
from tests.support.index import index_differences
from tests.support.site import RunningSite, write_site

T = TypeVar("T")

PARTICIPANTS, TASKS = 100, 1_000

CHAIN_ID = 31_337
REWARD_IEC = Decimal(1)
_AT_ONCE = 16
_LIMIT_S = 3_600.0
"""Wall time for either run."""

_ASK_S = 5.0
"""Wall time for one answer; whoever gets none asks again with the same request_id."""

KILLED = ("bridge", "chain", "router")

_COMMANDS = 3
"""That a task takes."""

_AT_WORK = 0.8
"""Share of the kills that wait until their victim works again; the others may meet it while it starts."""


class SoakFailed(RodeoError):
    """It did not end in time, or a process ended that nobody had killed."""


def hundred_participants(
    tasks: int = TASKS, participants: int = PARTICIPANTS, limit_s: float = _LIMIT_S
) -> dict[str, float]:
    names = [f"participant{number}" for number in range(participants)]
    with _Site("anvil", names, limit_s=limit_s) as site:

        def prepare(name: str) -> None:
            transfer = Transfer(to=name, amount_iec=Decimal(15), request_id=f"fund {name}")
            site.command("organization", "transfer", transfer)
            site.offer(name)

        site.together(prepare, names, lambda done: site.say(f"{done} of {participants} participants"))
        memory: list[int] = []
        spent_s: dict[str, list[float]] = {"time": [], "cpu": [], "node_cpu": []}

        def settle(number: int) -> None:
            site.settle(number, names[number % participants])

        def on_done(done: int) -> None:
            spent_s["time"].append(time.monotonic())
            spent_s["cpu"].append(site.cpu_s("bridge"))
            spent_s["node_cpu"].append(site.cpu_s("chain"))
            if done in (tasks // 4, tasks):
                memory.append(site.resident_bytes("bridge"))
            if done % 10 == 0:
                site.say(f"{done} of {tasks} tasks")

        started_s = time.monotonic()
        site.together(settle, range(tasks), on_done)
        quarter = tasks // 4

        def ratio(spent: Sequence[float]) -> float:
            second = spent[2 * quarter - 1] - spent[quarter - 1]
            return (spent[-1] - spent[-quarter - 1]) / second

        return {
            "soak_tasks_per_s": tasks / (spent_s["time"][-1] - started_s),
            **{f"soak_{name}_per_task_ratio": ratio(spent) for name, spent in spent_s.items()},
            "soak_memory_growth": memory[-1] / memory[0],
            **{f"soak_{name}": value for name, value in site.differences(tasks).items()},
        }


def faults(
    tasks: int,
    kills: int,
    backend: str = "eth-tester",
    at_once: int = _AT_ONCE,
    seed: int = 1,
    limit_s: float = _LIMIT_S,
) -> dict[str, float]:
    """Kill each of KILLED so often, each time when as many commands have been answered as chance says."""
    chance = random.Random(seed)
    victims = list(KILLED) * kills
    chance.shuffle(victims)
    # Never after so many answers that those in flight could be the last.
    moments = sorted(chance.sample(range(1, _COMMANDS * tasks - at_once), len(victims)))
    killed: Counter[str] = Counter()
    names = [f"participant{number}" for number in range(at_once)]
    with _Site(backend, names, at_once=at_once, moments=deque(moments), limit_s=limit_s) as site:
        for name in names:
            site.offer(name)

        def kill() -> None:
            while site.kill_is_due():
                victim = victims.pop()
                if chance.random() < _AT_WORK:
                    site.wait_served(victim)
                site.wait(chance.uniform(0.0, 0.3))  # in the middle of whatever comes next
                site.kill_and_restart(victim)
                killed[victim] += 1
                site.say(f"{site.answers} of {_COMMANDS * tasks} commands, kill {killed.total()}: {victim}")

        started_s = time.monotonic()
        # Children end with the thread that started them, so this one kills.
        site.together(lambda number: site.settle(number, "organization"), range(tasks), meanwhile=kill)
        took_s = time.monotonic() - started_s
        return {
            "faults_s": took_s,
            **{f"faults_kills_{name}": killed[name] for name in KILLED},
            **{f"faults_{name}": value for name, value in site.differences(tasks).items()},
        }


@dataclass
class _Site:
    """Router, chain, contracts and bridge of the lab; participants are played by the caller.

    Enter it, and kill, in one thread: the kernel ends children with the thread that started them.
    """

    backend: str
    participants: Sequence[str]
    """People who do cleanings, besides the lab's own robot."""
    at_once: int = _AT_ONCE
    moments: deque[int] = field(default_factory=deque)
    """After how many answers a kill is due. Nobody asks for more until it was done."""
    limit_s: float = _LIMIT_S
    events: list[DaoEvent] = field(default_factory=list)
    answers: int = 0

    def __enter__(self) -> _Site:
        self._started_s = time.monotonic()
        self._given_up = threading.Event()
        self._lock = threading.Lock()
        self._may_ask = threading.Event()
        self._may_ask.set()
        self._served: set[int] = set()
        self._folder = tempfile.TemporaryDirectory(prefix="rodeo-soak-")
        listed = ", ".join(f'{{ name = "{name}", kinds = ["waste_disposal"] }}' for name in self.participants)
        extra = f"participants = [{listed}]\n"
        self._running = RunningSite(write_site(Path(self._folder.name), self.backend, extra))
        self.site = self._running.site
        try:
            self._running.start(*KILLED, ready=False)
            self._running.deploy_contracts()
            self.bus: Bus = self._running.bus
            self._status = self.bus.subscribe_json(topics.STATUS.pattern(org=self.site.org), self._on_status)
            self._heard = DaoEvents(self.bus, self.site.org, self.events.append)
        except BaseException:
            self._end_processes()
            raise
        self.say("the site is up")
        return self

    def __exit__(self, *_error: object) -> None:
        self._given_up.set()
        self._heard.close()
        self._end_processes()

    def _end_processes(self) -> None:
        self._running.stop()
        self._folder.cleanup()

    def _on_status(self, _key: str, data: dict[str, Any]) -> None:
        if data["ready"]:
            self._served.add(data["pid"])

    def say(self, text: str) -> None:
        print(f"soak {time.monotonic() - self._started_s:6.1f} s: {text}", file=sys.stderr, flush=True)

    def together(
        self,
        job: Callable[[T], object],
        inputs: Iterable[T],
        on_done: Callable[[int], None] = lambda _count: None,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Do the job for all, several at once; both callbacks run in this thread, `on_done` hears the number.

        Raises SoakFailed, or what a job raised.
        """
        done = 0
        with ThreadPoolExecutor(self.at_once) as pool:
            try:
                left = {pool.submit(job, one) for one in inputs}
                while left:
                    ended, left = wait(left, timeout=0.02, return_when=FIRST_COMPLETED)
                    for one in ended:
                        one.result()
                        done += 1
                        on_done(done)
                    meanwhile()
                    self._check()
            except BaseException:
                self._given_up.set()
                pool.shutdown(cancel_futures=True)
                raise

    def _check(self) -> None:
        ended = [name for name, child in self._running.children.items() if child.poll() is not None]
        if ended:
            raise SoakFailed("a process ended by itself\n" + self._logs(), names=ended)
        if time.monotonic() - self._started_s > self.limit_s:
            raise SoakFailed("not done in time\n" + self._logs(), limit_s=self.limit_s)

    def _logs(self) -> str:
        return "\n".join(f"{name}:\n{self._running.log(name)}" for name in KILLED)

    # -- killing -------------------------------------------------------------------------------------------

    def kill_is_due(self) -> bool:
        """Whether one is; each is reported once. When none is, whoever waited continues."""
        with self._lock:
            if self.moments and self.answers >= self.moments[0]:
                self.moments.popleft()
                return True
            self._may_ask.set()
            return False

    def _answered(self) -> None:
        with self._lock:
            self.answers += 1
            if self.moments and self.answers >= self.moments[0]:
                self._may_ask.clear()

    def wait_served(self, name: str) -> None:
        """Until the process has said that it does its work."""
        while self._running.children[name].pid not in self._served:
            self.wait(0.02)
            self._check()

    def kill_and_restart(self, name: str) -> None:
        self._running.kill(name)
        self._running.start(name, ready=False)

    # -- what the processes use ----------------------------------------------------------------------------

    def resident_bytes(self, name: str) -> int:
        status = Path(f"/proc/{self._running.children[name].pid}/status").read_text()
        (line,) = [line for line in status.splitlines() if line.startswith("VmRSS:")]
        return int(line.split()[1]) * 1024

    def cpu_s(self, name: str) -> float:
        """What the process and its children (anvil) have computed, in user and kernel."""
        process = Path(f"/proc/{self._running.children[name].pid}")
        children = " ".join(path.read_text() for path in process.glob("task/*/children")).split()
        stats = [
            (Path("/proc") / pid / "stat").read_text().rpartition(")")[2].split()
            for pid in (process.name, *children)
        ]
        return sum(int(stat[11]) + int(stat[12]) for stat in stats) / os.sysconf("SC_CLK_TCK")

    # -- participants --------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> None:
        """Raises SoakFailed when meanwhile all is given up, or the time is over."""
        if self._given_up.wait(seconds) or time.monotonic() - self._started_s > self.limit_s:
            raise SoakFailed("given up while waiting", limit_s=self.limit_s)

    def command(self, participant: str, name: str, request: Command) -> dict[str, Any]:
        """The reply, however often it has to be asked for."""
        while not self._may_ask.wait(0.1):
            self.wait(0.0)
        key = topics.COMMAND.name(org=self.site.org, participant=participant, command=name)
        return self._patiently(key, request)

    def state(self, what: str, **parameters: Any) -> dict[str, Any]:
        """The index's answer, however often it has to be asked for."""
        return self._patiently(topics.STATE.name(org=self.site.org, what=what), **parameters)

    def _patiently(self, key: str, request: Command | None = None, **parameters: Any) -> dict[str, Any]:
        while True:
            try:
                return self.bus.query(key, request, parameters=parameters, timeout_s=_ASK_S)
            except (BusError, RemoteError) as error:
                if not is_transient(error):  # else asked again: this is what is measured
                    raise
            self.wait(0.05)

    def offer(self, name: str) -> None:
        service = RegisterService(kind="waste_disposal", price_iec=REWARD_IEC, request_id=f"service {name}")
        self.command(name, "register_service", service)

    def settle(self, number: int, creator: str) -> None:
        """Post a task, prove it and judge it, each once."""
        posted = self.command(
            creator,
            "register_task",
            RegisterTask(
                request_id=f"task {number}",
                kind="waste_disposal",
                reward_iec=REWARD_IEC,
                params={"item_id": f"item{number}", "x_m": 1.0, "y_m": 2.0},
            ),
        )
        self._answered()
        task_id, sha256 = int(posted["task_id"]), f"{number + 1:064x}"
        while (task := self.state(f"task/{task_id}"))["state"] == "open":
            self.wait(0.02)  # every service is at work
        self.command(
            task["executor_name"],
            "submit_proof",
            SubmitProof(
                request_id=f"proof {number}",
                task_id=task_id,
                attempt=task["attempt"],
                proof_sha256="0x" + sha256,
                proof_uri=f"{self.site.store_url}/{sha256}.mcap",
            ),
        )
        self._answered()
        self.command(
            "oracle",
            "rule",
            Rule(
                request_id=f"ruling {number}",
                task_id=task_id,
                attempt=task["attempt"],
                proof_sha256="0x" + sha256,
                ruling="accepted",
                amount_iec=Decimal(task["price_iec"]),
                reason="as it should be",
                report_sha256="0x" + "b" * 64,
                report_uri="",
            ),
        )
        self._answered()

    def differences(self, tasks: int) -> dict[str, float]:
        """What the contracts, the index and the events that were heard do not agree on."""
        client = ChainClient(self.site.chain.url, Deployment.load(self.site.data_dir, CHAIN_ID))
        chain = self.state("chain")
        while not self.events or self.events[-1].seq < chain["last_seq"]:
            self.wait(0.05)
            self._check()
        kept = [client.tasks.task(number) for number in range(1, client.tasks.count() + 1)]
        differing = index_differences(self.state, client)
        for line in differing:
            self.say(line)
        undone = {event.args["undone_seq"] for event in self.events if event.name == UNDONE}
        standing = [event for event in self.events if event.name != UNDONE and event.seq not in undone]
        heard = [(event.block, event.log_index, event.name) for event in standing]
        logs = client.logs(client.deployment.block, chain["head"])
        logged = [(log.block, log.log_index, log.event.name) for log in logs]
        settled = [event.task_id for event in standing if event.name == "TaskSettled"]
        items = {event.args["params"] for event in standing if event.name == "TaskRegistered"}
        return {
            "unsettled": sum(task.state.name != "SETTLED" for task in kept),
            "lost": tasks - len(items),
            "doubled": len(kept) - tasks + len(settled) - len(set(settled)),
            "index_differences": len(differing),
            "events_lost_or_doubled": sum((Counter(heard) - Counter(logged)).values())
            + sum((Counter(logged) - Counter(heard)).values()),
            "events_out_of_order": sum(
                event.seq != place for place, event in enumerate(self.events, start=1)
            ),
        }
