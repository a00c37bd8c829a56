"""Files with the vices of `files.toml`, and what becomes of them."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cache, reduce
from io import StringIO
from operator import or_
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from rodeo.checks.verify import verify_file
from rodeo.errors import RodeoError
from rodeo.evidence.unsealed import open_bag
from rodeo.person.statement import check_photo
from rodeo.ros2 import types
from rodeo.runtime.logs import TextFormatter
from rodeo.site.config import Site
from rodeo.vision.images import decode_image
from rodeo_cli.classify import classified
from rodeo_cli.common import console_on
from tests.outside.rows import Row

SITE = Path(__file__).parents[2] / "deploy" / "sites" / "lab.toml"
JOINTS = "sensor_msgs/msg/JointState"
TOPIC = "/panther1/joint_states"
START_NS = 1_800_000_000 * 10**9
MESSAGES = 40
_TEXT = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


class Unreadable(Exception):
    """The file was refused, or something else came out."""


def outcome(row: Row, folder: Path) -> str:
    """Empty where it works, else what is said."""
    folder.mkdir()
    try:
        DEEDS[row.how](row.given, folder)
    except (Unreadable, RodeoError) as error:
        return f"{getattr(error, 'code', 'refused')}: {error}"
    return ""


# -- bags ----------------------------------------------------------------------------------------------


def _joints(number: int) -> bytes:
    header = types.new("std_msgs/msg/Header", stamp=types.time_message(START_NS + number))
    position = np.array([0.1 * number])
    return types.serialize(types.new(JOINTS, header=header, name=["waist"], position=position))


def _mcap(path: Path, given: dict[str, Any], numbers: list[int]) -> None:
    index = reduce(or_, (IndexType[name] for name in given.get("index", ["ALL"])))
    repeat = given.get("repeat", True)
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=1000,
            compression=CompressionType[given.get("compression", "ZSTD")],
            index_types=index,
            repeat_channels=repeat,
            repeat_schemas=repeat,
            use_chunking=given.get("chunking", True),
            use_statistics=given.get("statistics", True),
        )
        writer.start(profile=given.get("profile", "ros2"), library="rosbag2")
        schema = 0
        if "no_schema" not in given:
            named = given.get("type", JOINTS)
            encoding = given.get("schema_encoding", "ros2msg")
            schema = writer.register_schema(named, encoding, given.get("text", _TEXT).encode())
        metadata = {} if "no_metadata" in given else {"offered_qos_profiles": given.get("qos", "")}
        channel = writer.register_channel(TOPIC, "cdr", schema, metadata)
        others = []
        for one in given.get("beside", []):
            other = 0
            if "schema" in one:
                other = writer.register_schema(one["schema"], one["schema_encoding"], one["text"].encode())
            others.append(writer.register_channel(one["topic"], one["encoding"], other))
        for place, number in enumerate(numbers):
            time_ns = START_NS + number
            writer.add_message(channel, time_ns, _joints(number), time_ns, place)
            for other in others:
                writer.add_message(other, time_ns, b"{}", time_ns, place)
            if given.get("attachments") and place % 10 == 0:
                writer.add_attachment(time_ns, time_ns, "map.yaml", "text/yaml", b"resolution: 0.05")
                writer.add_metadata("run", {"operator": "fred"})
        writer.finish()


def _bag(given: dict[str, Any], folder: Path) -> Path:
    numbers = list(range(MESSAGES))
    if given.get("shuffled"):
        numbers = numbers[::2] + numbers[1::2]
    bag = folder / "bag"
    if not given.get("folder"):
        path = folder / "bag.mcap"
        _mcap(path, given, numbers)
        data = path.read_bytes()
        if cut := given.get("cut"):
            data = data[:-cut]
        if given.get("spoilt"):
            middle = data.index(b"waist") if b"waist" in data else len(data) // 3
            data = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
        path.write_bytes(data)
        if given.get("junk"):
            path = folder / "bag.db3"
            path.write_bytes(b"not a database" * 99)
        return path
    bag.mkdir()
    parts = [numbers[: MESSAGES // 2], numbers[MESSAGES // 2 :]] if given.get("split") else [numbers]
    for number, part in enumerate(parts):
        _mcap(bag / f"bag_{number}.mcap", given, part)
    if text := given.get("metadata"):
        (bag / "metadata.yaml").write_text(text)
    return bag


@cache
def _site() -> Site:
    return Site.load(SITE)


def _said(path: Path) -> str:
    """Why `rodeo verify` cannot read it; empty where it can."""
    report = verify_file(path, _site())
    first = report.checks[0]
    if not first.passed and first.name == "readable_and_sealed":
        return first.detail
    return ""


def _read_bag(given: dict[str, Any], folder: Path) -> None:
    path = _bag(given, folder)
    if said := _said(path):
        raise Unreadable(said)
    table = open_bag(path).table(TOPIC, JOINTS)
    found = table.named("position", ["waist"])[:, 0]
    if not np.allclose(found, 0.1 * np.arange(MESSAGES)):
        raise Unreadable(f"other positions: {found}")


def _bag_words(given: dict[str, Any], folder: Path) -> None:
    report = verify_file(_bag(given, folder), _site())
    _require_plain(report.model_dump_json() + "".join(one.detail for one in report.checks))


# -- pictures ------------------------------------------------------------------------------------------


def _picture(given: dict[str, Any]) -> bytes:
    if raw := given.get("raw"):
        return bytes.fromhex(raw) + bytes(100)
    width, height = given["size"]
    if given.get("even"):
        image = np.full((height, width, 3), 90, np.uint8)
    else:
        image = np.random.default_rng(1).integers(0, 255, (height, width, 3), np.uint8)
    if given.get("gray"):
        image = image[:, :, 0]
    if given.get("deep"):
        image = np.dstack([image, image[:, :, :1]]).astype(np.uint16) * 257
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1] if given.get("progressive") else []
    data = bytes(cv2.imencode(given.get("kind", ".jpg"), image, options)[1])
    if given.get("thumbnail"):
        small = bytes(cv2.imencode(".jpg", cv2.resize(image, (80, 60)))[1])
        data = data[:2] + b"\xff\xe1" + struct.pack(">H", len(small) + 8) + b"Exif\0\0" + small + data[2:]
    # A video's bytes hold pairs that begin a scan in a JPEG.
    video = b"\0\0\0\x18ftypmp42" + np.random.default_rng(2).bytes(2 << 20) + b"\xff\xda" * 500
    behind = {
        "video": video,
        "long video": video * 6,
        "picture": data,
        "zeros": bytes(5000),
    }
    data += behind.get(given.get("behind", ""), b"")
    return data[: -given["cut"]] if "cut" in given else data


def _look(given: dict[str, Any], _folder: Path) -> None:
    """What the bin takes, a person's photo is, and the other way round."""
    data, said = _picture(given), list[str]()
    shapes = set()
    for look in (decode_image, check_photo):
        try:
            shapes.add(look(data).shape)
        except RodeoError as error:
            said.append(str(error))
    if said and len(said) < 2:
        raise Unreadable(f"refused by one of two: {said[0]}")
    if said:
        raise Unreadable(said[0])
    if shapes != {(*given["size"][::-1], 3)}:
        raise Unreadable(f"another picture: {shapes}")


