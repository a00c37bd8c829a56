"""What `tools/install.py` makes of pip's settings."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import install
from tools.install import pip_settings, uv_environment, uv_options

LISTING = """\
:env:.find-links='/srv/wheels ~/wheels'
:env:.disable-pip-version-check='1'
download.index-url='https://downloads.example/simple'
global.cert='/etc/ssl/company.pem'
global.extra-index-url='https://one.example/simple\\nhttps://two.example/simple'
global.find-links='/overridden'
global.index-url='https://global.example/simple'
install.index-url='https://name:word@install.example/simple'
"""


def test_the_environment_overrides_what_install_sets_and_that_what_is_global() -> None:
    settings = pip_settings(LISTING)
    assert settings["find-links"] == "/srv/wheels ~/wheels"
    assert settings["index-url"] == "https://name:word@install.example/simple"
    assert settings["cert"] == "/etc/ssl/company.pem"


def test_uv_gets_indexes_links_and_certificates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/ann")
    assert uv_environment(pip_settings(LISTING)) == {
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_DEFAULT_INDEX": "https://name:word@install.example/simple",
        "UV_INDEX": "https://one.example/simple https://two.example/simple",
        "UV_FIND_LINKS": "/srv/wheels,/home/ann/wheels",
        "SSL_CERT_FILE": "/etc/ssl/company.pem",
    }


def test_uv_gets_hosts_proxy_client_certificate_limits_and_a_folder_of_certificates(tmp_path: Path) -> None:
    settings = {
        "trusted-host": "one.example two.example:8443",
        "proxy": "ann:word@proxy.example:3128",
        "client-cert": "/etc/ssl/ann.pem",
        "default-timeout": "180",
        "no-cache-dir": "true",
        "cert": str(tmp_path),
    }
    assert uv_environment(settings) == {
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_INSECURE_HOST": "one.example two.example:8443",
        "HTTP_PROXY": "http://ann:word@proxy.example:3128",
        "HTTPS_PROXY": "http://ann:word@proxy.example:3128",
        "SSL_CLIENT_CERT": "/etc/ssl/ann.pem",
        "UV_HTTP_TIMEOUT": "180",
        "UV_NO_CACHE": "1",
        "SSL_CERT_DIR": str(tmp_path),
    }


def test_constraints_and_no_index_are_options() -> None:
    assert uv_options({"constraint": "/etc/a.txt /etc/b.txt", "no-index": "yes"}) == [
        "--no-index", "--constraint", "/etc/a.txt", "--constraint", "/etc/b.txt",
    ]  # fmt: skip
    assert uv_options({"no-index": "false"}) == []


def test_pip_installs_where_uv_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Into an environment that is made anew, as uv may have left half of it."""
    calls: list[str] = []
    monkeypatch.setattr(install, "VENV", tmp_path)
    environment = install.Environment(tmp_path)

    def pip(*words: str, read: bool = False) -> str:
        calls.append(" ".join(words))
        return ""

    def uv(path: str, *_: object) -> None:
        calls.append("uv")
        raise install.subprocess.CalledProcessError(2, [path])

    monkeypatch.setattr(environment, "_make", lambda: calls.append("make"))
    monkeypatch.setattr(environment, "_pip", pip)
    monkeypatch.setattr(install, "_uv", uv)
    environment.install(["thing"], ["constraints.txt"])
    assert calls == [
        "make",
        "install -qq --constraint constraints.txt uv",
        "config list",
        "uv",
        "make",
        "install --progress-bar=off --constraint constraints.txt thing",
    ]
    assert (tmp_path / "whole").exists()


def test_an_installation_that_did_not_end_is_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = install.Environment(tmp_path)
    made: list[str] = []
    monkeypatch.setattr(environment, "_make", lambda: made.append("made"))
    environment.python = install.sys.executable
    (tmp_path / "whole").touch()
    monkeypatch.setattr(environment, "_install", lambda *_: None)
    environment.install(["thing"], [])
    assert made == []

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(environment, "_install", interrupted)
    with pytest.raises(KeyboardInterrupt):
        environment.install(["thing"], [])
    monkeypatch.setattr(environment, "_install", lambda *_: None)
    environment.install(["thing"], [])
    assert made == ["made"]


def test_a_larger_extra_that_is_there_is_kept_up_to_date(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`make demo` after `make test` and a new constraint: what the tests need follows, too."""
    installed: list[list[str]] = []
    monkeypatch.setattr(install, "VENV", tmp_path)
    monkeypatch.setattr(install.Environment, "install", lambda _, what, __: installed.append(what))
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "__init__.py").touch()
    monkeypatch.chdir(tmp_path)
    install.install_extra("site")
    assert list(tmp_path.glob("own/__pycache__/*.pyc")), "the sources are compiled"
    assert not (tmp_path / "installed-dev").exists()
    install.install_extra("dev")
    install.install_extra("site")
    assert [what[-1] for what in installed] == [".[site]", ".[dev]", ".[dev]"]
    assert all((tmp_path / f"installed-{one}").exists() for one in ("site", "experiment", "dev"))
