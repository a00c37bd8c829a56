"""The hash of a kind's rules is the same for whoever has the same rules, and another for other rules."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from dataclasses import replace
from decimal import Decimal
from importlib.resources.abc import Traversable
from pathlib import Path

import pytest
from pydantic import BaseModel

from rodeo.checks import rules
from rodeo.checks.rules import Source, rules_hash
from rodeo.kinds import Kind, KindError, load
from rodeo.site.sections import RateConfig
from rodeo.vision.classification import model_sha256

CHECKS = '''"""Is the robot there?"""

from rodeo.checks.case import Checks
from rodeo.checks.report import at_most

LIMIT_M = 0.5
"""A stride."""


def arrived(case):
    """It is."""
    return at_most(0.1, LIMIT_M, "m", source="the # of the map")  # near enough


CHECKS = Checks(stages=((arrived,),), recognizes=lambda proof, site: False)
'''


class Params(BaseModel):
    place: str


class MoreParams(Params):
    wait_s: float


class DescribedParams(BaseModel):
    """Where to go."""

    place: str


KIND = Kind("visit", "Visit", "", "oracle", params=Params, checks="visit_kind.checks:CHECKS")


def where(module: str) -> Traversable:
    path = rules._path(module)
    assert path is not None, module
    return path


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Hash of `KIND` with these checks, each time installed in another folder."""
    count = 0

    def of(text: str, kind: Kind = KIND) -> str | None:
        nonlocal count
        count += 1
        package = tmp_path / str(count) / "visit_kind"
        package.mkdir(parents=True)
        (package / "__init__.py").write_text("")
        (package / "checks.py").write_bytes(text.encode())
        monkeypatch.syspath_prepend(package.parent)
        for name in [name for name in sys.modules if name.startswith("visit_kind")]:
            del sys.modules[name]
        importlib.invalidate_caches()
        clear()
        return rules_hash(kind)

    def clear() -> None:
        rules.sources_of.cache_clear()
        paths.cache_clear()

    paths, read = rules._path, rules._source
    monkeypatch.setattr(
        rules, "_source", lambda name: read(name) if name.startswith("rodeo") else read.__wrapped__(name)
    )
    yield of
    clear()


@pytest.mark.parametrize(
    "same",
    [
        CHECKS,
        CHECKS.replace("\n", "\r\n"),
        CHECKS.replace("  # near enough", ""),
        CHECKS.replace('"""A stride."""', '"""Two\nsteps."""'),
        CHECKS.replace("\n\n\n", "\n\n\n\n"),
    ],
    ids=["elsewhere", "line ends", "comment", "docstring", "empty lines"],
)
def test_where_it_lies_and_what_only_people_read_changes_no_hash(installed, same: str) -> None:
    assert installed(same) == installed(CHECKS)


@pytest.mark.parametrize(
    "other",
    [
        CHECKS.replace("0.5", "0.6"),
        CHECKS.replace("at_most(0.1,", "at_most(0.2,"),
        CHECKS.replace("the # of", "the # in"),
        CHECKS.replace("case import Checks", "case import Checks, Case"),
    ],
    ids=["limit", "code", "text", "import"],
)
def test_another_limit_or_other_source_has_another_hash(installed, other: str) -> None:
    assert installed(other) != installed(CHECKS)


def test_a_line_that_ends_in_a_docstring_is_a_rule_all_the_same(installed) -> None:
    one_line = 'class Away(Exception): """It is not."""\n'
    assert installed(CHECKS + one_line) != installed(CHECKS + one_line.replace("Exception", "ValueError"))
    assert installed(CHECKS + one_line) == installed(CHECKS + one_line.replace("It is not", "Gone"))


def test_what_the_parameters_are_called_for_people_changes_no_hash(installed) -> None:
    assert installed(CHECKS, replace(KIND, params=DescribedParams)) == installed(CHECKS)


def test_other_parameters_have_another_hash(installed) -> None:
    assert installed(CHECKS, replace(KIND, params=MoreParams)) != installed(CHECKS)


