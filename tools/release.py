"""`make release`: sdist and wheel in out/dist, checked, and the demo from the wheel in empty Debian roots.

uv builds the files from the last commit. An empty root is a Debian without a compiler. debootstrap makes it
under out/roots, and it is removed afterwards. Only `pip install "rodeo-dao[site]"` and `rodeo demo` are typed
there. If root's rights or debootstrap are missing, the command says so and fails: nothing was checked there.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterable
from pathlib import Path

from packaging.metadata import Metadata

from tools.install import pip_settings

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "out" / "dist"
ROOTS = ROOT / "out" / "roots"
SUITES = ("bookworm", "trixie")
"""Debian 12 with Python 3.11, Debian 13 with Python 3.13."""
PACKAGES = {
    "deploy", "rodeo", "rodeo_cli", "rodeo_experiments", "rodeo_kinds", "rodeo_testing", "services"
}  # fmt: skip
"""All that a wheel may hold, beside its metadata."""
LIMIT_BYTES = 30_000_000
_SECRET = re.compile(r"\.(pem|key|env|sqlite3?|so|pyx|c)$|(^|/)(keys|keystores|tests|var|out)/|(^|/)\.")
IN_ROOT = """\
set -eu
mount -t proc proc {root}/proc
mount -t tmpfs tmpfs {root}/dev/shm
exec chroot {root} env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 {settings} sh -euc '
for compiler in cc gcc clang; do if command -v $compiler; then exit 1; fi; done
python3 -m venv /venv
/venv/bin/pip install --quiet --disable-pip-version-check "{wheel}[site]"
mkdir /empty
cd /empty
/venv/bin/rodeo demo
'
"""
"""In a mount and process namespace of its own: nothing stays mounted, and no process stays."""


def faults_of_wheel(wheel: Path) -> list[str]:
    """What is wrong with its name, size, contents and metadata."""
    faults = []
    if not wheel.name.endswith("-py3-none-any.whl"):
        faults.append(f"{wheel.name}: the wheel is for one kind of machine")
    if (size := wheel.stat().st_size) > LIMIT_BYTES:
        faults.append(f"{wheel.name}: {size} bytes, {LIMIT_BYTES} at most")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (info,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
        metadata = archive.read(f"{info}/METADATA")
        licenses = [name for name in names if name.startswith(f"{info}/licenses/")]
    if tops := {name.split("/")[0] for name in names} - PACKAGES - {info}:
        faults.append(f"{wheel.name}: holds {', '.join(sorted(tops))}")
    faults += [f"{wheel.name}: holds {name}" for name in names if _SECRET.search(name)]
    if not licenses:
        faults.append(f"{wheel.name}: holds no license")
    return faults + faults_of_metadata(metadata)


def faults_of_metadata(text: bytes) -> list[str]:
    """What a package index would reject, or show wrongly."""
    try:
        metadata = Metadata.from_email(text, validate=True)
    except ExceptionGroup as group:
        return [str(error) for error in group.exceptions]
    faults = []
    if metadata.description_content_type != "text/markdown" or not (metadata.description or "").strip():
        faults.append("the description is not the README in Markdown")
    if metadata.requires_python is None or metadata.license_expression is None:
        faults.append("requires-python and a license expression are needed")
    if "site" not in (metadata.provides_extra or []):
        faults.append("there is no extra `site`")
    return faults


def faults_of_sdist(sdist: Path) -> list[str]:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    missing = {"pyproject.toml", "README.md", "LICENSE", "PKG-INFO"} - names
    return [f"{sdist.name}: lacks {name}" for name in sorted(missing)]


def build() -> tuple[Path, Path]:
    """The sdist, and the wheel that is built from it."""
    if _run("git", "status", "--porcelain", "--untracked-files=no").strip():
        say("What is not committed is not part of the release.")
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir(parents=True)
    source = DIST / "source"
    source.mkdir()
    _run("sh", "-c", f"git archive HEAD | tar --extract --directory {source}")
    _run(str(Path(sys.executable).with_name("uv")), "build", "--quiet", "--out-dir", str(DIST), str(source))
    shutil.rmtree(source)
    (sdist,), (wheel,) = DIST.glob("*.tar.gz"), DIST.glob("*.whl")
    for path in (sdist, wheel):
        say(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e6:.1f} MB")
    return sdist, wheel


def why_no_roots() -> str | None:
    """Why this machine cannot make empty Debian roots; None where it can."""
    if os.geteuid() != 0:
        return "only root can make Debian roots: sudo make release"
    missing = [name for name in ("debootstrap", "unshare", "chroot") if shutil.which(name) is None]
    return f"{', '.join(missing)} missing: apt-get install debootstrap" if missing else None


def check_in_root(suite: str, wheel: Path) -> None:
    """Install the wheel in an empty Debian of this suite, and run the demo. pip gets this machine's index,
    certificates and proxy, but no folder of wheels: everything comes from the index."""
    root = ROOTS / suite
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    try:
        say(f"{suite}: debootstrap")
        more = "--include=python3,python3-venv,ca-certificates"
        _run("debootstrap", "--variant=minbase", more, suite, str(root))
        shutil.copy("/etc/resolv.conf", root / "etc")
        (root / "dist").mkdir()
        shutil.copy(wheel, root / "dist")
        settings = pip_settings(_run(sys.executable, "-m", "pip", "config", "list"))
        say(f"{suite}: pip install {wheel.name}[site], rodeo demo")
        script = IN_ROOT.format(
            root=root, settings=" ".join(_carried(settings, root)), wheel=f"/dist/{wheel.name}"
        )
        namespaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child"]
        subprocess.run([*namespaces, "sh", "-c", script], check=True, stdin=subprocess.DEVNULL)
        summary = json.loads((root / "empty" / "out" / "demo" / "summary.json").read_text())
        states = [task["state"] for task in summary["tasks"]]
        if states != ["settled", "settled"]:
            raise SystemExit(f"{suite}: the demo's tasks are {', '.join(states)}")
        say(f"{suite}: both tasks of the demo are settled")
    finally:
        shutil.rmtree(root)


def _carried(settings: dict[str, str], root: Path) -> Iterable[str]:
    """pip's settings as variables for a root; the certificates are copied into it."""
    if certificates := settings.get("cert"):
        shutil.copy(certificates, root / "etc" / "ssl" / "certs" / "ca-certificates.crt")
        yield "PIP_CERT=/etc/ssl/certs/ca-certificates.crt"
    for key in ("index-url", "proxy", "trusted-host", "default-timeout"):
        if key in settings:
            yield f"PIP_{key.upper().replace('-', '_')}={shlex.quote(settings[key])}"


def _run(*command: str) -> str:
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} ended with status {done.returncode}\n{done.stdout[-2000:]}")
    return done.stdout


def say(line: str) -> None:
    print(line, flush=True)


def main() -> int:
    sdist, wheel = build()
    if faults := [*faults_of_sdist(sdist), *faults_of_wheel(wheel)]:
        say("\n".join(faults))
        return 1
    if why := why_no_roots():
        say(f"Built, and not checked in empty Debian roots: {why}")
        return 1
    for suite in SUITES:
        check_in_root(suite, wheel)
    say("Built and checked. What remains is to upload it: uv publish out/dist/*")
    return 0


if __name__ == "__main__":
    sys.exit(main())
