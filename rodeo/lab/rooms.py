"""Rooms of a lab: walls with doors between them, or an occupancy grid of ROS's map_server.

Either becomes furniture of the kind `wall`, which world, planner, checks and console know already.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rodeo.errors import ConfigError
from rodeo.lab.config import FurnitureConfig, LabConfig, Pose2, Positive, Section
from rodeo.lab.geometry import ahead

MOST_WALLS = 500
"""Most walls of one map: more boxes make the simulation slow. A coarser map, or one of straight walls, has
fewer."""

Side = Literal["west", "east", "south", "north"]
_Line = tuple[Literal["x", "y"], float]
"""Along which axis a wall runs, and where on the other one, m."""
_Interval = tuple[float, float]


class DoorConfig(Section):
    """A gap in a wall of a room."""

    wall: Side
    at_m: Annotated[float, Field(ge=0)]
    """Its middle, from the wall's western or southern end."""
    width_m: Positive = 1.4


class RoomConfig(Section):
    """A rectangle from `corner_m`, its south-western corner, with walls around it; or what `map` shows."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    corner_m: tuple[float, float] | None = None
    size_m: tuple[Positive, Positive] | None = None
    doors: tuple[DoorConfig, ...] = ()
    """Two rooms that share a wall share its doors: name each once."""
    map: Path | None = None
    """A map_server YAML file, which names a PGM image. Its path starts at the site file that says it."""

    @model_validator(mode="after")
    def _is_one_of_both(self) -> RoomConfig:
        if (self.map is None) == (self.corner_m is None) or (self.corner_m is None) != (self.size_m is None):
            raise ValueError("a room has corner_m and size_m, or a map")
        if self.map is not None and self.doors:
            raise ValueError("a map shows its doors itself: leave doors out")
        for door in self.doors:
            if door.at_m + door.width_m / 2 > self._length_m(door.wall) or door.at_m < door.width_m / 2:
                raise ValueError(f"the door at {door.at_m:g} m does not fit into the {door.wall} wall")
        return self

    def _length_m(self, side: Side) -> float:
        assert self.size_m is not None
        return self.size_m[1 if side in ("west", "east") else 0]


def walls(rooms: Iterable[RoomConfig], lab: LabConfig) -> tuple[FurnitureConfig, ...]:
    """The walls of all rooms. Where a room ends with the lab stands the lab's own.

    Raises ConfigError for a map that cannot be read.
    """
    rooms = list(rooms)
    built: list[tuple[str, Pose2, tuple[float, float]]] = [*_straight(rooms, lab)]
    for room in rooms:
        if room.map is not None:
            built += ((room.name, pose, size) for pose, size in _boxes(room.map, lab))
    return tuple(
        FurnitureConfig(
            name=f"{name}_wall{number}", kind="wall", pose=pose, size_m=(*size_m, lab.wall_height_m)
        )
        for number, (name, pose, size_m) in enumerate(built, 1)
    )


# -- rectangles ----------------------------------------------------------------------------------------


def _straight(rooms: list[RoomConfig], lab: LabConfig) -> Iterator[tuple[str, Pose2, tuple[float, float]]]:
    solid: dict[_Line, list[_Interval]] = defaultdict(list)
    doors: dict[_Line, list[_Interval]] = defaultdict(list)
    owner: dict[_Line, str] = {}
    for room in rooms:
        for side, line, (begin_m, end_m) in _sides(room):
            owner.setdefault(line, room.name)
            solid[line].append((begin_m, end_m))
            doors[line] += (
                (begin_m + one.at_m - one.width_m / 2, begin_m + one.at_m + one.width_m / 2)
                for one in room.doors
                if one.wall == side
            )
    half_m = lab.wall_thickness_m / 2
    for line, intervals in sorted(solid.items()):
        along, at_m = line
        # The lab's own walls are there already.
        if at_m <= half_m or at_m >= lab.size_m[1 if along == "x" else 0] - half_m:
            continue
        for begin_m, end_m in _without(_merged(intervals), _merged(doors[line])):
            middle_m, length_m = (begin_m + end_m) / 2, end_m - begin_m
            pose = Pose2(x_m=middle_m, y_m=at_m) if along == "x" else Pose2(x_m=at_m, y_m=middle_m)
            size_m = (length_m, lab.wall_thickness_m)
            yield owner[line], pose, size_m if along == "x" else (size_m[1], size_m[0])


def _sides(room: RoomConfig) -> Iterator[tuple[Side, _Line, _Interval]]:
    if room.corner_m is None or room.size_m is None:
        return
    (west, south), (length, width) = room.corner_m, room.size_m
    # Rounded, so that the wall between two rooms has the same coordinates in both.
    west, south, east, north = (round(one, 6) for one in (west, south, west + length, south + width))
    yield "west", ("y", west), (south, north)
    yield "east", ("y", east), (south, north)
    yield "south", ("x", south), (west, east)
    yield "north", ("x", north), (west, east)


def _merged(intervals: list[_Interval]) -> list[_Interval]:
    merged: list[_Interval] = []
    for begin, end in sorted(intervals):
        if merged and begin <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(merged[-1][1], end)
        else:
            merged.append((begin, end))
    return merged


def _without(intervals: list[_Interval], gaps: list[_Interval]) -> Iterator[_Interval]:
    for begin, end in intervals:
        for gap_begin, gap_end in gaps:
            if begin < gap_begin < end:
                yield begin, gap_begin
            if gap_begin < end:
                begin = max(begin, gap_end)
        if begin < end:
            yield begin, end


# -- maps ----------------------------------------------------------------------------------------------


class _Map(BaseModel):
    """A map_server file (https://docs.nav2.org, package nav2_map_server, mode trinary)."""

    model_config = ConfigDict(extra="ignore")

    image: Path
    resolution: Positive
    """m per pixel."""
    origin: tuple[float, float, float]
    """Position of the image's lower left corner: m, m, rad."""
    occupied_thresh: float = 0.65
    negate: bool = False
    mode: Literal["trinary"] = "trinary"


def _boxes(path: Path, lab: LabConfig) -> Iterator[tuple[Pose2, tuple[float, float]]]:
    """The occupied cells as rectangles; those outside of the lab are left out."""
    import yaml  # imported here: few sites have a map

    try:
        found = _Map.model_validate(yaml.safe_load(path.read_text()))
        image = path.parent / found.image
        rows, most = _pgm(image.read_bytes())
    except (OSError, UnicodeDecodeError, ValueError, ValidationError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read the map: {error}", path=str(path)) from error
    occupied = [
        [_occupancy(value / most, found.negate) > found.occupied_thresh for value in row]
        for row in reversed(rows)
    ]
    x0_m, y0_m, turn_rad = found.origin
    origin = Pose2(x_m=x0_m, y_m=y0_m, yaw_rad=turn_rad)
    count = 0
    for left, bottom, right, top in _rectangles(occupied):
        middle = (left + right) / 2 * found.resolution, (bottom + top) / 2 * found.resolution
        x_m, y_m = ahead(origin, *middle)
        pose = Pose2(x_m=x_m, y_m=y_m, yaw_rad=turn_rad)
        if not (0 <= pose.x_m <= lab.size_m[0] and 0 <= pose.y_m <= lab.size_m[1]):
            continue
        count += 1
        if count > MOST_WALLS:
            raise ConfigError("the map has too many walls: make it coarser", path=str(path), most=MOST_WALLS)
        yield pose, ((right - left) * found.resolution, (top - bottom) * found.resolution)


def _occupancy(brightness: float, negate: bool) -> float:
    """Black is a wall, unless the map is negated."""
    return brightness if negate else 1 - brightness


def _rectangles(cells: list[list[bool]]) -> Iterator[tuple[int, int, int, int]]:
    """Runs of occupied cells, each with those of equal extent above it: (left, bottom, right, top), exclusive
    at right and top."""
    growing: dict[tuple[int, int], int] = {}
    for number, row in enumerate([*cells, []]):
        runs = set(_runs(row))
        for left, right in sorted(growing.keys() - runs):
            yield left, growing.pop((left, right)), right, number
        for run in runs:
            growing.setdefault(run, number)


def _runs(row: list[bool]) -> Iterator[tuple[int, int]]:
    begin: int | None = None
    for at, occupied in enumerate([*row, False]):
        if occupied and begin is None:
            begin = at
        elif not occupied and begin is not None:
            yield begin, at
            begin = None


def _pgm(data: bytes) -> tuple[list[list[int]], int]:
    """Rows from the top, and what is white. Raises ValueError for what is no PGM (netpbm, P2 and P5)."""
    words: list[bytes] = []
    at = 0
    while len(words) < 4:
        if at >= len(data):
            raise ValueError("the image ends in its header")
        if data[at : at + 1] == b"#":
            at = data.find(b"\n", at) + 1 or len(data)
        elif data[at : at + 1].isspace():
            at += 1
        else:
            end = at
            while end < len(data) and not data[end : end + 1].isspace():
                end += 1
            words.append(data[at:end])
            at = end
    kind, (width, height, most) = words[0], map(int, words[1:])
    if kind not in (b"P2", b"P5") or not 0 < most < 256 or width < 1 or height < 1:
        raise ValueError(f"the image is no PGM of at most 255 greys: {kind[:8]!r}")
    values: Any = data[at + 1 :] if kind == b"P5" else [int(word) for word in data[at:].split()]
    if len(values) < width * height:
        raise ValueError(f"the image has {len(values)} of {width * height} pixels")
    return [list(values[row * width : (row + 1) * width]) for row in range(height)], most
