"""One organization per backend, deployed once; each test brings its own tasks and services to an end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.organization import Organization, running_chain


@pytest.fixture(scope="session", params=["eth-tester", "anvil"])
def organization(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Organization]:
    with running_chain(request.param, tmp_path_factory.mktemp(request.param)) as site:
        organization = Organization(site)
        organization.deploy()
        yield organization
