"""Sites whose organization is on their chain already: founded once, then copied for each test.

Creating an organization's contracts and setting them up takes seconds of processor time, and most tests only
need them to be there. A snapshot is the data folder of a site after that step. It is kept in `out/snapshots`
under a hash of all that it is made from: the code, the contracts, the site's settings and keys. Tests of the
step itself deploy.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from eth_account import Account
from eth_utils import keccak

from deploy import contracts
from deploy.chain.local_chain import LocalChain
from deploy.chain.methods import Methods
from deploy.chain.server import RpcServer
from deploy.chain.store import Store
from rodeo.checks.rules import rules_hash
from rodeo.kinds import kinds_of
from rodeo.signing.keystores import address, device_names, keystore_path, wallet_names
from rodeo.site.config import Site

_ROOT = Path(__file__).parents[2]
_FOLDER = _ROOT / "out" / "snapshots"
_CHAIN = Path("chain", "eth-tester", "chain.sqlite")
_BEGIN_S = 1_700_000_000
"""When a snapshot's chain begins: always then, so that no test depends on when its snapshot was made."""
_VERSIONS_KEPT = 2
"""Versions of the code whose snapshots stay. Those of older ones are deleted."""
_SCRYPT_N = 2
"""Work factor of the tests' keystores: they protect nothing, and each process of a site opens some."""


def give_wallets(site: Site) -> None:
    """Make the keystores that are missing. Their keys follow from the organization's name and their own."""
    folder = site.data_dir / "keys"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    passphrase = folder / "passphrase"
    if not passphrase.exists():
        passphrase.write_text("known to everybody")
        passphrase.chmod(0o600)
    for name in [*wallet_names(site), *device_names(site)]:
        path = keystore_path(site, name)
        if not path.exists():
            key = keccak(text=f"{site.org}/{path.stem}")
            keystore = Account.encrypt(key, passphrase.read_text(), kdf="scrypt", iterations=_SCRYPT_N)
            path.write_text(json.dumps(keystore))
            path.chmod(0o600)


def has_snapshot(site: Site) -> bool:
    """Whether the site can be `founded`: anvil keeps no such file, and wall time wants blocks of today."""
    return site.chain.backend == "eth-tester" and not site.clock.keeps_wall_time


def found(site: Site, chain: Path | None = None) -> None:
    """Give `site` its organization, on the chain file that the site's chain process opens, or on `chain`."""
    version = _FOLDER / _code()
    # Other workers of the tests do the same at the same time.
    with _locked(_FOLDER.with_suffix(".lock")):
        version.mkdir(parents=True, exist_ok=True)
        version.touch()
        for old in sorted(_FOLDER.iterdir(), key=lambda one: one.stat().st_mtime)[:-_VERSIONS_KEPT]:
            shutil.rmtree(old)
    folder = version / key(site)
    with _locked(folder.with_suffix(".lock")):
        if not folder.exists():
            _make(site, folder)
    shutil.copytree(folder, site.data_dir, dirs_exist_ok=True)
    if chain is not None:
        shutil.move(site.data_dir / _CHAIN, chain)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _make(site: Site, folder: Path) -> None:
    """Deploy on the site's own port, on a chain in this process."""
    half = folder.with_suffix(".half")
    shutil.rmtree(half, ignore_errors=True)
    shutil.copytree(site.data_dir / "keys", half / "keys")
    store = Store(half / _CHAIN)
    begin_s = _BEGIN_S if site.clock.start is None else site.clock.begin_s()
    with RpcServer(site.chain.url, Methods(LocalChain(store, site.chain.id, begin_s, lambda: None))):
        contracts.run(site.model_copy(update={"data_dir": half}), threading.Event())
    store.close()
    shutil.rmtree(half / "keys")
    half.rename(folder)


@cache
def _code() -> str:
    """Hash of what deploys and of what is deployed."""
    files = [file for package in ("deploy", "rodeo") for file in (_ROOT / package).rglob("*.*")]
    files = [file for file in files if file.suffix in (".py", ".json")]
    return _hash(*(file.read_bytes() for file in sorted([*files, _ROOT / "constraints.txt", Path(__file__)])))


def key(site: Site) -> str:
    """Hash of what else a snapshot depends on; not of where the site's folder and ports are."""
    settings = site.model_dump_json(exclude={"chain": {"url"}, "console": True})
    rules = {name: rules_hash(kind) for name, kind in kinds_of(site).items()}
    keys = {name: address(site, name) for name in [*wallet_names(site), *device_names(site)]}
    return _hash(settings.replace(str(site.data_dir), "").encode(), json.dumps([rules, keys]).encode())


def _hash(*parts: bytes) -> str:
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()[:16]
