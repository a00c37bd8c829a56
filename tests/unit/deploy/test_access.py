"""The router's rules cover the table of keys."""

import itertools
from typing import Any

import pytest
import zenoh

from deploy.access import access_control, everybody
from rodeo.lab.config import MeterConfig, Pose2, RobotConfig
from rodeo.site import sections, topics
from rodeo.site.config import Site
from rodeo.site.names import body_identity, node_identity, oracle_process, robot_process
from rodeo.site.sections import JudgeConfig, OtherBridgeConfig, RosConfig
from rodeo.site.topics import SEAL, TOPICS, WITNESS_STATEMENT, WITNESS_STATEMENTS, Form, Plane, Topic
from tests.support.site import LAB


@pytest.fixture(scope="module")
def rules() -> dict[str, dict[str, list[str]]]:
    return {rule["id"]: rule for rule in access_control(Site.load(LAB))["rules"]}


NAMES = ("panther1", "panther2")


@pytest.fixture(scope="module")
def two() -> Site:
    """A site of two robots, the second of another owner's make."""
    first, second = (RobotConfig(name=name, pose=Pose2(x_m=1, y_m=1)) for name in NAMES)
    second = second.model_copy(update={"namespace": "fleet/second", "body": "ros2"})
    return Site.load(LAB).model_copy(update={"robots": [first, second]})


OWNERS = {"annas": ["anna-2", "carl"], "berts": ["bert"]}
PARTICIPANTS = ["anna-2", "carl", "bert"]
ROS = Site.load(LAB).model_copy(
    update={"ros": [RosConfig(owner=owner, participants=names) for owner, names in OWNERS.items()]}
)


MINDED = Site.load(LAB).model_copy(
    update={
        "robots": [
            RobotConfig(name="panther1", pose=Pose2(x_m=1, y_m=1), mind="node.panther1"),
            RobotConfig(name="panther2", pose=Pose2(x_m=2, y_m=1), mind="node.anna-2"),
            RobotConfig(name="panther3", pose=Pose2(x_m=3, y_m=1)),
        ],
        "ros": [RosConfig(owner="annas", participants=["panther1", "anna-2"])],
    }
)
"""Two robots whose minds are ROS 2 nodes, and one of ours."""


class Rights:
    """The rules of sites, each made once."""

    def __init__(self) -> None:
        self._made: list[tuple[Site, dict[str, list[zenoh.KeyExpr]]]] = []

    def of(self, site: Site) -> dict[str, list[zenoh.KeyExpr]]:
        for one, rules in self._made:
            if one is site:
                return rules
        rules = {
            rule["id"]: list(map(zenoh.KeyExpr, rule["key_exprs"])) for rule in access_control(site)["rules"]
        }
        self._made.append((site, rules))
        return rules


RIGHTS = Rights()


def may(site: Site, name: str, does: str, key: str) -> bool:
    """Whether who shows the certificate of `name` "writes" or "asks" `key`."""
    asked = zenoh.KeyExpr(key)
    return any(allowed.includes(asked) for allowed in RIGHTS.of(site)[f"{name} {does}"])


def test_every_key_has_a_writer_who_may_be_on_the_bus() -> None:
    known = {*(name.partition(".")[0] for site in (ROS, MINDED) for name in everybody(site))}
    known |= {"every process", topics.EVERY_NODE, topics.DRIVER, "mocap"}
    assert {topic.writer for topic in TOPICS} <= known


@pytest.mark.parametrize("tables", [{}, {"ros": ROS.ros}, {"robots": MINDED.robots, "ros": MINDED.ros}])
def test_no_two_may_write_the_same(two: Site, tables: dict[str, Any]) -> None:
    two = two.model_copy(update=tables)
    # A robot's frames have its namespace in the message, not in the key, which all tools expect.
    all_nodes = topics.TF, topics.TF_STATIC, topics.ROSOUT, topics.PARAMETER_EVENTS
    shared = {"@ros2_lv/**", *(f"0/{topic.key}/{end}" for topic in all_nodes
                               for end in ("**", "**/@adv/**"))}  # fmt: skip
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(two)["rules"]}
    written = {name: set(rules[f"{name} writes"]) - shared for name in everybody(two)}
    for name, keys in written.items():
        for other, others in written.items():
            for key in keys:
                clashes = [o for o in others if zenoh.KeyExpr(key).intersects(zenoh.KeyExpr(o))]
                assert name == other or not clashes, (name, other, key, clashes)


