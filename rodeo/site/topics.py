"""The table of every key on the bus. Code, documentation, access rules and the recorder are made from it.

`{ns}` is a robot's namespace, `{body}` a body that the motion capture tracks, `{bin}`, `{compartment}` and
`{dock}` name furniture, `{org}` the organization, `{judge}` one of several oracles, and `{participant}`,
`{command}`, `{service}`, `{event}`, `{process}` what they say. DAO-plane names are Zenoh keys as they are;
the others become Zenoh keys by `rodeo.ros2`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache

BODY = "body"
"""Identity that speaks for a robot's sensors and motors: on the bus `body.<robot>`
(`rodeo.site.config.body_identity`)."""


NODE = "node"
"""Identity that speaks ROS 2 for a participant: on the bus `node.<participant>`
(`rodeo.site.config.node_identity`)."""

EVERY_NODE = "every node"
"""Writer of what each node of ROS 2 publishes by itself: those of participants, and of bodies."""

DRIVER = "driver"
"""Identity that speaks for the hardware of a bin or a dock: `robot_sim` where that is simulated, else who has
the certificate `driver.<name>`, or the process itself (`rodeo.site.providers`)."""

RECORDER = "robot_recorder"
"""What has the key of a robot's device: a process of its own beside a mind that is a ROS 2 node, else part of
`robot_agent`."""


class Plane(StrEnum):
    ROBOT = "robot"
    ORGANIZATION = "organization"
    """The organization as ROS 2 nodes see it."""
    DAO = "dao"


class Form(StrEnum):
    """How a key is used, in ROS 2's and Zenoh's terms."""

    TOPIC = "topic"
    SERVICE = "service"
    ACTION = "action"
    QUERY = "query"


@dataclass(frozen=True)
class Topic:
    key: str
    """Template of the name."""
    type: str
    """ROS 2 type on the robot plane, model in `rodeo.bus.messages` (or prose) on the DAO plane."""
    form: Form
    plane: Plane
    rate_hz: float | None
    """Nominal rate in site time; None for on demand."""
    writer: str
    """The process that publishes a topic or serves a service, action or query; `BODY` for the robot's."""
    recorded: bool = False
    """Part of a proof."""
    meaning: str = ""
    latched: bool = False
    """Transient local: a late subscriber gets the last message."""
    lazy: bool = False
    """Published only while somebody subscribes, because it is costly."""

    def name(self, **names: str) -> str:
        """The key with each part filled in. Raises KeyError for a part that is missing."""
        return self.key.format(**names)

    def pattern(self, **names: str) -> str:
        """A key expression. A part that is left out matches any one name.

        Parts that are left out at the end of a query's key match the whole branch: `state/**` matches
        `state/task/7`.
        """
        expression = self.key.format_map(_AnyOf(names))
        return re.sub(r"(/\*)+$", "/**", expression) if self.form is Form.QUERY else expression

    def parts(self, key: str) -> dict[str, str] | None:
        """The value of each part in `key`; None if the key is not of this topic. The last part may contain
        slashes, unless it is a name in ROS 2."""
        found = _matcher(self.key, "[^/]+" if self.plane is Plane.ORGANIZATION else ".+").fullmatch(key)
        return None if found is None else found.groupdict()


class _AnyOf(dict[str, str]):
    def __missing__(self, _name: str) -> str:
        return "*"


@cache
def _matcher(key: str, last_part: str) -> re.Pattern[str]:
    *parts, last = re.split(r"\{(\w+)\}", key)
    literals, names = parts[::2], parts[1::2]
    text = "".join(
        f"{re.escape(literal)}(?P<{name}>{last_part if name == names[-1] else '[^/]+'})"
        for literal, name in zip(literals, names, strict=True)
    )
    return re.compile(text + re.escape(last))


def _topic(key: str, type: str, rate_hz: float | None, writer: str, meaning: str, **marks: bool) -> Topic:
    """`marks` are `recorded`, `latched` and `lazy`."""
    return Topic(key, type, Form.TOPIC, Plane.ROBOT, rate_hz, writer, meaning=meaning, **marks)


def _body(key: str, type: str, rate_hz: float | None, meaning: str, **marks: bool) -> Topic:
    return _topic(key, type, rate_hz, BODY, meaning, **marks)


