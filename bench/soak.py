"""The bridge over a long run, on a site of its own: a hundred participants, and processes that are killed.

`soak_*`: 100 participants post and settle 1,000 tasks through one bridge on anvil. `soak_lost` and
`soak_doubled` must be 0; `soak_memory_growth` is the bridge's resident memory at the end over that after a
quarter; `soak_time_per_task_ratio` the time per task in the last quarter over that in the second.
`faults_*`: bridge, node and router get SIGKILL at 50 random moments in 100 tasks; `faults_unsettled`,
`faults_doubled` and `faults_index_differences` must be 0. Progress goes to stderr; a run that takes
longer than its limit ends with SoakFailed and the last lines of each process's log.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from bench.bridge import CHAIN_ID, write_site
from deploy.processes import BY_NAME
from rodeo import topics, wallets
from rodeo.bus import Bus, DaoEvents
from rodeo.chain import ChainClient, Deployment, from_wei
from rodeo.config import Site
from rodeo.dao import CLEANING
from rodeo.errors import BusError, RemoteError, RodeoError
from rodeo.messages import (
    Command,
    DaoEvent,
    PostVerdict,
    RegisterService,
    RegisterTask,
    SubmitProof,
    Transfer,
)
from rodeo.service import PARENT_VARIABLE

T = TypeVar("T")

PARTICIPANTS, TASKS = 100, 1_000
KILLS, TASKS_WITH_KILLS = 50, 100

REWARD_IEC = Decimal(1)
_AT_ONCE = 16
_LIMIT_S = 1_800.0
"""Wall time for either run."""

_ASK_S = 5.0
"""Wall time for one answer; whoever gets none asks again with the same request_id."""

_AGAIN = frozenset({"bridge_not_ready", "chain_unavailable", "transaction_timeout", "transaction_dropped"})
"""What may be asked again with the same request_id."""

KILLED = ("bridge", "chain", "router")


class SoakFailed(RodeoError):
    """It did not end in time, or a process ended that nobody had killed."""


def run() -> dict[str, float]:
    """Minutes, on free ports, in folders that are removed."""
    return hundred_participants() | faults(TASKS_WITH_KILLS, KILLS)


def hundred_participants(
    tasks: int = TASKS, participants: int = PARTICIPANTS, limit_s: float = _LIMIT_S
) -> dict[str, float]:
    names = [f"participant{number}" for number in range(participants)]
    listed = ", ".join(f'{{ name = "{name}" }}' for name in names)
    with _Site("anvil", f"participants = [{listed}]\n", limit_s=limit_s) as site:

        def prepare(name: str) -> None:
            transfer = Transfer(to=name, amount_iec=Decimal(15), request_id=f"fund {name}")
            site.command("organization", "transfer", transfer)
            site.offer(name)

        site.together(prepare, names, lambda done: site.say(f"{done} of {participants} participants"))
        memory: list[int] = []
        ended_s: list[float] = []

        def settle(number: int) -> None:
            site.settle(number, names[number % participants])

        def on_done(done: int) -> None:
            ended_s.append(time.monotonic())
            if done in (tasks // 4, tasks):
                memory.append(site.resident_bytes("bridge"))
            if done % 10 == 0:
                site.say(f"{done} of {tasks} tasks")

        started_s = time.monotonic()
        site.together(settle, range(tasks), on_done)
        quarter = tasks // 4
        second = ended_s[2 * quarter - 1] - ended_s[quarter - 1]
        last = ended_s[-1] - ended_s[-quarter - 1]
        return {
            "soak_tasks_per_s": tasks / (ended_s[-1] - started_s),
            "soak_time_per_task_ratio": last / second,
            "soak_memory_growth": memory[-1] / memory[0],
            **{f"soak_{name}": value for name, value in site.differences(tasks).items()},
        }


def faults(
    tasks: int, kills: int, backend: str = "eth-tester", seed: int = 1, limit_s: float = _LIMIT_S
) -> dict[str, float]:
    """Kill one of KILLED whenever as many commands have been answered as chance says."""
    chance = random.Random(seed)
    moments = sorted(chance.sample(range(1, 3 * tasks - 3), kills))
    with _Site(backend, limit_s=limit_s) as site:
        for number in range(8):
            site.offer("panther1", number)

        def kill(answers: int) -> None:
            while moments and answers >= moments[0]:
                moments.pop(0)
                victim = chance.choice(KILLED)
                site.wait(chance.uniform(0.0, 0.3))  # in the middle of whatever comes next
                site.kill_and_restart(victim)
                site.say(
                    f"{answers} of {3 * tasks} commands, {kills - len(moments)} of {kills} kills: {victim}"
                )

        started_s = time.monotonic()
        # Children end with the thread that started them, so this one kills.
        site.together(lambda number: site.settle(number, "organization"), range(tasks), on_answer=kill)
        took_s = time.monotonic() - started_s
        return {"faults_kills": kills - len(moments), "faults_s": took_s} | {
            f"faults_{name}": value for name, value in site.differences(tasks).items()
        }


@dataclass
class _Site:
    """Router, chain, contracts and bridge of the lab; participants are played by the caller.

    Enter it, and kill, in one thread: the kernel ends children with the thread that started them.
    """

    backend: str
    extra: str = ""
    limit_s: float = _LIMIT_S
    events: list[DaoEvent] = field(default_factory=list)

    def __enter__(self) -> _Site:
        self._started_s = time.monotonic()
        self._given_up = threading.Event()
        self._answers: SimpleQueue[None] = SimpleQueue()
        self._folder = tempfile.TemporaryDirectory(prefix="rodeo-soak-")
        self._path = write_site(Path(self._folder.name), self.backend, self.extra)
        self.site = Site.load(self._path)
        wallets.ensure_wallets(self.site)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        try:
            for name in KILLED:
                self._start(name)
            subprocess.run(
                [sys.executable, "-m", "deploy.contracts", "--site", str(self._path)],
                check=True,
                capture_output=True,
            )
            self.bus = Bus.open(self.site.bus.router, timeout_s=60.0)
            self._heard = DaoEvents(self.bus, self.site.org, self.events.append)
        except BaseException:
            self._end_processes()
            raise
        self.say("the site is up")
        return self

    def __exit__(self, *_error: object) -> None:
        self._given_up.set()
        self._heard.close()
        self.bus.close()
        self._end_processes()

    def _end_processes(self) -> None:
        for process in self._processes.values():
            process.send_signal(signal.SIGTERM)
        for process in self._processes.values():
            process.wait()
        self._folder.cleanup()

    def say(self, text: str) -> None:
        print(f"soak {time.monotonic() - self._started_s:6.1f} s: {text}", file=sys.stderr, flush=True)

    def together(
        self,
        job: Callable[[T], object],
        inputs: Iterable[T],
        on_done: Callable[[int], None] = lambda _count: None,
        on_answer: Callable[[int], None] = lambda _count: None,
    ) -> None:
        """Do the job for all, several at once; both callbacks get how many there were so far, in this thread.

        Raises SoakFailed, or what a job raised.
        """
        answers = done = 0
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            try:
                left = {pool.submit(job, one) for one in inputs}
                while left:
                    ended, left = wait(left, timeout=0.02, return_when=FIRST_COMPLETED)
                    for one in ended:
                        one.result()
                        done += 1
                        on_done(done)
                    while not self._answers.empty():
                        self._answers.get()
                        answers += 1
                    on_answer(answers)
                    self._check()
            except BaseException:
                self._given_up.set()
                pool.shutdown(cancel_futures=True)
                raise

    def _check(self) -> None:
        ended = [name for name, process in self._processes.items() if process.poll() is not None]
        if ended:
            raise SoakFailed("a process ended by itself\n" + self._logs(), names=ended)
        if time.monotonic() - self._started_s > self.limit_s:
            raise SoakFailed("not done in time\n" + self._logs(), limit_s=self.limit_s)

    def _logs(self) -> str:
        lines = []
        for name in KILLED:
            text = (Path(self._folder.name) / f"{name}.log").read_text(errors="replace")
            lines += [f"{name}: {line}" for line in text.splitlines()[-20:]]
        return "\n".join(lines)

    def _start(self, name: str) -> None:
        with open(Path(self._folder.name) / f"{name}.log", "ab") as log:
            self._processes[name] = subprocess.Popen(
                [sys.executable, "-m", BY_NAME[name].module, "--site", str(self._path)],
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, PARENT_VARIABLE: str(os.getpid())},
            )

    def kill_and_restart(self, name: str) -> None:
        self._processes[name].kill()
        self._processes[name].wait()
        self._start(name)

    def resident_bytes(self, name: str) -> int:
        status = Path(f"/proc/{self._processes[name].pid}/status").read_text()
        (line,) = [line for line in status.splitlines() if line.startswith("VmRSS:")]
        return int(line.split()[1]) * 1024

    def wait(self, seconds: float) -> None:
        """Raises SoakFailed when meanwhile all is given up, or the time is over."""
        if self._given_up.wait(seconds) or time.monotonic() - self._started_s > self.limit_s:
            raise SoakFailed("given up while waiting", limit_s=self.limit_s)

    def command(self, participant: str, name: str, request: Command) -> dict[str, Any]:
        """The reply, however often it has to be asked for."""
        return self._patiently(
            topics.COMMAND.name(org=self.site.org, participant=participant, command=name), request
        )

    def state(self, what: str, **parameters: Any) -> dict[str, Any]:
        """The index's answer, however often it has to be asked for."""
        return self._patiently(topics.STATE.name(org=self.site.org, what=what), **parameters)

    def _patiently(self, key: str, request: Command | None = None, **parameters: Any) -> dict[str, Any]:
        while True:
            try:
                return self.bus.query(key, request, parameters=parameters, timeout_s=_ASK_S)
            except BusError:
                pass  # asked again: this is what is measured
            except RemoteError as error:
                if error.code not in _AGAIN:
                    raise
            self.wait(0.05)

    def offer(self, name: str, number: int = 0) -> None:
        service = RegisterService(kind=CLEANING, price_iec=REWARD_IEC, request_id=f"service {name} {number}")
        self.command(name, "register_service", service)

    def settle(self, number: int, creator: str) -> None:
        """Post a task, prove it and judge it, each once."""
        posted = self.command(
            creator,
            "register_task",
            RegisterTask(
                request_id=f"task {number}",
                kind=CLEANING,
                reward_iec=REWARD_IEC,
                params={"item_id": f"item{number}", "x_m": 1.0, "y_m": 2.0},
            ),
        )
        self._answers.put(None)
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
        self._answers.put(None)
        self.command(
            "oracle",
            "post_verdict",
            PostVerdict(
                request_id=f"verdict {number}",
                task_id=task_id,
                attempt=task["attempt"],
                proof_sha256="0x" + sha256,
                accepted=True,
                reason="as it should be",
                report_sha256="0x" + "b" * 64,
                report_uri="",
            ),
        )
        self._answers.put(None)

    def differences(self, tasks: int) -> dict[str, float]:
        """What the contracts, the index and the events that were heard do not agree on."""
        client = ChainClient(self.site.chain.url, Deployment.load(self.site.data_dir, CHAIN_ID))
        chain = self.state("chain")
        while not self.events or self.events[-1].seq < chain["last_seq"]:
            self.wait(0.05)
            self._check()
        indexed: list[dict[str, Any]] = []
        while page := self.state("tasks", limit=500, offset=len(indexed))["tasks"]:
            indexed.extend(page)
        kept = {number: client.task(number) for number in range(1, client.task_count() + 1)}
        balances = self.state("wallets")["wallets"]
        differing = [one["id"] for one in indexed if one["state"] != kept[one["id"]].state.name.lower()]
        differing += [
            one["name"]
            for one in balances
            if one["balance_iec"] != f"{from_wei(client.balance(one['address'])):f}"
        ]
        settled = [event.task_id for event in self.events if event.name == "TaskSettled"]
        return {
            "unsettled": sum(task.state.name != "SETTLED" for task in kept.values()),
            "lost": tasks - len({one["params"]["item_id"] for one in indexed}),
            "doubled": len(kept) - tasks + len(settled) - len(set(settled)),
            "index_differences": len(differing) + len(kept) - len(indexed),
            "events_out_of_order": sum(
                event.seq != place for place, event in enumerate(self.events, start=1)
            ),
        }


def main(arguments: Sequence[str]) -> None:
    """`python -m bench.soak faults 100 50 anvil`: one of the two alone."""
    what, *numbers = arguments
    if what == "faults":
        tasks, kills, *backend = numbers
        print(json.dumps(faults(int(tasks), int(kills), backend[0] if backend else "eth-tester"), indent=2))
    else:
        print(json.dumps(hundred_participants(*map(int, numbers)), indent=2))


if __name__ == "__main__":
    main(sys.argv[1:])
