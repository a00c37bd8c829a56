"""The router's access rules, made from the table of keys: who may say what on a closed bus.

    everybody on the bus   may listen to everything and ask most things
    a process              may publish, serve and answer what the table says that it writes
    a robot's body         may publish and serve what is in the robot's namespace, and ask for nothing else
    a driver               may publish and serve what its bin's or dock's hardware measures and takes, and
                           the poses that `mocap` listens to; where that is simulated, `robot_sim` may
    a robot's mind         commands the body in that namespace, and takes orders for that robot, no other's
    a device               speaks through the process that has its key
    a wallet               takes from the process that works for it, and from operator and console, the
                           commands that are declared for them (`rodeo.commands`), and no others
    a participant's nodes  ask the ROS 2 services of that participant, serve its `do_task`, and open what
                           every node does; as a robot's mind they also do what a mind may, but for stopping
                           the body: the robot's recorder takes the orders
    a robot's eyes         its mind reports what lies on the floor, and operator and console say what it is
    a motion               is asked for by the process that `_CALLERS` names, and by operator and console

What the rules do not allow is denied.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from rodeo.bus.seen import GONE, REPORT, SAY
from rodeo.commands import COMMANDS
from rodeo.commands.people import PEOPLE
from rodeo.dao import ORGANIZATION
from rodeo.lab.config import RobotConfig
from rodeo.ros2.definitions import dds_type
from rodeo.runtime.serving import served_by
from rodeo.site import sections, topics
from rodeo.site.config import Site
from rodeo.site.minds import AGENT
from rodeo.site.names import BRIDGE, body_identity, node_identity, robot_process
from rodeo.site.processes import processes_of, ros_process
from rodeo.site.providers import MOTION_CAPTURE, SIMULATOR, driver_identity, drivers, provided_by
from rodeo.site.ros_names import ros_name
from rodeo.site.tls import OPERATOR
from rodeo.site.topics import BODY, DRIVER, EVERY_NODE, NODE, RECORDER, TOPICS, Form, Plane, Topic

_CALLERS: dict[str, str] = {
    topics.NAVIGATE_TO_POSE.key: AGENT,
    topics.FOLLOW_JOINT_TRAJECTORY.key: AGENT,
    topics.GRIPPER_CMD.key: AGENT,
    topics.MOTOR_POWER.key: AGENT,
    sections.GRIPPER_TRAJECTORY.key: AGENT,
    **dict.fromkeys((sections.STOP_TRIGGER.key, sections.STOP_RESET.key), RECORDER),
    # Whoever stops another owner's robot, or lets it continue, decides over its work.
    topics.EMERGENCY_STOP.key: RECORDER,
    # Only the mind says what it does, and what its robot signs.
    **dict.fromkeys((topics.START_RECORDING.key, topics.PRESENT.key, topics.STOP_RECORDING.key), AGENT),
    topics.BIN_CAPTURE.key: "itrash",
    topics.DOCK_ENABLE.key: "charger",
    # Nobody who is paid for moving things moves them by decree.
    topics.SET_ENTITY_STATE.key: OPERATOR,
    topics.ROBOT_ORDER.key: OPERATOR,
    # A certificate for people would give commands there that people may not give.
    topics.ROS_SERVICE.key: NODE,
    topics.ROS_CREATE_TASK.key: NODE,
    topics.ROS_DO_TASK.key: "ros_dao",
}
"""The one process that uses a service or action which moves or switches something."""

_KEYS = (*TOPICS, *sections.INSTEAD)

_PARAMETERS = {
    "describe_parameters": "rcl_interfaces/srv/DescribeParameters",
    "get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
    "get_parameters": "rcl_interfaces/srv/GetParameters",
    "get_type_description": "type_description_interfaces/srv/GetTypeDescription",
    "list_parameters": "rcl_interfaces/srv/ListParameters",
    "set_parameters": "rcl_interfaces/srv/SetParameters",
    "set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
}
"""Services that every node of ROS 2 Jazzy serves under its own name (rclcpp's and rclpy's Node)."""

_ALSO_WRITES: dict[str, str] = {topics.TF_STATIC.key: SIMULATOR}
"""A second writer: bin and dock have frames, too."""

_SIGNED_FOR_PEOPLE = {"sign", "sign_vote"}
"""Requests to wallets that are no commands of their own: signatures."""

_SIGNS_ITSELF = ("prepare", "broadcast", "sign")
"""Requests that `rodeo.dao.Participant` sends for a wallet whose key is elsewhere: the program that has it
connects as the operator."""


def commands_of(job: str) -> set[str]:
    """The commands that the process's code sends to the wallets it works for (`_wallets_of`). A test derives
    the same from the code."""
    declared = {name for name, model in COMMANDS.items() if job in model.declared.senders}
    return declared | (_SIGNED_FOR_PEOPLE if job == OPERATOR else set())


_EVERYBODY = "every process"
_LISTEN = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]
_WRITE = ["put", "delete", "declare_queryable", "reply", "liveliness_token"]
_ALL = [*_LISTEN, *_WRITE, "query"]
_ANY_KEY = ["**", "@ros2_lv/**", "**/@adv/**"]
"""`**` stands for no part of a key that begins with @: the ROS graph, and what latched topics keep."""


def everybody(site: Site) -> list[str]:
    """The names of those who may be on the bus."""
    bodies = [body_identity(robot.name) for robot in site.robots]
    return [
        *(process.name for process in processes_of(site)),
        *bodies,
        *drivers(site),
        *nodes_of(site),
        OPERATOR,
    ]


def nodes_of(site: Site) -> list[str]:
    """The certificates of participants' ROS 2 nodes: those of an owner, and those that are a robot's mind."""
    nodes = [node_identity(name) for one in site.ros for name in one.participants]
    return list(dict.fromkeys([*nodes, *(robot.mind for robot in site.robots if robot.mind is not None)]))


def access_control(site: Site) -> dict[str, Any]:
    """Zenoh's `access_control` for the router of `site`."""
    all_names = everybody(site)
    # The router may send everything to a client; it checks messages when it receives them.
    rules = [_rule("hear", "egress", _ALL, _ANY_KEY), _rule("listen", "ingress", _LISTEN, _ANY_KEY)]
    policies = [{"rules": ["hear", "listen"], "subjects": all_names}]
    for name in all_names:
        rules += [
            _rule(f"{name} writes", "ingress", _WRITE, sorted(set(_written_by(site, name)))),
            _rule(f"{name} asks", "ingress", ["query"], sorted(set(_asked_by(site, name)))),
        ]
        policies.append({"rules": [f"{name} writes", f"{name} asks"], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in all_names],
        "policies": policies,
    }


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


