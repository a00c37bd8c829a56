"""`rodeo organization kind`, `rules`: the rules are those by which the site's oracle judges."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo.checks.rules import rules_hash
from rodeo.config import Site
from rodeo.kinds import kinds_of, load
from rodeo_cli import app, organization
from tests.support.site import LAB

OTHER = "0x" + "ab" * 32


@pytest.fixture
def listing(tmp_path: Path) -> Path:
    """A site that lists another network, and another way of charging, beside what is installed."""
    path = tmp_path / "site.toml"
    path.write_text(
        f"extends = {json.dumps(str(LAB))}\n"
        f'[[kinds]]\nname = "waste_disposal"\nmodels_sha256 = ["{OTHER}"]\n'
        '[[kinds]]\nname = "battery_charging"\nrates = [{ from_hour = 0, iec = "0.5" }]\n'
    )
    return path


@pytest.mark.parametrize("name", ["waste_disposal", "battery_charging"])
def test_a_kind_is_announced_with_the_networks_and_rates_of_the_site_file(
    listing: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: dict[str, Any] = {}
    monkeypatch.setattr(organization, "send", lambda *_args, **fields: sent.update(fields))
    done = CliRunner().invoke(
        app, ["organization", "kind", name, "--review", "oracle", "--site", str(listing)]
    )
    assert done.exit_code == 0, done.output
    assert sent["rules_sha256"] == rules_hash(kinds_of(Site.load(listing))[name])
    assert sent["rules_sha256"] != rules_hash(load(name))


def test_the_rules_of_the_site_file_are_the_installed_ones(
    listing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "waste_disposal"
    own, as_it_comes = rules_hash(kinds_of(Site.load(listing))[name]), rules_hash(load(name))
    answers = {
        "ORGANIZATION": SimpleNamespace(kinds=[SimpleNamespace(kind=name, rules_sha256=[as_it_comes, own])]),
        "TASKS": SimpleNamespace(tasks=[], total=0),
    }
    asked = {getattr(organization.queries, what): answer for what, answer in answers.items()}

    @contextmanager
    def running(path: Path) -> Iterator[tuple[Site, Any]]:
        yield Site.load(path), None

    monkeypatch.setattr(organization, "connected", running)
    monkeypatch.setattr(organization.queries, "ask", lambda _bus, _org, what, **_fields: asked[what])
    done = CliRunner().invoke(app, ["organization", "rules", "--json", "--site", str(listing)])
    assert done.exit_code == 0, done.output
    listed = {one["rules_sha256"]: one["installed"] for one in json.loads(done.stdout)["rules"]}
    assert listed == {own: True, as_it_comes: False}
