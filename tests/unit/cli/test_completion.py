"""The shell completes commands, options, and the names of the site's own file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rodeo_testing.waiting import HANG_S

pytestmark = pytest.mark.long

SITE = """org = "lab"
[[robots]]
name = "ada_bot"
[[robots]]
name = "bert"
[[items]]
id = "can7"
[[bins]]
[[participants]]
name = "alice"
[[participants]]
name = "$(touch eval)"
[[kinds]]
name = "sweeping"
"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    path = tmp_path / "site.toml"
    path.write_text(SITE)
    return path


def completed(words: str, site: Path | None, shell: str = "bash") -> list[str]:
    """The shell's offers for the last of these words; `site` is RODEO_SITE."""
    typed = words.split(" ")
    environment = {
        **os.environ,
        "_RODEO_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(typed) - 1),
        "_TYPER_COMPLETE_ARGS": words,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    } | ({} if site is None else {"RODEO_SITE": str(site)})
    code = "import sys; sys.argv = ['rodeo']; from rodeo_cli.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=HANG_S
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("rodeo robot pause ", ["ada_bot", "bert"]),
        ("rodeo robot pause b", ["bert"]),
        ("rodeo task create ", ["sweeping"]),
        ("rodeo task create sweeping --item-id ", ["can7"]),
        ("rodeo task create sweeping --bin ", ["itrash"]),
        ("rodeo task create sweeping --as ", ["organization", "ada_bot", "bert", "alice"]),
        ("rodeo task submit 3 --as a", ["ada_bot", "alice"]),
        ("rodeo service pause 1 --as al", ["alice"]),
        ("rodeo proof ex", ["export"]),
        ("rodeo in", ["init"]),
        ("rodeo task create sweeping --item", ["--item-id"]),
    ],
)
def test_bash_is_offered_names_of_the_site_and_commands(words: str, offered: list[str], site: Path) -> None:
    assert completed(words, site) == offered


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_zsh_and_fish_are_offered_the_same(shell: str, site: Path) -> None:
    told = " ".join(completed("rodeo robot pause ", site, shell))
    assert "ada_bot" in told and "bert" in told


def test_the_site_that_was_typed_goes_before_the_environment(site: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text('org = "plant"\n[[robots]]\nname = "carl"\n')
    assert completed(f"rodeo robot pause --site {other} ", site) == ["carl"]


def test_a_site_file_that_cannot_be_read_offers_nothing(tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text("[[robots")
    assert completed("rodeo robot pause ", tmp_path / "site.toml") == []
