"""CDR without numpy is the CDR that rosbags reads and writes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rodeo.interfaces.package import register
from rodeo.ros2 import definitions, plain, types
from rodeo.ros2.errors import MalformedMessage, UnknownType
from rodeo.ros2.generate import generated
from rodeo.site.topics import TOPICS

BATTERY, SET_BOOL, WRENCH = (
    "sensor_msgs/msg/BatteryState",
    "std_srvs/srv/SetBool_Request",
    "geometry_msgs/msg/WrenchStamped",
)


def test_the_definitions_are_those_of_rosbags_and_of_the_interfaces_that_it_lacks() -> None:
    written = Path(definitions.__file__).with_name("definitions.json").read_text()
    assert written == generated(), "run python -m rodeo.ros2.generate"


def _battery(module: Any, sequence: Any) -> Any:
    message = module.new(BATTERY, voltage=24.5, current=-3.25, present=True, location="Dock für Öl")
    message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec = "dock1", -2, 5
    message.cell_voltage = sequence([1.5, 2.5, float("nan")])
    return message


def test_it_writes_the_same_bytes() -> None:
    expected = types.serialize(_battery(types, lambda numbers: np.array(numbers, np.float32)))
    assert plain.serialize(_battery(plain, list)) == expected


@pytest.mark.parametrize("typename", sorted({one.type for one in TOPICS if "/msg/" in one.type}))
def test_an_empty_message_of_each_type_is_the_same_and_reads_back(typename: str) -> None:
    register()
    cdr = types.serialize(types.new(typename))
    assert plain.serialize(plain.new(typename)) == cdr
    assert plain.deserialize(cdr, typename) == plain.new(typename)


def test_it_reads_what_rosbags_writes_in_either_byte_order() -> None:
    message = _battery(types, lambda numbers: np.array(numbers, np.float32))
    for little in (True, False):
        cdr = bytes(types.STORE.serialize_cdr(message, BATTERY, little_endian=little))
        found = plain.deserialize(cdr, BATTERY)
        assert (found.voltage, found.current, found.present) == (24.5, -3.25, True)
        assert (found.header.frame_id, found.header.stamp.sec, found.location) == ("dock1", -2, "Dock für Öl")
        assert found.cell_voltage[:2] == [1.5, 2.5]
        assert plain.stamp_ns(types.serialize(message)) == -2_000_000_000 + 5


def test_what_is_cut_off_or_too_long_is_malformed() -> None:
    cdr = plain.serialize(_battery(plain, list))
    for wrong in (*(cdr[:end] for end in range(len(cdr))), cdr + bytes(4), b"\x00\x07" + cdr[2:]):
        with pytest.raises(MalformedMessage):
            plain.deserialize(wrong, BATTERY)
    assert plain.deserialize(cdr + bytes(3), BATTERY).voltage == 24.5


def test_a_length_that_no_message_has_costs_nothing() -> None:
    with pytest.raises(MalformedMessage):
        plain.deserialize(b"\x00\x01\x00\x00" + bytes(8) + b"\xff\xff\xff\xff", WRENCH)


def test_values_and_fields_of_another_type_are_refused() -> None:
    with pytest.raises(UnknownType):
        plain.new(SET_BOOL, colour="red")
    with pytest.raises(UnknownType):
        plain.deserialize(b"\x00\x01\x00\x00\x01", "no_msgs/msg/Such")
    with pytest.raises(MalformedMessage):
        plain.serialize(plain.new(WRENCH, header="none"))
