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


def _topic(key: str, type: str, rate_hz: float | None, writer: str, recorded: bool, meaning: str) -> Topic:
    return Topic(key, type, Form.TOPIC, Plane.ROBOT, rate_hz, writer, recorded, meaning)


def _served(key: str, type: str, form: Form, meaning: str, writer: str = "") -> Topic:
    writer = writer or (BODY if key.startswith("{ns}/") else "robot_sim")
    return Topic(key, type, form, Plane.ROBOT, None, writer, meaning=meaning)


def _dao(key: str, type: str, form: Form, writer: str, meaning: str, rate_hz: float | None = None) -> Topic:
    return Topic(key, type, form, Plane.DAO, rate_hz, writer, False, meaning)


# -- robot plane: what any robot offers ----------------------------------------------------------------

CLOCK = _topic("clock", "rosgraph_msgs/msg/Clock", 50, "robot_sim", False, "simulated time")
ODOM = _topic("{ns}/odom", "nav_msgs/msg/Odometry", 50, BODY, True, "wheel odometry of the base")
JOINT_STATES = _topic(
    "{ns}/joint_states", "sensor_msgs/msg/JointState", 50, BODY, True, "arm, fingers and wheels"
)
ARM_STATE = _topic(
    "{ns}/arm_controller/controller_state",
    "control_msgs/msg/JointTrajectoryControllerState",
    10,
    BODY,
    True,
    "reference and measured positions of the arm's controller",
)
GRIPPER_STATE = _topic(
    "{ns}/gripper_controller/controller_state",
    "control_msgs/msg/JointTrajectoryControllerState",
    10,
    BODY,
    True,
    "the same of the fingers' controller: the reference is the last command",
)
BATTERY_STATE = _topic(
    "{ns}/battery_state", "sensor_msgs/msg/BatteryState", 1, BODY, True, "the robot's battery"
)
POSE = _topic(
    "{ns}/pose",
    "geometry_msgs/msg/PoseStamped",
    50,
    BODY,
    True,
    "the robot's own localisation in the map; only on sites without motion capture",
)
ITEM_POSE = _topic(
    "{ns}/item_pose",
    "geometry_msgs/msg/PoseStamped",
    None,
    "robot_agent",
    True,
    "pose in the map at which the robot sees the item that it will grasp",
)
CMD_VEL = _topic(
    "{ns}/cmd_vel", "geometry_msgs/msg/Twist", None, "robot_agent", False, "base velocity command"
)
SCAN = replace(
    _topic("{ns}/scan", "sensor_msgs/msg/LaserScan", 10, BODY, False, "obstacles 0.2 m above the floor"),
    lazy=True,
)
WRIST_DEPTH = replace(
    _topic(
        "{ns}/wrist_camera/depth/image_rect_raw",
        "sensor_msgs/msg/Image",
        5,
        BODY,
        False,
        "depth seen from the wrist, 32FC1 in m",
    ),
    lazy=True,
)
WRIST_DEPTH_INFO = replace(
    _topic(
        "{ns}/wrist_camera/depth/camera_info",
        "sensor_msgs/msg/CameraInfo",
        5,
        BODY,
        False,
        "intrinsics, one message with each depth image",
    ),
    lazy=True,
)
WRIST_IMAGE = replace(
    _topic(
        "{ns}/wrist_camera/image/compressed",
        "sensor_msgs/msg/CompressedImage",
        1,
        BODY,
        False,
        "colour image from the wrist, JPEG",
    ),
    lazy=True,
)
TF = replace(
    _topic("tf", "tf2_msgs/msg/TFMessage", 50, BODY, False, "frames of each robot, `{ns}/...`, in the map"),
    lazy=True,
)
TF_STATIC = replace(
    _topic(
        "tf_static",
        "tf2_msgs/msg/TFMessage",
        None,
        BODY,
        False,
        "frames that do not move",
    ),
    latched=True,
)
ROBOT_DESCRIPTION = replace(
    _topic("{ns}/robot_description", "std_msgs/msg/String", None, BODY, False, "the robot as URDF"),
    latched=True,
)
PLAN = replace(
    _topic(
        "{ns}/plan",
        "nav_msgs/msg/Path",
        None,
        BODY,
        False,
        "the planned path of the base",
    ),
    latched=True,
)
EMERGENCY_STOP = _served(
    "{ns}/emergency_stop",
    "std_srvs/srv/SetBool",
    Form.SERVICE,
    "true stops base and arm, and aborts and rejects goals until a call with false",
)
MOTOR_POWER = _served(
    "{ns}/motor_power",
    "std_srvs/srv/SetBool",
    Form.SERVICE,
    "optional; false cuts the motors' power outside the robot's working hours: the robot draws its standby "
    "power and rejects goals until a call with true",
)
NAVIGATE_TO_POSE = _served(
    "{ns}/navigate_to_pose",
    "nav2_msgs/action/NavigateToPose",
    Form.ACTION,
    "drive the base to a pose in the map frame, around obstacles",
)
FOLLOW_JOINT_TRAJECTORY = _served(
    "{ns}/arm_controller/follow_joint_trajectory",
    "control_msgs/action/FollowJointTrajectory",
    Form.ACTION,
    "move the arm along a joint trajectory",
)
GRIPPER_CMD = _served(
    "{ns}/gripper_controller/gripper_cmd",
    "control_msgs/action/GripperCommand",
    Form.ACTION,
    "open or close the fingers",
)

