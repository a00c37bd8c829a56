"""Fixtures of every test: sites of their own on free ports, and their real processes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from rodeo.bus.session import zenoh_config
from rodeo_testing.waiting import HANG_S
from tests.support.nursery import Nursery
from tests.support.site import NewSite, RunningSite, free_port, write_site

_hung = set[str]()
"""Files of this worker in which a test ended after HANG_S."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--chain",
        choices=("eth-tester", "anvil"),
        default="eth-tester",
        help="which local chain the integration tests run on",
    )
    parser.addoption(
        "--forks",
        action="store_true",
        help="fork the processes of sites from one that has imported what they need; else each imports it",
    )


def pytest_configure() -> None:
    """Whatever starts the tests in the background has SIGINT ignored, and children inherit that: a test that
    interrupts a process as Ctrl-C does would wait indefinitely."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """schemathesis gives the tests of all operations one id, and of those pytest-xdist would run only one."""
    for item in items:
        if label := getattr(item, "operation_label", None):
            item._id = item.id.with_params(label)
    # It waits for the package index for most of a minute. At the end, nothing else would run meanwhile.
    items.sort(key=lambda item: item.path.name != "test_resolution.py")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed and report.duration >= HANG_S:
        _hung.add(report.nodeid.partition("::")[0])


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Where one test hangs, those after it on the same site would wait as long, one after the other."""
    if item.nodeid.partition("::")[0] in _hung:
        pytest.fail("a test of this file has hung before", pytrace=False)


@pytest.fixture(scope="session")
def chain_backend(request: pytest.FixtureRequest) -> str:
    return str(request.config.getoption("--chain"))


@pytest.fixture(scope="session", autouse=True)
def nursery(request: pytest.FixtureRequest) -> Iterator[None]:
    """With `--forks`, processes of sites are forks of one that has imported what they need."""
    if not request.config.getoption("--forks"):
        yield
        return
    with Nursery() as RunningSite.nursery:
        yield
    RunningSite.nursery = None


@pytest.fixture(scope="session")
def new_site(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> NewSite:
    """A site file in a folder of its own, with the given TOML."""
    return lambda extra="": write_site(tmp_path_factory.mktemp("site"), chain_backend, extra)


@pytest.fixture
def connect() -> Iterator[Callable[[], zenoh.Session]]:
    """Opens sessions on a router of the test's own."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = zenoh.open(zenoh_config("router", listen=[endpoint]))
    with ExitStack() as sessions:
        yield lambda: sessions.enter_context(zenoh.open(zenoh_config("client", connect=[endpoint])))
    router.close()


@pytest.fixture
def site_path(tmp_path: Path, chain_backend: str) -> Path:
    """A site file of the test's own: the lab on free ports, data under the test's folder."""
    return write_site(tmp_path, chain_backend)


@pytest.fixture
def running(site_path: Path) -> Iterator[RunningSite]:
    """Start processes with `running.start(...)`; whatever was started is stopped at the end."""
    with RunningSite(site_path) as site:
        yield site
