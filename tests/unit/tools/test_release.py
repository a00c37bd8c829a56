"""What `make release` finds wrong with a wheel."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from tools.release import faults_of_wheel

METADATA = """\
Metadata-Version: 2.4
Name: rodeo-dao
Version: 0.1.0
Requires-Python: >=3.11
License-Expression: Apache-2.0
Description-Content-Type: text/markdown
Provides-Extra: site

# RODEO
"""


INFO = "rodeo_dao-0.1.0.dist-info"
WHOLE = {f"{INFO}/METADATA": METADATA, f"{INFO}/licenses/LICENSE": "Apache", "rodeo/__init__.py": ""}


def wheel(folder: Path, files: dict[str, str], name: str = "rodeo_dao-0.1.0-py3-none-any.whl") -> Path:
    with zipfile.ZipFile(folder / name, "w") as archive:
        for path, text in files.items():
            archive.writestr(path, text)
    return folder / name


def test_a_whole_wheel_has_no_faults(tmp_path: Path) -> None:
    assert faults_of_wheel(wheel(tmp_path, WHOLE)) == []


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("bench/robot.py", "holds bench"),
        ("deploy/keys/panther1.json", "holds deploy/keys/panther1.json"),
        ("rodeo/lab/scan.so", "holds rodeo/lab/scan.so"),
        ("deploy/router.pem", "holds deploy/router.pem"),
    ],
)
def test_what_does_not_belong_into_it_is_named(tmp_path: Path, path: str, told: str) -> None:
    (fault,) = faults_of_wheel(wheel(tmp_path, WHOLE | {path: ""}))
    assert told in fault


def test_a_wheel_for_one_kind_of_machine_is_named(tmp_path: Path) -> None:
    (fault,) = faults_of_wheel(wheel(tmp_path, WHOLE, "rodeo_dao-0.1.0-cp311-cp311-linux_x86_64.whl"))
    assert "one kind of machine" in fault


def test_metadata_that_an_index_would_reject_is_named(tmp_path: Path) -> None:
    bad = {f"{INFO}/METADATA": METADATA.replace(">=3.11", "three")}
    assert any("requires-python" in fault for fault in faults_of_wheel(wheel(tmp_path, WHOLE | bad)))
