"""`rodeo classify` on files, as a person at a terminal runs it; no site is up."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner

from rodeo_cli import app
from rodeo_testing.recordings import RENDERINGS
from rodeo_testing.waiting import HANG_S
from tests.support.site import LAB

CLASSES = {"cardboard", "glass", "metal", "paper", "plastic", "trash"}


def classify(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["classify", "--site", str(LAB), *arguments])
    return result.exit_code, result.stdout, result.stderr


def test_each_photo_gets_one_line_with_its_class_compartment_and_time() -> None:
    code, out, _ = classify(str(RENDERINGS / "metal_1.jpg"), str(RENDERINGS / "paper_1.jpg"))
    first, second = out.splitlines()
    assert code == 0
    assert "metal_1.jpg: metal -> yellow" in first
    assert "paper_1.jpg: paper -> blue" in second
    assert first.endswith(" ms")


def test_of_several_bins_one_can_be_named(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    bins = LAB.with_name("plural.toml").read_text()
    sorts = 'compartments = { left = ["paper", "cardboard", "plastic", "metal"], right = ["glass", "trash"] }'
    path.write_text(
        f"extends = {json.dumps(str(LAB))}\n"
        + bins[bins.index("[lab]") :].replace('name = "bin_east"', f'name = "bin_east"\n{sorts}')
    )

    def told(*arguments: str) -> tuple[int, str]:
        photo = str(RENDERINGS / "metal_1.jpg")
        result = CliRunner().invoke(app, ["classify", "--site", str(path), photo, *arguments])
        return result.exit_code, result.output

    for arguments, compartment in ((), "yellow"), (("--bin", "bin_east"), "left"):
        code, out = told(*arguments)
        assert (code, f"metal -> {compartment}" in out) == (0, True), out
    code, out = told("--bin", "none")
    assert (code, "config_error" in out, "bin_east" in out) == (1, True, True), out


def test_no_site_is_needed_unless_one_is_named(tmp_path: Path) -> None:
    photo = str((RENDERINGS / "glass_1.jpg").absolute())
    environment = {name: value for name, value in os.environ.items() if name != "RODEO_SITE"}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "rodeo_cli", "classify", *arguments, photo],
            cwd=tmp_path,
            env=environment | {"PYTHONPATH": str(Path.cwd())},
            capture_output=True,
            text=True,
            timeout=HANG_S,
            check=False,
        )

    answer = run()
    assert (answer.returncode, ": glass -> green" in answer.stdout) == (0, True), answer.stderr
    refused = run("--site", "none.toml")
    assert (refused.returncode, "config_error" in refused.stderr) == (1, True)


def test_json_holds_everything_and_unknown_is_not_guessed() -> None:
    code, out, _ = classify(str(RENDERINGS / "unknown_1.jpg"), "--json")
    (answer,) = json.loads(out)
    assert code == 0
    assert (answer["class"], answer["compartment"]) == ("unknown", "grey")
    assert set(answer["probabilities"]) == CLASSES
    assert abs(sum(answer["probabilities"].values()) - 1) < 1e-3
    assert answer["milliseconds"] > 0


def test_a_bad_file_is_named_and_the_others_are_still_classified(tmp_path: Path) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"\xff\xd8\xff\xe0 no photo")
    code, out, err = classify(str(broken), str(tmp_path / "none.jpg"), str(RENDERINGS / "glass_1.jpg"))
    assert code == 1
    assert "glass_1.jpg: glass -> green" in out
    assert "broken_image" in err and "broken.jpg" in err
    assert "unreadable" in err and "none.jpg" in err
    code, out, _ = classify(str(broken), "--json")
    assert code == 1
    assert json.loads(out)[0]["error"]["code"] == "broken_image"
