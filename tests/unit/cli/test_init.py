"""A site of one's own: written by `rodeo init`, on ports that nobody else has, and removed again."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rodeo.bus.messages import Status
from rodeo.errors import PortUnavailable
from rodeo.host.http import listen
from rodeo.host.instance import lock_instance
from rodeo.host.listeners import listener_on
from rodeo.site.config import Site
from rodeo_cli import app
from rodeo_cli import site as site_commands
from rodeo_cli.init import free_ports
from rodeo_cli.site_check import check
from rodeo_testing.waiting import HANG_S
from tests.support.site import LAB


def rodeo(*words: str | Path, answers: str | None = None) -> Result:
    return CliRunner().invoke(app, list(map(str, words)), input=answers)


@pytest.mark.parametrize(
    "options",
    [(), ("--robots", "2", "--person", "alice"), ("--robots", "3", "--name", "plant-7", "--real-time")],
    ids=["plain", "two robots", "three robots"],
)
def test_the_site_file_is_commented_and_the_check_finds_nothing(
    options: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "My lab" / "site.toml"
    done = rodeo("init", path.parent, *options)
    assert done.exit_code == 0, done.output
    assert check(path) == []
    assert path.read_text().count("#") > 20
    site = Site.load(path)
    assert site.org == ("plant-7" if "plant-7" in options else "my-lab")
    assert len(site.robots) == (int(options[1]) if options else 1)
    assert [one.name for one in site.participants] == (["alice"] if "alice" in options else [])
    assert site.clock.keeps_wall_time == ("--real-time" in options)
    assert site.data_dir == path.parent / "data"
    assert f"RODEO_SITE={path}" in done.output


def test_on_a_terminal_it_asks_for_what_no_option_says(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "rodeo_cli", "init", str(tmp_path / "asked"), "--robots", "2"]
    with subprocess.Popen(words, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        os.close(theirs)
        os.write(ours, b"workshop\nbob\nn\n")
        told, _ = process.communicate(timeout=HANG_S)
    os.close(ours)
    assert process.returncode == 0, told
    site = Site.load(tmp_path / "asked" / "site.toml")
    assert (site.org, len(site.robots), site.participants[0].name) == ("workshop", 2, "bob")
    assert b"How many robots" not in told


def test_a_site_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    assert rodeo("init", tmp_path / "lab").exit_code == 0
    (tmp_path / "lab" / "site.toml").write_text("mine")
    done = rodeo("init", tmp_path / "lab")
    assert done.exit_code == 1 and "there is a site already" in done.output
    assert (tmp_path / "lab" / "site.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("option", "value"), [("--name", "My Lab"), ("--person", "Alice"), ("--name", ""), ("--person", 'a"b')]
)
def test_what_no_site_file_takes_is_refused_before_it_is_written(
    option: str, value: str, tmp_path: Path
) -> None:
    done = rodeo("init", tmp_path / "lab", option, value)
    assert done.exit_code == 1 and f"{option} takes small letters" in done.output
    assert not (tmp_path / "lab").exists()


@pytest.mark.parametrize(
    "options", [("--person", "panther1"), ("--person", "organization"), ("--person", "oracle")]
)
def test_a_site_that_could_not_be_is_not_written_and_the_next_try_works(
    options: tuple[str, ...], tmp_path: Path
) -> None:
    done = rodeo("init", tmp_path / "lab", *options)
    assert done.exit_code == 1 and "Traceback" not in done.output
    assert not (tmp_path / "lab").exists()
    assert rodeo("init", tmp_path / "lab").exit_code == 0


def test_two_sites_get_different_ports_and_one_site_the_same_again() -> None:
    # Fixed names: of four thousand pairs of folders one gets the same ports.
    first, second = (free_ports(Path("/srv") / name / "site.toml") for name in ("one", "two"))
    assert len({*first, *second}) == 6
    assert free_ports(Path("/srv/one/site.toml")) == first


def test_ports_that_are_taken_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    taken = free_ports(path)
    with socket.create_server(("127.0.0.1", taken[1])):
        assert not {*free_ports(path)} & {*taken}


def test_who_finds_its_port_taken_names_the_process_that_has_it() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        assert listener_on(port).startswith(f"process {os.getpid()}, ")
        with pytest.raises(PortUnavailable, match=f"process {os.getpid()}, .* uses that port: stop it"):
            listen("127.0.0.1", port, "the console")
    assert listener_on(port) == ""


def test_a_process_of_rodeo_is_named_with_its_site_and_no_other_with_its_options(tmp_path: Path) -> None:
    program = (
        "import socket, sys\nlistener = socket.create_server(('127.0.0.1', 0))\n"
        "print(listener.getsockname()[1], flush=True)\nsys.stdin.read()\n"
    )
    (tmp_path / "services").mkdir()
    (tmp_path / "services" / "console.py").write_text(program)
    (tmp_path / "secret.py").write_text(program)
    for module, told in (
        ("services.console", "services.console of the site other.toml"),
        ("secret", "python"),
    ):
        words = [sys.executable, "-m", module, "--site", "other.toml", "--password", "hunter2"]
        with subprocess.Popen(
            words, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
        ) as process:  # fmt: skip
            assert process.stdout is not None
            said = listener_on(int(process.stdout.readline()))
            process.communicate("", timeout=HANG_S)
        assert said.startswith(f"process {process.pid}, {told}")
        assert "hunter2" not in said


def heard(http: str | None) -> list[site_commands.Row]:
    details = {} if http is None else {"http": http}
    now_s = time.time()
    status = Status(
        process="console",
        pid=1,
        time_s=now_s,
        ready=True,
        reason="",
        activity="",
        progress=None,
        since_s=now_s,
        details=details,
    )
    return [site_commands.Row("console", "ready", status=status)]


def test_status_says_how_a_laptop_shows_the_console(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    site = Site.load(LAB)
    monkeypatch.setattr(site_commands, "read_rows", lambda *_args, **_more: heard("http://127.0.0.1:8088"))
    monkeypatch.setenv("USER", "ada")
    told = rodeo("status", "--site", LAB).output
    assert f"ssh -N -L 8088:127.0.0.1:8088 ada@{socket.gethostname()}" in told
    monkeypatch.setattr(site_commands, "read_rows", lambda *_args, **_more: heard(None))
    assert "ssh" not in rodeo("status", "--site", LAB).output
    path = tmp_path / "site.toml"
    path.write_text(f'extends = "{LAB}"\nconsole.origin = "https://lab.example.org"\n')
    monkeypatch.setattr(site_commands, "read_rows", lambda *_args, **_more: heard("http://127.0.0.1:8088"))
    assert "ssh" not in rodeo("status", "--site", path).output
    assert site.console.origin is None


# -- removal -----------------------------------------------------------------------------------------------


def site_with_data(folder: Path, more: str = "") -> Path:
    path = folder / "site.toml"
    path.write_text(f'extends = "{LAB}"\ndata_dir = "data"\n{more}')
    for name in ("keys", "deployments", "store", "launcher", "robot_agent", "itrash"):
        (folder / "data" / name).mkdir(parents=True)
        (folder / "data" / name / "content").write_text("x" * 1000)
    (folder / "data" / "launcher" / "lock").touch()
    (folder / "data" / "deployments" / "31337.json").touch()
    return path


EXTERNAL = (
    'chain.backend = "external"\nchain.url = "https://node.example"\nclock.speed = 1\nclock.idle_speed = 1\n'
)


def test_a_site_is_removed_with_its_parts_named_and_its_file_stays(tmp_path: Path) -> None:
    path = site_with_data(tmp_path)
    done = rodeo("site", "remove", "--site", path, "--yes")
    assert done.exit_code == 0, done.output
    for name in ("keys", "store", "robot_agent"):
        assert str(tmp_path / "data" / name) in done.output
    assert [one.name for one in tmp_path.iterdir()] == ["site.toml"]
    assert "there is nothing to remove" in rodeo("site", "remove", "--site", path, "--yes").output


def test_nothing_is_removed_where_nobody_can_be_asked(tmp_path: Path) -> None:
    done = rodeo("site", "remove", "--site", site_with_data(tmp_path))
    assert done.exit_code == 1 and "repeat it with --yes" in done.output
    assert (tmp_path / "data" / "store" / "content").exists()


@pytest.mark.parametrize("name", ["thesis", "keys.bak", "deployments.old", "site.toml", "robot_agent.former"])
def test_where_anything_lies_that_rodeo_did_not_make_nothing_is_removed(name: str, tmp_path: Path) -> None:
    path = site_with_data(tmp_path)
    (tmp_path / "data" / name).mkdir()
    done = rodeo("site", "remove", "--site", path, "--yes")
    assert done.exit_code == 1 and "not_only_ours: RODEO did not make all" in done.output
    assert name in done.output
    assert (tmp_path / "data" / "store" / "content").exists() and (tmp_path / "data" / name).is_dir()


def test_no_link_is_followed(tmp_path: Path) -> None:
    path = site_with_data(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "data" / "logs").symlink_to(tmp_path / "elsewhere")
    assert rodeo("site", "remove", "--site", path, "--yes").exit_code == 1
    assert (tmp_path / "elsewhere").is_dir()


@pytest.mark.parametrize("data_dir", [".", "../project"])
def test_the_folders_of_another_project_are_not_removed(data_dir: str, tmp_path: Path) -> None:
    path = tmp_path / "site" / "site.toml"
    path.parent.mkdir()
    path.write_text(f'extends = "{LAB}"\ndata_dir = "{data_dir}"\n')
    project = (path.parent / data_dir).resolve()
    for name in ("contracts", "logs", "store"):
        (project / name).mkdir(parents=True)
    done = rodeo("site", "remove", "--site", path, "--yes")
    assert done.exit_code == 1 and "not_only_ours" in done.output
    assert {"contracts", "logs", "store"} <= {one.name for one in project.iterdir()}


def test_a_site_that_runs_is_not_removed(tmp_path: Path) -> None:
    path = site_with_data(tmp_path)
    lock = lock_instance(tmp_path / "data" / "bridge")
    try:
        done = rodeo("site", "remove", "--site", path, "--yes")
        assert done.exit_code == 1 and "stop it with `rodeo down` first (running: bridge)" in done.output
        assert (tmp_path / "data" / "store" / "content").exists()
    finally:
        os.close(lock)
    assert rodeo("site", "remove", "--site", path, "--yes").exit_code == 0


def test_keys_of_an_external_chain_stay_unless_both_options_ask_for_them(tmp_path: Path) -> None:
    path = site_with_data(tmp_path, EXTERNAL)
    assert "it takes --yes, too" in rodeo("site", "remove", "--site", path, "--keys").output
    done = rodeo("site", "remove", "--site", path, "--yes")
    assert done.exit_code == 0 and "keys and contracts of an external chain" in done.output
    assert {one.name for one in (tmp_path / "data").iterdir()} == {"keys", "deployments"}
    done = rodeo("site", "remove", "--site", path, "--yes", "--keys")
    assert "no copy of these keys loses all that their addresses hold" in done.output
    assert not (tmp_path / "data").exists()
