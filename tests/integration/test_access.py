"""A closed bus: who has no certificate of the site stays out, and nobody speaks for another."""

from __future__ import annotations

import itertools
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh
from eth_account import Account

from deploy.access import commands_of, everybody
from deploy.certificates import ensure_certificates
from rodeo.bus.holding import EVERYBODY
from rodeo.bus.session import Bus, zenoh_config
from rodeo.errors import BusUnavailable, NoResponder
from rodeo.evidence.seal import RunningHash, SealChain
from rodeo.host.clock import WallClock
from rodeo.host.metrics import HEADS_REFUSED
from rodeo.interfaces.package import asked as asked_queries
from rodeo.interfaces.package import register
from rodeo.ros2.action import ActionClient
from rodeo.ros2.base import BaseNode
from rodeo.ros2.dds import DdsRelay, RawCodec, names_of_body
from rodeo.ros2.errors import ActionServerUnavailable, GoalAborted, ServiceUnavailable
from rodeo.ros2.node import Node
from rodeo.ros2.types import new, serialize
from rodeo.site import tls, topics
from rodeo.site.config import Site
from rodeo.site.names import body_identity
from rodeo.site.processes import ros_process
from rodeo.site.ros_names import ros_name
from rodeo.witness.witness import Witness, unverified_seal
from rodeo_cli.dds import Names, names_of_node
from rodeo_testing import answers
from rodeo_testing.assignments import BINDING
from rodeo_testing.waiting import HANG_S, PAUSE_S, wait_until
from services.bridge.wallet import KNOWN
from services.robot_sim.sessions import BodySessions
from tests.support.command import rodeo
from tests.support.site import RunningSite, free_port, write_site

ONE, OTHER, MINDED = "panther1", "panther2", "panther3"
ROBOTS = f"""robots = [
    {{ name = "{ONE}", pose = {{ x_m = 1.4, y_m = 1.3 }} }},
    {{ name = "{OTHER}", pose = {{ x_m = 3.6, y_m = 4.1 }} }},
    {{ name = "{MINDED}", pose = {{ x_m = 3.6, y_m = 1.3 }}, mind = "node.{MINDED}" }},
]
ros = [{{ owner = "second", participants = ["{OTHER}"] }}]"""
MIND = f"robot_agent.{ONE}"
SEALS = 100


def closed_site(folder: Path) -> Site:
    """A site whose bus wants certificates, with its authority."""
    folder.mkdir(exist_ok=True)
    path = write_site(folder, extra=f'bus.router = "tls/127.0.0.1:{free_port()}"\n{ROBOTS}')
    site = Site.load(path)
    ensure_certificates(site)
    return site


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSite]:
    folder = tmp_path_factory.mktemp("closed")
    closed_site(folder)
    with RunningSite(folder / "site.toml") as site:
        site.start("router")
        yield site


class Voices(dict[str, Bus]):
    """Sessions on the bus, each with the certificate of the process that it is asked for by."""

    def __init__(self, site: Site) -> None:
        self._site = site

    def __missing__(self, name: str) -> Bus:
        shown = tls.identity(self._site, name)
        self[name] = Bus.open(self._site.bus.router, timeout_s=HANG_S, identity=shown)
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
    Bus.open(endpoint, timeout_s=HANG_S, identity=ours).close()


@pytest.mark.parametrize("speaker", ["itrash", MIND, "operator"])
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
    said = topics.WITNESS_STATEMENT.name(org=running.site.org, device=running.site.bins[0].name)
    voices[MIND].subscribe_json(said, lambda _key, data: heard.put(data["by"]))

    def say() -> None:
        voices["bridge"].put_json(said, {"by": "bridge"})
        voices["itrash"].put_json(said, {"by": "itrash"})

    assert "bridge" not in until(heard, "itrash", say)


def test_only_the_lab_speaks_for_its_sensors(running: RunningSite, voices: Voices) -> None:
    topic, typename = topics.BIN_PRESENCE.name(bin=running.site.bins[0].name), topics.BIN_PRESENCE.type
    heard: queue.Queue[float] = queue.Queue()

    def node(name: str) -> Node:
        return node_of(running, voices, name)

    node("itrash").subscription(topic, typename, lambda message, _info: heard.put(message.range))
    agent, body = (node(name).publisher(topic, typename) for name in (MIND, "robot_sim"))

    def say() -> None:
        agent.publish(new(typename, range=1.0))
        body.publish(new(typename, range=2.0))

    assert 1.0 not in until(heard, 2.0, say)


