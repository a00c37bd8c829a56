"""A command acts on its own site's bus, and says whose it is otherwise."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from rodeo.bus.origin import check_bus, record_path
from rodeo.bus.session import Bus, zenoh_config
from rodeo.errors import WrongBus
from rodeo.runtime.process import Process
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S
from tests.support.site import free_port, write_site

OURS, THEIRS = "0x" + "11" * 20, "0x" + "22" * 20


def make_site(folder: Path, router: str, org: str = "lab", contract: str = "") -> Site:
    folder.mkdir()
    site = Site.load(write_site(folder, extra=f'org = "{org}"\n[bus]\nopen = true\nrouter = "{router}"'))
    if contract:
        path = record_path(site.data_dir, site.chain.id)
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps({"genesis_hash": "0xab", "contracts": {"Organization": contract}}))
    return site


@pytest.fixture
def router() -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    session = zenoh.open(zenoh_config("router", listen=[endpoint]))
    yield endpoint
    session.close()


@pytest.fixture
def theirs(tmp_path: Path, router: str) -> Iterator[Site]:
    """A site of the organization `lab` that runs."""
    site = make_site(tmp_path / "theirs", router, contract=THEIRS)
    with Process("bridge", site, threading.Event()):
        yield site


def check(site: Site) -> None:
    with Bus.open(site.bus.router, timeout_s=HANG_S) as bus:
        check_bus(bus, site)


def test_the_sites_own_bus_is_right(theirs: Site) -> None:
    check(theirs)


def test_another_computer_of_the_site_has_the_same_contracts(
    theirs: Site, tmp_path: Path, router: str
) -> None:
    check(make_site(tmp_path / "robot", router, contract=THEIRS))


@pytest.mark.parametrize(
    ("org", "contract"), [("lab", OURS), ("lab", ""), ("harbour", OURS), ("harbour", "")]
)
def test_another_sites_bus_is_named(
    theirs: Site, tmp_path: Path, router: str, org: str, contract: str
) -> None:
    with pytest.raises(WrongBus) as wrong:
        check(make_site(tmp_path / "ours", router, org, contract))
    assert str(theirs.data_dir) in wrong.value.message and "organization lab" in wrong.value.message
    assert router in wrong.value.message


def test_a_bus_with_nobody_on_it_is_nobodys(tmp_path: Path, router: str) -> None:
    check(make_site(tmp_path / "ours", router))


def test_a_process_does_not_join_a_bus_of_other_contracts(theirs: Site, tmp_path: Path, router: str) -> None:
    ours = make_site(tmp_path / "ours", router, contract=OURS)
    with pytest.raises(WrongBus, match="belongs to"), Process("oracle", ours, threading.Event()):
        pass
