"""Every place that listens to the bus has a row which says whose key it takes words from."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("rodeo", "services", "rodeo_kinds", "rodeo_cli", "rodeo_testing", "rodeo_experiments", "deploy")
LISTENS = re.compile(r"(?<!un)subscri|queryable|query_all", re.IGNORECASE)
"""In the name of what is called. `serve` listens where a bus serves, and `get` where a session asks."""

SIGNED = "the device whose key it is: the statement names it, and its registered key signed it"
NAMED = "the process or event that the key names: the message must name the same"
KEY = "whoever the key names: the message itself names nobody"
ONE = "one key, on which the access rules let one process publish"
TOKENS = "liveliness tokens: the key is all that is said, and the access rules give it one holder"
WAKES = "nobody: it only wakes up who asks the index"
HASHED = "anybody: what is answered must have the hash that was asked for"
ASKED = "whoever asks: nothing depends on who that is"
CHECKED = "whoever asks: what changes something is signed, and the signer is looked up"
HANDED_ON = "as the caller's row says"
PARTICIPANT = "the participant that the key names: the access rules let its process command it"
LOOPBACK = "whoever reaches the relay on its own computer: it speaks there with that robot's certificate"

Call = tuple[str, str]
"""Where in a file, and the call up to its first argument."""

ROWS: dict[str, dict[Call, str]] = {
    "rodeo/bus/session.py": {
        ("Bus.subscribe_json", "self.subscribe_bytes(key)"): HANDED_ON,
        ("Bus.subscribe_bytes", "self.subscribe_with_source(key)"): HANDED_ON,
        ("Bus.subscribe_with_source", "self.session.declare_subscriber(key)"): HANDED_ON,
        ("Bus.serve", "self.session.declare_queryable(key)"): HANDED_ON,
        ("DaoEvents.__init__", "bus.subscribe_json(topics.EVENT.pattern(org=org))"): NAMED,
        ("Bus.query", "self.session.get(selector)"): ONE
        + ": bridge, bin and so on, which a closed bus lets answer there",
        ("Bus.query_all", "self.session.get(selector)"): HANDED_ON,
    },
    "rodeo/dao.py": {
        ("Participant.wait", "self._bus.subscribe_json(topics.EVENT.pattern(org=self._org))"): WAKES,
    },
    "rodeo/recording/copies.py": {
        ("Copies.__init__", "bus.serve(topics.PROOF_COPY.name(org=org, device=device))"): ASKED,
        ("_asked", "bus.query_all(key)"): HASHED + ", one answer on each key",
    },
    "rodeo/bus/holding.py": {
        ("Holder.__init__", "session.declare_subscriber(topics.CLOCK_MARK.name(org=org, to=to))"): ONE,
    },
    "rodeo/bus/origin.py": {
        ("statuses_at", "bus.session.get(key)"): NAMED,
    },
    "rodeo/runtime/clock_check.py": {
        ("ClockCheck.ask", "self._bus.session.get(key)"): NAMED,
    },
    "rodeo/ros2/service.py": {
        ("Client.call", "self._session.get(self._key)"): ONE,
        (
            "DeferredService.__init__",
            "node.session.declare_queryable(self._key)",
        ): "whom the access rules let ask: one process for what moves or switches something",
        (
            "Client.__init__",
            "node.session.liveliness().declare_subscriber"
            "(wire.servers_expression(node.domain_id, name, typename))",
        ): TOKENS,
    },
    "rodeo/runtime/serving.py": {
        ("Claim._look", "self._session.liveliness().get(self._expression)"): TOKENS,
        ("Claim.watch", "self._session.liveliness().declare_subscriber(self._expression)"): TOKENS,
    },
    "rodeo/runtime/sim_clock.py": {
        ("SimClock.__init__", "session.liveliness().get(graph)"): TOKENS,
        ("SimClock.__init__", "session.liveliness().declare_subscriber(graph)"): TOKENS,
        ("SimClock.__init__", "session.declare_subscriber(f'{domain_id}/{topics.CLOCK.name()}/**')"): ONE
        + "; of its publishers one is followed",
    },
    "services/robot_sim/roster.py": {
        ("Roster.__init__", "liveliness.get(self._everybody)"): TOKENS,
        ("Roster.ask_who_is_there", "self._asking.liveliness().get(self._everybody)"): TOKENS,
        ("Roster.__init__", "liveliness.declare_subscriber(self._everybody)"): TOKENS,
        ("Roster.__init__", "bus.session.declare_subscriber(self._everybody)"): KEY,
    },
    "rodeo/runtime/presence.py": {
        ("Presence.start", "self._bus.serve(self._key)"): ASKED,
    },
    "rodeo/recording/pictures.py": {
        (
            "PictureFetcher._fetch",
            "self._bus.query_all(topics.BIN_PICTURE.name(org=self._org, bin=bin_name))",
        ): HASHED,
    },
    "rodeo/recording/statements.py": {
        (
            "StatementListener.__init__",
            "bus.subscribe_bytes(topics.WITNESS_STATEMENT.name(org=org, device=only))",
        ): SIGNED,
        ("StatementListener._ask", "self._bus.query_all(key)"): SIGNED,
    },
    "rodeo/robot/receipts.py": {
        ("Receipts.__init__", "node.subscription(battery.name(ns=robot.namespace))"): ONE,
    },
    "rodeo/recording/pace.py": {
        ("Pace._listen", "self._node.raw_subscription(self._names[topic])"): ONE
        + "; of its publishers that say the same one is followed",
    },
    "rodeo/robot/recording.py": {
        ("Recording.__init__", "node.raw_subscription(name)"): ONE
        + "; of its publishers one is followed (MessageDoor)",
    },
    "rodeo/robot/ros_body.py": {
        ("Latest.__init__", "node.raw_subscription(topic)"): ONE,
    },
    "rodeo/robot/wrist_camera.py": {
        ("WristCamera.look", "self._subscribe(node)"): HANDED_ON,
        ("WristCamera.picture", "self._subscribe(node)"): HANDED_ON,
        ("WristCamera._subscribe", "node.raw_subscription(topic.name(**self._names))"): ONE,
    },
    "rodeo/ros2/action.py": {
        ("ActionClient.__init__", "node.subscription(service_name(name, 'feedback'))"): ONE,
    },
    "rodeo/ros2/base.py": {
        ("Subscription.__init__", "zenoh.ext.declare_advanced_subscriber(node.session)"): HANDED_ON,
        ("Subscription.__init__", "node.session.declare_subscriber(key)"): HANDED_ON,
        ("BaseNode.subscription", "self.raw_subscription(topic)"): HANDED_ON,
        ("BaseNode.raw_subscription", "Subscription(self)"): HANDED_ON,
    },
    "rodeo/ros2/dds.py": {
        ("DdsRelay.carry_in", "self._bridge.liveliness().declare_subscriber(expression)"): LOOPBACK
        + "; its tokens tell what is there",
        ("DdsRelay._publish", "zenoh.ext.declare_advanced_subscriber(self._bridge)"): LOOPBACK,
        ("DdsRelay._publish", "self._bridge.declare_subscriber(part.name)"): LOOPBACK,
        ("DdsRelay._send", "self._node.raw_subscription(part.name)"): HANDED_ON,
        ("DdsRelay._answer", "self._bridge.declare_queryable(part.name)"): LOOPBACK,
    },
    "rodeo/witness/witness.py": {
        ("Witness.__init__", "bus.subscribe_with_source(topics.SEAL.pattern(org=org))"): SIGNED,
        ("Witness.__init__", "bus.subscribe_with_source(topics.WITNESS_STATEMENT.pattern(org=org))"): SIGNED,
        ("Witness.__init__", "bus.serve(topics.WITNESS_STATEMENTS.name(org=org, device=device))"): ASKED,
    },
    "services/bridge/process.py": {
        ("Bridge._serve", "bus.serve(topics.STATE.pattern(org=org))"): ASKED,
        (
            "Bridge._serve",
            "bus.serve(topics.SIGHT.pattern(org=org))",
        ): "the robot or the person that the key names: the access rules let its process speak for it",
        ("Bridge._serve", "bus.serve(topics.COMMAND.pattern(org=org))"): PARTICIPANT,
        ("Bridge._serve", "bus.serve(topics.COMMAND.pattern(org=org, participant=name))"): PARTICIPANT,
    },
    "services/charger/terminals.py": {
        ("BusTerminals.__init__", "node.subscription(output.name(dock=dock))"): ONE,
    },
    "services/charger/process.py": {
        ("Charger.__init__", "node.subscription(battery.name(ns=robot.namespace))"): ONE,
    },
    "services/console/live.py": {
        ("Newest.__init__", "session.declare_subscriber(key)"): ONE,
        ("Live.run", "self._bus.subscribe_json(topics.STATUS.pattern(org=self._site.org))"): NAMED,
        ("Live.run", "self._bus.subscribe_bytes(topics.SEEN.pattern(org=self._site.org))"): WAKES,
        ("Live._draw_maps", "self._subscribe()"): HANDED_ON,
    },
    "services/itrash/camera.py": {
        ("BusCamera.__init__", "node.subscription(topics.BIN_IMAGE.name(bin=bin_name))"): ONE,
    },
    "services/itrash/steps.py": {
        ("Steps.listen", "node.subscription(self._presence)"): ONE,
        ("Steps.listen", "node.subscription(name)"): ONE,
    },
    "services/itrash/process.py": {
        ("Itrash.__init__", "bus.serve(topics.BIN_STATE.name(org=site.org, bin=config.name))"): ASKED,
    },
    "services/itrash/gallery.py": {
        ("Gallery.__init__", "process.bus.serve(topics.BIN_PICTURE.name(org=org, bin=name))"): ASKED,
        ("Gallery.__init__", "process.bus.serve(topics.BIN_CORRECTIONS.name(org=org, bin=name))"): CHECKED,
    },
    "services/oracle/votes.py": {
        (
            "Votes.run",
            "self._bus.subscribe_with_source(everybodys)",
        ): "the oracle that the key names: its registered key signed the vote",
    },
    "services/robot_recorder/mind.py": {
        (
            "Mind.__init__",
            "node.session.liveliness().declare_subscriber(expression)",
        ): "anybody: it only tells operators that a mind is there",
    },
    "services/ros_dao/services.py": {
        ("Fallback.__init__", "session.declare_queryable(expression)"): ASKED,
    },
    "rodeo/attempts/orders.py": {
        ("Orders.__init__", "bus.serve(key(order))"): "whom the access rules let ask: operator and console",
        ("Orders.__init__", "bus.serve(key('state'))"): ASKED,
        ("Orders.__init__", "bus.serve(key('explain'))"): ASKED,
    },
    "services/robot_agent/upkeep.py": {
        ("Upkeep.__init__", "node.subscription(topics.BATTERY_STATE.name(ns=robot.namespace))"): ONE,
    },
    "services/mocap/sources/ros2.py": {
        ("RosDriver.__init__", "opening.node.subscription(opening.address)"): ONE + ": its driver",
        ("RosDriver.__init__", "opening.node.subscription(opening.address.format(body=body))"): ONE
        + ": its driver",
    },
    "services/robot_sim/commander.py": {
        ("Commander.__init__", "session.liveliness().declare_subscriber(expression)"): TOKENS,
    },
    "services/robot_sim/people.py": {
        ("PeoplesTime.__init__", "bus.subscribe_bytes(topics.EVENT.pattern(org=site.org))"): WAKES
        + ", by the event that the key names",
    },
    "services/robot_sim/plane.py": {
        ("RobotPlane.__init__", "node.subscription(topics.CMD_VEL.name(ns=self._ns))"): ONE
        + "; of its publishers one is followed (Commander)",
    },
    "services/robot_sim/sessions.py": {
        ("BodySessions.__init__", "own.subscribe_json(topics.BODY_MARK.pattern(org=site.org))"): KEY,
    },
    "rodeo_cli/common.py": {
        ("send_command", "bus.subscribe_bytes(topics.STATUS.name(org=site.org, process='bridge'))"): ONE,
    },
    "rodeo_cli/mocap.py": {
        ("latency", "node.subscription(odom.name(ns=namespace))"): ONE,
        ("latency", "node.subscription(pose.name(body=robot))"): ONE,
    },
    "rodeo_cli/site.py": {
        (
            "StatusWatcher.statuses",
            "self.bus.subscribe_json(topics.STATUS.pattern(org=self._site.org))",
        ): NAMED,
    },
    "rodeo_experiments/conduct.py": {
        ("Conduct._days", "node.subscription(topics.BATTERY_STATE.name(ns=robot.namespace))"): ONE,
        ("Conduct._days", "node.subscription(topics.DOCK_OUTPUT.name(dock=dock.name))"): ONE,
        ("Conduct._wait_ready", "self._bus.subscribe_json(topics.STATUS.pattern(org=self._site.org))"): NAMED,
    },
    "rodeo_experiments/lab.py": {
        ("Lab.__init__", "node.subscription(topics.MOCAP_POSE.name(body=robot.name))"): ONE,
    },
}


def listeners(source: str) -> Iterator[Call]:
    """Where something listens to the bus in a module, and the call up to its first argument."""

    def visit(node: ast.AST, where: tuple[str, ...]) -> Iterator[Call]:
        for child in ast.iter_child_nodes(node):
            named = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
            inside = (*where, child.name) if named else where
            if isinstance(child, ast.Call) and _listens(called := ast.unparse(child.func)):
                yield ".".join(inside), f"{called}({ast.unparse(child.args[0]) if child.args else ''})"
            yield from visit(child, inside)

    yield from visit(ast.parse(source), ())


def _listens(called: str) -> bool:
    *whose, name = called.split(".")
    serves = name == "serve" and bool(whose) and whose[-1].lstrip("_") == "bus"
    asks = re.search(r"(session|liveliness(\(\))?|_asking)\.get$", called) is not None
    return serves or asks or (LISTENS.search(name) is not None and name != "SubscribedHeads")


def test_each_listener_has_a_row_that_says_whose_key_it_accepts() -> None:
    found = Counter(
        (path.relative_to(ROOT).as_posix(), *one)
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for one in listeners(path.read_text())
    )
    rows = {(file, *call) for file, calls in ROWS.items() for call in calls}
    new, gone = found.keys() - rows, rows - found.keys()
    assert not new, "say in ROWS whose key each of these accepts"
    assert not gone, "these listen no more"
    assert {call for call, count in found.items() if count > 1} == set()


@pytest.mark.parametrize(
    "call",
    [
        "bus.subscribe_json(topics.VOTE.pattern(), take)",
        "session.declare_subscriber('**', take)",
        "session.liveliness().declare_subscriber('**', take)",
        "zenoh.ext.declare_advanced_subscriber(session, '**', take)",
        "node.create_subscription(Odometry, 'odom', take, 1)",
        "self._bus.subscribe(key)",
        "self.process.bus.serve(key, answer)",
        "session.declare_queryable(key, answer)",
        "Subscription(node, key)",
        "bus.session.get(key)",
        "session.liveliness().get(key)",
    ],
)
def test_a_new_listener_is_found_whatever_it_calls(call: str) -> None:
    source = f"class Spy:\n    def __init__(self):\n        self.kept = [lambda: {call}]\n"
    assert [where for where, _ in listeners(source)] == ["Spy.__init__"]