ROBOTS_OWN = [topic for topic in TOPICS if topic.key.startswith("{ns}/")]
BODYS = [topic for topic in ROBOTS_OWN if topic.writer == topics.BODY and topic.form is not Form.TOPIC]


@pytest.mark.parametrize("topic", ROBOTS_OWN, ids=lambda topic: topic.key)
def test_what_is_in_a_robots_namespace_only_that_robots_body_or_mind_says(two: Site, topic: Topic) -> None:
    for robot in two.robots:
        key = f"0/{topic.name(ns=robot.namespace)}/what/follows"
        speakers = {name for name in everybody(two) if may(two, name, "writes", key)}
        body = topic.writer == topics.BODY
        assert speakers == {body_identity(robot.name) if body else robot_process(two, robot.name)}


@pytest.mark.parametrize("topic", BODYS, ids=lambda topic: topic.key)
def test_a_body_is_commanded_by_its_own_mind_itself_and_people(two: Site, topic: Topic) -> None:
    for robot in two.robots:
        key = f"0/{topic.name(ns=robot.namespace)}/what/follows"
        commanders = {name for name in everybody(two) if may(two, name, "asks", key)}
        own = {body_identity(robot.name), robot_process(two, robot.name)}
        assert commanders == {*own, "operator", "console"}


def test_a_mind_takes_orders_for_its_own_robot_only(two: Site) -> None:
    for robot in two.robots:
        key = topics.ROBOT_ORDER.name(org=two.org, robot=robot.name, order="pause")
        assert [name for name in everybody(two) if may(two, name, "writes", key)] == [
            robot_process(two, robot.name)
        ]


def test_a_mind_tells_what_its_own_robot_sees_and_people_say_what_it_is(two: Site) -> None:
    for act, tellers in (
        ("report", {"robot_agent.panther1"}),
        ("gone", {"robot_agent.panther1"}),
        ("say", {"operator", "console"}),
    ):
        key = topics.SIGHT.name(org="lab", who="panther1", act=act)
        assert {name for name in everybody(two) if may(two, name, "asks", key)} == tellers


def test_a_body_says_nothing_to_the_organization_and_asks_it_nothing(two: Site) -> None:
    for name in NAMES:
        rules = {rule["id"]: rule["key_exprs"] for rule in access_control(two)["rules"]}
        said = [key for key in rules[f"body.{name} writes"] if key.startswith("rodeo/")]
        assert said == [f"rodeo/lab/clock/body/{name}"]
        assert not [key for key in rules[f"body.{name} asks"] if key.startswith("rodeo/")]


def test_the_simulator_as_itself_says_what_is_the_labs(two: Site) -> None:
    names = {"ns": "panther1", "bin": two.bins[0].name, "dock": two.docks[0].name}
    said = {
        topic.key
        for topic in TOPICS
        if topic.plane is Plane.ROBOT and may(two, "robot_sim", "writes", f"0/{topic.pattern(**names)}/x")
    }
    lab = ("robot_sim", "mocap", topics.DRIVER)
    assert said == {topic.key for topic in TOPICS if topic.writer in lab} - {topics.CLOCK_MARK.key} | {
        topics.TF_STATIC.key
    }


def test_a_body_has_the_same_name_however_many_robots_there_are(two: Site) -> None:
    one = two.model_copy(update={"robots": two.robots[:1]})
    assert "body.panther1" in everybody(one) and "body.panther1" in everybody(two)


