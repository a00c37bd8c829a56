"""One organization per backend, deployed once; each test brings its own tasks and services to an end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.organization import Organization, founded, running_chain


@pytest.fixture(scope="session", params=["eth-tester", "anvil"])
def organization(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Organization]:
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "eth-tester":
        with founded(folder) as organization:
            yield organization
        return
    with running_chain(request.param, folder) as site:
        organization = Organization(site)
        organization.deploy()
        yield organization
