"""What is saved survives being killed in the middle of saving."""

from pathlib import Path

import numpy as np
import pytest

from services.robot_sim.state import AnotherWorld, StateFile, WorldLost, note_time, saved_time_ns

SIZE = 5


def open_file(path: Path, world: bytes = b"lab", size: int = SIZE) -> StateFile:
    return StateFile(path, world, size)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "world.state"


def test_a_new_file_holds_nothing(path: Path) -> None:
    assert open_file(path).load() is None
    assert saved_time_ns(path) is None


def test_the_last_save_is_what_is_loaded(path: Path) -> None:
    with open_file(path) as state:
        for k in range(7):
            state.save(1000 + k, np.full(SIZE, float(k)))
    with open_file(path) as state:
        loaded = state.load()
    assert loaded is not None
    assert loaded[0] == 1006
    assert loaded[1].tolist() == [6.0] * SIZE
    assert saved_time_ns(path) == 1006


def test_a_world_that_was_moved_away_leaves_its_time(path: Path) -> None:
    with open_file(path) as state:
        state.save(1000, np.zeros(SIZE))
    note_time(path, 900)
    assert saved_time_ns(path) == 1000
    note_time(path, 1000)
    path.rename(path.with_suffix(".old"))
    assert saved_time_ns(path) == 1000
    assert saved_time_ns(path, noted_too=False) is None


def test_a_note_of_the_time_that_is_none_says_nothing(path: Path) -> None:
    path.with_suffix(".time").write_text("")
    assert saved_time_ns(path) is None


def test_saving_goes_on_after_loading(path: Path) -> None:
    with open_file(path) as state:
        state.save(1, np.zeros(SIZE))
        state.save(2, np.ones(SIZE))
    with open_file(path) as state:
        state.load()
        state.save(3, np.full(SIZE, 3.0))
    with open_file(path) as state:
        loaded = state.load()
    assert loaded is not None and loaded[0] == 3


@pytest.mark.parametrize("torn_byte", [0, 45, 55, 80, 99])
def test_a_torn_slot_is_left_for_the_one_before(path: Path, torn_byte: int) -> None:
    with open_file(path) as state:
        state.save(1, np.zeros(SIZE))  # slot 1
        state.save(2, np.ones(SIZE))  # slot 0
    stored = bytearray(path.read_bytes())
    stored[torn_byte] ^= 0xFF
    path.write_bytes(stored)
    with open_file(path) as state:
        loaded = state.load()
    assert loaded is not None and loaded[0] == 1


@pytest.mark.parametrize(("world", "size"), [(b"another lab", SIZE), (b"another lab", SIZE + 1)])
def test_the_state_of_another_world_is_refused(path: Path, world: bytes, size: int) -> None:
    with open_file(path) as state:
        state.save(1, np.zeros(SIZE))
    with pytest.raises(AnotherWorld) as caught:
        open_file(path, world, size).load()
    assert caught.value.details == {"path": str(path)}


@pytest.mark.parametrize("left", [10, 70, 150])
def test_a_world_whose_file_was_cut_is_damaged_and_not_another_lab(path: Path, left: int) -> None:
    with open_file(path) as state:
        state.save(1, np.zeros(SIZE))
        state.save(2, np.zeros(SIZE))
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(WorldLost, match="the saved world is damaged") as damaged:
        open_file(path)
    assert damaged.value.details["path"] == str(path)
    assert path.stat().st_size == left
    assert saved_time_ns(path) in (None, 1, 2)


def test_a_world_that_is_lost_is_not_replaced_by_a_new_one(path: Path) -> None:
    with open_file(path) as state:
        state.save(1, np.zeros(SIZE))
    stored = bytearray(path.read_bytes())
    stored[150] ^= 0xFF
    path.write_bytes(stored)
    with pytest.raises(WorldLost):
        open_file(path).load()
