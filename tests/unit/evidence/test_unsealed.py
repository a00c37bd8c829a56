"""Bags by other tools are read as proofs without a seal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from rodeo.evidence.container import Limits
from rodeo.evidence.errors import CorruptProof, ProofNotFound, ProofTooLarge
from rodeo.evidence.unsealed import is_bag, is_never_sealed, open_bag

ODOMETRY, JOINTS, STRING = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
BATTERY = "sensor_msgs/msg/BatteryState"
START_NS = 1_800_000_000 * 10**9


def messages(store: object, header: dict[str, int]) -> list[tuple[str, str, object]]:
    types = store.types  # type: ignore[attr-defined]

    def head(number: int) -> object:
        time = types["builtin_interfaces/msg/Time"](sec=1_800_000_000, nanosec=number)
        return types["std_msgs/msg/Header"](**header, stamp=time, frame_id="odom")

    joints = types[JOINTS]
    return [
        *(
            (
                "/panther1/joint_states",
                JOINTS,
                joints(head(n), ["waist"], np.array([0.1 * n]), np.zeros(1), np.zeros(1)),
            )
            for n in range(5)
        ),
        ("/rodeo/event", STRING, types[STRING](data='{"event": "released"}')),
    ]


def ros1_bag(path: Path) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        connections: dict[str, object] = {}
        for number, (topic, kind, message) in enumerate(messages(store, {"seq": 3})):
            connection = connections.get(topic) or writer.add_connection(topic, kind, typestore=store)
            connections[topic] = connection
            writer.write(connection, START_NS + number, store.serialize_ros1(message, kind))  # type: ignore[arg-type]
    return path


def ros2_bag(path: Path, storage: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer2(path, version=9, storage_plugin=storage) as writer:
        connections: dict[str, object] = {}
        for number, (topic, kind, message) in enumerate(messages(store, {})):
            connection = connections.get(topic) or writer.add_connection(topic, kind, typestore=store)
            connections[topic] = connection
            writer.write(connection, START_NS + number, store.serialize_cdr(message, kind))  # type: ignore[arg-type]
    return path


@pytest.fixture(params=["ros1", "sqlite3", "mcap", "a single db3", "a single mcap"])
def bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "ros1":
        return ros1_bag(tmp_path / "run.bag")
    storage = "mcap" if "mcap" in request.param else "sqlite3"
    folder = ros2_bag(tmp_path / "run", StoragePlugin[storage.upper()])
    return (
        next(folder.glob("*.db3" if storage == "sqlite3" else "*.mcap"))
        if "single" in request.param
        else folder
    )


def test_a_bag_is_read_like_a_recording(bag: Path) -> None:
    assert is_bag(bag) or is_never_sealed(bag)
    proof = open_bag(bag)
    assert (proof.binding, proof.signer, proof.sealed) == (None, None, False)
    table = proof.table("/panther1/joint_states", JOINTS)
    assert table.named("position", ["waist"])[:, 0] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert list(table.log_ns) == [START_NS + number for number in range(5)]
    assert proof.events() == [{"event": "released"}]


def test_the_limits_of_proofs_hold_for_bags(bag: Path) -> None:
    for limits in (Limits(file_bytes=100), Limits(messages=3), Limits(channels=1)):
        with pytest.raises(ProofTooLarge):
            open_bag(bag, limits)


def test_a_spoilt_proof_is_no_bag(recorded: Callable[..., Path], tmp_path: Path) -> None:
    proof = recorded(50)
    assert not is_bag(proof) and not is_never_sealed(proof)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(proof.read_bytes()[:5000])
    assert not is_never_sealed(cut)


def test_what_is_no_bag_is_told(tmp_path: Path) -> None:
    with pytest.raises(ProofNotFound):
        open_bag(tmp_path / "no.bag")
    (tmp_path / "junk.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(1000))
    with pytest.raises(CorruptProof):
        open_bag(tmp_path / "junk.bag")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "metadata.yaml").write_text("nonsense: [")
    with pytest.raises(CorruptProof):
        open_bag(tmp_path / "folder")