def _photo(given: dict[str, Any]) -> None:
    check_photo(_picture(given))


def _classify(given: dict[str, Any], folder: Path) -> None:
    path = folder / "photo.jpg"
    path.write_bytes(_picture(given))

    def classify(data: bytes) -> SimpleNamespace:
        decode_image(data)
        return SimpleNamespace(label="paper", told={})

    classified(SimpleNamespace(classify=classify), path)


# -- words ---------------------------------------------------------------------------------------------


def _require_plain(text: str) -> None:
    if not text.isprintable():
        raise Unreadable(f"not printable: {text!r}")


def _log(given: dict[str, Any], _folder: Path) -> None:
    record = logging.LogRecord("x", logging.INFO, "x", 1, "said: %s", (given["words"],), None)
    _require_plain(TextFormatter("bridge").format(record))


def _error(given: dict[str, Any], _folder: Path) -> None:
    _require_plain(str(RodeoError("refused", name=given["words"])))


def _terminal(given: dict[str, Any], _folder: Path) -> None:
    written = StringIO()
    with redirect_stdout(written):
        console_on(written).print(f"{given['words']}: cardboard", markup=False)
    _require_plain(written.getvalue().strip("\n"))


DEEDS: dict[str, Callable[[dict[str, Any], Path], None]] = {
    "bag": _read_bag,
    "bag words": _bag_words,
    "picture": _look,
    "photo": lambda given, _folder: _photo(given),
    "classify": _classify,
    "log": _log,
    "error": _error,
    "terminal": _terminal,
}
