"""A PostgreSQL cluster of the test's own, on a free port, in a folder that is removed."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.site import free_port

_DEBIAN = Path("/usr/lib/postgresql")
_START_S = "120"


@contextmanager
def postgresql() -> Iterator[str]:
    """The cluster's SQLAlchemy URL. Skips the test, and says why, where PostgreSQL is not installed."""
    binaries = _binaries()
    if binaries is None:
        pytest.skip("PostgreSQL is missing: make system")
    folder = Path(tempfile.mkdtemp(prefix="rodeo-pg-"))
    as_owner: list[str] = []
    if os.getuid() == 0:
        # PostgreSQL refuses to run as root; Debian's package brings its own user.
        owner = pwd.getpwnam("postgres")
        os.chown(folder, owner.pw_uid, owner.pw_gid)
        as_owner = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"]
    port = free_port()
    data, log = str(folder / "data"), str(folder / "log")

    def run(program: str, *arguments: str) -> None:
        # Output to a file: the server inherits it, and a pipe would never be at its end.
        with open(os.devnull, "wb") as nowhere:
            subprocess.run(
                [*as_owner, str(binaries / program), *arguments],
                check=True,
                stdout=nowhere,
                stderr=nowhere,
                stdin=subprocess.DEVNULL,
                cwd=folder,
            )

    try:
        run("initdb", "-D", data, "-U", "rodeo", "--auth=trust", "--no-sync")
        options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories= -c fsync=off"
        run("pg_ctl", "-D", data, "-l", log, "-w", "-t", _START_S, "-o", options, "start")
        try:
            yield f"postgresql+psycopg://rodeo@127.0.0.1:{port}/postgres"
        finally:
            run("pg_ctl", "-D", data, "-m", "immediate", "-w", "stop")
    finally:
        shutil.rmtree(folder)


def _binaries() -> Path | None:
    newest = sorted(_DEBIAN.glob("*/bin/initdb"))
    found = str(newest[-1]) if newest else shutil.which("initdb")
    return None if found is None else Path(found).parent
