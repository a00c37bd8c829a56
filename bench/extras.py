"""Each process alone, in an environment with exactly its extra, until it is ready or waits for a peer.

The environments are made of the built wheel, with one cache. `extras_<extra>_mb` is the size of site-packages
on disk. `extras_<extra>_starts` is 1 for a process that said "ready", or what it waits for.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rodeo.site.processes import PROCESSES
from rodeo_cli.demo import LAB, write_site

_ROOT = Path(__file__).parents[1]
_UV = Path(sys.executable).with_name("uv")
_HANG_S = 300.0
_STANDS = re.compile(r": ready$|: not ready: (?!starting|loading)|: waiting for ", re.MULTILINE)
"""What a process says that has imported and opened everything of its own."""


def run() -> dict[str, float | None]:
    """Megabytes of 10^6 bytes, and whether each process starts. Raises CalledProcessError where uv fails."""
    figures: dict[str, float | None] = {}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        _uv("build", "--quiet", "--wheel", "--out-dir", str(folder), str(_ROOT))
        (wheel,) = folder.glob("*.whl")
        _, figures["extras_base_mb"] = _environment(folder / "base", str(wheel))
        site = write_site(LAB, "eth-tester", folder / "demo")
        router: subprocess.Popen[bytes] | None = None
        try:
            # The router is the first of the table: the others find it.
            for process in PROCESSES:
                extra = process.extra
                name = extra.replace("-", "_")
                python, figures[f"extras_{name}_mb"] = _environment(folder / extra, f"{wheel}[{extra}]")
                log = folder / f"{extra}.log"
                with log.open("wb") as output:
                    started = subprocess.Popen(
                        [str(python), "-m", process.module, "--site", str(site)],
                        cwd=folder,
                        env={"PATH": "/usr/bin:/bin", "HOME": text},
                        stdout=output,
                        stderr=subprocess.STDOUT,
                    )
                figures[f"extras_{name}_starts"] = float(_stands(started, log))
                if process.name == "router":
                    router = started
                else:
                    _end(started)
        finally:
            if router is not None:
                _end(router)
    return figures


def _environment(folder: Path, requirement: str) -> tuple[Path, float]:
    """The interpreter of a new environment, and the size of what is installed there."""
    python = folder / "bin" / "python"
    _uv("venv", "--quiet", "--python", sys.executable, str(folder))
    limits = ("--constraint", str(_ROOT / "constraints.txt"))
    _uv("pip", "install", "--quiet", "--python", str(python), *limits, requirement)
    (packages,) = folder.glob("lib/python*/site-packages")
    return python, sum(one.stat().st_size for one in packages.rglob("*") if one.is_file()) / 1e6


def _stands(started: subprocess.Popen[bytes], log: Path) -> bool:
    """Whether the process says so; what it said instead is printed."""
    ends_s = time.monotonic() + _HANG_S
    while time.monotonic() < ends_s:
        if _STANDS.search(log.read_text()):
            return True
        try:
            started.wait(0.2)
        except subprocess.TimeoutExpired:
            continue
        break
    print(log.read_text()[-2000:], file=sys.stderr)
    return False


def _end(started: subprocess.Popen[bytes]) -> None:
    started.terminate()
    try:
        started.wait(15)
    except subprocess.TimeoutExpired:
        started.kill()
        started.wait()


def _uv(*arguments: str) -> None:
    subprocess.run([str(_UV), *arguments], check=True)