# -- robot plane: what its recorder offers a mind that is a ROS 2 node ---------------------------------------

START_RECORDING = _served(
    "{ns}/start_recording",
    "rodeo_msgs/srv/StartRecording",
    Form.SERVICE,
    "record an attempt; answered when motion capture lists the recording",
    RECORDER,
)
PRESENT = _served(
    "{ns}/present",
    "rodeo_msgs/srv/Present",
    Form.SERVICE,
    "sign for a bin that the robot shows it something; answered with what the bin says of it",
    RECORDER,
)
STOP_RECORDING = _served(
    "{ns}/stop_recording",
    "rodeo_msgs/srv/StopRecording",
    Form.SERVICE,
    "seal and store the recording, once it holds what the kind of work needs; answered with URI and hash",
    RECORDER,
)
ROBOT_ORDERS = replace(
    _topic("{ns}/orders", "rodeo_msgs/msg/RobotOrders", None, RECORDER, False, "the orders that hold"),
    latched=True,
)

# -- robot plane: what every node of ROS 2 opens by itself, beside its own parameters' services --------------

ROSOUT = replace(
    _topic("rosout", "rcl_interfaces/msg/Log", None, EVERY_NODE, False, "what nodes log"), latched=True
)
PARAMETER_EVENTS = _topic(
    "parameter_events",
    "rcl_interfaces/msg/ParameterEvent",
    None,
    EVERY_NODE,
    False,
    "changes of nodes' parameters",
)

# -- robot plane: what the lab itself offers ------------------------------------------------------------

MOCAP_POSE = _topic(
    "mocap/{body}/pose", "geometry_msgs/msg/PoseStamped", 50, "mocap", False, "motion capture in the map"
)
BIN_PRESENCE = _topic(
    "{bin}/presence",
    "sensor_msgs/msg/Range",
    10,
    DRIVER,
    False,
    "distance to the item in front of the bin's camera",
)
BIN_LOAD = _topic(
    "{bin}/{compartment}/load",
    "geometry_msgs/msg/WrenchStamped",
    10,
    DRIVER,
    True,
    "weight in the compartment",
)
BIN_IMAGE = _topic(
    "{bin}/camera/image/compressed",
    "sensor_msgs/msg/CompressedImage",
    None,
    DRIVER,
    False,
    "a frame of the bin's camera, one per capture",
)
BIN_CAPTURE = _served(
    "{bin}/camera/capture",
    "std_srvs/srv/Trigger",
    Form.SERVICE,
    "software trigger of the bin's camera",
    DRIVER,
)
DOCK_OUTPUT = _topic(
    "{dock}/output",
    "sensor_msgs/msg/BatteryState",
    1,
    DRIVER,
    True,
    "V and A at the contacts",
)
DOCK_ENABLE = _served(
    "{dock}/enable", "std_srvs/srv/SetBool", Form.SERVICE, "close or open the dock's contactor", DRIVER
)
SET_ENTITY_STATE = _served(
    "lab/set_entity_state",
    "simulation_interfaces/srv/SetEntityState",
    Form.SERVICE,
    "simulated labs only: set the pose of an item, an obstacle or a robot that is not simulated",
)

# -- the organization as ROS 2 nodes see it: names with hyphens as underscores (`ros_names`) ----


def _ros(key: str, type: str, form: Form, writer: str, meaning: str) -> Topic:
    return Topic(key, type, form, Plane.ORGANIZATION, None, writer, meaning=meaning)


ROS_SERVICE = _ros(
    "{org}/{participant}/{service}",
    "rodeo_msgs/srv/...",
    Form.SERVICE,
    "ros_dao",
    "a command that the participant gives, or a query: [ROS 2 interfaces](ros2.md) lists them",
)

ROS_CREATE_TASK = _ros(
    "{org}/{participant}/create_task",
    "rodeo_msgs/action/CreateTask",
    Form.ACTION,
    "ros_dao",
    "post a task and follow it to its end; many goals at a time",
)
ROS_DO_TASK = _ros(
    "{org}/{participant}/do_task",
    "rodeo_msgs/action/DoTask",
    Form.ACTION,
    NODE,
    "a task that the participant is assigned is a goal of its own node, whose result is the proof",
)
ROS_TASKS = replace(
    _ros(
        "{org}/{participant}/tasks",
        "rodeo_msgs/msg/Tasks",
        Form.TOPIC,
        "ros_dao",
        "open and running tasks, the newest 500; `total` counts all of them, and `get_tasks` has the rest",
    ),
    latched=True,
)
ROS_SERVICES = replace(
    _ros(
        "{org}/{participant}/services",
        "rodeo_msgs/msg/Services",
        Form.TOPIC,
        "ros_dao",
        "services that participants offer, at most 500",
    ),
    latched=True,
)
ROS_BALANCES = replace(
    _ros(
        "{org}/{participant}/balances",
        "rodeo_msgs/msg/Wallets",
        Form.TOPIC,
        "ros_dao",
        "balances of the site's participants",
    ),
    latched=True,
)
ROS_EVENTS = replace(
    _ros(
        "{org}/{participant}/events",
        "rodeo_msgs/msg/DaoEvent",
        Form.TOPIC,
        "ros_dao",
        "each contract event from now on. A node that comes late or was away hears the newest one, and asks "
        "`get_events` for those after the last that it knows",
    ),
    latched=True,
)

