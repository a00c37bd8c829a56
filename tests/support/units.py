"""systemd for tests: processes started as the lines of their units say, and what they tell the manager."""

from __future__ import annotations

import os
import shlex
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from deploy.units import unit_name, units
from rodeo.host.instance import PARENT_VARIABLE
from rodeo.runtime.notify import SOCKET_VARIABLE
from rodeo.site.processes import processes_of
from tests.support.nursery import Fork
from tests.support.site import RunningSite

ROOT = Path(__file__).parents[2]

TESTS = {"PYTHONPATH": str(ROOT), PARENT_VARIABLE: str(os.getpid())}
"""What only the tests add: where the code is, and that no process outlives them."""


def settings(unit: str, name: str) -> list[str]:
    """Values of a setting in a unit, in order."""
    return [line.partition("=")[2] for line in unit.splitlines() if line.startswith(f"{name}=")]


def started(
    unit: str, credentials: Path, more: Mapping[str, str], output: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start a process as its unit says: its line, its folder, its environment, `more`, and nothing else."""

    def said(text: str) -> list[str]:
        known = text.replace("%d", str(credentials)).replace("%%", "%")
        return [word.replace("$$", "$") for word in shlex.split(known)]

    (line,), (folder,) = settings(unit, "ExecStart"), settings(unit, "WorkingDirectory")
    given = dict(one.split("=", 1) for text in settings(unit, "Environment") for one in said(text))
    folder_ = Path(*said(folder))
    folder_.mkdir(parents=True, exist_ok=True)
    return subprocess.Popen(
        said(line),
        cwd=folder_,
        env={"PATH": os.defpath, "LANG": "C.UTF-8", **given, **TESTS, **more},
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


class Manager:
    """A socket that hears what a process tells its service manager."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.said: list[str] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._listening = threading.Thread(target=self._listen, daemon=True)
        self._listening.start()

    def close(self) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
            own.sendto(b"", str(self.path))
        self._listening.join()
        self._socket.close()

    def _listen(self) -> None:
        while heard := self._socket.recv(65_536):
            self.said += heard.decode().splitlines()


class UnitsOfSite(RunningSite):
    """A site on which nothing was ever done, not even keystores, with a process for each of its units."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, wallets=False)
        self._names = {entry.name: unit_name(self.site, entry) for entry in processes_of(self.site)}
        self._folder = TemporaryDirectory(prefix="units-")
        passphrase = self.site.data_dir / "keys" / "passphrase"
        self._units = units(self.site, path, Path(sys.executable), "daemon", passphrase)
        self._managers: dict[str, Manager] = {}
        # What LoadCredential puts there.
        (Path(self._folder.name) / "passphrase").symlink_to(passphrase)

    def manager(self, name: str) -> Manager:
        """What hears process `name`."""
        return self._managers[name]

    def stop(self) -> None:
        super().stop()
        for manager in self._managers.values():
            manager.close()
        assert all("STOPPING=1" in one.said for one in self._managers.values())
        self._folder.cleanup()

    def spawn(
        self, name: str, module: str, arguments: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes] | Fork:
        if name not in self._names:
            return super().spawn(name, module, arguments)
        folder = Path(self._folder.name)
        self._managers[name] = manager = Manager(folder / name)
        logs = self.site.data_dir / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        with open(logs / f"{name}.log", "ab") as output:
            notified = {SOCKET_VARIABLE: str(manager.path)}
            return started(self._units[self._names[name]], folder, notified, output.fileno())
