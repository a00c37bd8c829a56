"""`rodeo classify` on files, as a person at a terminal runs it; no site is up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rodeo.cli import app
from tests.support.site import LAB

PICTURES = Path(__file__).parents[1] / "unit" / "services" / "itrash" / "renderings"
CLASSES = {"cardboard", "glass", "metal", "paper", "plastic", "trash"}


def classify(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["classify", "--site", str(LAB), *arguments])
    return result.exit_code, result.stdout, result.stderr


def test_each_photo_gets_one_line_with_its_class_compartment_and_time() -> None:
    code, out, _ = classify(str(PICTURES / "metal_1.jpg"), str(PICTURES / "paper_1.jpg"))
    first, second = out.splitlines()
    assert code == 0
    assert "metal_1.jpg: metal -> yellow" in first
    assert "paper_1.jpg: paper -> blue" in second
    assert first.endswith(" ms")


def test_no_site_is_needed_unless_one_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photo = str((PICTURES / "glass_1.jpg").absolute())
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RODEO_SITE", raising=False)
    answer = CliRunner().invoke(app, ["classify", photo])
    assert (answer.exit_code, ": glass -> green" in answer.stdout) == (0, True)
    refused = CliRunner().invoke(app, ["classify", "--site", "none.toml", photo])
    assert (refused.exit_code, "config_error" in refused.stderr) == (1, True)


def test_json_holds_everything_and_unknown_is_not_guessed() -> None:
    code, out, _ = classify(str(PICTURES / "unknown_1.jpg"), "--json")
    (answer,) = json.loads(out)
    assert code == 0
    assert (answer["class"], answer["compartment"]) == ("unknown", "grey")
    assert set(answer["probabilities"]) == CLASSES
    assert abs(sum(answer["probabilities"].values()) - 1) < 1e-3
    assert answer["milliseconds"] > 0


def test_a_bad_file_is_named_and_the_others_are_still_classified(tmp_path: Path) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"\xff\xd8\xff\xe0 no photo")
    code, out, err = classify(str(broken), str(tmp_path / "none.jpg"), str(PICTURES / "glass_1.jpg"))
    assert code == 1
    assert "glass_1.jpg: glass -> green" in out
    assert "broken_image" in err and "broken.jpg" in err
    assert "unreadable" in err and "none.jpg" in err
    code, out, _ = classify(str(broken), "--json")
    assert code == 1
    assert json.loads(out)[0]["error"]["code"] == "broken_image"
