"""Each error of docs/how-to/errors.md is said in these words: a test makes it happen."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rodeo.errors import RodeoError
from rodeo.host.http import listen
from rodeo.host.instance import lock_instance
from rodeo.signing.keystores import PASSPHRASE_VARIABLE
from rodeo.signing.wallets import ensure_wallets, load
from rodeo.site.config import Site
from rodeo_cli import app
from rodeo_cli.task_params import task_params
from tests.docs.text import ROOT
from tests.support.site import LAB

PAGE = ROOT / "docs/how-to/errors.md"
ROW = re.compile(r"^\| `(.+?)` \|", re.MULTILINE)


def said(*words: str | Path) -> str:
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == 1, done.output
    return done.output


def site(folder: Path, more: str = "") -> Path:
    path = folder / "site.toml"
    path.write_text(f'extends = "{LAB}"\ndata_dir = "data"\n{more}')
    return path


def raised(act: Callable[[], object]) -> str:
    with pytest.raises(RodeoError) as error:
        act()
    return f"{error.value.code}: {error.value.message}"


def stopped(folder: Path) -> str:
    return said("task", "list", "--site", site(folder))


def no_file(folder: Path) -> str:
    return said("status", "--site", folder / "nowhere.toml")


def mistake(folder: Path) -> str:
    item = '[[items]]\nid = "can"\nclass = "aluminium"\nshape = "can"\npose = { x_m = 4, y_m = 1 }\n'
    return said("site", "check", site(folder, item))


def not_installed(folder: Path) -> str:
    return said("site", "check", site(folder, '[[kinds]]\nname = "window_cleaning"\n'))


def port_taken(_folder: Path) -> str:
    with socket.create_server(("127.0.0.1", 0)) as other:
        return raised(lambda: listen("127.0.0.1", other.getsockname()[1], "the console"))


def started_twice(folder: Path) -> str:
    path = site(folder)
    lock = lock_instance(folder / "data" / "launcher")
    try:
        return said("up", "--site", path)
    finally:
        os.close(lock)


def removed_while_it_runs(folder: Path) -> str:
    path = site(folder)
    lock = lock_instance(folder / "data" / "bridge")
    try:
        return said("site", "remove", "--yes", "--site", path)
    finally:
        os.close(lock)


def no_parameter(_folder: Path) -> str:
    loaded = Site.load(LAB)
    assert loaded.demo is not None
    return raised(lambda: task_params(loaded, loaded.demo.kind, ["--itemid", "item1"], None))


def wrong_passphrase(folder: Path) -> str:
    loaded = Site.load(site(folder))
    ensure_wallets(loaded)
    (loaded.data_dir / "keys" / "passphrase").write_text("another one")
    return raised(lambda: load(loaded, "organization"))


def cut_off(folder: Path) -> str:
    (folder / "proof.mcap").write_bytes(b"\x89MCAP0\r\n")
    return said("proof", "plot", folder / "proof.mcap", "--offline", "--site", LAB)


CAUSES = (
    stopped,
    no_file,
    mistake,
    not_installed,
    port_taken,
    started_twice,
    removed_while_it_runs,
    no_parameter,
    wrong_passphrase,
    cut_off,
)


def test_the_page_has_ten_errors_in_the_order_of_their_causes() -> None:
    assert len(ROW.findall(PAGE.read_text())) == len(CAUSES) == 10


@pytest.mark.parametrize("number", range(len(CAUSES)), ids=[one.__name__ for one in CAUSES])
def test_an_error_is_said_as_the_page_says(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(PASSPHRASE_VARIABLE, raising=False)
    written = ROW.findall(PAGE.read_text())[number]
    pattern = ".*".join(map(re.escape, written.split("...")))
    told = " ".join(CAUSES[number](tmp_path).split())
    assert re.search(pattern, told), told