def _service(key: str, type: str, meaning: str, writer: str = BODY) -> Topic:
    return Topic(key, type, Form.SERVICE, Plane.ROBOT, None, writer, meaning=meaning)


def _action(key: str, type: str, meaning: str) -> Topic:
    return Topic(key, type, Form.ACTION, Plane.ROBOT, None, BODY, meaning=meaning)


def _ros(key: str, type: str, form: Form, meaning: str, writer: str = "ros_dao") -> Topic:
    return Topic(key, type, form, Plane.ORGANIZATION, None, writer, meaning=meaning)


def _ros_topic(key: str, type: str, meaning: str) -> Topic:
    return replace(_ros(key, type, Form.TOPIC, meaning), latched=True)


def _dao_topic(key: str, type: str, writer: str, meaning: str, rate_hz: float | None = None) -> Topic:
    return Topic(key, type, Form.TOPIC, Plane.DAO, rate_hz, writer, meaning=meaning)


def _dao_query(key: str, type: str, writer: str, meaning: str) -> Topic:
    return Topic(key, type, Form.QUERY, Plane.DAO, None, writer, meaning=meaning)


# -- robot plane: what any robot offers ----------------------------------------------------------------

CLOCK = _topic("clock", "rosgraph_msgs/msg/Clock", 50, "robot_sim", "simulated time")
ODOM = _body("{ns}/odom", "nav_msgs/msg/Odometry", 50, "wheel odometry of the base", recorded=True)
JOINT_STATES = _body(
    "{ns}/joint_states", "sensor_msgs/msg/JointState", 50, "arm, fingers and wheels", recorded=True
)
ARM_STATE = _body(
    "{ns}/arm_controller/controller_state",
    "control_msgs/msg/JointTrajectoryControllerState",
    10,
    "reference and measured positions of the arm's controller",
    recorded=True,
)
GRIPPER_STATE = _body(
    "{ns}/gripper_controller/controller_state",
    "control_msgs/msg/JointTrajectoryControllerState",
    10,
    "the same of the fingers' controller: the reference is the last command",
    recorded=True,
)
BATTERY_STATE = _body(
    "{ns}/battery_state", "sensor_msgs/msg/BatteryState", 1, "the robot's battery", recorded=True
)
POSE = _body(
    "{ns}/pose",
    "geometry_msgs/msg/PoseStamped",
    50,
    "the robot's own localisation in the map; only on sites without motion capture",
    recorded=True,
)
ITEM_POSE = _topic(
    "{ns}/item_pose",
    "geometry_msgs/msg/PoseStamped",
    None,
    "robot_agent",
    "pose in the map at which the robot sees the item that it will grasp",
    recorded=True,
)
CMD_VEL = _topic("{ns}/cmd_vel", "geometry_msgs/msg/Twist", None, "robot_agent", "base velocity command")
SCAN = _body("{ns}/scan", "sensor_msgs/msg/LaserScan", 10, "obstacles 0.2 m above the floor", lazy=True)
WRIST_DEPTH = _body(
    "{ns}/wrist_camera/depth/image_rect_raw",
    "sensor_msgs/msg/Image",
    5,
    "depth seen from the wrist, 32FC1 in m",
    lazy=True,
)
WRIST_DEPTH_INFO = _body(
    "{ns}/wrist_camera/depth/camera_info",
    "sensor_msgs/msg/CameraInfo",
    5,
    "intrinsics, one message with each depth image",
    lazy=True,
)
WRIST_IMAGE = _body(
    "{ns}/wrist_camera/image/compressed",
    "sensor_msgs/msg/CompressedImage",
    1,
    "colour image from the wrist, JPEG",
    lazy=True,
)
TF = _body("tf", "tf2_msgs/msg/TFMessage", 50, "frames of each robot, `{ns}/...`, in the map", lazy=True)
TF_STATIC = _body("tf_static", "tf2_msgs/msg/TFMessage", None, "frames that do not move", latched=True)
ROBOT_DESCRIPTION = _body(
    "{ns}/robot_description", "std_msgs/msg/String", None, "the robot as URDF", latched=True
)
PLAN = _body("{ns}/plan", "nav_msgs/msg/Path", None, "the planned path of the base", latched=True)
EMERGENCY_STOP = _service(
    "{ns}/emergency_stop",
    "std_srvs/srv/SetBool",
    "true stops base and arm, and aborts and rejects goals until a call with false",
)
MOTOR_POWER = _service(
    "{ns}/motor_power",
    "std_srvs/srv/SetBool",
    "optional; false cuts the motors' power outside the robot's working hours: the robot draws its standby "
    "power and rejects goals until a call with true",
)
NAVIGATE_TO_POSE = _action(
    "{ns}/navigate_to_pose",
    "nav2_msgs/action/NavigateToPose",
    "drive the base to a pose in the map frame, around obstacles",
)
FOLLOW_JOINT_TRAJECTORY = _action(
    "{ns}/arm_controller/follow_joint_trajectory",
    "control_msgs/action/FollowJointTrajectory",
    "move the arm along a joint trajectory",
)
GRIPPER_CMD = _action(
    "{ns}/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", "open or close the fingers"
)