def test_each_of_several_bins_and_docks_speaks_for_itself_only() -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(site)["rules"]}
    for process, own, other in (
        ("itrash.bin_east", "bin_east", "bin_north"),
        ("charger.dock_east", "dock_east", "dock_west"),
    ):
        written, asked = rules[f"{process} writes"], rules[f"{process} asks"]
        assert f"rodeo/lab/witness/{own}/statement" in written
        assert not [key for key in written if other in key]
        assert [key for key in asked if key.startswith("0/") and other in key] == []
    assert "rodeo/lab/itrash/bin_east/state" in rules["itrash.bin_east writes"]
    assert "0/bin_east/camera/capture/**" in rules["itrash.bin_east asks"]
    assert "0/dock_east/enable/**" in rules["charger.dock_east asks"]
    assert {"0/bin_east/presence/**", "0/dock_west/output/**"} <= set(rules["robot_sim writes"])


def test_a_dock_that_reads_its_meter_publishes_what_it_reads_and_the_simulator_does_not() -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    west, east = site.docks
    modbus = MeterConfig(source="modbus", address="tcp://192.168.1.20:502")
    mixed = site.model_copy(update={"docks": [east.model_copy(update={"meter": modbus}), west]})
    for dock, process in ((east.name, "charger.dock_east"), (west.name, "robot_sim")):
        key = f"0/{dock}/output/type/hash"
        assert [name for name in everybody(mixed) if may(mixed, name, "writes", key)] == [process]
    assert not may(mixed, "robot_sim", "writes", f"0/{east.name}/enable/type/hash")
    assert may(mixed, "robot_sim", "writes", f"0/{west.name}/enable/type/hash")


@pytest.mark.parametrize("topic", [SEAL, WITNESS_STATEMENT, WITNESS_STATEMENTS], ids=lambda topic: topic.key)
def test_a_device_speaks_through_the_process_that_has_its_key(
    rules: dict[str, dict[str, list[str]]], topic: Topic
) -> None:
    site = Site.load(LAB)
    speakers = {
        device: [
            name
            for name in everybody(site)
            if any(
                zenoh.KeyExpr(topic.name(org=site.org, device=device)).intersects(zenoh.KeyExpr(key))
                for key in rules[f"{name} writes"]["key_exprs"]
            )
        ]
        for device in (site.bins[0].name, site.docks[0].name, "panther1", "mocap", "somebody")
    }
    assert speakers == {
        site.bins[0].name: ["itrash"],
        site.docks[0].name: ["charger"],
        "panther1": ["robot_agent"],
        "mocap": ["robot_sim"],
        "somebody": [],
    }


def test_only_robot_sim_tells_the_time(rules: dict[str, dict[str, list[str]]]) -> None:
    clock = zenoh.KeyExpr("0/clock/**")
    speakers = {
        name
        for name in everybody(Site.load(LAB))
        if any(clock.intersects(zenoh.KeyExpr(key)) for key in rules[f"{name} writes"]["key_exprs"])
    }
    assert speakers == {"robot_sim"}


def test_each_of_several_oracles_votes_for_itself_only() -> None:
    names = ("anna", "bert", "carl")
    site = Site.load(LAB).model_copy(update={"oracles": [JudgeConfig(name=name) for name in names]})
    for name, other in itertools.product(names, names):
        own = name == other
        process = oracle_process(site, name)
        assert process in everybody(site)
        assert may(site, process, "writes", topics.VOTE.name(org="lab", judge=other)) is own


def test_each_of_several_bridges_answers_for_its_own_wallets_only() -> None:
    site = Site.load(LAB).model_copy(update={"bridges": [OtherBridgeConfig(name="judges")]})
    for participant, bridge in (("organization", "bridge"), ("oracle", "bridge.judges")):
        command = topics.COMMAND.name(org="lab", participant=participant, command="transfer")
        assert {name for name in everybody(site) if may(site, name, "writes", command)} == {bridge}
    event = topics.EVENT.name(org="lab", event="TaskSettled")
    assert {name for name in everybody(site) if may(site, name, "writes", event)} == {"bridge"}


