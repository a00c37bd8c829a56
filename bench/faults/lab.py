"""A site of real processes that a case breaks: launchers that keep them running, small disks, money that is
counted in the contracts.

The launchers live in the process's main thread, as in `rodeo up`, because the kernel ends children with the
thread that started them; the case's script runs beside it and may block.
"""

from __future__ import annotations

import ctypes
import json
import os
import queue
import re
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, TypeVar

from bench.faults.case import BASE, Case
from deploy.chain.record import give_up_chain
from deploy.launcher import Launcher
from rodeo.bus.messages import Status
from rodeo.bus.session import Bus
from rodeo.chain.client import ChainClient
from rodeo.chain.contracts.abi import TaskState
from rodeo.chain.contracts.events import TaskRegistered, TaskSettled
from rodeo.chain.deployment import Deployment
from rodeo.errors import BusError, RemoteError, RodeoError
from rodeo.host.instance import lock_holder
from rodeo.runtime.process import is_transient
from rodeo.signing.wallets import ensure_wallets
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.tls import OPERATOR, identity
from rodeo_cli.site import read_rows
from rodeo_testing.waiting import HANG_S
from tests.support.index import index_differences
from tests.support.site import write_site

T = TypeVar("T")

CHAIN_ID = 31_337
POLL_S = 0.25
"""Wall time between two looks at the children, as in `rodeo up`."""
PAUSE_S = 0.1
_ENDED = ("settled", "failed", "cancelled")
ASK_S = 3.0
"""Wall time for one answer; whoever gets none asks again with the same request_id."""
_LOOK_S = 2.0
DISK_BYTES = 24 << 20
REWARD_IEC = Decimal(10)
WORKERS = ("worker1", "worker2")
"""People who work beside the robot, so that a task that hangs keeps no other."""
PARTICIPANTS = """participants = [
    { name = "worker1", kinds = ["waste_disposal"] },
    { name = "worker2", kinds = ["waste_disposal"] },
]
"""
PLACE = {"item_id": "item1", "x_m": 4.6, "y_m": 1.2}
"""Where item1 lies by the lab's site file."""

_DONE = (TaskState.SETTLED, TaskState.FAILED, TaskState.CANCELLED)


class NotSurvived(AssertionError):
    """What the case expected did not come true."""


def need(holds: object, why: str) -> None:
    """Raises NotSurvived."""
    if not holds:
        raise NotSurvived(why)


@dataclass
class _Up:
    name: str
    launcher: Launcher


