"""Nothing that is printed or sent has the secrets in addresses."""

from __future__ import annotations

import json
import logging
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import requests
import urllib3

from rodeo.chain.client import connect
from rodeo.chain.node.errors import ChainUnavailable
from rodeo.chain.node.translation import translated
from rodeo.errors import ConfigError
from rodeo.host.http import problem
from rodeo.host.instance import last_ending, note_ending
from rodeo.runtime import logs
from rodeo.site.config import Site
from rodeo.text import redaction
from rodeo.text.redaction import learn, redacted, redacted_json, shown
from rodeo_cli.layout import printable
from services.bridge.heads import SubscribedHeads
from services.bridge.node import Node
from tests.support.site import LAB

KEY = "planted-key-4711"
ADDRESSES = [
    f"https://node.example/v3/{KEY}",
    f"https://node.example:8545/v3/{KEY}/",
    f"https://node.example/rpc?apikey={KEY}&chain=1",
    f"https://node.example/#{KEY}",
    f"https://user:{KEY}@node.example",
    f"https://{KEY}@node.example/",
    f"https://user:{KEY}%40%2F@node.example/v3",
]


@pytest.fixture(autouse=True)
def _knows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redaction, "_known", {})
    monkeypatch.setattr(redaction, "_pattern", None)


@pytest.mark.parametrize("address", ADDRESSES)
def test_an_address_is_shown_without_its_secrets(address: str) -> None:
    assert KEY not in shown(address) and shown(address).startswith("https://node.example")


@pytest.mark.parametrize("address", ADDRESSES)
def test_what_other_libraries_say_of_an_address_has_no_secret(address: str) -> None:
    learn(address, path_is_secret=True)
    path = address.partition("node.example")[2]
    for text in (
        f"401 Client Error: Unauthorized for url: {address}",
        f"HTTPSConnectionPool(host='node.example', port=443): Max retries exceeded with url: {path}",
        repr(requests.Request("GET", address).prepare().url),
        f"invalid project id {KEY}%40%2F" if "%" in address else f"invalid project id {KEY}",
        str(urllib3.util.parse_url(address)),
        f"Authorization: {requests.auth._basic_auth_str('user', KEY)}" if "user:" in address else "",
    ):
        assert KEY not in redacted(text), text
        if "user:" in address and "%" not in address:
            assert "dXNlcjpwbGFudGVk" not in redacted(text)
    assert redacted("the node does not answer") == "the node does not answer"


@pytest.mark.parametrize(
    "address",
    [
        f"postgresql+psycopg://rodeo:{KEY}@db/rodeo",
        f"rtsp://bin:{KEY}@cam/stream",
        f"http://cam/jpg?pwd={KEY}",
    ],
)
def test_a_database_or_camera_keeps_its_host_and_path(address: str) -> None:
    learn(address)
    text = redacted(f"cannot open {address}")
    assert KEY not in text and ("db/rodeo" in text or "cam/" in text)


def test_a_short_password_is_hidden_in_its_address_only() -> None:
    learn("postgresql://rodeo:rodeo@db/rodeo")
    assert (
        redacted("rodeo status: postgresql://rodeo:rodeo@db/rodeo") == "rodeo status: postgresql://db/rodeo"
    )


def test_credentials_in_an_address_that_nobody_set_are_hidden_too() -> None:
    assert redacted("redirected to https://a:b@other/x") == "redirected to https://other/x"
    assert redacted("robot:panther1@dock") == "robot:panther1@dock"


def test_texts_in_json_are_redacted_and_numbers_stay() -> None:
    learn(ADDRESSES[0], path_is_secret=True)
    said = redacted_json({"url": ADDRESSES[0], "list": [KEY, 1, None], "n": 1.5})
    assert KEY not in json.dumps(said) and said["list"][1:] == [1, None] and said["n"] == 1.5


# -- the settings ---------------------------------------------------------------------------------------


def site_with(folder: Path, lines: str) -> Site:
    path = folder / "site.toml"
    path.write_text(f"extends = {json.dumps(str(LAB))}\n{lines}\n")
    return Site.load(path)


