"""`rodeo organization kind`, `rules`: the rules are those by which the site's oracle judges."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from eth_account import Account
from typer.testing import CliRunner

from rodeo.checks.rules import rules_hash
from rodeo.judging.votes import possession
from rodeo.kinds import kinds_of, load
from rodeo.site.config import Site
from rodeo_cli import app, forms, organization
from rodeo_testing import answers
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
    monkeypatch.setattr(forms, "send", lambda *_args, **fields: sent.update(fields))
    done = CliRunner().invoke(
        app, ["organization", "kind", name, "--judge", "oracle", "--site", str(listing)]
    )
    assert done.exit_code == 0, done.output
    assert sent["rules_sha256"] == rules_hash(kinds_of(Site.load(listing))[name])
    assert sent["rules_sha256"] != rules_hash(load(name))


def test_the_rules_of_the_site_file_are_the_installed_ones(
    listing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "waste_disposal"
    own, as_it_comes = rules_hash(kinds_of(Site.load(listing))[name]), rules_hash(load(name))
    told = {
        "ORGANIZATION": SimpleNamespace(kinds=[SimpleNamespace(kind=name, rules_sha256=[as_it_comes, own])]),
        "TASKS": SimpleNamespace(tasks=[], total=0),
    }
    asked = {getattr(organization.queries, what): answer for what, answer in told.items()}

    @contextmanager
    def running(path: Path) -> Iterator[tuple[Site, Any]]:
        yield Site.load(path), None

    monkeypatch.setattr(organization, "connected", running)
    monkeypatch.setattr(organization.queries, "ask", lambda _bus, _org, what, **_fields: asked[what])
    done = CliRunner().invoke(app, ["organization", "rules", "--json", "--site", str(listing)])
    assert done.exit_code == 0, done.output
    listed = {one["rules_sha256"]: one["installed"] for one in json.loads(done.stdout)["rules"]}
    assert listed == {own: True, as_it_comes: False}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"judge": "auditor"}, "judged by an auditor"),
        ({"judge": "oracle", "removed": True}, "its judge was removed"),
        ({"judge": OTHER[:42]}, f"judged by the contract {OTHER[:42]}"),
        (
            {"judge": "oracle", "audit_window_s": 3600},
            "the oracle; 1 h more for auditors, where the judge",
        ),
        ({"judge": "oracle", "allowed": False}, "not accepted"),
    ],
)
def test_a_kind_says_who_judges_it(changes: dict[str, Any], says: str) -> None:
    kind = {"kind": "x", "allowed": True, "min_window_s": 0, "audit_window_s": 0} | changes
    assert says in organization.kind_in_words(organization.queries.KindRules.model_validate(kind))


def test_void_attempts_are_counted_by_whose_doing_they_were() -> None:
    assert organization.voids_in_words({"nobody": 2, "creator": 1, "oracle": 0}) == (
        "2 nobody's doing, 1 the creator's doing"
    )
    assert organization.voids_in_words({}) == ""


def test_a_judge_signs_that_it_sits_for_its_owner(monkeypatch: pytest.MonkeyPatch) -> None:
    key, owner = Account.create(), "0x" + "cd" * 20
    asked = {
        organization.queries.CHAIN: answers.chain(),
        organization.queries.PARTICIPANTS: {"participants": []},
    }

    @contextmanager
    def connected(_site: Path) -> Iterator[tuple[Site, None]]:
        yield Site.load(LAB), None

    monkeypatch.setattr(organization, "connected", connected)
    monkeypatch.setattr("rodeo.signing.keystores.open_key", lambda *_: key)
    monkeypatch.setattr(
        organization.queries, "ask", lambda _bus, _org, query, **_: query.answer.model_validate(asked[query])
    )
    done = CliRunner().invoke(app, ["organization", "sign-seat", "anna", "--owner", owner])
    r, vs = possession(key, owner, answers.chain()["chain_id"], answers.CONTRACTS["OracleCommittee"])
    assert done.stdout.strip() == "0x" + (r + vs).hex(), done.output