def _written_by(site: Site, process: str) -> Iterator[str]:
    # Whose endpoints are in the ROS graph is no secret and no command.
    yield "@ros2_lv/**"
    yield from _parameters_of(site, process)
    if process == driver_identity(MOTION_CAPTURE):
        key = f"{site.bus.domain_id}/{site.mocap.address.replace('{body}', '**')}/**"
        yield from (key, f"{key}/@adv/**")
    roles = _roles(site, process)
    for topic in _KEYS:
        if topic is topics.SERVES:
            # Nobody keeps another from its work by claiming it.
            for what, name in served_by(site, process):
                yield topic.pattern(org=site.org, what=what, name=name)
        elif topic.writer in roles or _ALSO_WRITES.get(topic.key) == process:
            for key in _written_keys(site, topic, process):
                yield key
                if topic.plane is not Plane.DAO:
                    yield f"{key}/@adv/**"


def _asked_by(site: Site, process: str) -> Iterator[str]:
    yield "**/@adv/**"
    roles = _roles(site, process)
    if _job(process) in (BODY, DRIVER, NODE):
        yield from _parameters_of(site, process)
        for topic in _KEYS:
            own = topic.writer == BODY and topic.form is not Form.TOPIC
            if own if _job(process) == BODY else _CALLERS.get(topic.key) in roles:
                yield from _asked_keys(site, topic, process)
        return
    for topic in _KEYS:
        if topic.key == topics.COMMAND.key:
            for participant, command in _commands_of(site, process):
                yield topics.COMMAND.name(org=site.org, participant=participant, command=command)
            continue
        if topic is topics.SIGHT:
            for who, act in _sights_of(site, process):
                yield topic.name(org=site.org, who=who, act=act)
            continue
        asked = topic.form is not Form.TOPIC or topic.writer == _EVERYBODY
        caller = _CALLERS.get(topic.key, _job(process))
        of_mind = caller == AGENT and topic.writer == RECORDER
        people = process in PEOPLE and topic.plane is not Plane.ORGANIZATION and not of_mind
        if asked and (people or caller in roles):
            yield from _asked_keys(site, topic, process)


def _commands_of(site: Site, process: str) -> Iterator[tuple[str, str]]:
    """Each participant and command that the process may send to the participant's wallet; `*` for all
    participants."""
    yield from itertools.product(_wallets_of(site, process), commands_of(_job(process)))
    if process == OPERATOR:
        elsewhere = [one.name for one in site.participants if one.address is not None]
        yield from itertools.product(elsewhere, _SIGNS_ITSELF)


def _sights_of(site: Site, process: str) -> Iterator[tuple[str, str]]:
    """In whose name the process tells of things on the floor, and what: a mind in its robot's."""
    if process in PEOPLE:
        yield "*", SAY
    elif _job(process) == AGENT:
        yield from itertools.product(_own(site, process, "robot"), (REPORT, GONE))


def _wallets_of(site: Site, process: str) -> list[str]:
    """Participants for whom the process works; `*` for all."""
    if process in PEOPLE:
        return ["*"]
    if (job := _job(process)) in (AGENT, "oracle"):
        return _own(site, process, "robot" if job == AGENT else "oracle")
    return _participants_of(site, process) or [ORGANIZATION]


def _participants_of(site: Site, process: str) -> list[str]:
    """The participants for whom the process speaks ROS 2."""
    return [
        name
        for one in site.ros
        for name in one.participants
        if process in (ros_process(site, one.owner), node_identity(name))
    ]


