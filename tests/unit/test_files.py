"""Files that must survive a kill."""

import re
from pathlib import Path

import pytest

from rodeo.errors import FolderTaken
from rodeo.host.files import begin_folder, replace_file, replacing

ROOT = Path(__file__).parents[2]


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


def test_a_block_that_fails_leaves_the_old_file_and_no_part_of_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    replace_file(path, b"old")
    with pytest.raises(ZeroDivisionError), replacing(path) as file:
        file.write(b"new")
        raise ZeroDivisionError
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("a.json", "old")]


def test_a_private_file_is_its_owners_alone(tmp_path: Path) -> None:
    replace_file(tmp_path / "key", "secret", mode=0o600)
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600


def test_two_writers_of_one_file_each_write_a_whole_one(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with (
        replacing(path, part=tmp_path / "one") as one,
        replacing(path, part=tmp_path / "two") as two,
    ):
        one.write(b"first")
        two.write(b"second")
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_no_other_file_renames_what_it_wrote_beside() -> None:
    renames = re.compile(r"\bos\.(replace|rename|fsync)\(|\bpart\.(replace|rename)\(|mkstemp\(")
    found = {
        str(path.relative_to(ROOT)): len(renames.findall(path.read_text()))
        for folder in ("rodeo", "services", "deploy", "rodeo_cli")
        for path in (ROOT / folder).rglob("*.py")
        if renames.search(path.read_text())
    }
    # A running recording is flushed and renamed while it is open; a journal that begins again is kept aside.
    assert found == {"rodeo/host/files.py": 2, "rodeo/evidence/recorder.py": 3, "rodeo/witness/journal.py": 1}


LINE = "# Written by a test."


def test_a_new_run_takes_the_place_of_an_earlier_one_and_of_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "run"
    for _ in range(2):
        begin_folder(folder, LINE)
        assert list(folder.iterdir()) == []
        (folder / "site.toml").write_text(f"{LINE}\norg = 'lab'\n")
        (folder / "log").write_text("of the run")


def test_a_folder_whose_removal_was_interrupted_is_still_that_of_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "big").write_text("of the run")
    (tmp_path / "site.toml").write_text(LINE + "\n")
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(Path, "unlink", lambda _path: (_ for _ in ()).throw(KeyboardInterrupt))
        begin_folder(tmp_path, LINE)
    assert [path.name for path in tmp_path.iterdir()] == ["site.toml"]
    begin_folder(tmp_path, LINE)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_was_killed_while_it_wrote_its_site_file_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / "site.part").write_text(LINE)
    begin_folder(tmp_path, LINE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "files", [{"thesis.tex": "years"}, {"site.toml": "org = 'mine'\n"}, {"site.toml": f"#{LINE}\n"}]
)
def test_a_folder_with_anything_else_is_left_as_it_is(tmp_path: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(FolderTaken) as caught:
        begin_folder(tmp_path, LINE)
    assert caught.value.details == {"path": str(tmp_path)}
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == files


def test_a_file_and_a_link_are_no_folder_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "site.toml").write_text(LINE)
    (tmp_path / "link").symlink_to(tmp_path / "home")
    for name in ("file", "link"):
        with pytest.raises(FolderTaken):
            begin_folder(tmp_path / name, LINE)
    assert (tmp_path / "home" / "site.toml").exists()