# -- robot plane: what its recorder offers a mind that is a ROS 2 node ---------------------------------------

START_RECORDING = _service(
    "{ns}/start_recording",
    "rodeo_msgs/srv/StartRecording",
    "record an attempt; answered when motion capture lists the recording",
    RECORDER,
)
PRESENT = _service(
    "{ns}/present",
    "rodeo_msgs/srv/Present",
    "sign for a bin that the robot shows it something; answered with what the bin says of it",
    RECORDER,
)
STOP_RECORDING = _service(
    "{ns}/stop_recording",
    "rodeo_msgs/srv/StopRecording",
    "seal and store the recording, once it holds what the kind of work needs; answered with URI and hash",
    RECORDER,
)
ROBOT_ORDERS = _topic(
    "{ns}/orders", "rodeo_msgs/msg/RobotOrders", None, RECORDER, "the orders that hold", latched=True
)

# -- robot plane: what every node of ROS 2 opens by itself, beside its own parameters' services --------------

ROSOUT = _topic("rosout", "rcl_interfaces/msg/Log", None, EVERY_NODE, "what nodes log", latched=True)
PARAMETER_EVENTS = _topic(
    "parameter_events", "rcl_interfaces/msg/ParameterEvent", None, EVERY_NODE, "changes of nodes' parameters"
)

# -- robot plane: what the lab itself offers ------------------------------------------------------------

MOCAP_POSE = _topic(
    "mocap/{body}/pose", "geometry_msgs/msg/PoseStamped", 50, "mocap", "motion capture in the map"
)
BIN_PRESENCE = _topic(
    "{bin}/presence", "sensor_msgs/msg/Range", 10, DRIVER, "distance to the item in front of the bin's camera"
)
BIN_LOAD = _topic(
    "{bin}/{compartment}/load",
    "geometry_msgs/msg/WrenchStamped",
    10,
    DRIVER,
    "weight in the compartment",
    recorded=True,
)
BIN_IMAGE = _topic(
    "{bin}/camera/image/compressed",
    "sensor_msgs/msg/CompressedImage",
    None,
    DRIVER,
    "a frame of the bin's camera, one per capture",
)
BIN_CAPTURE = _service(
    "{bin}/camera/capture", "std_srvs/srv/Trigger", "software trigger of the bin's camera", DRIVER
)
DOCK_OUTPUT = _topic(
    "{dock}/output", "sensor_msgs/msg/BatteryState", 1, DRIVER, "V and A at the contacts", recorded=True
)
DOCK_ENABLE = _service("{dock}/enable", "std_srvs/srv/SetBool", "close or open the dock's contactor", DRIVER)
SET_ENTITY_STATE = _service(
    "lab/set_entity_state",
    "simulation_interfaces/srv/SetEntityState",
    "simulated labs only: set the pose of an item, an obstacle or a robot that is not simulated",
    "robot_sim",
)

# -- the organization as ROS 2 nodes see it: names with hyphens as underscores (`ros_names`) ----

ROS_SERVICE = _ros(
    "{org}/{participant}/{service}",
    "rodeo_msgs/srv/...",
    Form.SERVICE,
    "a command that the participant gives, or a query: [ROS 2 interfaces](ros2.md) lists them",
)