def test_only_the_bridge_answers_for_the_chain(running: RunningSite, voices: Voices) -> None:
    root = f"rodeo/{running.site.org}"
    voices["itrash"].serve(f"{root}/state/**", lambda _request: {"balance_iec": "1000000"})
    own = topics.BIN_STATE.name(org=running.site.org, bin=running.site.bins[0].name)
    voices["itrash"].serve(own, lambda _request: {"seq": 1})
    assert asked(voices["operator"], own) == {"seq": 1}
    with pytest.raises(NoResponder):
        voices["operator"].query(f"{root}/state/wallets")


def test_a_wallet_takes_from_each_certificate_the_commands_that_its_process_sends(
    running: RunningSite, voices: Voices
) -> None:
    wallet = f"rodeo/{running.site.org}/wallet"
    voices["bridge"].serve(f"{wallet}/**", lambda request: {"key": request.key})
    assert asked(voices["operator"], f"{wallet}/organization/withdraw")
    wallets = ("organization", "oracle", ONE, OTHER)
    people = dict.fromkeys(("console", "operator"), wallets)
    for name in set(everybody(running.site)) - {"bridge"}:
        job, _, robot = name.partition(".")
        own = people | {"oracle": ("oracle",), "robot_agent": (robot,), "ros_dao": (OTHER,)}
        allowed = set(itertools.product(own.get(job, ("organization",)), commands_of(job)))
        for participant, command in sorted(allowed):
            key = f"{wallet}/{participant}/{command}"
            assert voices[name].query(key) == {"key": key}
        refused = set(itertools.product((*wallets, "*"), {*KNOWN, "*", "**"})) - allowed
        for key in ("rodeo/**", *(f"{wallet}/{participant}/{command}" for participant, command in refused)):
            if (
                job in people
                and key.startswith(f"{wallet}/*/")
                and key.rpartition("/")[2] in commands_of(job)
            ):
                continue  # a person's command to everybody, which no bridge carries out
            with pytest.raises(NoResponder):
                voices[name].query(key)


@pytest.mark.parametrize("intruder", [body_identity(ONE), MIND, "robot_sim", "operator"])
def test_only_its_own_body_says_how_a_robot_drives(
    running: RunningSite, voices: Voices, intruder: str
) -> None:
    typename = topics.ODOM.type
    heard: queue.Queue[str] = queue.Queue()
    own = body_identity(OTHER)
    said = {
        name: node_of(running, voices, name).publisher(topics.ODOM.name(ns=OTHER), typename)
        for name in (intruder, own)
    }
    node_of(running, voices, "itrash").subscription(
        topics.ODOM.name(ns=OTHER), typename, lambda message, _info: heard.put(message.child_frame_id)
    )

    def say() -> None:
        for name, publisher in said.items():
            publisher.publish(new(typename, child_frame_id=name))

    assert intruder not in until(heard, own, say)


def test_a_velocity_comes_from_a_robots_own_mind(running: RunningSite, voices: Voices) -> None:
    topic, typename = topics.CMD_VEL.name(ns=ONE), topics.CMD_VEL.type
    heard: queue.Queue[float] = queue.Queue()
    node_of(running, voices, body_identity(ONE)).subscription(
        topic, typename, lambda twist, _info: heard.put(twist.linear.x)
    )
    stranger, own = (
        node_of(running, voices, name).publisher(topic, typename) for name in (f"robot_agent.{OTHER}", MIND)
    )

    def say() -> None:
        for publisher, speed_m_s in ((stranger, 1.0), (own, 0.5)):
            publisher.publish(
                new(typename, linear=new("geometry_msgs/msg/Vector3", x=speed_m_s, y=0.0, z=0.0))
            )

    assert 1.0 not in until(heard, 0.5, say)


