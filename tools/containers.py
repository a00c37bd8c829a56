"""`make containers`: the images of `rodeo deploy compose`, built and run with podman until a task is settled.

The base is an empty Debian (debootstrap), images are built in a chroot, and runc starts them: no registry of
images is asked. The site has people only, so four images suffice, and a person's work is paid by commands in
containers. Everything is under out/containers but for the images, which stay for the next time.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import yaml

from deploy.containers import USER_ID
from rodeo_testing.waiting import wait_until
from tools.install import pip_settings
from tools.release import ROOT, build, say

OUT = ROOT / "out" / "containers"
BASE = "localhost/rodeo-debian"
SUITE = "trixie"
SITE = """\
org = "yard"
data_dir = "data"
robots = []
bins = []
docks = []
items = []
clock.source = "wall"
lab = { mocap = false, size_m = [7.0, 5.0] }
participants = [{ name = "alice" }]
kinds = [{ name = "sweeping", judge = "auditor", price_iec = 40 }]
governance = { delay_s = 0, terms = { bond_iec = 0, penalty_iec = 0, max_failures = 0 } }
"""
PROCESSES = ("router", "chain", "bridge")
WORK = (
    "service offer sweeping --price 40 --as alice",
    "task create sweeping --reward 50 --description yard",
    "task accept 1 --as alice",
    "task submit 1 --as alice --note swept",
    "task judge 1 --accept --reason seen",
)


def why_not() -> str:
    """Why this machine cannot; empty where it can."""
    if os.geteuid() != 0:
        return "only root can make Debian roots: sudo make containers"
    missing = [one for one in ("debootstrap", "podman", "runc") if shutil.which(one) is None]
    return f"missing: apt-get install {' '.join(missing)}" if missing else ""


class Podman:
    """podman, with limits that a machine without CAP_SYS_RESOURCE grants, and the services of a compose file:
    Debian's podman-compose gives none the computer's network."""

    def __init__(self) -> None:
        files = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        processes = int(Path("/proc/sys/kernel/pid_max").read_text())
        limits = json.dumps([f"nofile={files}:{files}", f"nproc={processes}:{processes}"])
        settings = OUT / "containers.conf"
        settings.write_text(f'[containers]\ndefault_ulimits = {limits}\n[engine]\nruntime = "runc"\n')
        self._environment = {**os.environ, "CONTAINERS_CONF": str(settings), "BUILDAH_ISOLATION": "chroot"}
        self._document = yaml.safe_load((OUT / "compose.yaml").read_text())

    def __call__(self, *command: str) -> str:
        done = subprocess.run(
            command, cwd=OUT, env=self._environment, stdout=subprocess.PIPE, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(
                f"{' '.join(command)} ended with status {done.returncode}\n{done.stdout[-2000:]}"
            )
        return done.stdout

    def _options(self, name: str) -> Iterator[str]:
        service = self._document["services"][name]
        yield from ("--name", self._container(name), "--read-only", "--network", service["network_mode"])
        yield from ("--user", service["user"])
        for option, setting in (
            ("tmpfs", "tmpfs"),
            ("cap-drop", "cap_drop"),
            ("security-opt", "security_opt"),
        ):
            yield from (f"--{option}={one.removesuffix(':true')}" for one in service[setting])
        yield from (f"--env={variable}={text}" for variable, text in service["environment"].items())
        for one in service["volumes"]:
            source = self._container(one["source"]) if one["type"] == "volume" else one["source"]
            yield f"--volume={source}:{one['target']}:{'ro' if one.get('read_only') else 'rw'}"
        for one in service.get("secrets", ()):
            yield f"--volume={self._document['secrets'][one]['file']}:/run/secrets/{one}:ro"

    def _container(self, name: str) -> str:
        return f"{self._document['name']}-{name}"

    def start(self, name: str) -> None:
        """Start a process, and wait until its own health check says that it is ready."""
        service = self._document["services"][name]
        self("podman", "run", "--detach", *self._options(name), service["image"], *service["command"])
        asked = ["podman", "exec", self._container(name), *service["healthcheck"]["test"][1:]]

        def ready() -> bool:
            return not subprocess.run(
                asked, env=self._environment, capture_output=True, check=False
            ).returncode

        wait_until(ready, lambda: self("podman", "logs", self._container(name)))

    def rodeo(self, *words: str) -> str:
        """A command in a container of its own."""
        service = self._document["services"]["rodeo"]
        entry = json.dumps(service["entrypoint"])
        given = [*self._options("rodeo"), "--entrypoint", entry, service["image"], *words]
        return self("podman", "run", "--rm", *given)

    def remove(self) -> None:
        """Containers and data, not the images."""
        for name in self._document["services"]:
            self("podman", "rm", "--force", "--time", "120", "--ignore", self._container(name))
        self("podman", "volume", "rm", "--force", self._container("data"))


def write() -> None:
    """The wheel, the site and what `rodeo deploy compose` says of it."""
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    _, wheel = build()
    shutil.copy(wheel, OUT)
    site, passphrase = OUT / "site.toml", OUT / "passphrase"
    site.write_text(SITE)
    passphrase.write_text(os.urandom(16).hex())
    passphrase.chmod(0o400)
    os.chown(passphrase, USER_ID, USER_ID)
    told = ["deploy", "compose", "--site", str(site), "--out", str(OUT), "--passphrase", str(passphrase)]
    subprocess.run([sys.executable, "-m", "rodeo_cli", *told], check=True, cwd=ROOT)


def make_images(podman: Podman) -> None:
    """Those of the site, on a base that is made once."""
    if subprocess.run(["podman", "image", "exists", BASE], check=False).returncode:
        say(f"{SUITE}: debootstrap")
        root = OUT / "root"
        podman("debootstrap", "--variant=minbase", "--include=python3-venv,ca-certificates", SUITE, str(root))
        podman("sh", "-c", f"tar --create --directory {root} . | podman import - {BASE}")
        shutil.rmtree(root)
    settings = pip_settings(podman(sys.executable, "-m", "pip", "config", "list"))
    lines = [
        f"{key} = {settings[key]}" for key in ("index-url", "proxy", "default-timeout") if key in settings
    ]
    mounted = []
    if certificates := settings.get("cert"):
        lines.append("cert = /etc/pip-certificates.crt")
        mounted = ["--volume", f"{certificates}:/etc/pip-certificates.crt:ro"]
    (OUT / "pip.conf").write_text("\n".join(["[global]", *lines, ""]))
    mounted += ["--volume", f"{OUT / 'pip.conf'}:/etc/pip.conf:ro"]
    for target in (*PROCESSES, "site"):
        say(f"rodeo-{target}: podman build")
        image = ["--target", target, "--tag", f"rodeo-{target}", "--build-arg", f"BASE={BASE}"]
        podman("podman", "build", "--quiet", *mounted, *image, ".")


def settle(podman: Podman) -> None:
    """A task, from its creation to its payment. Raises SystemExit."""
    podman.rodeo("site", "prepare")
    for name in PROCESSES:
        say(f"{name}: podman run")
        podman.start(name)
    for words in WORK:
        say(f"rodeo {words}")
        podman.rodeo(*words.split())
    task = json.loads(podman.rodeo("task", "show", "1", "--json"))
    if task["state"] != "settled":
        raise SystemExit(f"the task is {task['state']}")
    say(f"Task 1 is settled, {task['executor_name']} is paid, in containers.")


def main() -> int:
    if why := why_not():
        say(f"No containers: {why}")
        return 1
    write()
    podman = Podman()
    make_images(podman)
    podman.remove()
    try:
        settle(podman)
    finally:
        podman.remove()
    return 0


if __name__ == "__main__":
    sys.exit(main())
