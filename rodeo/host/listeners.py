"""The process that listens on a port of this machine, for whoever finds that port taken."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_LISTENS = "0A"
"""State of a listening socket in /proc/net/tcp."""


def is_free(port: int, host: str = "127.0.0.1") -> bool:
    """Whether a process could listen there now."""
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
        except OSError:
            return False
    return True


def listener_on(port: int) -> str:
    """The process that listens on `port` in words, empty where it cannot be told (another user's).

    Of a process of RODEO its module and site; of any other its name alone: its options may hold secrets.
    """
    inodes = {f"socket:[{inode}]" for inode in _sockets(port)}
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            for entry in (process / "fd").iterdir():
                with suppress(OSError):
                    if os.readlink(entry) in inodes:
                        return _in_words(process)
    return ""


def _sockets(port: int) -> Iterator[str]:
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with suppress(OSError):
            for line in Path(table).read_text().splitlines()[1:]:
                fields = line.split()
                if fields[3] == _LISTENS and int(fields[1].rpartition(":")[2], 16) == port:
                    yield fields[9]


def _in_words(process: Path) -> str:
    words = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
    with suppress(ValueError, IndexError):
        module, site = words[words.index("-m") + 1], words[words.index("--site") + 1]
        if module.partition(".")[0] in ("services", "deploy"):
            return f"process {process.name}, {module} of the site {site}"
    return f"process {process.name}, {(process / 'comm').read_text().strip()}"
