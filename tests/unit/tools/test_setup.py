"""`tools/setup.sh` on machines that a folder of stand-ins pretends."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
REAL = ("sh", "dirname", "awk", "grep", "ls", "sed")
"""Everything else that the script calls is a stand-in, or missing."""


class Machine:
    """A Debian machine that has what a site needs, and of the rest nothing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.bin = folder / "bin"
        self.bin.mkdir()
        for name in REAL:
            (self.bin / name).symlink_to(str(shutil.which(name)))
        self.has("uname", '[ "$1" = -m ] && echo x86_64 || echo Linux')
        self.has("make")
        self.has("ldconfig", "echo ' libEGL.so.1 (libc6) => /lib/libEGL.so.1'")
        self.has("id", "echo 0")
        self.disk(50_000)
        self.memory(8_000)

    def has(self, name: str, script: str = "") -> None:
        (self.bin / name).write_text(f"#!{self.bin}/sh\n{script}\n")
        (self.bin / name).chmod(0o755)

    def has_python(self, name: str, why_not: str = "") -> None:
        """Its stand-in answers the probe; `-V` tells the name."""
        self.has(name, f'[ "$1" = -V ] && echo "{name}" || echo "{why_not}"')

    def disk(self, free_mb: int) -> None:
        self.has("df", f"echo header; echo /dev/vda 1 1 {free_mb * 1024} 1% /")

    def memory(self, total_mb: int) -> None:
        (self.folder / "proc").mkdir(exist_ok=True)
        (self.folder / "proc" / "meminfo").write_text(f"MemTotal: {total_mb * 1024} kB\n")

    def setup(self, *words: str, **more: str) -> tuple[int, str, str]:
        env = {"PATH": str(self.bin), "RODEO_MACHINE": str(self.folder), **more}
        # A copy, as .venv of the checkout is a candidate.
        script = self.folder / "checkout" / "tools" / "setup.sh"
        script.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "tools" / "setup.sh", script)
        done = subprocess.run(["/bin/sh", str(script), *words], env=env, capture_output=True, text=True)
        return done.returncode, done.stdout.strip(), done.stderr


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_the_newest_python_that_fits_is_taken_before_python3(machine: Machine) -> None:
    machine.has("python3.14", "exit 127")  # pyenv's shim of a version that is not active here
    machine.has_python("python3.13", "has no venv")
    machine.has_python("python3.12")
    machine.has_python("python3", "is Python 3.15")
    status, python, said = machine.setup("check", "site")
    assert (status, python) == (0, str(machine.bin / "python3.12"))
    assert "124 packages" in said and "about 2 minutes" in said


def test_a_python_that_is_named_is_the_only_candidate(machine: Machine) -> None:
    machine.has_python("python3.13")
    machine.has_python("other", "is Python 3.15")
    status, python, said = machine.setup("check", "site", PYTHON="other", GOAL="test")
    assert (status, python) == (1, "")
    assert "other is Python 3.15" in said and "make test PYTHON=/path/to/python3.13" in said


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda m: m.has("uname", "echo Darwin"), "docker run"),
        (lambda m: m.has("uname", "echo MINGW64_NT-10.0"), "wsl --install"),
        (lambda m: m.has("uname", '[ "$1" = -m ] && echo armv7l || echo Linux'), "not armv7l|this is armv7l"),
        (lambda m: m.disk(900), "disk: 1500 MB; 900 MB are free"),
        (lambda m: m.memory(1_000), "memory: 3000 MB; this machine has 1000 MB"),
        (lambda m: (m.bin / "make").unlink(), "apt-get install make"),
        (lambda m: m.has_python("python3.13", "is Python 3.10"), "python3.13 is Python 3.10"),
        (lambda m: (m.bin / "python3.13").unlink(), "python3 is not there"),
    ],
)
def test_a_machine_that_does_not_fit_is_told_what_to_type(
    machine: Machine, change: Callable[[Machine], object], told: str
) -> None:
    machine.has_python("python3.13")
    change(machine)
    status, python, said = machine.setup("check", "site")
    assert (status, python) == (1, "")
    assert "`make demo` cannot run here" in said
    assert any(one in said for one in told.split("|")), said


def test_everything_that_is_missing_is_named_in_one_message(machine: Machine) -> None:
    machine.disk(100)
    machine.memory(100)
    (machine.bin / "ldconfig").unlink()
    status, _, said = machine.setup("check", "dev")
    assert status == 1
    for one in ("Python 3.11", "disk:", "memory:", "libEGL", "Node", "PostgreSQL", "Chromium", "make system"):
        assert one in said


def test_the_tests_need_more_memory_than_the_demo(machine: Machine) -> None:
    machine.has_python("python3.13")
    machine.memory(4_000)
    assert machine.setup("check", "site")[0] == 0
    assert "memory: 5000 MB; this machine has 4000 MB" in machine.setup("check", "dev")[2]


