"""Memory: what is held and what lies where survives the process."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.robot.errors import JournalBroken
from rodeo.robot.memory import Held, Memory
from rodeo.site.config import Site
from tests.support.site import LAB

SITE = Site.load(LAB)
HELD = Held(item_id="item1", place_m=(1.0, 2.0), hang_m=0.06, centre_m=-0.01)


def test_at_first_items_lie_where_the_site_file_says(tmp_path: Path) -> None:
    memory = Memory(SITE, tmp_path / "memory.json")
    assert memory.place("item1") == (SITE.items[0].pose.x_m, SITE.items[0].pose.y_m)
    assert len(memory.lying()) == len(SITE.items)
    assert len(memory.lying(but="item1")) == len(SITE.items) - 1


def test_what_was_taken_is_held_after_a_restart_and_lies_nowhere(tmp_path: Path) -> None:
    Memory(SITE, tmp_path / "memory.json").took(HELD)
    again = Memory(SITE, tmp_path / "memory.json")
    assert again.held == HELD
    assert again.place("item1") is None


@pytest.mark.parametrize("place_m", [(3.0, 1.0), None])
def test_what_was_let_go_lies_there_or_is_gone(tmp_path: Path, place_m: tuple[float, float] | None) -> None:
    memory = Memory(SITE, tmp_path / "memory.json")
    memory.took(HELD)
    memory.let_go(place_m)
    again = Memory(SITE, tmp_path / "memory.json")
    assert again.held is None
    assert again.place("item1") == place_m


def test_a_damaged_memory_is_not_taken_for_an_empty_one(tmp_path: Path) -> None:
    (tmp_path / "memory.json").write_text('{"held": 3}')
    with pytest.raises(JournalBroken):
        Memory(SITE, tmp_path / "memory.json")
