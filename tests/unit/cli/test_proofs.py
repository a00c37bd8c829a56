"""A proof in other people's tools: what is derived from it says so, and the proof itself stays as it is."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner, Result

from rodeo.checks.motion.poses import Pose, base_of, motion_of, pose_of
from rodeo.checks.verify import case_of, verify_file
from rodeo.evidence.errors import ProofTooLarge
from rodeo.evidence.proof import open_proof
from rodeo.site.config import Site
from rodeo_cli import app
from rodeo_cli.proof_export import COLUMNS, DERIVED, bounded, rows_of
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, moved, seal, write_bag
from rodeo_testing.waiting import HANG_S
from tests.docs.text import ROOT
from tests.support.site import LAB

GUIDE = "docs/how-to/proofs.md"


@pytest.fixture(scope="module")
def proof(cleaning: Take, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return seal(cleaning, tmp_path_factory.mktemp("proofs") / "proof.mcap", BINDING, ROBOT).path


def command(name: str, file: Path, into: Path, *more: str) -> Result:
    words = ["proof", name, str(file), "--into", str(into), "--site", str(LAB), "--offline", *more]
    return CliRunner().invoke(app, words)


@pytest.fixture(scope="module")
def derived(proof: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder `derived` of the guide, with what was exported."""
    folder = tmp_path_factory.mktemp("exported") / "derived"
    done = command("export", proof, folder)
    assert done.exit_code == 0, done.output
    return folder


def drawn(file: Path, into: Path) -> str:
    """All words of the picture."""
    done = command("plot", file, into)
    assert done.exit_code == 0, done.output
    return " ".join(ET.parse(into / f"{file.stem}.derived.svg").getroot().itertext())


def test_the_sealed_file_stays_as_it_is(proof: Path, tmp_path: Path) -> None:
    before = sha256(proof.read_bytes()).hexdigest()
    for name in ("export", "plot"):
        assert command(name, proof, tmp_path).exit_code == 0
    assert sha256(proof.read_bytes()).hexdigest() == before
    assert {path.name for path in tmp_path.iterdir()} == {
        f"proof.derived.{end}" for end in ("mcap", "csv", "svg")
    }
    assert [path.name for path in proof.parent.iterdir()] == ["proof.mcap"]


def test_rosbags_reads_in_tf_where_motion_capture_signed_robot_and_item(proof: Path, derived: Path) -> None:
    case = case_of(open_proof(proof), Site.load(LAB), None)
    last = {}
    with AnyReader([derived / "proof.derived.mcap"]) as bag:
        for connection, _, data in bag.messages():
            if connection.topic == "/tf":
                (one,) = bag.deserialize(data, connection.msgtype).transforms
                assert one.header.frame_id == "map"
                last[one.child_frame_id] = one.transform.translation
    for body, pose in (("panther1", base_of(case)), ("item1", pose_of(case, "item1"))):
        at = last[body]
        assert (at.x, at.y, at.z) == pytest.approx(tuple(pose.position_m[-1]), abs=1e-9)


