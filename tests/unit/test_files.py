"""Files that must survive a kill."""

from pathlib import Path

import pytest

from rodeo.files import replace_file


def test_the_new_text_takes_the_place_of_the_old(tmp_path: Path) -> None:
    replace_file(tmp_path / "a.json", "old")
    replace_file(tmp_path / "a.json", "new")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.json", "new")]


def test_a_write_that_fails_leaves_the_old_text(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    replace_file(path, "old")
    with pytest.raises(UnicodeEncodeError):
        replace_file(path, "\ud800")
    assert path.read_text() == "old"