ROS_CREATE_TASK = _ros(
    "{org}/{participant}/create_task",
    "rodeo_msgs/action/CreateTask",
    Form.ACTION,
    "post a task and follow it to its end; many goals at a time",
)
ROS_DO_TASK = _ros(
    "{org}/{participant}/do_task",
    "rodeo_msgs/action/DoTask",
    Form.ACTION,
    "a task that the participant is assigned is a goal of its own node, whose result is the proof",
    NODE,
)
ROS_TASKS = _ros_topic(
    "{org}/{participant}/tasks",
    "rodeo_msgs/msg/Tasks",
    "open and running tasks, the newest 500; `total` counts all of them, and `get_tasks` has the rest",
)
ROS_SERVICES = _ros_topic(
    "{org}/{participant}/services", "rodeo_msgs/msg/Services", "services that participants offer, at most 500"
)
ROS_BALANCES = _ros_topic(
    "{org}/{participant}/balances", "rodeo_msgs/msg/Wallets", "balances of the site's participants"
)
ROS_EVENTS = _ros_topic(
    "{org}/{participant}/events",
    "rodeo_msgs/msg/DaoEvent",
    "each contract event from now on. A node that comes late or was away hears the newest one, and asks "
    "`get_events` for those after the last that it knows",
)

# -- DAO plane ------------------------------------------------------------------------------------------

COMMAND = _dao_query(
    "rodeo/{org}/wallet/{participant}/{command}",
    "Command",
    "bridge",
    "the bridge signs a command with the participant's wallet and sends the transaction",
)
STATE = _dao_query(
    "rodeo/{org}/state/{what}", "per query", "bridge", "answers from the bridge's index of the chain"
)
EVENT = _dao_topic("rodeo/{org}/event/{event}", "DaoEvent", "bridge", "each contract event, in chain order")
SIGHT = _dao_query(
    "rodeo/{org}/sight/{who}/{act}",
    "per query",
    "bridge",
    "a robot reports something on the floor or that it is gone (report, gone), and a person says what it is "
    "(say)",
)
SEEN = _dao_topic(
    "rodeo/{org}/seen/{thing}",
    "SeenThing",
    "bridge",
    "a thing that a robot saw on the floor, when something about it changes",
)
VOTE = _dao_topic(
    "rodeo/{org}/vote/{judge}",
    "SealedVote",
    "oracle",
    "the signature of one of several oracles that has judged a proof: who found the same can count it; again "
    "until there is a verdict",
)
SEAL = _dao_topic(
    "rodeo/{org}/seal/{device}",
    "Attestation",
    "every process",
    "each seal of a running recording, published by the device that records",
)
WITNESS_STATEMENT = _dao_topic(
    "rodeo/{org}/witness/{device}/statement",
    "Attestation",
    "every process",
    "a statement that a device signed, one link of its chain",
)
WITNESS_STATEMENTS = _dao_query(
    "rodeo/{org}/witness/{device}/statements",
    "per query",
    "every process",
    "earlier statements of the device, as it signed them: `?after=SEQ;limit=N`",
)
PROOF_COPY = _dao_query(
    "rodeo/{org}/proof/{device}",
    "ProofCopy",
    "every process",
    "the device's own copy of a proof that it recorded: `?sha256=0x...;put=1` uploads it to the store "
    "again, `?sha256=0x...;offset=N` reads a part of it",
)
BIN_PICTURE = _dao_query(
    "rodeo/{org}/itrash/{bin}/picture",
    "per query",
    "itrash",
    "a picture that the bin classified, as the camera encoded it: `?sha256=0x...`",
)
BIN_STATE = _dao_query(
    "rodeo/{org}/itrash/{bin}/state", "BinState", "itrash", "state of the bin, and its last attestations"
)
BIN_CORRECTIONS = _dao_query(
    "rodeo/{org}/itrash/{bin}/corrections",
    "per query",
    "itrash",
    "how often the bin was right, by those who looked; a signed correction as payload is stored before",
)
ROBOT_ORDER = _dao_query(
    "rodeo/{org}/robot/{robot}/{order}",
    "per query",
    RECORDER,
    "orders to the robot (pause, resume, charge, cancel, stop), its state, and why it decided what (explain)",
)
STATUS = _dao_topic("rodeo/{org}/status/{process}", "Status", "every process", "heartbeat", 1)
ALIVE = _dao_topic(
    "rodeo/{org}/alive/{process}", "liveliness token", "every process", "present while the process runs"
)
SERVES = _dao_topic(
    "rodeo/{org}/serves/{what}/{name}/{state}/{holder}",
    "liveliness token",
    "every process",
    "the process that claims or serves a wallet, the oracle, a robot, bin, dock or motion capture, an "
    "owner's ROS nodes, the clock or the console: one at a time",
)
CLOCK_MARK = _dao_topic(
    "rodeo/{org}/clock/mark/{to}",
    "ClockMark",
    "robot_sim",
    "the simulator asks the holder of its clock that `to` names, or `all`, whether everything that it sent "
    "before has been received",
)
BODY_MARK = _dao_topic(
    "rodeo/{org}/clock/body/{robot}",
    "ClockMark",
    BODY,
    "a simulated body with its own session has sent everything up to now; the simulator then sends its "
    "own mark",
)
CLOCK_HOLD = _dao_topic(
    "rodeo/{org}/clock/hold/{process}/{session}",
    "ClockHold",
    "every process",
    "the process is busy, or has nothing to do before a time; the simulator's clock waits for the process "
    "while a liveliness token of this name exists",
)

