"""Rooms are walls of the lab: the world has them, the planner goes through the doors."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import mujoco
import pytest

from rodeo.errors import ConfigError
from rodeo.lab.config import LabConfig, Pose2
from rodeo.lab.rooms import DoorConfig, RoomConfig, walls
from rodeo.lab.world import build_world
from rodeo.robot.navigation import Floor
from rodeo.site.config import Site
from services.robot_sim.planner import Map, PlanningFailed, plan
from tests.support.site import LAB

LAB_SIZE = LabConfig(size_m=(7.0, 5.0))
WEST = RoomConfig(name="west", corner_m=(0.0, 0.0), size_m=(3.0, 5.0))
EAST = RoomConfig(name="east", corner_m=(3.0, 0.0), size_m=(4.0, 5.0))


def spans(rooms: list[RoomConfig], lab: LabConfig = LAB_SIZE) -> list[tuple[float, float, float, float]]:
    """(middle x, middle y, length x, length y) of each wall."""
    return [(w.pose.x_m, w.pose.y_m, w.size_m[0], w.size_m[1]) for w in walls(rooms, lab)]


def test_two_rooms_share_one_wall_and_the_lab_has_its_own() -> None:
    assert spans([WEST, EAST]) == [(3.0, 2.5, 0.1, 5.0)]


def test_a_door_is_a_gap_whichever_room_names_it() -> None:
    east_door = DoorConfig(wall="east", at_m=1.0, width_m=1.0)
    west_door = DoorConfig(wall="west", at_m=1.0, width_m=1.0)
    gap = [(3.0, 0.25, 0.1, 0.5), (3.0, 3.25, 0.1, 3.5)]
    assert spans([WEST.model_copy(update={"doors": (east_door,)}), EAST]) == gap
    assert spans([WEST, EAST.model_copy(update={"doors": (west_door,)})]) == gap


@pytest.mark.parametrize(
    ("room", "text"),
    [
        ({"name": "a"}, "a room has corner_m and size_m, or a map"),
        ({"name": "a", "corner_m": (0, 0)}, "a room has corner_m and size_m, or a map"),
        (
            {
                "name": "a",
                "corner_m": (0, 0),
                "size_m": (2, 2),
                "doors": [{"wall": "east", "at_m": 0.2}],
            },
            "the door at 0.2 m does not fit into the east wall",
        ),
        ({"name": "a", "map": "a.yaml", "doors": [{"wall": "east", "at_m": 1}]}, "leave doors out"),
    ],
)
def test_what_is_no_room_is_refused(room: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        RoomConfig.model_validate(room)


def with_rooms(tmp_path: Path, *tables: str) -> Site:
    site = tmp_path / "site.toml"
    lines = [f'extends = "{LAB}"', "items = []", "[lab]", "furniture = []", *tables]
    site.write_text("\n".join(lines))
    return Site.load(site)


ROOMS = """
[[rooms]]
name = "west"
corner_m = [0.0, 0.0]
size_m = [3.4, 5.0]
doors = [{ wall = "east", at_m = 1.2 }]
"""


def test_the_world_has_the_wall_and_the_way_goes_through_the_door(tmp_path: Path) -> None:
    site = with_rooms(tmp_path, ROOMS)
    assert mujoco.mj_name2id(build_world(site), mujoco.mjtObj.mjOBJ_BODY, "west_wall1") >= 0
    assert not Floor(site).is_open(3.4, 4.0)
    start, goal = Pose2(x_m=1.4, y_m=4.0), Pose2(x_m=5.5, y_m=3.0)
    way = plan(Map.of(site), start, goal).way
    (crossing,) = [
        (a[1] + (b[1] - a[1]) * (3.4 - a[0]) / (b[0] - a[0])) for a, b in pairwise(way) if a[0] < 3.4 <= b[0]
    ]
    assert 0.5 < crossing < 1.9
    closed = with_rooms(tmp_path, ROOMS.replace('doors = [{ wall = "east", at_m = 1.2 }]', ""))
    with pytest.raises(PlanningFailed):
        plan(Map.of(closed), start, goal)


def test_nothing_else_has_a_walls_name_and_a_site_that_is_read_again_is_the_same(tmp_path: Path) -> None:
    site = with_rooms(tmp_path, ROOMS)
    assert Site.model_validate_json(site.model_dump_json(by_alias=True)).lab == site.lab
    crate = (
        '[{ name = "west_wall1", kind = "crate", pose = { x_m = 1.0, y_m = 1.0 }, size_m = [0.3, 0.3, 0.3] }]'
    )
    path = tmp_path / "site.toml"
    path.write_text(path.read_text().replace("furniture = []", f"furniture = {crate}"))
    with pytest.raises(ConfigError, match="west_wall1"):
        Site.load(path)


def test_a_room_outside_the_lab_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refused:
        with_rooms(tmp_path, ROOMS.replace("3.4, 5.0", "3.4, 5.5"))
    assert "west reaches out of the lab" in refused.value.details["fields"]["rooms.0"]


# -- maps ----------------------------------------------------------------------------------------------

GREYS = [
    [254, 254, 254, 254],
    [0, 0, 205, 254],
    [0, 0, 254, 0],
]
"""Seen from the top; 205 is unknown, as map_saver writes it."""
YAML = """image: lab.pgm
resolution: 0.5
origin: [1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.25
"""


def write_map(folder: Path, binary: bool, yaml: str = YAML) -> Path:
    header = b"P5\n# CREATOR: map_saver\n4 3\n255\n" if binary else b"P2 4 3 255\n"
    values = [value for row in GREYS for value in row]
    body = bytes(values) if binary else " ".join(map(str, values)).encode()
    (folder / "lab.pgm").write_bytes(header + body)
    (folder / "lab.yaml").write_text(yaml)
    return folder / "lab.yaml"


@pytest.mark.parametrize("binary", [True, False])
def test_black_cells_of_a_map_are_walls(tmp_path: Path, binary: bool) -> None:
    room = RoomConfig(name="hall", map=write_map(tmp_path, binary))
    assert sorted(spans([room])) == [(1.5, 2.5, 1.0, 1.0), (2.75, 2.25, 0.5, 0.5)]


def test_a_map_may_be_negated_or_turned(tmp_path: Path) -> None:
    room = RoomConfig(name="hall", map=write_map(tmp_path, True, YAML.replace("negate: 0", "negate: 1")))
    assert (1.5, 2.5, 1.0, 1.0) not in spans([room])
    quarter = YAML.replace("[1.0, 2.0, 0.0]", f"[3.0, 2.0, {math.pi / 2}]")
    turned = walls([RoomConfig(name="hall", map=write_map(tmp_path, True, quarter))], LAB_SIZE)
    poses = {(round(one.pose.x_m, 6), round(one.pose.y_m, 6), one.pose.yaw_rad) for one in turned}
    assert poses == {(2.5, 2.5, math.pi / 2), (2.75, 3.75, math.pi / 2)}


def test_a_map_stands_beside_the_site_file(tmp_path: Path) -> None:
    write_map(tmp_path, True)
    site = with_rooms(tmp_path, '[[rooms]]\nname = "hall"\nmap = "lab.yaml"')
    assert [one.name for one in site.lab.furniture] == ["hall_wall1", "hall_wall2"]


@pytest.mark.parametrize(
    ("yaml", "data", "text"),
    [
        ("image: lab.pgm\nresolution: 0\norigin: [0, 0, 0]\n", None, "resolution"),
        ("image: none.pgm\nresolution: 1\norigin: [0, 0, 0]\n", None, "none.pgm"),
        (YAML, b"P6 1 1 255 \x00\x00\x00", "no PGM"),
        (YAML, b"P5 4 3 255\n\x00", "of 12 pixels"),
        (YAML, b"P5 4", "ends in its header"),
        (": [", None, "cannot read the map"),
    ],
)
def test_a_map_that_cannot_be_read_is_named(tmp_path: Path, yaml: str, data: bytes | None, text: str) -> None:
    path = write_map(tmp_path, True, yaml)
    if data is not None:
        (tmp_path / "lab.pgm").write_bytes(data)
    with pytest.raises(ConfigError) as refused:
        walls([RoomConfig(name="hall", map=path)], LAB_SIZE)
    assert text in str(refused.value) and refused.value.details["path"] == str(path)