class Lab:
    """One running site. `serve` belongs to the main thread, everything else to the script's."""

    def __init__(self, case: Case, folder: Path, template: Path | None = None) -> None:
        self.case = case
        self.folder = folder
        path = write_site(folder, case.backend, PARTICIPANTS + case.extra)
        self.path = path
        self.site = Site.load(path)
        self.data = self.site.data_dir
        if template is not None:
            shutil.copytree(template, self.data)
        ensure_wallets(self.site)
        (self.data / "logs").mkdir(parents=True, exist_ok=True)
        self.disk: SmallDisk | None = None
        if case.small_disk:
            self.disk = SmallDisk((self.data / case.small_disk).resolve(), self._writers)
            # Here, in the thread from which all others come: what it mounts is seen by those alone.
            self.disk.mount()
        self.clients: list[subprocess.Popen[bytes]] = []
        self.asked: dict[str, int] = {}
        """Label of a task that was posted -> its id."""
        self.unfinished: set[str] = set()
        """Labels of tasks that the case leaves open on purpose."""
        self._orders: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._ups: list[_Up] = []
        self._started: Counter[str] = Counter()
        self._pids: dict[str, int] = {}
        self._said: list[str] = []
        self._marks: dict[Path, int] = {}
        self._statuses: dict[str, Status] = {}
        self._lock = threading.Lock()
        self._bus: Bus | None = None
        self.closing = threading.Event()
        self._marked_s = time.monotonic()
        self._opened = ExitStack()
        self.sites: dict[str, Path] = {}
        """Site files of processes that are not started from the lab's own."""

    def enter(self, thing: AbstractContextManager[T]) -> T:
        """Open it until the end of the case."""
        return self._opened.enter_context(thing)

    # -- the main thread's part ----------------------------------------------------------------------------

    def serve(self) -> None:
        """Start, watch and stop children as the script orders, until `close`."""
        try:
            while not self.closing.is_set():
                try:
                    order = self._orders.get(timeout=POLL_S)
                except queue.Empty:
                    order = None
                if order is not None:
                    order()
                for up in list(self._ups):
                    self._poll(up)
        finally:
            for up in reversed(self._ups):
                up.launcher.__exit__(None, None, None)
            for client in self.clients:
                client.kill()
                client.wait()

    def _poll(self, up: _Up) -> None:
        try:
            up.launcher.poll()
        except RodeoError as error:
            self.say(f"rodeo up {up.name}: {error}")
            self._ups.remove(up)
            up.launcher.__exit__(None, None, None)
            return
        for name, pid in up.launcher.running().items():
            if self._pids.get(name) != pid:
                self._pids[name] = pid
                self._started[name] += 1
        for name, problem in up.launcher.problems().items():
            self.say(f"rodeo up: {name} {problem}")

    def _order(self, do: Callable[[], T]) -> T:
        done: Future[T] = Future()

        def order() -> None:
            try:
                done.set_result(do())
            except BaseException as error:  # noqa: BLE001 - whoever gave the order hears of it
                done.set_exception(error)

        self._orders.put(order)
        return done.result(timeout=HANG_S)

    def close(self) -> None:
        self._opened.close()
        if self._bus is not None:
            self._bus.close()
        self.closing.set()

    # -- processes -----------------------------------------------------------------------------------------

    def up(self, *names: str, site: Path | None = None) -> None:
        """`rodeo up NAME` for each; returns at once. Says why when one does not start."""

        def start(name: str) -> None:
            if site is None and any(one.name == name for one in self._ups):
                return  # it is up
            launcher = Launcher(site or self.sites.get(name, self.path), (name,))
            try:
                launcher.__enter__()
            except RodeoError as error:
                self.say(f"rodeo up {name}: {error}")
                return
            self._ups.append(_Up(name, launcher))

        for name in names:
            self._order(lambda name=name: start(name))  # type: ignore[misc]

    def down(self, *names: str, site: Path | None = None) -> None:
        """Ctrl-C for each of these; with `site` only those that were started from this file."""

        def end(name: str) -> None:
            for up in list(self._ups):
                if up.name == name and site in (None, up.launcher.site_path):
                    self._ups.remove(up)
                    up.launcher.__exit__(None, None, None)

        for name in names:
            self._order(lambda name=name: end(name))  # type: ignore[misc]

    def pid(self, name: str) -> int:
        pid = lock_holder(self.site.data_dir / name)
        need(pid is not None, f"{name} does not run")
        assert pid is not None
        return pid

    def kill(self, *names: str) -> None:
        """SIGKILL to all of them at once; their launchers start them again."""
        for pid in [self.pid(name) for name in names]:
            os.kill(pid, signal.SIGKILL)

    def frozen(self, name: str) -> Iterator[None]:
        """The end of a script: the process hangs while the fault stands."""
        pid = self.pid(name)
        os.kill(pid, signal.SIGSTOP)
        yield
        os.kill(pid, signal.SIGCONT)
        yield

    def restart_if_down(self, name: str) -> None:
        """What the operator does for a process that gave up; one that waits continues by itself."""
        if lock_holder(self.data / name) is None:
            self.down(name)
            self.up(name)

    def starts(self, name: str) -> int:
        """How often the process was started since the mark."""
        return self._started[name]

    def rodeo(self, *arguments: str, timeout_s: float = HANG_S, env: dict[str, str] | None = None) -> str:
        """What `rodeo ARGUMENTS` prints, whatever its exit status."""
        return self.program("rodeo_cli", *arguments, timeout_s=timeout_s, env=env)[1]

    def program(
        self, module: str, *arguments: str, timeout_s: float = HANG_S, env: dict[str, str] | None = None
    ) -> tuple[int, str]:
        """Exit status and output of `python -m MODULE ARGUMENTS`; 124 where it took longer than it may."""
        try:
            done = subprocess.run(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=timeout_s,
                env={**os.environ, "COLUMNS": "400", **(env or {})},
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            parts = [part for part in (error.stdout, error.stderr) if part]
            texts = [part.decode(errors="replace") if isinstance(part, bytes) else part for part in parts]
            return 124, "".join(texts)
        return done.returncode, done.stdout + done.stderr

    def new_chain(self) -> None:
        """`rodeo up --new-chain`, where the old chain's file is gone."""
        give_up_chain(self.site)
        self.up("chain")
        self.deploy()
        self.asked.clear()
        self.wait(lambda: self.ready("bridge"), "the bridge does not follow the new chain")
        if "robot_agent" not in self.case.processes:
            self.offer("panther1", *WORKERS)

    def deploy(self) -> None:
        status, output = self.program("deploy.contracts", "--site", str(self.path), timeout_s=HANG_S)
        need(status == 0, f"the contracts were not deployed: {output[-400:]}")

    def variant(self, name: str, extra: str, data: bool = True) -> Path:
        """A site file that differs from the lab's own by `extra`; with `data` from another machine: a data
        directory of its own, which has the keystores of the first."""
        path = self.folder / f"{name}.toml"
        text = f"extends = {json.dumps(str(self.path))}\n"
        if data:
            elsewhere = self.folder / name
            text += f"data_dir = {json.dumps(str(elsewhere))}\n"
            if "bus.router" not in extra:
                text += f"bus.router = {json.dumps(self.site.bus.router)}\n"
            elsewhere.mkdir(exist_ok=True)
            shutil.copytree(self.data / "keys", elsewhere / "keys")
            shutil.copytree(self.data / "deployments", elsewhere / "deployments")
        path.write_text(text + extra + "\n")
        return path

    # -- what is said --------------------------------------------------------------------------------------

    def say(self, text: str) -> None:
        with self._lock:
            if not self._said or self._said[-1] != text:
                self._said.append(text)

    def _logs(self) -> list[Path]:
        return sorted(self.folder.glob("*/logs/*.log"))

    def _writers(self) -> list[int]:
        """The processes that write to the small disk."""
        names = [name for name in self.case.processes if name == self.case.small_disk]
        if not names:
            names = ["oracle"] if self.case.small_disk == "store" else list(self.case.processes)
        return [self.pid(name) for name in names]

    def mark(self) -> None:
        """From now on `said` tells what is new."""
        with self._lock:
            self._said.clear()
            self._started.clear()
        self._marks = {path: path.stat().st_size for path in self._logs()}
        self._marked_s = time.monotonic()

    def said(self) -> str:
        """Everything that processes and launchers have said since the mark."""
        parts = []
        for path in self._logs():
            with path.open("rb") as log:
                log.seek(self._marks.get(path, 0))
                parts.append(log.read().decode(errors="replace"))
        with self._lock:
            return "\n".join([*self._said, *parts])

    def log(self, name: str) -> str:
        path = self.data / "logs" / f"{name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    def wait_for_log(self, folder: str, name: str, pattern: str) -> None:
        """Until the process with the data directory `folder` has logged this."""
        path = self.folder / folder / "logs" / f"{name}.log"
        wanted = re.compile(pattern, re.IGNORECASE | re.MULTILINE)
        self.wait(
            lambda: path.exists() and wanted.search(path.read_text(errors="replace")),
            f"the {name} of {folder} did not say /{pattern}/",
        )

    def wait_said(self, pattern: str) -> None:
        wanted = re.compile(pattern, re.IGNORECASE)
        look_s = time.monotonic() + _LOOK_S

        def heard() -> bool:
            nonlocal look_s
            if wanted.search(self.said()):
                return True
            if time.monotonic() >= look_s:
                self.look()
                look_s = time.monotonic() + _LOOK_S
            return False

        self.wait(heard, f"nobody said /{pattern}/")

    def look(self) -> None:
        """What `rodeo status` shows of processes that are not ready."""
        for row in read_rows(self.site, timeout_s=ASK_S):
            if row.state != "ready" and row.name in self.case.processes:
                self.say(f"{row.name} {row.state}: {row.reason}")

    # -- the bus -------------------------------------------------------------------------------------------

    @property
    def bus(self) -> Bus:
        if self._bus is None:
            shown = identity(self.site, OPERATOR)
            self._bus = Bus.open(self.site.bus.router, timeout_s=HANG_S, identity=shown)
            self._bus.subscribe_json(topics.STATUS.pattern(org=self.site.org), self._on_status)
        return self._bus

    def _on_status(self, _key: str, data: dict[str, Any]) -> None:
        status = Status.model_validate(data)
        self._statuses[status.process] = status
        for text in (status.reason, *status.warnings, status.activity):
            if text:
                self.say(f"{status.process}: {text}")

    def ready(self, name: str) -> bool:
        """What the process answers now."""
        holder = lock_holder(self.data / name)
        try:
            # Of all that are called so: there may be a second one.
            answers = self.bus.query_all(
                topics.STATUS.name(org=self.site.org, process=name), parameters={}, timeout_s=ASK_S, most=8
            )
        except BusError:
            return False
        for status in map(Status.model_validate, answers):
            if not status.ready:
                self.say(f"{name}: {status.reason}")
            if status.pid == holder:
                return status.ready
        return False

    def all_ready(self) -> bool:
        return all(self.ready(name) for name in self.case.processes)

    def not_ready(self) -> str:
        return ", ".join(
            f"{name}: {self._statuses[name].reason if name in self._statuses else 'never heard'}"
            for name in self.case.processes
            if not self.ready(name)
        )

    def wait(self, holds: Callable[[], object], why: str, within_s: float = HANG_S) -> None:
        deadline_s = time.monotonic() + within_s
        while not holds():
            if self.closing.wait(PAUSE_S) or time.monotonic() > deadline_s:
                raise NotSurvived(f"{why} within {within_s:.0f} s")

    def pause(self, seconds: float) -> None:
        self.closing.wait(seconds)

    def state(self, what: str, **parameters: Any) -> dict[str, Any]:
        return self.patiently(topics.STATE.name(org=self.site.org, what=what), None, parameters)

    def command(self, participant: str, name: str, **fields: Any) -> dict[str, Any]:
        """The reply, however often it has to be asked for: the fields hold a request_id."""
        assert "request_id" in fields
        return self.patiently(
            topics.COMMAND.name(org=self.site.org, participant=participant, command=name),
            fields,
        )

    def patiently(
        self, key: str, payload: dict[str, Any] | None, parameters: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """Raises NotSurvived when nobody answers, and RemoteError for an answer that is final."""
        deadline_s = time.monotonic() + HANG_S
        last: Exception | None = None
        while time.monotonic() < deadline_s and not self.closing.is_set():
            try:
                return self.bus.query(key, payload, parameters=parameters, timeout_s=ASK_S)
            except (BusError, RemoteError) as error:
                if not is_transient(error):
                    raise
                last = error
            self.pause(PAUSE_S)
        raise NotSurvived(f"no answer on {key} within {HANG_S:.0f} s: {last}")

    # -- work ----------------------------------------------------------------------------------------------

    def offer(self, *participants: str) -> None:
        """Let them have work, one task at a time each."""
        for name in participants:
            self.command(
                name,
                "register_service",
                kind="waste_disposal",
                price_iec=str(REWARD_IEC),
                request_id=f"service of {name}",
            )

    def post(self, label: str, **fields: Any) -> int:
        """A cleaning task of the organization, which is described by its label."""
        request = {
            "kind": "waste_disposal",
            "reward_iec": str(REWARD_IEC),
            "params": PLACE,
            "description": label,
            "request_id": f"task {label}",
            "max_attempts": 1,
            **fields,
        }
        self.asked.setdefault(label, 0)
        answer = self.command("organization", "register_task", **request)
        task_id = int(answer["task_id"])
        self.asked[label] = task_id
        return task_id

    def order(self, label: str, creator: str, **fields: Any) -> int:
        """A task of somebody else than the organization, and of another kind."""
        request = {"request_id": f"task {label}", "max_attempts": 1, "description": label, **fields}
        self.asked.setdefault(label, 0)
        task_id = int(self.command(creator, "register_task", **request)["task_id"])
        self.asked[label] = task_id
        return task_id

    def cancel(self, label: str) -> None:
        self.command("organization", "cancel_task", task_id=self.asked[label], request_id=f"cancel {label}")

    def cancel_if_open(self, label: str) -> None:
        """Cancel it, or end what somebody has to do already."""
        if self.state(f"task/{self.asked[label]}")["state"] == "open":
            try:
                self.cancel(label)
            except RemoteError as error:
                if error.code != "wrong_state":
                    raise
        if self.state(f"task/{self.asked[label]}")["state"] == "assigned":
            self.end(label)

    def finish(self, label: str, again: str = "") -> None:
        """Prove and judge a task in the executor's and the oracle's name."""
        sha256 = f"{self.asked[label]:064x}"
        self.submit(label, "0x" + sha256, f"{self.site.store_url}/{sha256}.mcap", again=again)
        self.judge(label, again)

    def finish_again(self, label: str) -> None:
        """Bring a task to its end that a reorganization took back.

        The same request returns its number now. Another assignment is proved again, and a lost verdict is
        posted again, unless what the bridge sends again comes first.
        """

        def is_its_number() -> bool:
            task_id = self.post(label)
            try:
                return bool(self.state(f"task/{task_id}")["description"] == label)
            except RemoteError as error:
                if error.code != "unknown_task":
                    raise
                return False

        self.wait(is_its_number, f"{label} is not there again")

        def is_ended() -> bool:
            state = self.state(f"task/{self.asked[label]}")["state"]
            if state in _ENDED:
                return True
            do = self.judge if state == "submitted" else self.finish
            try:
                do(label, " again")
            except RemoteError as error:
                if error.code != "wrong_state":  # what was sent again came first
                    raise
            return False

        self.wait(is_ended, f"{label} did not end")

    def judge(self, label: str, again: str = "") -> None:
        """Accept the proof that was submitted."""
        task_id = self.asked[label]
        # The index may hear of the proof a moment later than its sender.
        self.wait(
            lambda: self.state(f"task/{task_id}")["state"] not in ("open", "assigned"),
            f"no proof of {label} is in the index",
        )
        task = self.state(f"task/{task_id}")
        self.command(
            "oracle",
            "rule",
            request_id=f"verdict {label}{again}",
            task_id=task_id,
            attempt=task["attempt"],
            proof_sha256=task["proof_sha256"],
            ruling="accepted",
            amount_iec=task["price_iec"],
            reason="as it should be",
            report_sha256="0x" + "b" * 64,
            report_uri="",
        )

    def work(self, label: str) -> None:
        """One task, from the post to the payment; where robots work, which takes them a minute, a payment."""
        if "robot_agent" in self.case.processes:
            self.command("organization", "transfer", to="oracle", amount_iec="1", request_id=label)
            return
        self.post(label)
        self.end(label)

    def end(self, label: str) -> None:
        """Bring a posted task to its end."""
        if "oracle" in self.case.processes:
            self.ask_the_oracle(label)
        else:
            self.finish(label)

    def ask_the_oracle(self, label: str) -> None:
        """Submit what is no recording, which the oracle rejects: the quickest honest end of a task."""
        self.submit(label, *self.store(f"no recording: {label}".encode()))
        self.wait_ended(label)

    def submit(
        self, label: str, sha256: str, uri: str, task: dict[str, Any] | None = None, again: str = ""
    ) -> dict[str, Any]:
        """A proof in the executor's name, with `again` a new request; the task as it was before."""
        task = task or self.assigned(label)
        self.command(
            task["executor_name"],
            "submit_proof",
            request_id=f"proof {label}{again}",
            task_id=task["id"],
            attempt=task["attempt"],
            nonce=task["nonce"],
            proof_sha256=sha256,
            proof_uri=uri,
        )
        return task

    def assigned(self, label: str) -> dict[str, Any]:
        """The task once somebody has it."""
        task_id = self.asked[label]
        self.wait(
            lambda: self.state(f"task/{task_id}")["state"] != "open",
            f"task {task_id} ({label}) was not assigned",
        )
        return self.state(f"task/{task_id}")

    def store(self, data: bytes, suffix: str = ".mcap") -> tuple[str, str]:
        """Put bytes into the site's store; their hash and URI."""
        # Imported here: most cases put nothing into a store.
        from rodeo.evidence.store import Store

        uri, sha256 = Store(self.site).put_bytes(data, suffix)
        return sha256, uri

    def wait_ended(self, label: str) -> dict[str, Any]:
        """The task once it is settled, failed or cancelled."""
        task_id = self.asked[label]
        self.wait(
            lambda: self.state(f"task/{task_id}")["state"] in _ENDED,
            f"task {task_id} ({label}) did not end",
        )
        return self.state(f"task/{task_id}")

    # -- money ---------------------------------------------------------------------------------------------

    def client(self) -> ChainClient:
        return ChainClient(self.site.chain.url, Deployment.load(self.data, CHAIN_ID))

    def count_money(self) -> None:
        """Every task once, ended, and paid exactly once or not at all; the escrow holds the rest. Raises
        NotSurvived. Read from the contracts, and the bridge's index is held against them."""
        client = self.client()
        tasks = {number: client.tasks.task(number) for number in range(1, client.tasks.count() + 1)}
        head = int(self.state("chain")["head"])
        logs = client.logs(client.deployment.block, head)
        settled = Counter(log.event.task_id for log in logs if isinstance(log.event, TaskSettled))
        posted = Counter(
            json.loads(log.event.params)["description"]
            for log in logs
            if isinstance(log.event, TaskRegistered)
        )
        for label, task_id in self.asked.items():
            need(posted[label] == (1 if task_id else 0), f"task {label} was posted {posted[label]} times")
        for number, task in tasks.items():
            need(
                settled[number] == (1 if task.state is TaskState.SETTLED else 0),
                f"task {number} is {task.state.name} and was paid {settled[number]} times",
            )
        left = {self.asked[label] for label in self.unfinished}
        open_ones = {number for number, task in tasks.items() if task.state not in _DONE}
        need(open_ones == left, f"tasks that did not end: {sorted(open_ones - left)}")
        escrow, iec = client.token.balance(client.task_manager), client.currency.text
        held = sum(task.reward for number, task in tasks.items() if number in open_ones)
        owed = sum(
            client.tasks.pending_payments(entry["address"]) for entry in self.state("wallets")["wallets"]
        )
        need(
            escrow == held + owed,
            f"the escrow holds {iec(escrow)} IEC instead of {iec(held + owed)}",
        )
        # The index may be a block behind for a moment.
        differing: list[str] = []

        def agrees() -> bool:
            differing[:] = index_differences(self.state, client)
            return not differing

        try:
            self.wait(agrees, "the index and the contracts do not agree")
        except NotSurvived as error:
            raise NotSurvived(f"{error}: {'; '.join(differing[:3])}") from None

    # -- the whole run -------------------------------------------------------------------------------------

    def run(self) -> float:
        """Wall time, s, from the end of the fault until everything worked. Raises NotSurvived."""
        case = self.case
        if case.works:
            self.start()
        script = case.script(self)
        next(script)
        asker = self.post_beside("meanwhile") if case.asks else None
        problems: list[str] = []
        if case.said:
            try:
                self.wait_said(case.said + self._otherwise_said())
            except NotSurvived as error:
                problems.append(str(error))
        self.pause(max(0.0, case.held_s - (time.monotonic() - self._marked_s)))
        next(script)
        ended_s = time.monotonic()
        # What ended is wanted back by then; more waiting only tells how late it is.
        self.work("afterwards")
        self.wait(self.all_ready, "not ready again")
        recovery_s = time.monotonic() - ended_s
        if asker is not None:
            asker.result(timeout=HANG_S)
            self.end("meanwhile")
        next(script, None)
        self.count_money()
        need(not problems, "; ".join(problems))
        return recovery_s

    def _otherwise_said(self) -> str:
        """A limit for the size of files is not a full disk, and SQLite does not call it one."""
        limited = self.disk is not None and not self.disk.mounted
        return r"|cannot be written|file too large" if limited else ""

    def start(self) -> None:
        """Everything that the case needs, and one task done."""
        self.up(*(name for name in self.case.processes if name in BASE))
        if not Deployment.path(self.data, CHAIN_ID).exists():
            self.deploy()
        self.up(*(name for name in self.case.processes if name not in BASE))
        self.wait(self.all_ready, "the site did not start")
        if "robot_agent" not in self.case.processes:
            self.offer("panther1", *(WORKERS if self.case.workers else ()))
        self.work("before")
        self.mark()

    def post_beside(self, label: str) -> Future[int]:
        """Post a task, asking until it is answered, while the script continues."""
        done: Future[int] = Future()

        def ask() -> None:
            try:
                done.set_result(self.post(label))
            except BaseException as error:  # noqa: BLE001 - raised where the result is asked for
                done.set_exception(error)

        threading.Thread(target=ask, name="asker", daemon=True).start()
        return done


# -- disks -------------------------------------------------------------------------------------------------

_CLONE_NEWNS, _CLONE_NEWUSER = 0x00020000, 0x10000000
_MS_REC, _MS_PRIVATE = 0x4000, 0x40000


def own_mounts() -> bool:
    """Let this process mount what nobody else sees and what goes with it; whether the machine allows that."""
    libc = ctypes.CDLL(None, use_errno=True)
    if os.geteuid() == 0:
        allowed = libc.unshare(_CLONE_NEWNS) == 0
    else:
        user, group = os.geteuid(), os.getegid()
        allowed = libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNS) == 0
        if allowed:
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
            Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
    return allowed and libc.mount(None, b"/", None, _MS_REC | _MS_PRIVATE, None) == 0


class SmallDisk:
    """A folder on a tmpfs of its own that can be filled to the last byte.

    Where nothing can be mounted, `fill` limits the files of the processes instead, which then get EFBIG for
    whatever they write: their own folder's, and everything else.
    """

    def __init__(self, folder: Path, pids: Callable[[], list[int]]) -> None:
        self.folder = folder
        self._pids = pids
        self._filling = folder / "filling"
        self._limited: dict[int, tuple[int, int]] = {}
        self.mounted = False

    def mount(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        if not own_mounts():
            return
        kept = self.folder.with_name(self.folder.name + "-kept")
        self.folder.rename(kept)
        self.folder.mkdir()
        options = f"size={DISK_BYTES},mode=0700".encode()
        libc = ctypes.CDLL(None, use_errno=True)
        mounted = libc.mount(b"tmpfs", os.fsencode(self.folder), b"tmpfs", 0, options)
        self.mounted = mounted == 0
        shutil.copytree(kept, self.folder, dirs_exist_ok=True)
        shutil.rmtree(kept)

    def fill(self) -> None:
        if not self.mounted:
            for pid in self._pids():
                self._limited[pid] = resource.prlimit(pid, resource.RLIMIT_FSIZE)
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, self._limited[pid][1]))
            return
        with self._filling.open("ab", buffering=0) as file:
            for size in (1 << 16, 1 << 12, 1 << 9, 1):
                with suppress(OSError):  # it is full for pieces of this size
                    while file.write(bytes(size)) == size:
                        pass

    def free(self) -> None:
        for pid, limits in self._limited.items():
            with suppress(ProcessLookupError):  # it has ended meanwhile
                resource.prlimit(pid, resource.RLIMIT_FSIZE, limits)
        self._limited.clear()
        self._filling.unlink(missing_ok=True)