# -- a recording's own channels, beside those of the robot's topics ------------------------------------------

EVENT_CHANNEL = "rodeo/event"
"""Contract events of the task, and notes of the recorder and the robot: JSON."""
ATTESTATION_CHANNEL = "rodeo/attestation"
"""Signed statements of other devices: JSON."""
SEAL_CHANNEL = "rodeo/seal"
"""Seals: JSON."""

ROBOT_STATE = (ODOM, JOINT_STATES, ARM_STATE, GRIPPER_STATE, BATTERY_STATE, POSE)
"""What a robot publishes about itself, for a proof of its work."""

TOPICS: tuple[Topic, ...] = tuple(value for value in list(globals().values()) if isinstance(value, Topic))


def markdown() -> str:
    """The table as text: the first part of docs/reference/keys.md, which `rodeo.payloads` makes."""
    lines = [
        "# Keys on the bus",
        "",
        "Generated by `python -m rodeo.payloads` from `rodeo/site/topics.py` and the models.",
        "",
    ]
    for plane, text in _PLANES.items():
        lines += [f"## {text}", "", "| key | type | form | rate (Hz) | writer | recorded | what |"]
        lines += ["|---|---|---|---|---|---|---|"]
        for topic in TOPICS:
            if topic.plane is plane:
                recorded = "yes" if topic.recorded else ""
                cells = [
                    f"`{topic.key}`",
                    f"`{topic.type}`",
                    topic.form,
                    _rate(topic),
                    topic.writer,
                    recorded,
                ]
                lines.append(f"| {' | '.join(cells)} | {topic.meaning} |")
        lines.append("")
    return "\n".join(lines) + "\n"


def robot_interface() -> str:
    """A robot's interface as a table: part of docs/tutorials/robot.md."""
    lines = ["| name | type | form | rate (Hz) | in a proof | what |", "|---|---|---|---|---|---|"]
    for topic in TOPICS:
        if topic is ITEM_POSE or topic.writer == RECORDER:
            continue  # the mind's own, and what is for it
        if topic.plane is Plane.ROBOT and (topic.key.startswith("{ns}/") or topic.key.startswith("tf")):
            form = "subscribed" if topic.writer != BODY else topic.form
            recorded = "yes" if topic.recorded else ""
            lines.append(
                f"| `{topic.key}` | `{topic.type}` | {form} | {_rate(topic)} | {recorded} | {topic.meaning} |"
            )
    return "\n".join(lines) + "\n"


def _rate(topic: Topic) -> str:
    rate = "on demand" if topic.rate_hz is None else f"{topic.rate_hz:g}"
    return rate + (", while subscribed" if topic.lazy else "") + (", latched" if topic.latched else "")


_PLANES = {
    Plane.ROBOT: "Robot plane: ROS 2 as rmw_zenoh writes it",
    Plane.ORGANIZATION: "The organization over ROS 2, on sites with `[[ros]]`",
    Plane.DAO: "DAO plane: JSON",
}
