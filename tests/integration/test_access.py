"""A closed bus: who has no certificate of the site stays out, and nobody speaks for another."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deploy.certificates import ensure_certificates
from rodeo import tls, topics
from rodeo.bus import Bus
from rodeo.config import Site
from rodeo.errors import BusUnavailable, NoResponder
from rodeo.ros2 import Node
from rodeo.ros2.types import new
from tests.support.site import WAIT_S, RunningSite, free_port, write_site


def closed_site(folder: Path) -> Site:
    """A site whose bus wants certificates, with its authority."""
    folder.mkdir(exist_ok=True)
    path = write_site(folder, extra=f'bus.router = "tls/127.0.0.1:{free_port()}"')
    site = Site.load(path)
    ensure_certificates(site)
    return site


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSite]:
    folder = tmp_path_factory.mktemp("closed")
    closed_site(folder)
    site = RunningSite(folder / "site.toml")
    site.start("router")
    yield site
    site.stop()


class Voices(dict[str, Bus]):
    """Sessions on the bus, each with the certificate of the process that it is asked for by."""

    def __init__(self, site: Site) -> None:
        self._site = site

    def __missing__(self, name: str) -> Bus:
        shown = tls.identity(self._site, name)
        self[name] = Bus.open(self._site.bus.router, timeout_s=WAIT_S, identity=shown)
        return self[name]


@pytest.fixture
def voices(running: RunningSite) -> Iterator[Voices]:
    voices = Voices(running.site)
    yield voices
    for bus in voices.values():
        bus.close()


def until(heard: queue.Queue[Any], last: Any, say: Callable[[], None]) -> list[Any]:
    """All that was heard up to `last`; says it again and again, as a subscription takes its time."""
    came: list[Any] = []
    while last not in came:
        say()
        try:
            came.append(heard.get(timeout=0.2))
        except queue.Empty:
            continue
    return came


def asked(bus: Bus, key: str) -> dict[str, Any]:
    """The answer to a question, once the responder's declaration has come through."""
    while True:
        try:
            return bus.query(key)
        except NoResponder:
            continue


def test_a_client_without_a_certificate_of_the_site_stays_out(running: RunningSite, tmp_path: Path) -> None:
    endpoint, ours = running.site.bus.router, tls.files(running.site, "bridge")
    foreign = tls.files(closed_site(tmp_path / "other"), "bridge")
    for shown in (None, foreign, tls.Identity(ours.authority, foreign.certificate, foreign.key)):
        with pytest.raises(BusUnavailable):
            Bus.open(endpoint, timeout_s=1.0, identity=shown).close()
    with pytest.raises(BusUnavailable):
        Bus.open(endpoint.replace("tls/", "tcp/"), timeout_s=1.0).close()
    Bus.open(endpoint, timeout_s=WAIT_S, identity=ours).close()


@pytest.mark.parametrize("speaker", ["itrash", "robot_agent", "operator"])
def test_only_the_bridge_publishes_events(running: RunningSite, voices: Voices, speaker: str) -> None:
    heard: queue.Queue[str] = queue.Queue()
    event = topics.EVENT.name(org=running.site.org, event="TaskSettled")
    voices["charger"].subscribe_json(event, lambda _key, data: heard.put(data["by"]))

    def say() -> None:
        voices[speaker].put_json(event, {"by": speaker})
        voices["bridge"].put_json(event, {"by": "bridge"})

    assert speaker not in until(heard, "bridge", say)


def test_only_the_bin_states_what_it_was_shown(running: RunningSite, voices: Voices) -> None:
    heard: queue.Queue[str] = queue.Queue()
    said = topics.WITNESS_STATEMENT.name(org=running.site.org, device=running.site.bin.name)
    voices["robot_agent"].subscribe_json(said, lambda _key, data: heard.put(data["by"]))

    def say() -> None:
        voices["bridge"].put_json(said, {"by": "bridge"})
        voices["itrash"].put_json(said, {"by": "itrash"})

    assert "bridge" not in until(heard, "itrash", say)


def test_only_the_body_speaks_for_its_sensors(running: RunningSite, voices: Voices) -> None:
    topic, typename = topics.BIN_PRESENCE.name(bin=running.site.bin.name), topics.BIN_PRESENCE.type
    heard: queue.Queue[float] = queue.Queue()

    def node(name: str) -> Node:
        return Node(voices[name].session, name, "", running.site.bus.domain_id, _Now())

    node("itrash").subscription(topic, typename, lambda message, _info: heard.put(message.range))
    agent, body = (node(name).publisher(topic, typename) for name in ("robot_agent", "robot_sim"))

    def say() -> None:
        agent.publish(new(typename, range=1.0))
        body.publish(new(typename, range=2.0))

    assert 1.0 not in until(heard, 2.0, say)


def test_only_the_bridge_answers_for_the_chain(running: RunningSite, voices: Voices) -> None:
    root = f"rodeo/{running.site.org}"
    voices["itrash"].serve(f"{root}/state/**", lambda _request: {"balance_iec": "1000000"})
    own = topics.BIN_STATE.name(org=running.site.org, bin=running.site.bin.name)
    voices["itrash"].serve(own, lambda _request: {"seq": 1})
    assert asked(voices["operator"], own) == {"seq": 1}
    with pytest.raises(NoResponder):
        voices["operator"].query(f"{root}/state/wallets")


def test_a_wallet_takes_orders_from_those_who_work_for_it(running: RunningSite, voices: Voices) -> None:
    wallet = f"rodeo/{running.site.org}/wallet"
    voices["bridge"].serve(f"{wallet}/**", lambda request: {"key": request.key})
    for process, own, other in (
        ("robot_agent", "panther1", "organization"),
        ("charger", "organization", "panther1"),
        ("oracle", "oracle", "organization"),
    ):
        assert asked(voices[process], f"{wallet}/{own}/transfer") == {"key": f"{wallet}/{own}/transfer"}
        for key in (f"{wallet}/{other}/transfer", f"{wallet}/*/transfer", "rodeo/**"):
            with pytest.raises(NoResponder):
                voices[process].query(key)
    assert asked(voices["operator"], f"{wallet}/organization/transfer")


class _Now:
    def now_ns(self) -> int:
        return 1