def _job(process: str) -> str:
    """The name in the key table: the same for every robot's mind, and for every robot's body."""
    return process.partition(".")[0]


def _roles(site: Site, process: str) -> set[str]:
    """The names in the key table as which the process speaks. A mind of ours is its robot's recorder, too."""
    job = _job(process)
    if job in (BODY, NODE):
        is_mind = process in [robot.mind for robot in site.robots]
        return {job, EVERY_NODE, *([AGENT] if is_mind else [])}
    if job == DRIVER:
        return {DRIVER, EVERY_NODE}
    cameras = [MOTION_CAPTURE] if provided_by(site, process, "mocap") else []
    return {job, DRIVER, _EVERYBODY, *cameras, *([RECORDER] if job == AGENT else [])}


def _parameters_of(site: Site, process: str) -> Iterator[str]:
    """The keys of the parameters of a participant's nodes, which are in its namespace."""
    if _job(process) == NODE:
        namespace = f"{ros_name(site.org)}/{ros_name(process.removeprefix(f'{NODE}.'))}"
        for service, typename in _PARAMETERS.items():
            yield f"{site.bus.domain_id}/{namespace}/*/{service}/{dds_type(typename)}/*"


def _own(site: Site, process: str, what: str) -> list[str]:
    """The oracles, robots, bins or docks (`what`) that the process is the one of."""
    return [thing.name for thing in served_by(site, process) if thing.what == what]


def _devices_of(site: Site, process: str) -> list[str]:
    """Names of the devices whose keys the process has."""
    if cameras := provided_by(site, process, "mocap"):
        return cameras
    return [name for what in ("bin", "dock", "robot") for name in _own(site, process, what)]


def _robots_of(site: Site, process: str) -> list[RobotConfig]:
    """The robot whose body or mind speaks; all of them for a process that is no robot's."""
    own = [
        robot
        for robot in site.robots
        if process in (body_identity(robot.name), robot_process(site, robot.name), robot.mind)
    ]
    return own if _job(process) == NODE else own or site.robots


def _written_keys(site: Site, topic: Topic, process: str) -> Iterator[str]:
    """Key expressions that `process` publishes on `topic` on this site."""
    if topic.writer == BRIDGE and site.bridges:
        yield from _written_by_bridge(site, topic, process)
        return
    if topic.plane is Plane.ORGANIZATION:
        yield from _ros_keys(site, topic, process)
        return
    if topic.writer == EVERY_NODE:
        yield f"{site.bus.domain_id}/{topic.name()}/**"
        return
    if topic.writer == DRIVER:
        for part in ("bin", "dock"):
            for name in provided_by(site, process, part) if f"{{{part}}}" in topic.key else ():
                yield f"{site.bus.domain_id}/{topic.pattern(**{part: name})}/**"
        return
    devices = _devices_of(site, process) if "{device}" in topic.key else ["*"]
    for robot, device in itertools.product(_robots_of(site, process), devices):
        yield from _keys(
            site, topic, process, robot=robot.name, ns=robot.namespace, device=device, process=process
        )


def _written_by_bridge(site: Site, topic: Topic, process: str) -> Iterator[str]:
    """Each of several bridges answers for its own wallets, and the site's own one publishes the chain."""
    if topic is topics.COMMAND:
        for participant in _own(site, process, "wallet"):
            yield topic.pattern(org=site.org, participant=participant)
    elif process == BRIDGE:
        yield topic.pattern(org=site.org)


def _asked_keys(site: Site, topic: Topic, process: str) -> Iterator[str]:
    """Key expressions of `topic` that `process` asks on this site, whoever answers."""
    if topic.plane is Plane.ORGANIZATION:
        yield from _ros_keys(site, topic, process)
        return
    for robot in _robots_of(site, process):
        yield from _keys(site, topic, process, ns=robot.namespace)


def _ros_keys(site: Site, topic: Topic, process: str) -> Iterator[str]:
    """The keys of its own participants. Type and hash follow the name, so that a service with any name is
    none of the parts of an action, which others may serve."""
    end = "_action/*/*/*" if topic.form is Form.ACTION else "*/*"
    for participant in _participants_of(site, process):
        key = topic.pattern(org=ros_name(site.org), participant=ros_name(participant))
        yield f"{site.bus.domain_id}/{key}/{end}"


def _keys(site: Site, topic: Topic, speaker: str, **names: str) -> Iterator[str]:
    """The key of its own bin or dock; of all of them for a process that belongs to none."""
    bins = _own(site, speaker, "bin") or [one.name for one in site.bins]
    docks = _own(site, speaker, "dock") or [dock.name for dock in site.docks]
    judges = _own(site, speaker, "oracle") or ["*"]
    for bin_name, dock, judge in itertools.product(
        bins if "{bin}" in topic.key else ["*"],
        docks if "{dock}" in topic.key else ["*"],
        judges if "{judge}" in topic.key else ["*"],
    ):
        key = topic.pattern(org=site.org, bin=bin_name, dock=dock, judge=judge, **names)
        # One responder serves a query's whole branch: state/task/7 as well as state/tasks.
        yield f"{site.bus.domain_id}/{key}/**" if topic.plane is Plane.ROBOT else key