def test_a_body_at_rest_is_told_each_second_and_one_that_is_unseen_is_not() -> None:
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    pose = Pose(np.array([0.0, 3.0, 3.1, 9.0]), np.eye(4)[:, :3], upright, unseen_s=((3.1, 9.0),))
    told = list(rows_of(pose, held=True))
    assert [at_ns / 1e9 for at_ns, *_ in told] == pytest.approx([0.0, 1.0, 2.0, 3.0, 3.1, 9.0])
    assert [position for _, position, _ in told[:4]] == [[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("time_s", "x_m"), [(1e9, 1.0), (60.0, 1e6), (60.0, -2000.0)], ids=["long", "far", "far behind"]
)
def test_a_recording_that_would_fill_the_memory_is_refused(time_s: float, x_m: float) -> None:
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    pose = Pose(np.array([0.0, time_s]), np.array([[1.0, 1.0, 0.0], [x_m, 1.0, 0.0]]), upright)
    with pytest.raises(ProofTooLarge, match="than allowed"):
        bounded(pose)


def test_a_hostile_recording_makes_neither_a_large_file_nor_a_large_picture(
    cleaning: Take, tmp_path: Path
) -> None:
    take = cleaning.edited("mocap/item1/pose", lambda sample: moved(sample, x=600.0))
    file = seal(take, tmp_path / "far.mcap", BINDING, ROBOT).path
    assert "proof_too_large" in command("export", file, tmp_path / "into").output
    assert "No grip is shown" in drawn(file, tmp_path)
    assert (tmp_path / "far.derived.svg").stat().st_size < 300_000


def test_the_derived_file_names_its_proof_and_is_accepted_as_none(proof: Path, derived: Path) -> None:
    path = derived / "proof.derived.mcap"
    with path.open("rb") as file:
        (record,) = make_reader(file).iter_metadata()
    assert (record.name, record.metadata["derived"]) == (DERIVED, "true")
    assert record.metadata["from_sha256"] == "0x" + sha256(proof.read_bytes()).hexdigest()
    assert record.metadata["poses"] == "motion capture"
    assert not verify_file(path, Site.load(LAB)).accepted
    assert "unsealed_proof" in command("export", path, derived.parent / "again").output


def test_each_row_of_the_table_is_a_pose_of_a_statement(proof: Path, derived: Path) -> None:
    case = case_of(open_proof(proof), Site.load(LAB), None)
    with (derived / "proof.derived.csv").open() as file:
        head, *rows = csv.reader(file)
    assert tuple(head) == COLUMNS
    own = [row for row in rows if row[1] == "panther1"]
    assert len(own) == len(base_of(case).time_s)
    numbers = {str(one.statement.seq) for one in motion_of(case)}
    assert {row[-1] for row in own} <= numbers


def test_the_example_plots_the_path_and_prints_where_the_robot_ended(
    proof: Path, derived: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "path.png"
    program = [sys.executable, str(ROOT / "examples/read_proof.py")]
    told = subprocess.run(
        [*program, str(derived / "proof.derived.mcap"), str(picture)],
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=True,
    )
    x_m, y_m, _ = base_of(case_of(open_proof(proof), Site.load(LAB), None)).position_m[-1]
    assert f"panther1 ended at {x_m:.2f} {y_m:.2f}" in told.stdout.splitlines()
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_each_topic_of_the_foxglove_layout_is_in_the_proof_or_in_what_is_derived(
    proof: Path, derived: Path
) -> None:
    known, frames = set(), set()
    for path in (proof, derived / "proof.derived.mcap"):
        with path.open("rb") as file:
            reader = make_reader(file)
            known |= {channel.topic for channel in reader.get_summary().channels.values()}
    with (derived / "proof.derived.csv").open() as file:
        frames = {row[1] for row in csv.reader(file)}
    layout = json.loads((ROOT / "docs/how-to/foxglove.json").read_text())
    panels = layout["configById"]
    named = {path["value"] for panel in panels.values() for path in panel.get("paths", [])}
    named |= {topic for panel in panels.values() for topic in panel.get("topics", {})}
    named |= {panel["topicPath"] for panel in panels.values() if "topicPath" in panel}
    assert len(named) >= 6
    assert {re.split(r"[.\[]", one)[0] for one in named} <= known
    assert {one for path in named for one in re.findall(r'child_frame_id=="([^"]+)"', path)} <= frames
    assert set(re.findall(r"[A-Za-z0-9]+![a-z]+", json.dumps(layout["layout"]))) == set(panels)


def test_the_picture_shows_path_grip_bin_and_verdict(proof: Path, tmp_path: Path) -> None:
    text = drawn(proof, tmp_path)
    for words in (
        "accepted",
        "Waste disposal, task 7",
        "item1 lay here",
        "shown: metal, into yellow",
        "gap between the fingers, mm",
        "grasps",
        "robot with the item",
    ):
        assert words in text
    assert "Reason" not in text


def test_the_picture_of_refused_work_says_why(cleaning: Take, tmp_path: Path) -> None:
    take = cleaning.edited("mocap/item1/pose", lambda sample: moved(sample, z=0.05))
    text = drawn(seal(take, tmp_path / "forged.mcap", BINDING, ROBOT).path, tmp_path)
    assert "rejected" in text and "Reason" in text
    assert "No grip is shown: the item never leaves the floor" in text


def test_the_picture_of_a_charge_shows_what_the_meter_signed_and_that_nobody_saw_a_path(
    charge: Take, tmp_path: Path
) -> None:
    text = drawn(seal(charge, tmp_path / "charge.mcap", BINDING, ROBOT).path, tmp_path)
    assert "Battery charging" in text and "dock1" in text
    assert re.search(r"panther1: \d+\.\d Wh, up to \d+ % of charge", text)
    assert "No path is shown" in text and "fingers" not in text


@pytest.mark.parametrize("name", ["export", "plot"])
@pytest.mark.parametrize("what", ["truncated", "foreign", "receipt", "text", "empty"])
def test_what_is_no_proof_is_refused_in_words(
    name: str, what: str, proof: Path, cleaning: Take, tmp_path: Path
) -> None:
    file, into = tmp_path / "given.mcap", tmp_path / "into"
    expected = {
        "truncated": "truncated_proof",
        "foreign": "unsealed_proof: this MCAP file is another tool's recording",
        "receipt": "corrupt_proof: this is a JSON document, such as a receipt",
        "text": "corrupt_proof: this is no MCAP file",
        "empty": "truncated_proof",
    }
    match what:
        case "truncated":
            file.write_bytes(proof.read_bytes()[:-1000])
        case "foreign":
            file = write_bag(cleaning, tmp_path / "bag", StoragePlugin.MCAP) / "bag.mcap"
        case "receipt":
            file.write_text(json.dumps({"task_id": 7, "proof_sha256": "0x" + "ab" * 32}, indent=2))
        case "text":
            file.write_text("what the robot did")
        case "empty":
            file.write_bytes(b"")
    done = command(name, file, into)
    assert done.exit_code == 1
    assert expected[what] in done.output
    assert not into.exists()
