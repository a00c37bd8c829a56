"""The bus as it is by default, and opened by choice: who can reach it, and who receives what."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from rodeo.bus.messages import Status
from rodeo.bus.session import Bus
from rodeo.host.instance import GAVE_UP
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo.site.tls import bus_is_closed
from rodeo_testing.waiting import HANG_S
from tests.integration.test_itrash import Office
from tests.support import command
from tests.support.browser import chromium, log_in
from tests.support.console import PASSPHRASE, WAIT_MS, Desk
from tests.support.site import LAB, RunningSite, free_port, write_site

pytestmark = pytest.mark.long

NOBODY = 65534
ROOT = Path(__file__).parents[2]

CONNECT = """
import socket, sys
with socket.socket(socket.AF_UNIX) as client:
    client.connect(sys.argv[1])
"""
"""Exit status 1 and PermissionError where the kernel keeps the caller out."""


def socket_of(site: RunningSite) -> Path:
    return Path(site.site.bus.router.removeprefix("unixsock-stream/"))


@pytest.fixture
def reachable() -> Iterator[RunningSite]:
    """A site of which every folder but the socket's may be entered by all."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        os.chmod(folder, 0o755)
        with RunningSite(write_site(Path(folder))) as running:
            running.start("router")
            yield running


def connects_as_nobody(path: Path) -> subprocess.CompletedProcess[str]:
    # Not our own interpreter: nobody need not be able to read where it is.
    return subprocess.run(
        ["/usr/bin/env", "python3", "-I", "-c", CONNECT, str(path)],
        user=NOBODY,
        group=NOBODY,
        extra_groups=[],
        cwd="/",
        env={"PATH": os.defpath},
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_another_user_of_the_machine_does_not_reach_the_bus(reachable: RunningSite) -> None:
    path = socket_of(reachable)
    assert path.is_socket()
    assert path.parent.stat().st_mode & 0o7777 == 0o700
    kept_out = connects_as_nobody(path)
    assert kept_out.returncode == 1 and "PermissionError" in kept_out.stderr
    # It is the folder that keeps them out: with that and the socket open they come in.
    path.parent.chmod(0o711)
    path.chmod(0o777)
    assert connects_as_nobody(path).returncode == 0


def test_a_router_that_was_killed_leaves_a_socket_that_the_next_one_takes_over(running: RunningSite) -> None:
    running.start("router")
    running.kill("router")
    assert socket_of(running).is_socket()
    running.start("router")
    Bus.open(running.site.bus.router, timeout_s=HANG_S).close()


def test_a_router_does_not_listen_where_others_could_be_it(running: RunningSite) -> None:
    folder = socket_of(running).parent
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    running.start("router", ready=False)
    assert running.children["router"].wait(HANG_S) == GAVE_UP
    assert "unsafe_socket_folder" in running.log("router") and str(folder) in running.log("router")
    running.children.clear()


def status(path: Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "COLUMNS": "300"}
    return command.rodeo("status", "--site", str(path), env=env, timeout_s=HANG_S, folder=ROOT)


@pytest.mark.parametrize("router", ["tcp/127.0.0.1:7447", "tcp/192.168.1.10:7447"])
def test_plain_tcp_is_refused_with_what_to_do_instead(tmp_path: Path, router: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f'extends = {json.dumps(str(LAB))}\ndata_dir = "data"\nbus.router = "{router}"\n')
    done = status(path)
    assert done.returncode == 1 and "config_error" in done.stderr
    assert all(word in done.stderr for word in (router, "tls/", "bus.open = true", "leave bus.router out"))


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSite]:
    """A site whose bus was opened by choice."""
    extra = f'bus.open = true\nbus.router = "tcp/127.0.0.1:{free_port()}"'
    with RunningSite(write_site(tmp_path_factory.mktemp("opened"), extra=extra)) as running:
        running.start("router")
        running.start("console", ready=False)
        yield running


def test_an_open_bus_is_told_of_by_status(opened: RunningSite) -> None:
    assert not bus_is_closed(opened.site)
    said = status(opened.path).stdout
    assert "the bus is open (bus.open = true)" in said and opened.site.bus.router in said
    assert any("the bus is open" in warning for warning in opened.status("router").warnings)


def test_a_site_on_an_open_bus_starts_only_for_who_knows_that_nobody_is_paid(opened: RunningSite) -> None:
    env = {**os.environ, "COLUMNS": "300"}
    done = command.rodeo("up", "--site", str(opened.path), env=env, timeout_s=HANG_S, folder=ROOT)
    assert done.returncode == 1 and "nobody is paid" in done.stderr and "--anyway" in done.stderr


def test_a_closed_bus_is_not_called_open(running: RunningSite) -> None:
    running.start("router")
    assert "bus is open" not in status(running.path).stdout
    assert running.status("router").warnings == []


def test_an_open_bus_is_told_of_on_the_consoles_pages(opened: RunningSite) -> None:
    opened.wait_for_status("console", lambda status: "http" in status.details)
    with chromium() as browser:
        desk = Desk(opened, browser)
        page = browser.new_page(base_url=desk.origin)
        page.set_default_timeout(WAIT_MS)
        page.goto("/")
        log_in(page, "reader", PASSPHRASE)
        for path in ("/", "/tasks"):
            page.goto(path)
            expect(page.get_by_text("The bus is open (bus.open = true)").first).to_be_visible()
        with desk.client("reader") as client:
            rows = {row["name"]: row for row in client.get("/processes").json()}
    assert any("the bus is open" in warning for warning in rows["router"]["warnings"])


def test_nobody_else_moves_the_sites_clock_and_whoever_tries_is_told_of(running: RunningSite) -> None:
    running.start("router")
    Office(running)
    running.start("robot_sim", "itrash")
    domain, session = running.site.bus.domain_id, running.bus.session
    far_future = b"\x00\x01\x00\x00" + struct.pack("<iI", 2**31 - 1, 0)
    key = f"{domain}/{topics.CLOCK.name()}/rosgraph_msgs::msg::dds_::Clock_/RIHS01_test"

    def told(status: Status) -> bool:
        session.put(key, far_future)
        return any("second publisher on /clock" in warning for warning in status.warnings)

    clock = SimClock(session, domain)
    running.wait_for_status("itrash", told)
    assert clock.wait_ready(threading.Event(), HANG_S) and clock.now_s() < 2**31 - 1
    assert "second publisher on /clock" in status(running.path).stdout
    assert "second publisher on /clock" in running.log("itrash")


def test_the_clock_is_followed_again_after_the_router_was_restarted(running: RunningSite) -> None:
    running.start("router", "robot_sim")
    clock = SimClock(running.bus.session, running.site.bus.domain_id)
    assert clock.wait_ready(threading.Event(), HANG_S)
    running.kill("router")
    running.start("router")
    before_s = clock.now_s()
    late = threading.Event()
    timer = threading.Timer(HANG_S, late.set)
    timer.start()
    assert clock.wait_until(before_s + 10.0, late)
    timer.cancel()
