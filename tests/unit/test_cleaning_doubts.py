"""Who posts a task for an item that lies in the bin by now is told so."""

from typing import Any

import pytest

from rodeo.cleaning import doubt_about


def task(number: int, state: str, verdict: str | None = None, item_id: Any = "item1") -> dict[str, Any]:
    return {"id": number, "state": state, "verdict": verdict, "params": {"item_id": item_id}}


PAID = task(3, "settled", "accepted")


@pytest.mark.parametrize(
    ("tasks", "doubt"),
    [
        ([], ""),
        ([PAID], "item1 should lie in the bin: task 3 was paid for"),
        (
            [task(4, "assigned"), task(3, "settled", "accepted")],
            "task 4 is about item1 already, and is assigned",
        ),
        (
            [task(4, "failed", "rejected"), task(3, "settled", "accepted")],
            "item1 should lie in the bin: task 3",
        ),
        ([task(4, "cancelled")], ""),
        ([task(3, "settled", "accepted", item_id="item10")], ""),
        ([{"id": 1, "state": "settled", "verdict": "accepted", "params": ["item1"]}], ""),
    ],
)
def test_the_newest_task_about_the_item_that_says_anything_decides(
    tasks: list[dict[str, Any]], doubt: str
) -> None:
    assert doubt_about("item1", tasks).startswith(doubt) if doubt else doubt_about("item1", tasks) == ""
