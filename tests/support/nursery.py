"""A site's processes as forks of one process that has imported what they need.

A run of the tests starts some hundred processes. Importing takes most of the processor time of a start: three
seconds where it signs, and a fork takes milliseconds. From there on it is as `python -m MODULE` is: a process
and a session of its own, with its arguments, environment, output, signals and exit status, and it ends with
the one that started it. Launchers, and with them `rodeo up` and `make demo`, start theirs anew, in tests too.

Commands of `rodeo` are forks as well (`tests.support.command`): most only ask the bridge something, and take
ten times as long to import.
"""

from __future__ import annotations

import faulthandler
import fcntl
import gc
import importlib
import json
import multiprocessing.util
import os
import runpy
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from rodeo.host.instance import PARENT_VARIABLE

_ROOT = Path(__file__).parents[2]

_IMPORTED = {
    "deploy.chain": "deploy.chain.process",
    "deploy.contracts": "deploy.contracts",
    "deploy.router": "deploy.router",
    "rodeo_cli": "rodeo_cli",
    "services.bridge": "services.bridge.process",
    "services.charger": "services.charger.process",
    "services.console": "services.console.process",
    "services.itrash": "services.itrash.process",
    "services.oracle": "services.oracle.process",
    "services.robot_agent": "services.robot_agent.process",
    "services.robot_recorder": "services.robot_recorder.process",
    "services.robot_sim": "services.robot_sim.process",
    "services.ros_dao": "services.ros_dao.process",
}
"""Module that is run -> what is imported before the fork; one that is not here imports everything itself."""

_CHECKS = ("rodeo.checks.verify", "rodeo_kinds.waste_disposal.checks")
_IMPORTED_LATER = {
    "rodeo_cli": ("rodeo.dao", *_CHECKS),
    "services.oracle": (*_CHECKS, "rodeo_kinds.battery_charging.checks", "services.oracle.preload"),
}
"""What it imports only once it is needed, which is imported before the fork, too. The oracle's verifications
need it: they are forks of a fork server, which is made from the same process (`_fork_server_too`). That one
loads the network itself: loading starts a thread, and forks without it abort when they end."""

_MESSAGE_BYTES = 1 << 17
"""Room for the arguments and the environment of a process (Linux gives one string of them as much)."""


_HIGH = 100
"""Descriptors from here on are nobody's yet in a process that has just been forked."""

_NUMBER = struct.Struct("=i")
"""As a process's id and its exit status are told."""


class Fork:
    """A process of the nursery, with what tests use of `subprocess.Popen`."""

    def __init__(self, news: int) -> None:
        self.returncode: int | None = None
        self._news = news
        """Gives the process's id, later its exit status, and nothing when the nursery is gone."""
        told = os.read(news, _NUMBER.size)
        assert told, "the nursery ended; what it printed tells why"
        (self.pid,) = _NUMBER.unpack(told)

    def poll(self) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Raises subprocess.TimeoutExpired after `timeout` seconds of wall time."""
        if self.returncode is None:
            if not select.select([self._news], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            told = os.read(self._news, _NUMBER.size)
            os.close(self._news)
            # The end of the nursery ends its children.
            self.returncode = _NUMBER.unpack(told)[0] if told else -signal.SIGTERM
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def tell_stacks(self) -> None:
        """Have the process write where each of its threads is to its output."""
        self.send_signal(signal.SIGUSR1)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class Nursery:
    """Starts processes as forks. Use as a context manager; its own process starts with the first of them."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket

    def __enter__(self) -> Nursery:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            # Not only closed: that would be too little where somebody else has a copy of it.
            self._control.shutdown(socket.SHUT_RDWR)
            self._control.close()
            self._process.wait()

    def start(
        self,
        module: str,
        arguments: Sequence[str],
        output: IO[bytes],
        env: Mapping[str, str],
        *,
        errors: IO[bytes] | None = None,
        folder: Path | None = None,
    ) -> Fork:
        """`python -m module arguments`, with the output to `output` and nothing to read.

        Its standard error goes to `errors`, by default to `output`, too. It runs in `folder`, by default in
        the folder of the test.
        """
        if self._process is None:
            self._begin()
        reader, writer = os.pipe()
        asked = {
            "module": module,
            "arguments": list(arguments),
            "env": dict(env),
            "folder": str(folder or Path.cwd()),
        }
        told = [output.fileno(), (errors or output).fileno(), writer]
        try:
            socket.send_fds(self._control, [json.dumps(asked).encode()], told)
        finally:
            os.close(writer)
        return Fork(reader)

    def _begin(self) -> None:
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _MESSAGE_BYTES)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.support.nursery", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                cwd=_ROOT,
                start_new_session=True,
            )


