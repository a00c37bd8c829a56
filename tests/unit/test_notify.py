"""What a process tells the service manager that started it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from rodeo.runtime.notify import SOCKET_VARIABLE, ServiceManager
from rodeo.runtime.process import Process
from rodeo.site.config import Site
from rodeo_testing.waiting import wait_until
from tests.support.nodes import router_port as router_port
from tests.support.site import write_site
from tests.support.units import Manager


@pytest.fixture
def manager() -> Iterator[Manager]:
    with TemporaryDirectory(prefix="notify-") as folder, closing(Manager(Path(folder) / "socket")) as one:
        yield one


def test_a_process_is_ready_once_and_alive_again_and_again(manager: Manager) -> None:
    told = ServiceManager({SOCKET_VARIABLE: str(manager.path)})
    told.alive("waiting for\n/clock", hangs=False)
    told.ready()
    told.ready()
    told.alive("", hangs=False)
    told.close()
    wait_until(lambda: "STOPPING=1" in manager.said)
    assert manager.said == [
        *("STATUS=waiting for /clock", "EXTEND_TIMEOUT_USEC=60000000", "WATCHDOG=1"),
        *("READY=1", "STATUS=ready"),
        *("STATUS=ready", "WATCHDOG=1"),
        "STOPPING=1",
    ]


def test_a_process_that_hangs_is_not_alive(manager: Manager) -> None:
    told = ServiceManager({SOCKET_VARIABLE: str(manager.path)})
    told.ready()
    told.alive("it hangs", hangs=True)
    told.close()
    wait_until(lambda: "STOPPING=1" in manager.said)
    assert "STATUS=it hangs" in manager.said and "WATCHDOG=1" not in manager.said


def test_a_socket_of_the_abstract_namespace_is_found() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind("")  # the kernel chooses an abstract name
        name = heard.getsockname().decode()
        ServiceManager({SOCKET_VARIABLE: name.replace("\0", "@", 1)}).ready()
        assert heard.recv(100) == b"READY=1\nSTATUS=ready"


def test_a_manager_that_is_gone_ends_no_process(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ServiceManager({SOCKET_VARIABLE: str(tmp_path / "nobody")}).ready()
    assert "the service manager cannot be told READY=1" in caplog.text


def test_a_process_says_that_it_is_ready_when_it_is_and_no_longer_that_it_is_alive_when_it_hangs(
    tmp_path: Path, router_port: int, manager: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SOCKET_VARIABLE, str(manager.path))
    monkeypatch.setattr("rodeo.runtime.presence.HEARTBEAT_S", 0.02)
    site = Site.load(
        write_site(tmp_path, extra=f'bus.open = true\nbus.router = "tcp/127.0.0.1:{router_port}"')
    )
    with Process("oracle", site, threading.Event()) as process:
        wait_until(lambda: "STATUS=starting" in manager.said)
        assert "READY=1" not in manager.said and "WATCHDOG=1" in manager.said
        process.ready(lapses_s=0.001)
        wait_until(lambda: any(one.startswith("STATUS=it hangs") for one in manager.said))
        del manager.said[:]
        wait_until(lambda: sum(one.startswith("STATUS=it hangs") for one in manager.said) >= 3)
        assert "WATCHDOG=1" not in manager.said
        process.not_ready("waiting for a router")
        wait_until(lambda: "STATUS=waiting for a router" in manager.said and "WATCHDOG=1" in manager.said)
    assert "STOPPING=1" in manager.said