def test_by_way_of_a_stock_dds_a_body_and_nodes_say_what_their_certificates_allow(
    running: RunningSite, voices: Voices
) -> None:
    """The bridge's side is bytes on plain keys."""
    register()
    site, header = running.site, b"\x00\x01\x00\x00"
    with ExitStack() as closing:
        bridge = closing.enter_context(zenoh.open(zenoh_config("router")))

        def relay(shown: str, names: tuple[Names, Names]) -> None:
            node = BaseNode(voices[shown].session, "dds", "", site.bus.domain_id, WallClock(), RawCodec())
            carried = DdsRelay(bridge, node)
            closing.callback(carried.close)
            for topic, name in names[0]:
                carried.carry_in(topic, name)
            for topic, name in names[1]:
                carried.carry_out(topic, name)

        relay(body_identity(ONE), names_of_body(ONE))
        relay(f"node.{OTHER}", names_of_node(site, OTHER))
        mind = Node(voices[MIND].session, "agent", ONE, site.bus.domain_id, WallClock())
        heard, stop = queue.Queue[Any](), f"{ONE}/emergency_stop"
        mind.raw_subscription(f"{ONE}/odom", topics.ODOM.type, lambda info: heard.put(info.cdr))
        odometry = header + bytes(700)
        until(heard, odometry, lambda: bridge.put(f"{ONE}/odom", odometry))

        served = bridge.declare_queryable(
            stop, lambda query: query.reply(stop, header + b"\1\0\0\0\1\0\0\0\0")
        )
        token = f"@/0/@ros2_lv/SS/{stop.replace('/', '§')}/std_srvs§srv§SetBool"
        there = bridge.liveliness().declare_token(token)
        client = mind.client(stop, topics.EMERGENCY_STOP.type)
        assert client.wait_for_server(HANG_S)
        assert client.call(new(f"{topics.EMERGENCY_STOP.type}_Request", data=True), HANG_S).success

        dao = Node(voices[ros_process(site, "second")].session, "dao", "", site.bus.domain_id, WallClock())
        asked_for = asked_queries()["get_chain"].interface.typename
        answer = new(f"{asked_for}_Response")
        dao.service(f"{ros_name(site.org)}/{OTHER}/get_chain", asked_for, lambda _request: answer)

        def replies() -> list[bytes]:
            found = bridge.get(f"{ros_name(site.org)}/{OTHER}/get_chain", timeout=HANG_S)
            return [one.ok.payload.to_bytes() for one in found if one.ok is not None]

        wait_until(lambda: replies() == [serialize(answer)])
        for one in (mind, dao):
            one.close()
        for declared in (there, served):
            declared.undeclare()


def test_a_session_file_lets_a_mind_move_its_own_body_and_open_what_every_node_does(
    running: RunningSite, voices: Voices, tmp_path: Path
) -> None:
    path = tmp_path / "session.json5"
    ran = rodeo(
        *("ros2", "session", MINDED, "--out", str(path), "--site", str(running.path)),
        env=os.environ,
        timeout_s=HANG_S,
    )
    assert (ran.returncode, f"RMW_ZENOH_SESSION_CONFIG_URI={path}" in ran.stdout) == (0, True), ran.stderr
    session = zenoh.open(zenoh.Config.from_file(str(path)))
    heard: queue.Queue[str] = queue.Queue()
    listener = node_of(running, voices, "itrash")
    node = Node(session, "mind", f"{running.site.org}/{MINDED}", running.site.bus.domain_id, _Now())
    own, others, logs = topics.CMD_VEL.name(ns=MINDED), topics.CMD_VEL.name(ns=ONE), topics.ROSOUT.name()
    said = []
    for name, topic in ((others, topics.CMD_VEL), (own, topics.CMD_VEL), (logs, topics.ROSOUT)):
        listener.raw_subscription(name, topic.type, lambda _info, name=name: heard.put(name), inline=True)
        said.append((node.publisher(name, topic.type), new(topic.type)))

    def say() -> None:
        for publisher, message in said:
            publisher.publish(message)

    came = until(heard, own, say) + until(heard, logs, say)
    assert others not in came

    stop, power = topics.EMERGENCY_STOP, topics.MOTOR_POWER
    done = new(f"{power.type}_Response", success=True)
    for topic, robot in itertools.product((stop, power), (ONE, MINDED)):
        body = node_of(running, voices, body_identity(robot))
        body.service(topic.name(ns=robot), topic.type, lambda _request: done)
    for topic, robot, may in ((power, MINDED, True), (power, ONE, False), (stop, MINDED, False)):
        client = node.client(topic.name(ns=robot), topic.type)
        assert client.wait_for_server(HANG_S)
        request = new(f"{topic.type}_Request", data=False)
        if may:
            assert client.call(request, HANG_S).success
        else:
            with pytest.raises(ServiceUnavailable):
                client.call(request, HANG_S)
    session.close()


