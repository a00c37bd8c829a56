"""Encrypted keystores: who holds which key, and how a process opens its own.

Keystores are Web3 Secret Storage files (`<data_dir>/keys/<name>.json`). The passphrase comes from
`RODEO_KEYSTORE_PASSPHRASE`, from the file that `RODEO_KEYSTORE_PASSPHRASE_FILE` names, or from
`<data_dir>/keys/passphrase`, which `rodeo.signing.wallets` writes (mode 0600) beside keystores it makes for a
local chain; on a terminal an operator is asked. Keys are never on the bus.
"""

from __future__ import annotations

import json
import os
import sys
from functools import cache
from getpass import getpass
from hashlib import pbkdf2_hmac, scrypt
from hmac import compare_digest
from pathlib import Path
from typing import Any, NamedTuple

from Crypto.Cipher import AES
from eth_utils import keccak, to_checksum_address

from rodeo.errors import KeystoreMissing, WalletError
from rodeo.signing.keys import Key
from rodeo.site.config import Site
from rodeo.site.names import oracle_names
from rodeo.site.providers import MOTION_CAPTURE

PASSPHRASE_VARIABLE = "RODEO_KEYSTORE_PASSPHRASE"
PASSPHRASE_FILE_VARIABLE = "RODEO_KEYSTORE_PASSPHRASE_FILE"

KEY_VARIABLE = "RODEO_KEY_"
"""`RODEO_KEY_ORGANIZATION` holds the private key of `organization` (0x, 32 bytes), in place of a keystore."""

_SCRYPT_SPARE_BYTES = 1 << 20
"""What OpenSSL allows scrypt beside what it needs."""


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
        SiteDevice("mocap", MOTION_CAPTURE),
        # With these they vote. What sends transactions, and pays for them, is the wallet of the same name.
        *(SiteDevice("oracle", one.name) for one in site.oracles),
    ]
    return {f"{device.name}-device": device for device in devices}


def keystore_path(site: Site, name: str) -> Path:
    """The keystore of participant or device `name`; a robot's is the one that the site file gives it as
    wallet."""
    stem = next((robot.wallet for robot in site.robots if robot.name == name), name)
    return site.data_dir / "keys" / f"{stem}.json"


def address(site: Site, name: str) -> str:
    """The checksummed address of keystore `name`, if it says so without being opened. Raises WalletError."""
    if key_variable(name) in os.environ:
        return open_key(site, name).address
    keystore = _read(keystore_path(site, name), name)
    # The format does not require it, and Foundry's keystores keep it to themselves.
    if "address" not in keystore:
        return open_key(site, name).address
    try:
        return to_checksum_address(str(keystore["address"]))
    except ValueError as error:
        raise WalletError(
            "the keystore's address is not valid", name=name, path=str(keystore_path(site, name))
        ) from error


def open_key(site: Site, name: str) -> Key:
    """Open keystore `name`, or take the key from the environment.

    Raises KeystoreMissing, or WalletError when the passphrase does not fit or the variable holds no key.
    """
    variable = key_variable(name)
    if variable in os.environ:
        try:
            return Key(bytes.fromhex(os.environ[variable].strip().removeprefix("0x")))
        except ValueError:
            # Neither the key nor what is wrong with it: both would end in a log.
            raise WalletError("the variable holds no private key", name=name, variable=variable) from None
    path = keystore_path(site, name)
    keystore = _read(path, name)
    try:
        return Key(_decrypted(keystore, passphrase(site).encode()))
    except (KeyError, TypeError, AttributeError) as error:
        raise WalletError("this is not a keystore", name=name, path=str(path)) from error
    except ValueError as error:
        raise WalletError("the passphrase does not open the keystore", name=name, path=str(path)) from error


def _decrypted(keystore: dict[str, Any], passphrase: bytes) -> bytes:
    """The private key in a Web3 Secret Storage file, version 3. What does not fit raises ValueError, and what
    is missing KeyError.

    eth-keyfile reads them as well, and imports the curves of version 4, which takes half a second.
    """
    if keystore["version"] != 3:
        raise KeyError(keystore["version"])
    # Old files of geth's have it in upper case.
    crypto = keystore["crypto"] if "crypto" in keystore else keystore["Crypto"]
    derived = _derived(crypto["kdf"], crypto["kdfparams"], passphrase)
    ciphertext = bytes.fromhex(crypto["ciphertext"].removeprefix("0x"))
    mac = bytes.fromhex(crypto["mac"].removeprefix("0x"))
    if not compare_digest(mac, keccak(derived[16:32] + ciphertext)):
        raise ValueError("the passphrase is another one")
    if crypto["cipher"] != "aes-128-ctr":
        raise KeyError(crypto["cipher"])
    iv = bytes.fromhex(crypto["cipherparams"]["iv"].removeprefix("0x"))
    cipher = AES.new(derived[:16], AES.MODE_CTR, nonce=b"", initial_value=iv.rjust(16, b"\0"))
    return cipher.decrypt(ciphertext)


def _derived(kdf: str, params: dict[str, Any], passphrase: bytes) -> bytes:
    salt, length = bytes.fromhex(params["salt"].removeprefix("0x")), params["dklen"]
    if kdf == "scrypt":
        n, r, p = params["n"], params["r"], params["p"]
        most_bytes = _SCRYPT_SPARE_BYTES + 128 * r * (n + p)
        return scrypt(passphrase, salt=salt, n=n, r=r, p=p, maxmem=most_bytes, dklen=length)
    if kdf == "pbkdf2" and params["prf"] == "hmac-sha256":
        return pbkdf2_hmac("sha256", passphrase, salt, params["c"], length)
    raise KeyError(kdf)


def key_variable(name: str) -> str:
    return KEY_VARIABLE + name.upper().replace("-", "_")


def passphrase(site: Site) -> str:
    if PASSPHRASE_VARIABLE in os.environ:
        return os.environ[PASSPHRASE_VARIABLE]
    named = os.environ.get(PASSPHRASE_FILE_VARIABLE)
    path = Path(named) if named else site.data_dir / "keys" / "passphrase"
    try:
        return path.read_text().strip()
    except OSError as error:
        if not named and sys.stdin is not None and sys.stdin.isatty():
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