@pytest.mark.parametrize(
    "line",
    [
        *(f'chain.url = "{address}"' for address in ADDRESSES[:-1]),
        f'chain.websocket_url = "wss://node.example/ws/{KEY}"',
        f'bridge.database = "postgresql+psycopg://rodeo:{KEY}@db/rodeo"',
        f'store = {{ url = "s3://bucket/store", options = {{ secret = "{KEY}" }} }}',
    ],
)
def test_each_setting_with_a_secret_is_learnt(tmp_path: Path, line: str) -> None:
    site_with(tmp_path, line)
    assert KEY not in redacted(f"it says {KEY}")


def test_the_key_has_a_file_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "key").write_text(f"{KEY}\n")
    lines = 'chain.secret_file = "key"\nchain.url = "https://node.example/v3/{secret}"\n'
    chain = site_with(tmp_path, lines + 'chain.websocket_url = "wss://node.example/ws/{secret}"').chain
    assert (chain.url, chain.websocket_url) == (ADDRESSES[0], f"wss://node.example/ws/{KEY}")
    assert chain.shown_url == "https://node.example/..." and KEY not in redacted(f"it says {KEY}")


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('chain.url = "https://node.example/{secret}"', "set chain.secret_file"),
        ('chain.secret_file = "none"', "cannot read chain.secret_file"),
        ('chain.secret_file = "empty"', "chain.secret_file is empty"),
        ('store.url = "s3://user:password@bucket/store"', "leave password and query out"),
    ],
)
def test_a_secret_that_cannot_be_is_refused(tmp_path: Path, lines: str, said: str) -> None:
    (tmp_path / "empty").touch()
    with pytest.raises(ConfigError) as refused:
        site_with(tmp_path, lines)
    assert said in str(refused.value) and "password@" not in redacted(str(refused.value))


# -- the ways out ---------------------------------------------------------------------------------------


@pytest.fixture
def failure() -> Iterator[BaseException]:
    learn(ADDRESSES[0], path_is_secret=True)
    try:
        raise requests.HTTPError(f"401 Client Error: Unauthorized for url: {ADDRESSES[0]}")
    except requests.HTTPError as error:
        yield error


@pytest.mark.parametrize("formatter", [logs.TextFormatter, logs.JsonFormatter, lambda _: logs.Redacting()])
def test_logs_have_no_secret(failure: BaseException, formatter: type[logging.Formatter]) -> None:
    record = logging.makeLogRecord({"msg": "%s", "args": (failure,), "levelname": "ERROR"})
    record.exc_info = (type(failure), failure, failure.__traceback__)
    line = formatter("bridge").format(record)  # type: ignore[arg-type]
    assert "Unauthorized" in line and "Traceback" in line and KEY not in line


def test_tracebacks_have_no_secret(
    failure: BaseException, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    redaction.hide_in_tracebacks()
    sys.excepthook(type(failure), failure, failure.__traceback__)
    threading.excepthook(threading.ExceptHookArgs((type(failure), failure, failure.__traceback__, None)))
    written = capsys.readouterr().err
    assert written.count("HTTPError: 401") == 2 and KEY not in written


def test_problems_over_http_endings_and_the_command_line_have_no_secret(
    failure: BaseException, tmp_path: Path
) -> None:
    answer = problem(503, "not_ready", str(failure), {"reason": str(failure)})
    note_ending(tmp_path, repr(failure), gave_up=False)
    ending = last_ending(tmp_path)
    assert ending is not None
    for text in (bytes(answer.body).decode(), ending.reason, printable(str(failure))):
        assert "Unauthorized" in text and KEY not in text


def test_a_node_that_refuses_the_key_is_told_of_without_it() -> None:
    address = f"http://127.0.0.1:9/v3/{KEY}?apikey={KEY}"
    learn(address, path_is_secret=True)
    with pytest.raises(ChainUnavailable) as by_web3, translated():
        connect(address).eth.chain_id  # noqa: B018
    with pytest.raises(ChainUnavailable) as by_batch:
        Node(address).call("eth_chainId")
    with pytest.raises(ChainUnavailable) as by_websocket:
        SubscribedHeads(address.replace("http", "ws"))
    for raised in (by_web3, by_batch, by_websocket):
        assert KEY not in redacted(str(raised.value)) and KEY not in redacted(repr(raised.value.details))
    assert httpx.URL(address).host == "127.0.0.1"
