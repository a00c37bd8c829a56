"""A reader follows docs/tutorials/kind.md: types each command and makes each change."""

from __future__ import annotations

import os
import site
import subprocess
import sysconfig
import venv
from pathlib import Path

import pytest

from rodeo_testing.template import write
from rodeo_testing.waiting import HANG_S
from tests.docs.not_run import ON_THEIR_OWN
from tests.docs.text import ROOT, Block, blocks

PAGE = "docs/tutorials/kind.md"


class Reader:
    """Has RODEO installed, and a folder of its own to work in."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "work"
        self.folder.mkdir()
        environment = folder / "environment"
        venv.create(environment, symlinks=True)
        self._python = environment / "bin" / "python"
        packages = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
        installed = [str(ROOT), *site.getsitepackages()]
        (packages / "rodeo.pth").write_text("\n".join(installed) + "\n")
        for name, words in {"rodeo": "-m rodeo_cli", "pip": "-m pip", "python": ""}.items():
            program = environment / "bin" / name
            program.unlink(missing_ok=True)
            program.write_text(f'#!/bin/sh\nexec "{self._python}3" {words} "$@"\n')
            program.chmod(0o755)
        self._path = f"{environment / 'bin'}:{os.environ['PATH']}"

    def types(self, command: str) -> None:
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=self.folder,
            # What builds the package is installed beside RODEO: nothing is fetched.
            env=os.environ | {"PATH": self._path, "PIP_NO_BUILD_ISOLATION": "0", "PYTHONPATH": ""},
            capture_output=True,
            text=True,
            timeout=HANG_S,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"


def apply(change: Block, package: Path) -> None:
    done = subprocess.run(
        ["git", "apply", "-"], cwd=package, input=change.text, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{change}: {done.stderr}"


@pytest.mark.long
def test_the_page_leads_to_a_kind_whose_checks_hold(tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    done = 0
    for block in (one for one in blocks() if one.page == PAGE):
        if block.kind == "shell":
            for command in block.text.splitlines():
                assert command.strip() in ON_THEIR_OWN
                reader.types(command)
                done += 1
        elif block.kind == "diff":
            apply(block, reader.folder / "inspect-door")
            done += 1
    assert done == len(ON_THEIR_OWN) + 4


def test_the_pages_changes_fit_what_a_new_kind_is_written_as(tmp_path: Path) -> None:
    write("inspect_door", tmp_path)
    for block in (one for one in blocks() if one.page == PAGE and one.kind == "diff"):
        apply(block, tmp_path)
    for path in tmp_path.rglob("*.py"):
        compile(path.read_text(), str(path), "exec")