def test_a_changed_shared_check_changes_the_hash_of_kinds_that_use_it_alone(
    installed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def changed(module: str) -> None:
        path = tmp_path / f"{module}.py"
        path.write_text(where(f"rodeo.checks.{module}").read_text() + "\nMORE = 1\n")
        monkeypatch.setattr(
            rules, "_source", lambda name: Source(name, path) if name.endswith(module) else read(name)
        )

    read, before = rules._source, installed(CHECKS)
    changed("motion.gripper")
    assert installed(CHECKS) == before
    changed("report")
    assert installed(CHECKS) != before


def test_a_kind_that_people_judge_has_no_rules() -> None:
    assert rules_hash(Kind("plants", "Plants", "", "auditor")) is None


BEHIND = {
    "rodeo.site.minds": "who thinks for a robot",
    "rodeo.site.ros_names": "names of nodes",
    "rodeo.site.faults": "what no site file may say",
    "rodeo.site.file": "a site's own settings",
    "rodeo.site.names": "names of processes",
    "rodeo.site.processes": "which processes a site has",
    "rodeo.site.providers": "which process speaks for a device",
    "rodeo.host.budget": "how often somebody may ask",
    "rodeo.bus.session": "carries messages",
    "rodeo.chain.contracts.abi": "names of what is on chain",
    "rodeo.chain.artifacts": "names of what is on chain",
    "rodeo.chain.node.errors": "what a node or a contract refuses",
    "rodeo.chain.proposals": "what members decide about",
    "rodeo.chain.contracts.types": "names of what is on chain",
    "rodeo.host.clock": "whose time a process goes by",
    "rodeo.host.clocked": "how a process waits in it",
    "rodeo.dao": "asks the organization's index",
    "rodeo.display.formatting": "times in words",
    "rodeo.site.endpoint": "addresses of processes",
    "rodeo.evidence.recorder": "writes recordings",
    "rodeo.evidence.upload": "stores recordings",
    "rodeo.evidence.writer": "writes recordings",
    "rodeo.lab.rooms": "a site's own walls",
    "rodeo.host.metrics": "counts",
    "rodeo.person.statement": "writes recordings",
    "rodeo.host.proxies": "ways to servers",
    "rodeo.bus.queries": "shapes of what the index answers",
    "rodeo.bus.receiving": "carries messages",
    "rodeo.bus.sending": "counts messages",
    "rodeo.money.rewards": "what is offered for work",
    "rodeo.judging.rulings": "who rules on what is on chain",
    "rodeo.chain.signed_requests": "signs for relayers",
    "rodeo.site.tls": "certificates",
    "rodeo.judging.verdicts": "verdicts in words",
    "rodeo.judging.votes": "what judges sign",
}
"""What is imported behind `UNDECIDING` alone, and why it decides nothing."""


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("waste_disposal", {"rodeo.money.currency": "a cleaning is paid its price, in no parts"}),
        (
            "battery_charging",
            {
                "rodeo.vision.images": "a charge has no pictures",
                "rodeo_kinds.battery_charging.problems": "what is wrong with a site file",
            },
        ),
    ],
    ids=["waste_disposal", "battery_charging"],
)
def test_a_changed_constant_in_whatever_a_verification_imports_is_another_rule(
    kind: str, more: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Except in what decides nothing, and in what only that imports."""

    def hash_with(module: str, text: str) -> str | None:
        path = tmp_path / where(module).name
        path.write_text(text)
        with monkeypatch.context() as patched:
            patched.setattr(
                rules, "_source", lambda name: Source(name, path) if name == module else read(name)
            )
            rules.sources_of.cache_clear()
            return rules_hash(loaded)

    loaded, read = load(kind), rules._source
    before, decide = rules_hash(loaded), rules.sources_of(f"rodeo_kinds.{kind}.checks")
    roots = {f"rodeo_kinds.{kind}.checks", "rodeo.checks.verify"}
    by_name = {name for one in decide.values() for name in one.imports}
    named = by_name | {name.rpartition(".")[0] for name in by_name} | roots
    code = f"import sys, rodeo.checks.verify, rodeo_kinds.{kind}.checks; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    behind = BEHIND | more
    assert named.isdisjoint(behind)
    for module in sorted(done.stdout.split()):
        if not module.startswith(("rodeo.", "rodeo_kinds.")) or where(module).name == "__init__.py":
            continue
        text = where(module).read_text(encoding="utf-8")
        other = re.sub(r"(?m)^(_?[A-Z][A-Z_0-9]* = )", r"\1not ", text, count=1)
        same = hash_with(module, other if other != text else text + "\nMORE = 1\n") == before
        # What is sent to the organization decides nothing either.
        sent = module.startswith("rodeo.commands.")
        assert same == (sent or module in rules.UNDECIDING or module in behind), module
    rules.sources_of.cache_clear()


def test_a_model_and_the_definitions_of_messages_are_rules() -> None:
    found = rules.rules(load("waste_disposal"))
    assert found is not None
    assert found["files"].keys() == {"rodeo.lab/panther_viperx.xml", "rodeo.ros2/definitions.json"}


def test_relative_imports_are_imports(tmp_path: Path) -> None:
    path = tmp_path / "checks.py"
    path.write_text("from . import near\nfrom .limits import LIMIT_M\nfrom ..shared.map import walls\n")
    named = {"lab.visit.near", "lab.visit.limits.LIMIT_M", "lab.shared.map.walls"}
    assert Source("lab.visit.checks", path).imports == named


def test_a_network_counts_where_the_kind_lists_it_and_that_makes_other_rules() -> None:
    kind, other = load("waste_disposal"), "0x" + "33" * 32
    listing = replace(kind, models_sha256=(other,))
    assert kind.models() == [model_sha256()]
    assert listing.models() == sorted([model_sha256(), other])
    assert rules_hash(listing) != rules_hash(kind)
    with pytest.raises(KindError, match="ask no network"):
        rules_hash(replace(load("battery_charging"), models_sha256=(other,)))


def test_other_rates_are_other_rules() -> None:
    kind = load("battery_charging")
    hashes = {rules_hash(kind)}
    for rates in ([(6, "180")], [(6, "181")], [(7, "180")], [(6, "180"), (22, "120")]):
        listed = tuple(RateConfig(from_hour=hour, iec=Decimal(iec)) for hour, iec in rates)
        hashes.add(rules_hash(replace(kind, rates=listed)))
        same = tuple(RateConfig(from_hour=hour, iec=Decimal(iec + ".0")) for hour, iec in rates)
        hashes.add(rules_hash(replace(kind, rates=same)))
    assert len(hashes) == 5