def test_the_simulators_mark_comes_after_what_its_bodies_said(running: RunningSite, voices: Voices) -> None:
    site, bus = running.site, voices["robot_sim"]
    sessions = BodySessions(bus, site, [ONE, OTHER], threading.Event())
    assert len({str(session.info.zid()) for session in (bus.session, *map(sessions.of, (ONE, OTHER)))}) == 3
    heard: list[tuple[str, bytes]] = []
    changed = threading.Condition()
    keys = [f"{site.bus.domain_id}/{topics.ODOM.name(ns=ns)}/sample" for ns in (ONE, OTHER)]
    mark = topics.CLOCK_MARK.name(org=site.org, to=EVERYBODY)

    def hear(key: str, payload: bytes) -> None:
        with changed:
            heard.append((key, payload))
            changed.notify_all()

    def say(session: zenoh.Session, key: str, payload: bytes) -> None:
        session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)

    bodies = list(zip(map(sessions.of, (ONE, OTHER)), keys, strict=True))
    for session, key in (*bodies, (bus.session, mark)):
        voices["itrash"].subscribe_bytes(key, hear, inline=True)
        while (key, b"begin") not in heard:  # until the subscription has come through
            say(session, key, b"begin")
            with changed:
                changed.wait(0.1)
    while not sessions.taken():
        continue
    for turn in range(30):
        payload = bytes([turn]) * 20_000
        for session, key in bodies:
            for _ in range(20):
                say(session, key, payload)
        assert sessions.taken()
        say(bus.session, mark, payload)
        with changed:
            assert changed.wait_for(lambda end=(mark, payload): end in heard, HANG_S)
            before = heard[: heard.index((mark, payload))]
        assert [before.count((key, payload)) for key in keys] == [20, 20]
    sessions.close()


def test_a_simulated_body_speaks_as_itself_and_follows_its_own_mind_only(
    running: RunningSite, voices: Voices
) -> None:
    running.start("robot_sim")
    for robot in (ONE, OTHER):
        came = threading.Event()
        node_of(running, voices, "itrash").raw_subscription(
            topics.ODOM.name(ns=robot), topics.ODOM.type, lambda _info, came=came: came.set()
        )
        assert came.wait(HANG_S), robot
        mind = node_of(running, voices, f"robot_agent.{robot}")
        for body in (ONE, OTHER):
            arm = ActionClient(
                mind, topics.FOLLOW_JOINT_TRAJECTORY.name(ns=body), topics.FOLLOW_JOINT_TRAJECTORY.type
            )
            stop = mind.client(topics.EMERGENCY_STOP.name(ns=body), topics.EMERGENCY_STOP.type)
            released = new(f"{topics.EMERGENCY_STOP.type}_Request", data=False)
            goal = new(f"{topics.FOLLOW_JOINT_TRAJECTORY.type}_Goal")
            # Its server is in the graph for all to see.
            assert arm.wait_for_server(HANG_S)
            if body == robot:
                assert stop.call(released, HANG_S).success
                # It comes as far as the arm, which has no use for a trajectory without joints.
                with pytest.raises(GoalAborted):
                    arm.send_goal(goal, timeout_s=HANG_S).result(HANG_S)
            else:
                for ask in (partial(arm.send_goal, goal), partial(stop.call, released)):
                    # The router ends the question itself, long before the time is up.
                    with pytest.raises((ServiceUnavailable, ActionServerUnavailable)):
                        ask(timeout_s=HANG_S)


FLOOD = """
import sys, time
from pathlib import Path
from rodeo.site import tls
from rodeo.bus.session import Bus, zenoh_config
from rodeo.site.config import Site
site, name, folder, rate_hz, *keys = sys.argv[1:]
site = Site.load(Path(site))
payloads = [path.read_bytes() for path in sorted(Path(folder).iterdir())]
bus = Bus.open(site.bus.router, identity=tls.identity(site, name))
print("begun", flush=True)
began_s, sent = time.monotonic(), 0
while True:
    for payload in payloads:
        for key in keys:
            bus.put_bytes(key, payload)
    sent += len(payloads) * len(keys)
    time.sleep(max(0.0, began_s + sent / float(rate_hz) - time.monotonic()))
"""