@pytest.mark.parametrize("participant", PARTICIPANTS)
def test_only_a_participants_own_nodes_ask_its_services_and_only_its_owners_process_answers(
    participant: str,
) -> None:
    service = f"0/lab/{participant.replace('-', '_')}/transfer/rodeo_msgs::srv::dds_::Transfer_/RIHS01_0"
    assert [name for name in everybody(ROS) if may(ROS, name, "asks", service)] == [
        node_identity(participant)
    ]
    owner = next(owner for owner, names in OWNERS.items() if participant in names)
    assert [name for name in everybody(ROS) if may(ROS, name, "writes", service)] == [f"ros_dao.{owner}"]


def test_an_owners_process_commands_its_own_participants_and_never_the_organization() -> None:
    for owner, names in OWNERS.items():
        wallets = {
            participant
            for participant in (*PARTICIPANTS, "organization", "oracle", "panther1")
            for key in [topics.COMMAND.name(org="lab", participant=participant, command="transfer")]
            if may(ROS, f"ros_dao.{owner}", "asks", key)
        }
        assert wallets == set(names)


def test_a_participants_nodes_ask_nothing_of_the_bridge() -> None:
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(ROS)["rules"]}
    for name in ("node.anna-2", "node.carl", "node.bert"):
        assert not [
            key for key in rules[f"{name} asks"] + rules[f"{name} writes"] if key.startswith("rodeo/")
        ]


MINDS = {"panther1": "node.panther1", "panther2": "node.anna-2"}


@pytest.mark.parametrize("robot", MINDS)
def test_nodes_that_are_a_mind_move_their_own_body_and_ask_its_recorder_and_nobody_elses(robot: str) -> None:
    mind, recorder = MINDS[robot], f"robot_recorder.{robot}"
    stops = (topics.EMERGENCY_STOP, sections.STOP_TRIGGER, sections.STOP_RESET)
    for topic in (*BODYS, *sections.INSTEAD):
        key = f"0/{topic.name(ns=robot)}/x/y"
        asks = {name for name in everybody(MINDED) if may(MINDED, name, "asks", key)}
        moves = recorder if topic in stops else mind
        assert [name for name in everybody(MINDED) if may(MINDED, name, "writes", key)] == [
            body_identity(robot)
        ]
        assert asks == {moves, body_identity(robot), "operator", "console"}, topic.key
    for topic in (topics.START_RECORDING, topics.PRESENT, topics.STOP_RECORDING):
        key = f"0/{topic.name(ns=robot)}/x/y"
        assert [name for name in everybody(MINDED) if may(MINDED, name, "asks", key)] == [mind]
        assert [name for name in everybody(MINDED) if may(MINDED, name, "writes", key)] == [recorder]
    for topic in (topics.CMD_VEL, topics.ITEM_POSE):
        key = f"0/{topic.name(ns=robot)}/x/y"
        assert [name for name in everybody(MINDED) if may(MINDED, name, "writes", key)] == [mind]


def test_a_mind_signs_nothing_and_tells_the_organization_nothing() -> None:
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(MINDED)["rules"]}
    for robot, mind in MINDS.items():
        written = [key for key in rules[f"{mind} writes"] if key.startswith("rodeo/")]
        assert written + [key for key in rules[f"{mind} asks"] if key.startswith("rodeo/")] == []
        order = topics.ROBOT_ORDER.name(org="lab", robot=robot, order="stop")
        assert [name for name in everybody(MINDED) if may(MINDED, name, "writes", order)] == [
            f"robot_recorder.{robot}"
        ]


def test_a_node_serves_the_parameters_of_its_own_namespace_and_logs() -> None:
    served = "get_parameters/rcl_interfaces::srv::dds_::GetParameters_/RIHS01_0"
    for does in ("writes", "asks"):
        key = f"0/lab/anna_2/my_node/{served}"
        assert [name for name in everybody(MINDED) if may(MINDED, name, does, key)] == ["node.anna-2"]
    for name in ("node.anna-2", "body.panther3"):
        for topic in (topics.ROSOUT, topics.PARAMETER_EVENTS):
            assert may(MINDED, name, "writes", f"0/{topic.key}/x/y")
            assert may(MINDED, name, "writes", f"0/{topic.key}/x/y/@adv/pub/z/0/_")
    assert not may(MINDED, "bridge", "writes", "0/rosout/x/y")
