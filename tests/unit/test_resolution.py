"""Whatever a site needs has wheels, for both machines and every Python: nobody needs a compiler."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import product

import pytest

from tests.support.extras import PROJECT, ROOT

MACHINES = ("x86_64-manylinux_2_28", "aarch64-manylinux_2_28")
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
EXTRAS = sorted(PROJECT["optional-dependencies"].keys() - {"dev"})
"""`dev` is not for sites."""
AWAY = (
    "error sending request",
    "dns error",
    "Failed to fetch",
    "Connect",
    "Network connectivity is disabled",
)
"""How uv says that it cannot reach the package index."""


def resolved(machine: str, python: str) -> subprocess.CompletedProcess[str]:
    extras = [word for extra in EXTRAS for word in ("--extra", extra)]
    target = ["--python-platform", machine, "--python-version", python]
    return subprocess.run(
        ["uv", "pip", "compile", "--quiet", "--no-build", *target, *extras, "pyproject.toml"],
        cwd=ROOT,
        # Several indexes may be configured: the best version of any of them counts, as for pip.
        env={"UV_INDEX_STRATEGY": "unsafe-best-match"} | os.environ | {"PATH": _path()},
        capture_output=True,
        text=True,
        timeout=1800,
    )


def _path() -> str:
    """uv is installed beside the interpreter."""
    return os.pathsep.join([os.path.dirname(sys.executable), os.environ.get("PATH", "")])


@pytest.mark.long
def test_all_extras_resolve_to_wheels_for_both_machines_and_every_python() -> None:
    wanted = list(product(MACHINES, PYTHONS))
    with ThreadPoolExecutor(2) as pool:
        answers = list(pool.map(lambda one: resolved(*one), wanted))
    failed = {one: answer.stderr for one, answer in zip(wanted, answers, strict=True) if answer.returncode}
    if any(text in stderr for stderr in failed.values() for text in AWAY):
        pytest.skip("the package index cannot be reached, so no resolution can be computed")
    assert not failed
