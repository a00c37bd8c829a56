"""The units that `rodeo deploy systemd` writes."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from typer.testing import CliRunner

from deploy.units import unit_name, units
from rodeo.errors import ConfigError
from rodeo.host.instance import GAVE_UP
from rodeo.site.config import Site
from rodeo.site.processes import processes_of
from rodeo_cli import app
from rodeo_testing.waiting import HANG_S
from tests.support.site import LAB, write_real_site, write_site
from tests.support.units import settings, started

analyzed = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is missing: make system"
)


def files(path: Path) -> dict[str, str]:
    return units(Site.load(path), path, Path(sys.executable), "daemon", Path("/etc/rodeo/a passphrase"))


def unit(found: dict[str, str], process: str) -> str:
    (text,) = [text for name, text in found.items() if name.endswith(f"-{process}.service")]
    return text


@pytest.fixture
def real(tmp_path: Path) -> Path:
    """A site of which all devices are real, on somebody's chain, in a folder with blanks and signs."""
    return write_real_site(
        tmp_path / "our lab, 100 % $HOME", 'mocap.source = "natnet"\nmocap.address = "192.168.1.5"'
    )


def test_there_is_a_unit_for_each_process_and_a_target_for_all() -> None:
    site, found = Site.load(LAB), files(LAB)
    names = [unit_name(site, entry) for entry in processes_of(site)]
    assert sorted(found) == sorted([*names, "rodeo-lab.target"])
    assert settings(found["rodeo-lab.target"], "Wants") == [" ".join(names)]
    for name in names:
        assert settings(found[name], "Type") == ["notify"]
        assert settings(found[name], "RestartPreventExitStatus") == [str(GAVE_UP)]
        assert settings(found[name], "WantedBy") == settings(found[name], "PartOf") == ["rodeo-lab.target"]


@analyzed
def test_systemd_finds_nothing_wrong_and_rates_each_unit_ok(real: Path, tmp_path: Path) -> None:
    for number, path in enumerate((LAB, real)):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name, text in files(path).items():
            (folder / name).write_text(text)
        paths = sorted(map(str, folder.iterdir()))
        verified = subprocess.run(
            ["systemd-analyze", "verify", *paths], capture_output=True, text=True, timeout=HANG_S
        )
        assert (verified.returncode, verified.stderr) == (0, "")
        for one in (one for one in paths if one.endswith(".service")):
            rated = subprocess.run(
                ["systemd-analyze", "security", "--offline=true", "--threshold=49", one],
                capture_output=True,
                text=True,
                timeout=HANG_S,
            )
            assert rated.returncode == 0 and re.search(r": [0-4]\.\d OK", rated.stdout), rated.stdout[-300:]


def test_each_computer_has_the_units_of_its_own_processes(real: Path) -> None:
    mine = ["router", "bridge", "console", "robot_agent", "robot_sim", "itrash", "mocap"]
    with real.open("a") as file:
        file.write(f'[hosts]\noffice = {mine}\ndock-pi = ["oracle", "charger"]\n'.replace("'", '"'))
    found = files(real)
    assert {name.rpartition("-")[2] for name in found if name.startswith("dock-pi/")} == {
        "oracle.service",
        "charger.service",
        "lab.target",
    }
    assert sum(name.startswith("office/") for name in found) == len(mine) + 1
    assert "router" not in found["dock-pi/rodeo-lab-oracle.service"].partition("[Service]")[0]


def test_secrets_reach_only_the_processes_that_use_them(real: Path) -> None:
    found, data = files(real), Site.load(real).data_dir
    key = real.with_name("node-key")
    for process, opens in {"bridge": True, "charger": True, "router": False}.items():
        text = unit(found, process)
        loaded = settings(text, "LoadCredential")
        assert ("passphrase:/etc/rodeo/a passphrase" in loaded) == opens
        assert (f"node-key:{key}".replace("%", "%%") in loaded) == (process == "bridge")
        assert bool(settings(text, "SetCredential")) == (process != "bridge")
        assert bool(settings(text, "InaccessiblePaths")) != opens
        assert "the provider's key" not in text
        own = [str(data / "tls" / name) for name in ("ca.pem", f"{process}.pem", f"{process}.key")]
        (bound,) = settings(text, "BindReadOnlyPaths")
        assert shlex.split(bound.replace("%%", "%")) == own


def test_a_dock_may_use_its_serial_line_and_nobody_any_other_device(real: Path) -> None:
    found = files(real)
    assert settings(unit(found, "charger"), "DeviceAllow") == ["/dev/ttyUSB0 rw"]
    assert settings(unit(found, "charger"), "DevicePolicy") == ["closed"]
    assert settings(unit(found, "bridge"), "PrivateDevices") == ["yes"]


@pytest.mark.long
@pytest.mark.parametrize("process", ["router", "charger"])
def test_a_wrong_site_file_ends_a_process_with_the_status_that_prevents_a_restart(
    process: str, tmp_path: Path
) -> None:
    path = write_site(tmp_path)
    text = unit(files(path), process)
    path.write_text("org = 1")
    assert started(text, tmp_path, {}).wait(timeout=HANG_S) == GAVE_UP
    assert settings(text, "RestartPreventExitStatus") == [str(GAVE_UP)]


@pytest.fixture
def short() -> Iterator[Path]:
    """A folder in which a bus's socket has room."""
    with TemporaryDirectory() as folder:
        yield Path(folder)


def test_paths_with_blanks_and_signs_are_one_word_each(short: Path) -> None:
    folder = short / "our lab, 100 % $HOME"
    folder.mkdir()
    path = write_site(folder)
    text = unit(files(path), "router")
    path.write_text("org = 1")
    with open(short / "log", "wb") as log:
        assert started(text, short, {}, log.fileno()).wait(timeout=HANG_S) == GAVE_UP
    assert str(path) in (short / "log").read_text()


def test_a_path_that_no_unit_can_name_is_refused(short: Path) -> None:
    folder = short / "a\nExecStartPre=evil"
    folder.mkdir()
    with pytest.raises(ConfigError, match="a unit cannot name this"):
        files(write_site(folder))


def test_a_socket_that_no_two_units_share_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    with pytest.raises(ConfigError, match="the bus's socket must lie in the data folder"):
        files(write_site(folder))


def test_the_command_writes_them_and_refuses_what_no_unit_would_know(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_site(tmp_path)
    given = ["deploy", "systemd", "--site", str(path), "--out", str(tmp_path / "units")]
    assert "9 units and rodeo-lab.target" in CliRunner().invoke(app, given).stdout
    assert len(list((tmp_path / "units").iterdir())) == 10
    monkeypatch.setenv("RODEO__CONSOLE__PORT", "1234")
    refused = CliRunner().invoke(app, given)
    assert refused.exit_code == 1 and "RODEO__CONSOLE__PORT" in refused.stderr