@pytest.mark.long
def test_every_seal_is_listed_whatever_another_robot_publishes(
    running: RunningSite, voices: Voices, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Old seals and bad signatures of it come 2,000 times a second, on the attacker's key and on its own."""
    site, accounts = running.site, {name: Account.create() for name in (ONE, OTHER)}
    signed = {"TaskManager": BINDING.task_manager, "Organization": BINDING.organization}
    chain = answers.chain(chain_id=BINDING.chain_id, contracts=answers.CONTRACTS | signed)
    owner = BINDING.organization
    devices = [
        {"address": account.address, "role": "robot", "name": name, "owner": owner}
        for name, account in accounts.items()
    ]
    told: dict[str, dict[str, Any]] = {"chain": chain, "devices": {"devices": devices}}
    for what, one in told.items():
        key = topics.STATE.name(org=site.org, what=what)
        voices["bridge"].serve(key, lambda _request, one=one: one)
    witness = Witness(
        voices["itrash"], site.org, "itrash", Account.create(), tmp_path / "bin", "closed_bus", time.time_ns
    )
    wait_until(lambda: witness.chain is not None and witness.devices.known(accounts[OTHER].address))

    def recording(task_id: int) -> Callable[[float], bytes]:
        binding = BINDING.model_copy(update={"device": ONE, "task_id": task_id})
        seals, running_hash = SealChain(binding, accounts[ONE]), RunningHash()
        return lambda ago_s: seals.next(running_hash, time.time_ns() - round(ago_s * 1e9))

    (tmp_path / "attack").mkdir()
    for number in range(3):
        old = recording(number)(3600.0 - number)
        (tmp_path / "attack" / f"old{number}").write_bytes(old)
        bad = old.replace(json.loads(old)["signature"].encode(), b"0x" + b"11" * 64 + b"1b")
        (tmp_path / "attack" / f"bad{number}").write_bytes(bad)
    keys = [topics.SEAL.name(org=site.org, device=name) for name in (OTHER, ONE)]
    arguments = [running.path, f"robot_agent.{OTHER}", tmp_path / "attack", "4000", *keys]
    command = [sys.executable, "-c", FLOOD, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[2]) as flood:
        try:
            assert flood.stdout is not None and flood.stdout.readline()
            seal, listed, longest_s = recording(200), 0, 0.0
            began_s, before = time.monotonic(), refusals()
            for number in range(1, SEALS + 1):
                data, said_s = seal(0.0), time.monotonic()
                voices[MIND].put_bytes(keys[1], data)
                newest = unverified_seal(data).spoken.head.digest
                listed += wait_for(lambda newest=newest: newest in [o.digest for o in witness.heads.take()])
                longest_s = max(longest_s, time.monotonic() - said_s)
                # As many as come between two seals at 2,000 a second if the site runs 20 times as fast.
                wait_until(lambda number=number: refusals() - before >= 100 * number)
            rate_hz = (refusals() - before) / (time.monotonic() - began_s)
        finally:
            flood.kill()
            witness.close()
    record_property("flood_per_s", round(rate_hz))
    print(
        f"{listed} of {SEALS} listed, at most {longest_s:.2f} s late, under {rate_hz:.0f} messages a second"
    )
    assert listed >= 0.98 * SEALS


def refusals() -> float:
    """How many seals and statements this process left out."""
    (metric,) = HEADS_REFUSED.collect()
    return metric.samples[0].value


def wait_for(done: Callable[[], bool]) -> bool:
    """Whether `done()`; the limit only ends the wait for what was lost."""
    end_s = time.monotonic() + HANG_S
    while not (happened := done()) and time.monotonic() < end_s:
        time.sleep(PAUSE_S)
    return happened


def node_of(running: RunningSite, voices: Voices, name: str) -> Node:
    node_name = name.replace(".", "_")
    return Node(voices[name].session, node_name, "", running.site.bus.domain_id, _Now())


class _Now:
    def now_ns(self) -> int:
        return 1