# -- DAO plane ------------------------------------------------------------------------------------------

COMMAND = _dao(
    "rodeo/{org}/wallet/{participant}/{command}",
    "Command",
    Form.QUERY,
    "bridge",
    "the bridge signs a command with the participant's wallet and sends the transaction",
)
STATE = _dao(
    "rodeo/{org}/state/{what}",
    "per query",
    Form.QUERY,
    "bridge",
    "answers from the bridge's index of the chain",
)
EVENT = _dao(
    "rodeo/{org}/event/{event}", "DaoEvent", Form.TOPIC, "bridge", "each contract event, in chain order"
)
SIGHT = _dao(
    "rodeo/{org}/sight/{who}/{act}",
    "per query",
    Form.QUERY,
    "bridge",
    "a robot reports something on the floor or that it is gone (report, gone), and a person says what it is "
    "(say)",
)
SEEN = _dao(
    "rodeo/{org}/seen/{thing}",
    "SeenThing",
    Form.TOPIC,
    "bridge",
    "a thing that a robot saw on the floor, when something about it changes",
)
VOTE = _dao(
    "rodeo/{org}/vote/{judge}",
    "SealedVote",
    Form.TOPIC,
    "oracle",
    "the signature of one of several oracles that has judged a proof: who found the same can count it; again "
    "until there is a verdict",
)
SEAL = _dao(
    "rodeo/{org}/seal/{device}",
    "Attestation",
    Form.TOPIC,
    "every process",
    "each seal of a running recording, published by the device that records",
)
WITNESS_STATEMENT = _dao(
    "rodeo/{org}/witness/{device}/statement",
    "Attestation",
    Form.TOPIC,
    "every process",
    "a statement that a device signed, one link of its chain",
)
WITNESS_STATEMENTS = _dao(
    "rodeo/{org}/witness/{device}/statements",
    "per query",
    Form.QUERY,
    "every process",
    "earlier statements of the device, as it signed them: `?after=SEQ;limit=N`",
)
PROOF_COPY = _dao(
    "rodeo/{org}/proof/{device}",
    "ProofCopy",
    Form.QUERY,
    "every process",
    "the device's own copy of a proof that it recorded: `?sha256=0x...;put=1` uploads it to the store "
    "again, `?sha256=0x...;offset=N` reads a part of it",
)
BIN_PICTURE = _dao(
    "rodeo/{org}/itrash/{bin}/picture",
    "per query",
    Form.QUERY,
    "itrash",
    "a picture that the bin classified, as the camera encoded it: `?sha256=0x...`",
)
BIN_STATE = _dao(
    "rodeo/{org}/itrash/{bin}/state",
    "BinState",
    Form.QUERY,
    "itrash",
    "state of the bin, and its last attestations",
)
BIN_CORRECTIONS = _dao(
    "rodeo/{org}/itrash/{bin}/corrections",
    "per query",
    Form.QUERY,
    "itrash",
    "how often the bin was right, by those who looked; a signed correction as payload is stored before",
)
ROBOT_ORDER = _dao(
    "rodeo/{org}/robot/{robot}/{order}",
    "per query",
    Form.QUERY,
    RECORDER,
    "orders to the robot (pause, resume, charge, cancel, stop), its state, and why it decided what (explain)",
)
STATUS = _dao("rodeo/{org}/status/{process}", "Status", Form.TOPIC, "every process", "heartbeat", 1)
ALIVE = _dao(
    "rodeo/{org}/alive/{process}",
    "liveliness token",
    Form.TOPIC,
    "every process",
    "present while the process runs",
)
SERVES = _dao(
    "rodeo/{org}/serves/{what}/{name}/{state}/{holder}",
    "liveliness token",
    Form.TOPIC,
    "every process",
    "the process that claims or serves a wallet, the oracle, a robot, bin, dock or motion capture, an "
    "owner's ROS nodes, the clock or the console: one at a time",
)
CLOCK_MARK = _dao(
    "rodeo/{org}/clock/mark/{to}",
    "ClockMark",
    Form.TOPIC,
    "robot_sim",
    "the simulator asks the holder of its clock that `to` names, or `all`, whether everything that it sent "
    "before has been received",
)
BODY_MARK = _dao(
    "rodeo/{org}/clock/body/{robot}",
    "ClockMark",
    Form.TOPIC,
    BODY,
    "a simulated body with its own session has sent everything up to now; the simulator then sends its "
    "own mark",
)
CLOCK_HOLD = _dao(
    "rodeo/{org}/clock/hold/{process}/{session}",
    "ClockHold",
    Form.TOPIC,
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
