"""Encrypted keystores: who holds which key, and how a process opens its own.

Keystores are Web3 Secret Storage files (`<data_dir>/keys/<name>.json`). The passphrase comes from
`RODEO_KEYSTORE_PASSPHRASE`, or from the file `<data_dir>/keys/passphrase` that `ensure_wallets` writes
(mode 0600) beside keystores it makes for a local chain; on a terminal an operator is asked. Keys are never on
the bus.
"""

from __future__ import annotations

import json
import os
import secrets
import sys
from collections.abc import Iterable
from functools import cache
from getpass import getpass
from pathlib import Path
from typing import NamedTuple

from eth_account import Account
from eth_account.signers.local import LocalAccount
from eth_utils import to_checksum_address

from rodeo.config import Site, oracle_names
from rodeo.errors import KeystoreMissing, WalletError
from rodeo.files import replace_file

_PRIVATE = 0o600
PASSPHRASE_VARIABLE = "RODEO_KEYSTORE_PASSPHRASE"

KEY_VARIABLE = "RODEO_KEY_"
"""`RODEO_KEY_ORGANIZATION` holds the private key of `organization` (0x, 32 bytes), in place of a keystore."""

_SCRYPT_N = 1 << 14
"""Work factor of the keystores made here: a quarter of a second would not protect a throw-away key more."""


MOCAP_NAME = "mocap"
"""The lab has one motion capture."""


def wallet_names(site: Site) -> list[str]:
    """Participants whose wallet the site has: the organization's operator, robots, oracles, others."""
    others = [participant.name for participant in site.participants if participant.address is None]
    return [*sender_names(site), *others]


def sender_names(site: Site) -> list[str]:
    """Those of them that pay for gas themselves. Others can send for the rest (`rodeo task relay`)."""
    return ["organization", *(robot.name for robot in site.robots), *oracle_names(site)]


def wallets_elsewhere(site: Site) -> dict[str, str]:
    """Participants who sign for themselves -> their checksummed address."""
    return {
        participant.name: to_checksum_address(participant.address)
        for participant in site.participants
        if participant.address is not None
    }


class SiteDevice(NamedTuple):
    """What a device is, as the chain has it."""

    role: str
    name: str


def device_names(site: Site) -> dict[str, SiteDevice]:
    """Keystores of the devices, which sign evidence and own nothing -> role and name on chain."""
    devices = [
        *(SiteDevice("robot", robot.name) for robot in site.robots),
        *(SiteDevice("bin", one.name) for one in site.bins),
        *(SiteDevice("meter", dock.name) for dock in site.docks),
        SiteDevice("mocap", MOCAP_NAME),
        # With these they vote. What sends transactions, and pays for them, is the wallet of the same name.
        *(SiteDevice("oracle", one.name) for one in site.oracles),
    ]
    return {f"{device.name}-device": device for device in devices}


def keystore_path(site: Site, name: str) -> Path:
    """Of participant or device `name`; a robot's is the one that the site file gives it as wallet."""
    stem = next((robot.wallet for robot in site.robots if robot.name == name), name)
    return site.data_dir / "keys" / f"{stem}.json"


def address(site: Site, name: str) -> str:
    """The checksummed address of keystore `name`, if it says so without being opened. Raises WalletError."""
    if _key_variable(name) in os.environ:
        return load(site, name).address
    keystore = _read(keystore_path(site, name), name)
    # The format does not require it, and Foundry's keystores keep it to themselves.
    if "address" not in keystore:
        return load(site, name).address
    try:
        return to_checksum_address(str(keystore["address"]))
    except ValueError as error:
        raise WalletError(
            "the keystore's address is not valid", name=name, path=str(keystore_path(site, name))
        ) from error


def load(site: Site, name: str) -> LocalAccount:
    """Open keystore `name`, or take the key from the environment.

    Raises KeystoreMissing, or WalletError when the passphrase does not fit or the variable holds no key.
    """
    variable = _key_variable(name)
    if variable in os.environ:
        try:
            return Account.from_key(os.environ[variable].strip())
        except ValueError:
            # Neither the key nor what is wrong with it: both would end in a log.
            raise WalletError("the variable holds no private key", name=name, variable=variable) from None
    path = keystore_path(site, name)
    keystore = _read(path, name)
    try:
        return Account.from_key(Account.decrypt(keystore, _passphrase(site)))
    except (KeyError, TypeError) as error:
        raise WalletError("this is not a keystore", name=name, path=str(path)) from error
    except ValueError as error:
        raise WalletError("the passphrase does not open the keystore", name=name, path=str(path)) from error


def ensure_wallets(site: Site) -> list[str]:
    """Make the keystores that are missing, with fresh throw-away keys: for local chains only. Returns their
    names."""
    folder = _folder(site)
    if PASSPHRASE_VARIABLE not in os.environ and not (folder / "passphrase").exists():
        replace_file(folder / "passphrase", secrets.token_urlsafe(24), mode=_PRIVATE)
    return make_missing(site, _SCRYPT_N)


def make_missing(site: Site, scrypt_n: int | None = None) -> list[str]:
    """Make the keystores that are missing, with fresh keys; returns their names. Raises WalletError without a
    passphrase.

    `scrypt_n` is the work factor; by default eth-account's own, a second per keystore.
    """
    _folder(site)
    made = _missing(site, [*wallet_names(site), *device_names(site)])
    for name in made:
        keystore = Account.encrypt(Account.create().key, _passphrase(site), kdf="scrypt", iterations=scrypt_n)
        replace_file(keystore_path(site, name), json.dumps(keystore), mode=_PRIVATE)
    return made


def _folder(site: Site) -> Path:
    folder = site.data_dir / "keys"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return folder


def _missing(site: Site, names: Iterable[str]) -> list[str]:
    return [
        name
        for name in names
        if _key_variable(name) not in os.environ and not keystore_path(site, name).exists()
    ]


def _key_variable(name: str) -> str:
    return KEY_VARIABLE + name.upper().replace("-", "_")


def _passphrase(site: Site) -> str:
    if PASSPHRASE_VARIABLE in os.environ:
        return os.environ[PASSPHRASE_VARIABLE]
    path = site.data_dir / "keys" / "passphrase"
    try:
        return path.read_text().strip()
    except OSError as error:
        if sys.stdin is not None and sys.stdin.isatty():
            return _asked(str(site.data_dir))
        raise WalletError(
            f"no passphrase: set {PASSPHRASE_VARIABLE}, write it to a file or start on a terminal",
            path=str(path),
        ) from error


@cache
def _asked(keys: str) -> str:
    """What the operator types, once per process."""
    return getpass(f"Passphrase of the keystores in {keys}: ")


def _read(path: Path, name: str) -> dict[str, object]:
    try:
        keystore = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise KeystoreMissing("there is no keystore of this name", name=name, path=str(path)) from error
    except (OSError, ValueError) as error:
        raise WalletError("cannot read the keystore", name=name, path=str(path)) from error
    if not isinstance(keystore, dict):
        raise WalletError("this is not a keystore", name=name, path=str(path))
    return keystore
