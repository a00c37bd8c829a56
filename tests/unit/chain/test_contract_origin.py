"""Tests of the contracts run what is deployed, and do not begin where that was not built from the sources."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from rodeo.chain import artifacts

ROOT = Path(__file__).parents[3]
ORIGIN = "rodeo/chain/artifacts/origin.json"

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        not (ROOT / "node_modules").exists(), reason="Foundry is missing: make system, make setup"
    ),
]


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A checkout without tests of contracts: forge is asked for its help alone."""
    for folder in ("contracts/src", "rodeo/chain/artifacts"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    for program in (ROOT / "contracts").glob("*.mjs"):
        shutil.copy(program, tmp_path / "contracts")
    shutil.copy(ROOT / "foundry.toml", tmp_path)
    (tmp_path / "node_modules").symlink_to(ROOT / "node_modules")
    return tmp_path


def begin(copy: Path, **more: str) -> tuple[int, list[str]]:
    """The status of `forge test --help`, and what has changed since the contracts were built."""
    env = {name: value for name, value in os.environ.items() if name != "RODEO_CONTRACTS"} | more
    done = subprocess.run(
        ["node", "contracts/forge.mjs", "test", "--help"], cwd=copy, env=env, capture_output=True, text=True
    )
    changed = [line.strip() for line in done.stderr.splitlines() if line.startswith("  ")]
    if changed:
        assert "`make contracts`" in done.stderr
    return done.returncode, changed


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_what_was_built_from_these_sources_is_tested(copy: Path) -> None:
    assert begin(copy) == (0, [])


def test_a_byte_in_a_source_stops_the_tests_of_what_was_built_before(copy: Path) -> None:
    replace(copy / "contracts/src/IECoin.sol", "\n", " \n")
    assert begin(copy) == (1, ["contracts/src/IECoin.sol"])


def test_a_byte_in_what_a_source_imports_stops_them(copy: Path) -> None:
    origin = json.loads((copy / ORIGIN).read_text())
    imported = next(path for path in origin["files"] if path.startswith("node_modules/"))
    origin["files"][imported] = "0" * 64
    (copy / ORIGIN).write_text(json.dumps(origin))
    assert begin(copy) == (1, [imported])


def test_a_setting_or_another_compiler_stops_them(copy: Path) -> None:
    replace(copy / "foundry.toml", "via_ir = true", "via_ir = false")
    replace(copy / ORIGIN, '"compiler": "0', '"compiler": "1')
    assert begin(copy) == (1, ["compiler", "via_ir"])


def test_a_source_that_is_gone_or_built_contracts_without_origin_stop_them(copy: Path) -> None:
    (copy / "contracts/src/IECoin.sol").unlink()
    assert begin(copy) == (1, ["contracts/src/IECoin.sol"])
    (copy / ORIGIN).unlink()
    status, changed = begin(copy)
    assert status == 1
    assert [Path(one).name for one in changed] == ["origin.json"]


def test_a_contract_that_was_left_from_before_stops_them(copy: Path) -> None:
    replace(copy / "rodeo/chain/artifacts/IECoin.json", '"bytecode": "0x', '"bytecode": "0x00')
    assert begin(copy) == (1, ["rodeo/chain/artifacts/IECoin.json"])


def test_what_does_not_change_the_code_stops_nothing(copy: Path) -> None:
    replace(copy / "foundry.toml", "runs = 256", "runs = 7")
    assert begin(copy, FOUNDRY_PROFILE="bench", FOUNDRY_FUZZ_SEED="7") == (0, [])


def test_the_sources_themselves_may_be_tested_whatever_was_built(copy: Path) -> None:
    (copy / ORIGIN).unlink()
    assert begin(copy, RODEO_CONTRACTS="sources") == (0, [])


def test_the_origin_has_the_source_of_every_built_contract() -> None:
    sources = {Path(path).name for path in json.loads((ROOT / ORIGIN).read_text())["files"]}
    built = {path.stem for path in Path(artifacts.__path__[0]).glob("*.json")} - {"enums", "origin"}
    assert {f"{name}.sol" for name in built} <= sources
