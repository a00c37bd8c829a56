"""The bridge over a long run, on a site of its own: a hundred participants, and processes that are killed.

`soak_*`: 100 participants post and settle 1,000 tasks through one bridge on anvil. `soak_lost` and
`soak_doubled` must be 0; `soak_memory_growth` is the bridge's resident memory at the end over that after a
quarter; `soak_time_per_task_ratio` the time per task in the last quarter over that in the second.
`faults_*`: bridge, node and router get SIGKILL at 50 random moments in 100 tasks; `faults_unsettled`,
`faults_doubled` and `faults_index_differences` must be 0.
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
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from bench.bridge import CHAIN_ID, write_site
from deploy.processes import BY_NAME
from rodeo import wallets
from rodeo.bus import Bus, DaoEvents
from rodeo.chain import ChainClient, Deployment, from_wei
from rodeo.config import Site
from rodeo.dao import CLEANING, Participant
from rodeo.errors import BusError, RemoteError
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

PARTICIPANTS, TASKS = 100, 1_000
KILLS, TASKS_WITH_KILLS = 50, 100

REWARD_IEC = Decimal(1)
_AT_ONCE = 16
_PATIENCE_S = 600.0
"""Wall time for one command through all the kills."""

_AGAIN = frozenset({"bridge_not_ready", "chain_unavailable", "transaction_timeout", "transaction_dropped"})
"""What may be asked again with the same request_id."""

KILLED = ("bridge", "chain", "router")


def run() -> dict[str, float]:
    """Minutes, on free ports, in folders that are removed."""
    return hundred_participants() | faults(TASKS_WITH_KILLS, KILLS)


def hundred_participants(tasks: int = TASKS, participants: int = PARTICIPANTS) -> dict[str, float]:
    names = [f"participant{number}" for number in range(participants)]
    listed = ", ".join(f'{{ name = "{name}" }}' for name in names)
    with _Site("anvil", f"participants = [{listed}]\n") as site:
        for name in names:
            site.command("organization", "transfer", Transfer(to=name, amount_iec=Decimal(15)))
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            list(pool.map(site.offer, names))
        memory: list[int] = []
        ended_s: list[float] = []
        lock = threading.Lock()

        def one(number: int) -> None:
            site.settle(number, names[number % participants])
            with lock:
                ended_s.append(time.monotonic())
                if len(ended_s) in (tasks // 4, tasks):
                    memory.append(site.resident_bytes("bridge"))

        started_s = time.monotonic()
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            list(pool.map(one, range(tasks)))
        quarter = tasks // 4
        second = ended_s[2 * quarter - 1] - ended_s[quarter - 1]
        last = ended_s[-1] - ended_s[-quarter - 1]
        return {
            "soak_tasks_per_s": tasks / (ended_s[-1] - started_s),
            "soak_time_per_task_ratio": last / second,
            "soak_memory_growth": memory[-1] / memory[0],
            **{f"soak_{name}": value for name, value in site.differences(tasks).items()},
        }


def faults(tasks: int, kills: int, backend: str = "eth-tester", seed: int = 1) -> dict[str, float]:
    """Kill one of KILLED whenever as many commands have been answered as chance says."""
    chance = random.Random(seed)
    commands = 3 * tasks
    moments = sorted(chance.sample(range(1, commands - 3), min(kills, commands - 5)))
    with _Site(backend) as site:
        for number in range(8):
            site.offer("panther1", number)
        answered = threading.Semaphore(0)
        site.on_answer = answered.release

        def kill() -> None:
            count = 0
            for moment in moments:
                while count < moment:
                    answered.acquire()
                    count += 1
                threading.Event().wait(chance.uniform(0, 0.3))  # in the middle of whatever comes next
                site.kill_and_restart(chance.choice(KILLED))

        killer = threading.Thread(target=kill, name="killer", daemon=True)
        started_s = time.monotonic()
        killer.start()
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(lambda number: site.settle(number, "organization"), range(tasks)))
        took_s = time.monotonic() - started_s
        killer.join()
        found = site.differences(tasks)
        return {"faults_kills": len(moments), "faults_s": took_s} | {
            f"faults_{name}": value for name, value in found.items()
        }


@dataclass
class _Site:
    """Router, chain, contracts and bridge of the lab; participants are played by the caller."""

    backend: str
    extra: str = ""
    on_answer: Callable[[], object] = lambda: None
    events: list[DaoEvent] = field(default_factory=list)

    def __enter__(self) -> _Site:
        self._folder = tempfile.TemporaryDirectory(prefix="rodeo-soak-")
        self._path = write_site(Path(self._folder.name), self.backend, self.extra)
        self.site = Site.load(self._path)
        wallets.ensure_wallets(self.site)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        for name in KILLED:
            self._start(name)
        subprocess.run(
            [sys.executable, "-m", "deploy.contracts", "--site", str(self._path)],
            check=True,
            capture_output=True,
        )
        self.bus = Bus.open(self.site.bus.router, timeout_s=60.0)
        self._heard = DaoEvents(self.bus, self.site.org, self.events.append)
        return self

    def __exit__(self, *_error: object) -> None:
        self._heard.close()
        self.bus.close()
        for process in self._processes.values():
            process.send_signal(signal.SIGTERM)
        for process in self._processes.values():
            process.wait()
        self._folder.cleanup()

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

    def command(self, participant: str, name: str, request: Command) -> dict[str, Any]:
        """The reply, however often it has to be asked for."""
        return self._patiently(
            lambda: Participant(self.bus, self.site.org, participant).command(name, request)
        )

    def _patiently(self, ask: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        deadline_s = time.monotonic() + _PATIENCE_S
        pause = threading.Event()
        while True:
            try:
                return ask()
            except BusError:
                pass
            except RemoteError as error:
                if error.code not in _AGAIN:
                    raise
            if time.monotonic() > deadline_s:
                raise TimeoutError("no answer through all the kills")
            pause.wait(0.05)

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
        self.on_answer()
        task_id, sha256 = int(posted["task_id"]), f"{number + 1:064x}"
        me = Participant(self.bus, self.site.org, "organization")
        pause = threading.Event()
        while (task := self._patiently(lambda: me.state(f"task/{task_id}")))["state"] == "open":
            pause.wait(0.02)  # every service is at work
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
        self.on_answer()
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
        self.on_answer()

    def differences(self, tasks: int) -> dict[str, float]:
        """What the contracts, the index and the events that were heard do not agree on."""
        client = ChainClient(self.site.chain.url, Deployment.load(self.site.data_dir, CHAIN_ID))
        me = Participant(self.bus, self.site.org, "organization")
        chain = self._patiently(lambda: me.state("chain"))
        wait = threading.Event()
        while not self.events or self.events[-1].seq < chain["last_seq"]:
            wait.wait(0.05)
        indexed: list[dict[str, Any]] = []

        def next_page() -> dict[str, Any]:
            return me.state("tasks", limit=500, offset=len(indexed))

        while page := self._patiently(next_page)["tasks"]:
            indexed.extend(page)
        kept = {number: client.task(number) for number in range(1, client.task_count() + 1)}
        balances = self._patiently(lambda: me.state("wallets"))["wallets"]
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