def test_what_a_container_may_use_of_the_memory_counts(machine: Machine) -> None:
    machine.has_python("python3.13")
    limit = machine.folder / "sys" / "fs" / "cgroup" / "memory.max"
    limit.parent.mkdir(parents=True)
    limit.write_text("max\n")
    assert machine.setup("check", "site")[0] == 0
    limit.write_text(f"{512 << 20}\n")
    assert "this machine has 512 MB" in machine.setup("check", "site")[2]


def test_pictures_and_nodes_tests_are_not_needed(machine: Machine) -> None:
    machine.has_python("python3.13")
    (machine.bin / "ldconfig").unlink()
    status, _, said = machine.setup("check", "site")
    assert status == 0
    assert "Not here, and not needed" in said and "libEGL" in said and "Node" not in said


def test_the_python_of_the_environment_is_kept(machine: Machine) -> None:
    machine.has_python("python3.14")
    machine.has_python("mine")
    own = machine.folder / "checkout" / ".venv" / "bin"
    own.mkdir(parents=True)
    (own / "python").symlink_to(machine.bin / "mine")
    assert machine.setup("check", "site")[1] == ".venv/bin/python"


def test_the_python_of_these_tests_fits(machine: Machine) -> None:
    (machine.bin / "python3").symlink_to(os.path.realpath(sys.executable))
    assert machine.setup("check", "site")[:2] == (0, str(machine.bin / "python3"))


def test_system_installs_with_apt_get_only_what_is_missing(machine: Machine) -> None:
    done = machine.folder / "done"
    machine.has("env", 'shift; exec "$@"')
    machine.has("apt-get", f'echo "$@" >>{done}')
    machine.has("node", "echo 20")
    machine.has("npm")
    machine.has("initdb")
    status, _, said = machine.setup("system")
    assert "apt-get install chromium-headless-shell" in said and "chromium" in done.read_text()
    assert "postgresql" not in done.read_text() and "nodejs" not in done.read_text()
    assert status == 1 and "Still missing" in said and "Chromium" in said
    assert "rosidl-tools" in done.read_text() and "rosidl-tools" in said
    assert "python3-rospy" in done.read_text() and "ROS 1 is missing" in said
    assert "systemd" in done.read_text() and "units are not verified" in said
    machine.has("chromium")
    machine.has("systemd-analyze")
    system_python = machine.folder / "usr" / "bin" / "python3"
    system_python.parent.mkdir(parents=True)
    system_python.write_text("#!/bin/sh\n")
    system_python.chmod(0o755)
    system_python.with_name("rosmaster").symlink_to(system_python)
    (machine.folder / "checkout" / ".venv-noetic").mkdir()
    (machine.folder / "checkout" / ".venv-noetic" / "whole").touch()
    done.unlink()
    status, _, said = machine.setup("system")
    assert status == 0 and not done.exists()


def test_system_gives_the_ros_1_that_is_there_an_old_zenoh_client(machine: Machine) -> None:
    made = machine.folder / "checkout" / ".venv-noetic"
    system = machine.folder / "usr" / "bin"
    system.mkdir(parents=True)
    # A stand-in that makes an environment of stand-ins, of which the first cannot install.
    for fails, whole in (("exit 1", False), ("", True)):
        (system / "python3").write_text(f"""#!{machine.bin}/sh
            case "$2" in venv)
                {shutil.which("mkdir")} -p .venv-noetic/bin
                echo '#!{machine.bin}/sh\n{fails}' >.venv-noetic/bin/python
                {shutil.which("chmod")} +x .venv-noetic/bin/python
            esac""")
        (system / "python3").chmod(0o755)
        if not (system / "rosmaster").exists():
            (system / "rosmaster").symlink_to(system / "python3")
        (machine.folder / "checkout" / "tests" / "noetic_robot").mkdir(parents=True, exist_ok=True)
        wanted = Path("tests") / "noetic_robot" / "requirements.txt"
        shutil.copy(ROOT / wanted, machine.folder / "checkout" / wanted)
        machine.has("apt-get")
        machine.has("env", 'shift; exec "$@"')
        machine.has("tr", f'exec {shutil.which("tr")} "$@"')
        said = machine.setup("system")[2]
        assert "eclipse-zenoh==1.5.1" in said
        assert (made / "whole").exists() is whole and ("could not be made" in said) is not whole


def test_system_tells_people_who_may_not_install_what_root_types(machine: Machine) -> None:
    machine.has("id", "echo 1000")
    machine.has("apt-get", "exit 1")
    status, _, said = machine.setup("system")
    wanted = "nodejs npm postgresql chromium-headless-shell"
    assert status == 1 and f"Type as root: apt-get install {wanted}" in said


def test_an_old_node_does_not_do(machine: Machine) -> None:
    machine.has("npm")
    machine.has("node", "echo 16")
    status, _, said = machine.setup("node", GOAL="contracts")
    assert status == 1 and "`make contracts` needs Node 18 or newer" in said
    machine.has("node", "echo 18")
    assert machine.setup("node")[0] == 0
