"""Install Python packages into a virtual environment, with the interpreter that runs this.

`tools/setup.sh` chooses that interpreter. pip puts uv into the environment, and uv installs the rest in a
third of pip's time. uv gets pip's own settings: indexes, find-links, certificates, proxy, constraints.
pip installs where uv cannot be had or fails. Standard library only.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import time
import venv
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = Path(".venv")
CONSTRAINTS = "constraints.txt"
EXTRAS = ("site", "experiment", "dev")
"""Each contains those before it."""


def pip_settings(listing: str) -> dict[str, str]:
    """What `pip config list` says for `pip install`: [install] overrides [global], the environment both."""
    found: dict[str, dict[str, str]] = {"global": {}, "install": {}, ":env:": {}}
    for line in listing.splitlines():
        name, _, text = line.partition("=")
        section, _, key = name.partition(".")
        if section in found and text.startswith(("'", '"')):
            found[section][key] = str(ast.literal_eval(text))
    return found["global"] | found["install"] | found[":env:"]


def uv_environment(settings: Mapping[str, str]) -> dict[str, str]:
    """The same settings as environment variables of uv; addresses may hold passwords, so no options."""
    env = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # pip takes the best version of all indexes

    def words(key: str) -> list[str]:
        return [os.path.expanduser(word) for word in settings.get(key, "").split()]

    if index := settings.get("index-url"):
        env["UV_DEFAULT_INDEX"] = index
    if more := words("extra-index-url"):
        env["UV_INDEX"] = " ".join(more)
    if links := words("find-links"):
        env["UV_FIND_LINKS"] = ",".join(links)
    if hosts := words("trusted-host"):
        env["UV_INSECURE_HOST"] = " ".join(hosts)
    if certificates := settings.get("cert"):
        path = os.path.expanduser(certificates)
        env["SSL_CERT_DIR" if os.path.isdir(path) else "SSL_CERT_FILE"] = path
    if client := settings.get("client-cert"):
        env["SSL_CLIENT_CERT"] = os.path.expanduser(client)
    if proxy := settings.get("proxy"):
        env["HTTP_PROXY"] = env["HTTPS_PROXY"] = proxy if "://" in proxy else f"http://{proxy}"
    if timeout := settings.get("timeout", settings.get("default-timeout")):
        env["UV_HTTP_TIMEOUT"] = timeout
    if _true(settings.get("no-cache-dir")):
        env["UV_NO_CACHE"] = "1"
    return env


def uv_options(settings: Mapping[str, str]) -> list[str]:
    """What has to be an option: uv reads the variable of constraints only where no option names some."""
    options = ["--no-index"] if _true(settings.get("no-index")) else []
    for file in settings.get("constraint", "").split():
        options += ["--constraint", os.path.expanduser(file)]
    return options


def _true(text: str | None) -> bool:
    return (text or "").lower() in ("1", "true", "yes", "on", "y", "t")


class Environment:
    """A virtual environment. One whose last installation did not end, with half a package, is made anew."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.python = str(folder / "bin" / "python")
        self._whole = folder / "whole"

    def install(self, what: list[str], constraints: list[str]) -> None:
        """`what` are pip's own words: requirements, `--editable .`, `--requirement FILE`."""
        if not self._whole.exists() or os.path.realpath(self.python) != os.path.realpath(sys.executable):
            self._make()
        self._whole.unlink(missing_ok=True)
        self._install(what, constraints)
        self._whole.touch()

    def _make(self) -> None:
        say(f"making {self.folder} with Python {sys.version.split()[0]}")
        venv.create(self.folder, clear=True, symlinks=True, with_pip=True)

    def _install(self, what: list[str], constraints: list[str]) -> None:
        kept = [word for file in constraints for word in ("--constraint", file)]
        try:
            uv = self._uv(kept)
            say("uv downloads, installs and compiles to bytecode")
            settings = pip_settings(self._pip("config", "list", read=True))
            _uv(uv, self.python, [*uv_options(settings), *kept, *what], uv_environment(settings))
        except subprocess.CalledProcessError as failed:
            say(f"uv cannot do it (status {failed.returncode}); pip does, which takes three times as long")
            self._make()
            self._pip("install", "--progress-bar=off", *kept, *what)

    def _uv(self, kept: list[str]) -> str:
        """The path of uv: the one that is there, or one that pip puts here."""
        for folder in (self.folder, VENV):
            if (folder / "bin" / "uv").exists():
                return str(folder / "bin" / "uv")
        say("pip installs uv, which installs the rest")
        self._pip("install", "-qq", *kept, "uv")
        return str(self.folder / "bin" / "uv")

    def _pip(self, *words: str, read: bool = False) -> str:
        command = [self.python, "-m", "pip", "--disable-pip-version-check", *words]
        done = subprocess.run(command, stdout=subprocess.PIPE if read else None, text=True, check=True)
        return done.stdout or ""


def _uv(uv: str, python: str, words: list[str], settings: dict[str, str]) -> None:
    """uv prints a line per step. It also prints one per package at the end; these are left out."""
    own = {name: text for name, text in os.environ.items() if name.startswith("UV_")}
    command = [uv, "pip", "install", "--python", python, "--compile-bytecode", *words]
    with subprocess.Popen(
        command, env={**os.environ, **settings, **own}, stderr=subprocess.PIPE, text=True, errors="replace"
    ) as running:
        assert running.stderr is not None
        for line in running.stderr:
            if not line.startswith((" + ", " - ", " ~ ")):
                say(f"  {line.rstrip()}")
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)


def say(line: str) -> None:
    print(f"  {line}", file=sys.stderr, flush=True)


def install_extra(extra: str) -> None:
    """Install it into .venv, or the larger one that is there. Leaves a stamp for each that is there."""
    there = max([extra, *(one for one in EXTRAS if _stamp(one).exists())], key=EXTRAS.index)
    Environment(VENV).install(["--editable", f".[{there}]"], [CONSTRAINTS])
    # The editable sources as well: else ten processes of the first demo compile them side by side.
    sources = sorted({str(file.parts[0]) for file in Path().glob("*/__init__.py")})
    subprocess.run([sys.executable, "-m", "compileall", "-q", "-j0", *sources], check=True)
    for one in EXTRAS[: EXTRAS.index(there) + 1]:
        _stamp(one).touch()


def _stamp(extra: str) -> Path:
    return VENV / f"installed-{extra}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--extra", choices=EXTRAS, help="this project with an extra, into .venv")
    parser.add_argument("--folder", type=Path, help="another environment")
    parser.add_argument("--requirement", help="a requirements file for it")
    asked = parser.parse_args()
    os.chdir(ROOT)
    began = time.monotonic()
    try:
        if asked.extra:
            install_extra(asked.extra)
        else:
            Environment(asked.folder).install(["--requirement", asked.requirement], [])
    except KeyboardInterrupt:
        say("interrupted. The same command begins anew, with what is downloaded")
        return 130
    except subprocess.CalledProcessError as failed:
        say(f"failed: {' '.join(map(str, failed.cmd[:5]))} ... ended with status {failed.returncode}")
        return 1
    say(f"installed in {time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