def main(control: socket.socket) -> None:
    """Fork what is asked for on `control` and tell how each ends, until it is closed."""
    given = dict(os.environ)
    reporting: dict[int, int] = {}
    """Process -> where its exit status is published."""
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    os.set_blocking(writer, False)
    signal.signal(signal.SIGCHLD, lambda _number, _frame: None)
    signal.set_wakeup_fd(writer)
    while True:
        ready = select.select([control.fileno(), reader], [], [])[0]
        if reader in ready:
            os.read(reader, 4096)
            _report(reporting)
        if control.fileno() not in ready:
            continue
        message, descriptors, _, _ = socket.recv_fds(control, _MESSAGE_BYTES, 3)
        if not message:
            return
        output, errors, news = descriptors
        asked = json.loads(message)
        # A module that cannot be imported is the child's to tell of.
        with suppress(ImportError):
            importlib.import_module(_IMPORTED.get(asked["module"], "rodeo.runtime.process"))
            for name in _IMPORTED_LATER.get(asked["module"], ()):
                importlib.import_module(name)
        gc.collect()
        # What is imported is not looked at again: pages that nobody touches stay shared.
        gc.freeze()
        parent = os.getpid()
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            control.close()
            for descriptor in (reader, writer, news, *reporting.values()):
                os.close(descriptor)
            # MuJoCo's importers choose its OpenGL back end so.
            imports = {name: value for name, value in os.environ.items() if given.get(name) != value}
            _become(asked, {**imports, **asked["env"]}, parent, output, errors)
            return
        os.close(output)
        os.close(errors)
        reporting[pid] = news
        _send(news, pid)


def _report(reporting: dict[int, int]) -> None:
    """Tell how those ended that have, by the numbers of `subprocess.Popen.returncode`."""
    while reporting:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid == 0:
            return
        news = reporting.pop(pid)
        _send(news, os.waitstatus_to_exitcode(status))
        os.close(news)


def _send(news: int, number: int) -> None:
    # Nobody may be there to read it: a test that took too long has given up.
    with suppress(BrokenPipeError):
        os.write(news, _NUMBER.pack(number))


def _become(asked: dict[str, Any], env: dict[str, str], parent: int, output: int, errors: int) -> None:
    """Run the module in this process."""
    os.setsid()
    os.dup2(output, 1)
    os.dup2(errors, 2)
    os.close(output)
    os.close(errors)
    faulthandler.register(signal.SIGUSR1)
    os.chdir(asked["folder"])
    os.environ.clear()
    os.environ.update(env)
    if PARENT_VARIABLE in os.environ:
        os.environ[PARENT_VARIABLE] = str(parent)
    module = asked["module"]
    if module == "services.oracle":
        _fork_server_too()
    # Run, it is `__main__`, and not imported as well.
    if module in _IMPORTED.values():
        sys.modules.pop(module, None)
    # The command line looks at its terminal and at its folder while it is imported.
    for name in [name for name in sys.modules if name.startswith("rodeo_cli.")]:
        del sys.modules[name]
    sys.argv = [module, *asked["arguments"]]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _fork_server_too() -> None:
    """Have the fork server of multiprocessing be a fork of this process as it is now, with one thread and
    everything imported. It waits until it is asked for."""
    control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    pid = os.fork()
    if pid == 0:
        control.close()
        message, descriptors, _, _ = socket.recv_fds(theirs, _MESSAGE_BYTES, 8)
        theirs.close()
        if message:
            program, numbers = json.loads(message)
            # First out of the way of each other.
            moved = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, _HIGH) for descriptor in descriptors]
            for descriptor, number in zip(moved, numbers, strict=True):
                os.dup2(descriptor, number)
            try:
                exec(program, {})
            finally:
                os._exit(0)
        os._exit(0)
    theirs.close()
    util: Any = multiprocessing.util  # what is replaced here is not declared alike everywhere
    spawn = util.spawnv_passfds

    def fork_or_spawn(path: str, arguments: Sequence[str], given: Sequence[int]) -> int:
        program = arguments[-1]
        if "multiprocessing.forkserver" not in str(program):
            return int(spawn(path, arguments, given))
        util.spawnv_passfds = spawn
        socket.send_fds(control, [json.dumps([program, list(given)]).encode()], given)
        control.close()
        return pid

    util.spawnv_passfds = fork_or_spawn


if __name__ == "__main__":
    main(socket.socket(fileno=int(sys.argv[1])))
