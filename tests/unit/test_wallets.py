"""Keystores: made once, opened with the passphrase, never readable by others."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from rodeo.errors import KeystoreMissing, WalletError
from rodeo.signing import keystores, wallets
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S


@pytest.fixture
def site(site_path: Path) -> Site:
    return Site.load(site_path)


def test_a_keystore_opens_to_the_address_it_states(site: Site) -> None:
    wallets.ensure_wallets(site)
    assert wallets.load(site, "panther1").address == keystores.address(site, "panther1")


def test_a_robot_uses_the_wallet_that_the_site_names(site: Site) -> None:
    robot = site.robots[0].model_copy(update={"wallet": "purse"})
    site = site.model_copy(update={"robots": [robot]})
    wallets.ensure_wallets(site)
    assert (site.data_dir / "keys" / "purse.json").exists()
    assert keystores.keystore_path(site, robot.name).name == "purse.json"
    assert keystores.keystore_path(site, f"{robot.name}-device").name == f"{robot.name}-device.json"


def test_making_wallets_twice_keeps_the_first(site: Site) -> None:
    wallets.ensure_wallets(site)
    before = keystores.address(site, "oracle")
    wallets.ensure_wallets(site)
    assert keystores.address(site, "oracle") == before


def test_only_the_owner_can_read_keys_and_passphrase(site: Site) -> None:
    wallets.ensure_wallets(site)
    for path in (site.data_dir / "keys").iterdir():
        assert path.stat().st_mode & 0o077 == 0, path.name


def test_a_wrong_passphrase_is_an_error_that_names_the_keystore(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    wallets.ensure_wallets(site)
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "wrong")
    with pytest.raises(WalletError) as caught:
        wallets.load(site, "oracle")
    assert caught.value.details["name"] == "oracle"


def test_a_key_in_the_environment_stands_in_for_its_keystore(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The first account of every local node: a test key that all the world knows.
    key = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"
    monkeypatch.setenv("RODEO_KEY_PANTHER1_DEVICE", key)
    wallets.ensure_wallets(site)
    assert not keystores.keystore_path(site, "panther1-device").exists()
    assert keystores.address(site, "panther1-device") == "0xf39Fd6e51aad88F6F4ce6aB8827279cffFb92266"
    assert wallets.load(site, "panther1-device").key.to_0x_hex() == key


def test_what_is_no_key_is_an_error_that_does_not_repeat_it(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RODEO_KEY_ORACLE", "0xnokey")
    with pytest.raises(WalletError) as caught:
        wallets.load(site, "oracle")
    assert caught.value.details == {"name": "oracle", "variable": "RODEO_KEY_ORACLE"}
    assert "nokey" not in str(caught.value)


def test_a_missing_keystore_is_an_error(site: Site) -> None:
    wallets.ensure_wallets(site)
    with pytest.raises(WalletError) as caught:
        wallets.load(site, "nobody")
    assert caught.value.details["name"] == "nobody"


def test_a_missing_keystore_is_told_apart_from_one_that_does_not_open(site: Site) -> None:
    with pytest.raises(KeystoreMissing) as caught:
        wallets.load(site, "oracle")
    assert caught.value.details["name"] == "oracle"
    keystores.keystore_path(site, "oracle").parent.mkdir(parents=True)
    keystores.keystore_path(site, "oracle").write_text("{")
    with pytest.raises(WalletError) as caught_other:
        wallets.load(site, "oracle")
    assert not isinstance(caught_other.value, KeystoreMissing)


@pytest.mark.parametrize("text", ["[]", "{}", '{"crypto": 1, "version": 3}'])
def test_what_is_no_keystore_is_called_so(site: Site, text: str) -> None:
    wallets.ensure_wallets(site)
    keystores.keystore_path(site, "oracle").write_text(text)
    with pytest.raises(WalletError, match="not a keystore"):
        wallets.load(site, "oracle")


def test_a_terminal_is_asked_for_the_passphrase_once(site: Site, site_path: Path) -> None:
    wallets.ensure_wallets(site)
    passphrase = site.data_dir / "keys" / "passphrase"
    typed = passphrase.read_text()
    passphrase.unlink()
    program = (
        "import sys; from pathlib import Path\n"
        "from rodeo.signing import wallets; from rodeo.site.config import Site\n"
        "site = Site.load(Path(sys.argv[1]))\n"
        "print(*(wallets.load(site, name).address for name in ('panther1', 'oracle')))\n"
    )
    ours, theirs = pty.openpty()
    # In a session of its own there is no /dev/tty, only what stands for it here.
    with subprocess.Popen(
        [sys.executable, "-c", program, str(site_path)],
        stdin=theirs,
        stdout=subprocess.PIPE,
        stderr=theirs,
        text=True,
        start_new_session=True,
        env={name: value for name, value in os.environ.items() if name != keystores.PASSPHRASE_VARIABLE},
    ) as asking:
        os.close(theirs)  # so that reading ends when the process does
        shown = b""
        while b"Passphrase" not in shown:
            shown += os.read(ours, 1024)
        os.write(ours, f"{typed}\n".encode())
        printed, _ = asking.communicate(timeout=HANG_S)
    os.close(ours)
    passphrase.write_text(typed)
    assert printed.split() == [wallets.load(site, name).address for name in ("panther1", "oracle")]
    assert typed.encode() not in shown
