"""The training command's defaults, and what it says where something is missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from rodeo.site.config import Site
from tests.support.site import LAB
from training import __main__ as command
from training import crossed, needs, others
from training.dataset import CLASSES, NoPhotos
from training.folds import FOLDS
from training.needs import NoFolds, NotInstalled
from training.others import NoSamples, Package

PROJECT = Path(__file__).parents[3]
PACKAGE = Package(lambda name, into: None, "photos", "MIT", ("*.jpg",))


@pytest.fixture
def complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with all that is needed, and the packages installed."""
    monkeypatch.setattr(needs.importlib.util, "find_spec", lambda name: SimpleNamespace())
    monkeypatch.setattr(others, "LEARNT", (PACKAGE,))
    monkeypatch.setattr(others, "MEASURED", ())
    for part in crossed.PARTS:
        for label in CLASSES:
            (tmp_path / "data" / part / label).mkdir(parents=True)
    (tmp_path / "others" / "photos").mkdir(parents=True)
    (tmp_path / "others" / "photos" / "a.jpg").touch()
    for fold in range(FOLDS):
        folder = crossed.folder_of(tmp_path / "folds", fold)
        folder.mkdir(parents=True)
        (folder / crossed.TRAINING).touch()
    (tmp_path / "folds" / crossed.DIVISION).write_text('{"photos": {}}')
    return tmp_path


def check(folder: Path) -> None:
    needs.check(folder / "data", folder / "others", folder / "folds")


def test_the_site_file_is_all_that_has_to_be_named() -> None:
    what = command.asked(["--add-corrections", str(LAB)])
    assert what.data == PROJECT.parent / "shared/data/trashnet"
    assert what.folds == PROJECT / "out/folds"
    assert what.others == PROJECT / "out/others"
    assert what.out == Site.load(LAB).data_dir / "model"


def test_without_a_site_the_model_goes_into_the_projects_output() -> None:
    assert command.asked([]).out == PROJECT / "out/model"


def test_what_is_named_is_taken(tmp_path: Path) -> None:
    places = {name: tmp_path / name for name in ("data", "out", "folds", "others")}
    named = [word for name, place in places.items() for word in (f"--{name}", str(place))]
    what = command.asked([*named, "--add-corrections", str(LAB)])
    assert {name: getattr(what, name) for name in places} == places


def test_where_all_is_there_nothing_is_missed(complete: Path) -> None:
    check(complete)


def test_missing_packages_are_named_with_the_command_that_installs_them(
    complete: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(needs.importlib.util, "find_spec", lambda name: None if name == "torch" else name)
    with pytest.raises(NotInstalled, match=r"pip install --constraint constraints.txt -r") as refused:
        check(complete)
    assert refused.value.details["missing"] == ["torch"]


def test_missing_photos_to_learn_from_are_named(complete: Path) -> None:
    (complete / "data" / "val" / "glass").rmdir()
    with pytest.raises(NoPhotos, match="--data") as refused:
        check(complete)
    assert refused.value.details["missing"] == str(complete / "data/val/glass")


def test_missing_photos_of_other_things_are_named_with_the_command_that_fetches_them(complete: Path) -> None:
    (complete / "others" / "photos" / "a.jpg").unlink()
    with pytest.raises(NoSamples, match=r"python -m training\.others"):
        check(complete)


def test_missing_networks_are_named_and_not_asked_for_where_none_is_needed(complete: Path) -> None:
    (complete / "folds" / crossed.DIVISION).unlink()
    needs.check(complete / "data", complete / "others", None)
    with pytest.raises(NoFolds, match="--folds"):
        check(complete)


WITHOUT_TORCH = """
import importlib.util, runpy, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "torch" else find(name, *more)
sys.argv = ["train", "--add-corrections", {site!r}]
sys.path.insert(0, {project!r})
runpy.run_module("training", run_name="__main__")
"""


def test_the_command_says_in_any_folder_what_to_install(tmp_path: Path) -> None:
    code = WITHOUT_TORCH.format(site=str(LAB.absolute()), project=str(PROJECT))
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "pip install --constraint constraints.txt -r training/requirements.txt" in done.stderr
