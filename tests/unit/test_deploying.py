"""Everybody who waits for the contracts can read how far their deployment is, and by which process."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from rodeo.errors import AlreadyRunning
from rodeo.host.instance import LAUNCHER, lock_instance
from rodeo.site.config import Site
from rodeo.site.deploying import deploying, deployment_under_way, forget_deployment
from tests.support.site import write_site


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site.load(write_site(tmp_path))


def told(site: Site) -> str:
    return str(deployment_under_way(site) or "")


def test_a_deployment_tells_its_steps_while_it_runs(site: Site) -> None:
    assert told(site) == ""
    with deploying(site, threading.Event()) as steps:
        assert told(site) == "deploying contracts"
        steps.plan(2)
        steps.begin("OrganizationRegistry")
        assert told(site) == "deploying contracts, 1 of 2: OrganizationRegistry"
        steps.plan(4)
        steps.begin("IECoin", 3)
        assert told(site) == "deploying contracts, 2 of 6: IECoin"
        steps.begin("TaskManager")
        assert told(site) == "deploying contracts, 5 of 6: TaskManager"
        under_way = deployment_under_way(site)
        assert under_way is not None and under_way.pid == os.getpid()
    assert told(site) == ""


def test_a_launcher_that_has_just_begun_is_about_to_deploy(site: Site) -> None:
    with deploying(site, threading.Event()):
        pass
    lock = lock_instance(site.data_dir / LAUNCHER)
    # Of the launcher's own deployment, which is over.
    assert told(site) == ""
    forget_deployment(site)
    assert told(site) == "deploying contracts"
    os.close(lock)
    assert told(site) == ""


def test_a_second_deployment_waits_for_the_first(site: Site) -> None:
    stopped = threading.Event()
    stopped.set()
    with deploying(site, threading.Event()), pytest.raises(AlreadyRunning), deploying(site, stopped):
        pass
