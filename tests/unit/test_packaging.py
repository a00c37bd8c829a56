"""What the wheel installs, under which license, and how the project is cited."""

import hashlib
import json
import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]

APACHE_2_SHA256 = "c71d239df91726fc519c6eb72d318ec65820627232b2f796219e87dcf35d0ab4"
"""Hash of the text as the Apache Software Foundation publishes it, without its empty first line."""


def test_the_wheel_holds_what_sites_run_and_neither_benchmarks_nor_tests_nor_training() -> None:
    find = PYPROJECT["tool"]["setuptools"]["packages"]["find"]
    packages = [folder.parent.name for folder in ROOT.glob("*/__init__.py")]
    installed = {name for name in packages if any(fnmatch(name, pattern) for pattern in find["include"])}
    assert installed >= {"rodeo", "rodeo_cli", "services", "deploy"}
    assert not installed & {"bench", "tests", "training"}


def test_the_wheel_is_for_every_machine_and_needs_no_compiler() -> None:
    assert PYPROJECT["build-system"]["requires"] == ["setuptools>=77"]
    assert "ext-modules" not in PYPROJECT["tool"]["setuptools"]
    extras = PROJECT["optional-dependencies"]
    assert [name for name, needs in extras.items() if any("ruckig" in one for one in needs)] == ["dev"]


def test_the_license_is_the_whole_text_of_apache_2_and_is_in_the_wheel() -> None:
    assert hashlib.sha256((ROOT / "LICENSE").read_bytes()).hexdigest() == APACHE_2_SHA256
    assert (PROJECT["license"], PROJECT["license-files"]) == ("Apache-2.0", ["LICENSE"])


def test_everything_names_the_same_license() -> None:
    named = {path: _spdx(path) for path in (ROOT / "contracts").rglob("*.sol") if "out" not in path.parts}
    named[ROOT / "package.json"] = json.loads((ROOT / "package.json").read_text())["license"]
    named[ROOT / "CITATION.cff"] = _citation()["license"]
    assert {path for path, license in named.items() if license != PROJECT["license"]} == set()


def _spdx(path: Path) -> str:
    found = re.match(r"// SPDX-License-Identifier: (\S+)\n", path.read_text())
    return found[1] if found else ""


def _citation() -> dict[str, object]:
    return yaml.safe_load((ROOT / "CITATION.cff").read_text())


def test_the_citation_is_of_this_version_and_by_the_papers_authors() -> None:
    citation = _citation()
    assert citation["cff-version"] == "1.2.0"
    assert citation["message"] and citation["title"]
    assert str(citation["version"]) == PROJECT["version"]
    papers = citation["preferred-citation"]
    assert isinstance(papers, dict)
    for authors in (citation["authors"], papers["authors"]):
        assert isinstance(authors, list)
        assert [one["family-names"] for one in authors] == ["Groshev", "Castelló Ferrer"]


def test_the_changelog_is_short_and_has_this_version_below_what_is_unreleased() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    assert re.findall(r"^## (.*)$", text, re.MULTILINE)[:2] == ["[Unreleased]", f"[{PROJECT['version']}]"]
    assert len(text.splitlines()) <= 40
