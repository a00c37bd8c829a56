"""A task for an item that lies in the bin by now is refused, and the refusal says so."""

from typing import Any

import pytest

from rodeo.bus.messages import Task
from rodeo_kinds.waste_disposal.params import doubt


def task(number: int, state: str, verdict: str | None = None, item_id: Any = "item1") -> Task:
    # Only what tells of the item; a Task has thirty fields more.
    return Task.model_construct(id=number, state=state, verdict=verdict, params={"item_id": item_id})  # type: ignore[arg-type]


PAID = task(3, "settled", "accepted")


@pytest.mark.parametrize(
    ("tasks", "says"),
    [
        ([], ""),
        ([PAID], "task 3 was paid for carrying item1"),
        (
            [task(4, "assigned"), task(3, "settled", "accepted")],
            "task 4, which is assigned, already moves item1",
        ),
        (
            [task(4, "failed", "rejected"), task(3, "settled", "accepted")],
            "task 3 was paid for",
        ),
        ([task(4, "cancelled")], ""),
        ([task(3, "settled", "accepted", item_id="item10")], ""),
        ([task(3, "settled", "accepted", item_id=["item1"])], ""),
    ],
)
def test_the_newest_task_about_the_item_that_says_anything_decides(tasks: list[Task], says: str) -> None:
    found = doubt({"item_id": "item1"}, tasks)
    assert found.startswith(says) if says else found == ""


@pytest.mark.parametrize(
    ("state", "x_m", "says"),
    [
        ("open", 2.1, "task 4, which is open, is about what lies 0.10 m from there"),
        ("open", 2.3, ""),
        ("settled", 2.1, ""),
        ("open", None, ""),
    ],
)
def test_a_task_about_the_same_place_is_doubtful(state: str, x_m: float | None, says: str) -> None:
    other = task(4, state)
    other.params.update(x_m=x_m, y_m=1.0)
    assert doubt({"x_m": 2.0, "y_m": 1.0}, [other]) == says
