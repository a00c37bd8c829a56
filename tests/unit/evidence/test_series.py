"""A topic's layout is found once, by bytes, whatever strangers published under its name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from rodeo.evidence import series
from rodeo.evidence.errors import LayoutChanged
from rodeo.evidence.layout import Walk
from rodeo.evidence.proof import TopicMessages
from rodeo.ros2.types import new, serialize

JOINTS = "sensor_msgs/msg/JointState"


def joints(*names: str, position: float = 0.0) -> bytes:
    return serialize(new(JOINTS, name=list(names), position=np.full(len(names), float(position))))


def topic(messages: Sequence[bytes], ros_type: str = JOINTS) -> TopicMessages:
    column = TopicMessages("/joint_states", ros_type)
    for number, message in enumerate(messages):
        column.data.append(message)
        column.log_ns.append(number)
    return column


@pytest.fixture
def walks(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The messages that are walked over."""
    walked: list[bytes] = []

    class Counted(Walk):
        def __init__(self, data: bytes) -> None:
            walked.append(data)
            super().__init__(data)

    monkeypatch.setattr(series, "Walk", Counted)
    return walked


def test_one_message_of_ten_thousand_is_walked_over(walks: list[bytes]) -> None:
    column = topic([joints("a", "b", position=number) for number in range(10_000)])
    assert np.array_equal(column.table().named("position", ["b"])[:, 0], np.arange(10_000.0))
    assert len(walks) == 1


@pytest.mark.long
def test_joints_in_four_layouts_are_walked_over_four_times_however_often_they_are_asked_for(
    walks: list[bytes],
) -> None:
    column = topic([joints(str(number % 4), *[""] * 200) for number in range(10_000)])
    for _ in range(3):
        with pytest.raises(LayoutChanged, match="differ in length, or in their strings"):
            column.table()
    assert len(walks) == 4


def test_each_message_in_a_layout_of_its_own_costs_no_more_than_a_sample(walks: list[bytes]) -> None:
    column = topic([joints(f"{number:06d}") for number in range(10_000)])
    with pytest.raises(LayoutChanged):
        column.table()
    assert len(walks) == 31


def test_publishers_among_strangers_cost_at_most_two_samples(walks: list[bytes]) -> None:
    """Half of the messages are of two publishers, and the others each in a layout of its own."""
    own = [joints("a", "long"), joints("b", "long")]
    column = topic(
        [own[number // 2 % 2] if number % 2 else joints(f"{number:06d}") for number in range(10_000)]
    )
    with pytest.raises(LayoutChanged):
        column.tables()
    assert len(walks) <= 2 * 31


def test_joints_of_a_slow_publisher_are_found_beside_those_of_a_fast_one_and_strangers(
    walks: list[bytes],
) -> None:
    """One in thirty messages is of the fingers, and one in fifteen of somebody else."""
    messages = [
        joints("finger")
        if number % 30 == 7
        else joints(f"{number:06d}")
        if number % 15 == 4
        else joints("arm")
        for number in range(9_000)
    ]
    assert [one.names() for one in topic(messages).tables()] == [["arm"], ["finger"]]
    assert len(walks) <= 2 * 31


def test_what_cannot_be_read_is_sampled_too(walks: list[bytes]) -> None:
    column = topic([joints("a") + bytes(4) for _ in range(10_000)])
    with pytest.raises(LayoutChanged, match="longer than its type"):
        column.table()
    assert len(walks) == 31


@pytest.mark.parametrize("every", [10, 11, 12, 100])
def test_strangers_that_come_periodically_are_left_out(every: int) -> None:
    """Also if they are the first."""
    own, other = joints("a", "b", position=1.0), joints("a", "c", position=2.0)
    column = topic([own if number % every else other for number in range(10 * every * 10)])
    table = column.table()
    assert np.array_equal(table.kept, np.flatnonzero(np.arange(100 * every) % every))
    assert (table["position"] == 1.0).all()


def test_a_few_layouts_at_the_beginning_do_not_hide_the_topics_own() -> None:
    strange = [joints("x", str(number)) for number in range(9)]
    table = topic([*strange, *[joints("a", "b")] * 200]).table()
    assert len(table) == 200
    assert table.strings["name[1]"] == "b"


def test_of_two_joints_with_one_name_the_first_counts() -> None:
    message = serialize(new(JOINTS, name=["a", "a"], position=np.array([1.0, 2.0])))
    assert topic([message]).table().named("position", ["a"]).tolist() == [[1.0]]


def test_an_empty_sequence_has_a_column_without_numbers() -> None:
    table = topic([joints("a")] * 3).table()
    assert table["effort"].shape == (3, 0)
    with pytest.raises(LayoutChanged, match="joints are missing"):
        table.named("effort", ["a"])


def test_messages_without_a_byte_are_no_table() -> None:
    with pytest.raises(LayoutChanged, match="encapsulation"):
        topic([b""] * 3).table()


def test_rows_that_are_left_out_are_left_out_of_each_column() -> None:
    table = topic([joints("a", position=number) for number in range(6)]).table()
    odd = table.only(np.arange(6) % 2 == 1).only(np.array([False, True, True]))
    assert odd["position"].tolist() == [[3.0], [5.0]]
    assert odd.kept.tolist() == [3, 5]
    assert odd.log_ns.tolist() == [3, 5]
