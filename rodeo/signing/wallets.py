"""Wallets that send transactions, as accounts of eth-account's, and new keystores.

`rodeo.signing.keystores` has the rest, without eth-account, which takes a second to import.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Iterable
from pathlib import Path

from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.host.files import replace_file
from rodeo.signing.keystores import (
    PASSPHRASE_FILE_VARIABLE,
    PASSPHRASE_VARIABLE,
    device_names,
    key_variable,
    keystore_path,
    open_key,
    passphrase,
    wallet_names,
)
from rodeo.site.config import Site

_PRIVATE = 0o600
_SCRYPT_N = 1 << 14
"""Work factor of the keystores made here: a quarter of a second would not protect a throw-away key more."""


def load(site: Site, name: str) -> LocalAccount:
    """`rodeo.signing.keystores.open_key`, as an account that can sign transactions."""
    account: LocalAccount = Account.from_key(open_key(site, name).key)
    return account


def ensure_wallets(site: Site) -> list[str]:
    """Make the keystores that are missing, with fresh throw-away keys: for local chains only. Returns their
    names."""
    folder = _folder(site)
    given = {PASSPHRASE_VARIABLE, PASSPHRASE_FILE_VARIABLE} & os.environ.keys()
    if not given and not (folder / "passphrase").exists():
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
        keystore = Account.encrypt(Account.create().key, passphrase(site), kdf="scrypt", iterations=scrypt_n)
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
        if key_variable(name) not in os.environ and not keystore_path(site, name).exists()
    ]
