"""A load cell sees what falls, also what fell while nobody looked."""

from __future__ import annotations

from services.itrash.load import Cell, LoadCell, Step


def feed(cell: LoadCell, force_n: float, start_s: float, seconds: float = 1.5) -> list[Step]:
    """Readings at 10 Hz of a constant force; the steps that have stayed, which are accounted for."""
    steps = []
    for index in range(round(seconds * 10) + 1):
        step = cell.reading(force_n, start_s + index / 10)
        if step is not None and step.ripe:
            steps.append(step)
            cell.account()
    return steps


def test_the_first_settled_weight_is_the_zero() -> None:
    cell = LoadCell(Cell())
    assert feed(cell, 3.0, 0.0) == []
    assert cell.memory.settled_n == 3.0


def test_a_step_up_that_settles_is_reported_once_with_its_weight() -> None:
    cell = LoadCell(Cell())
    feed(cell, 0.0, 0.0)
    (step,) = feed(cell, 0.3, 2.0, seconds=5.0)
    assert abs(step.delta_n - 0.3) < 1e-9
    assert 1.0 <= step.after_s <= 2.0 < step.time_s <= 3.0


def test_a_bounce_is_not_a_drop_until_it_settles() -> None:
    cell = LoadCell(Cell())
    feed(cell, 0.0, 0.0)
    for i, force_n in enumerate((4.0, 0.0, 2.0, 0.1, 1.0, 0.2)):
        assert cell.reading(force_n, 2.0 + i / 10) is None
    (step,) = feed(cell, 0.3, 2.6)
    assert abs(step.delta_n - 0.3) < 1e-9


def test_a_touch_that_goes_away_is_no_drop() -> None:
    cell = LoadCell(Cell())
    feed(cell, 0.0, 0.0)
    assert feed(cell, 5.0, 2.0, seconds=0.2) == []
    assert feed(cell, 0.0, 2.3) == []


def test_a_weight_that_settles_and_does_not_stay_is_no_drop() -> None:
    cell = LoadCell(Cell())
    feed(cell, 0.0, 0.0)
    assert feed(cell, 5.0, 2.0, seconds=0.9) == []
    assert cell.step is not None
    assert feed(cell, 0.0, 3.0) == []
    assert cell.step is None
    assert cell.memory.settled_n == 0.0


def test_a_step_is_not_accounted_for_until_somebody_says_so() -> None:
    cell = LoadCell(Cell(settled_n=1.0))
    for index in range(30):
        cell.reading(1.5, index / 10)
    assert cell.step is not None
    assert (cell.step.delta_n, cell.step.ripe) == (0.5, True)
    assert cell.memory.settled_n == 1.0


def test_drift_below_the_threshold_is_neither_reported_nor_forgotten() -> None:
    cell = LoadCell(Cell())
    feed(cell, 0.0, 0.0)
    assert feed(cell, 0.06, 2.0) == []
    (step,) = feed(cell, 0.12, 4.0)
    assert abs(step.delta_n - 0.12) < 1e-9


def test_emptying_is_a_step_down_and_the_new_zero() -> None:
    cell = LoadCell(Cell(settled_n=8.0))
    (down,) = feed(cell, 0.0, 0.0)
    assert down.delta_n == -8.0
    (up,) = feed(cell, 0.5, 2.0)
    assert up.delta_n == 0.5


def test_a_container_that_is_lifted_out_brings_back_what_it_held() -> None:
    cell = LoadCell(Cell())
    feed(cell, 20.0, 0.0)
    (lifted,) = feed(cell, -6.0, 2.0)
    (back,) = feed(cell, 20.05, 4.0)
    assert (lifted.delta_n, back.delta_n) == (-26.0, 0.0)
    feed(cell, -6.0, 6.0)
    (emptied,) = feed(cell, 0.0, 8.0)
    assert emptied.delta_n < 0
    (fell,) = feed(cell, 0.3, 10.0)
    assert abs(fell.delta_n - 0.3) < 1e-9


def test_only_what_a_container_holds_more_than_before_came_in_while_it_was_out() -> None:
    cell = LoadCell(Cell())
    feed(cell, 2.0, 0.0)
    for index, force_n in enumerate((-6.0, -5.7)):  # something fell on the bare scale
        (out,) = feed(cell, force_n, 2.0 + 2 * index)
        assert out.delta_n < 0
    (back,) = feed(cell, 2.3, 6.0)
    assert abs(back.delta_n - 0.3) < 1e-9


def test_a_zero_that_drifted_below_nothing_is_no_container_lifted_out() -> None:
    cell = LoadCell(Cell(settled_n=-0.5))
    (step,) = feed(cell, -0.2, 0.0)
    assert abs(step.delta_n - 0.3) < 1e-9


def test_what_fell_while_the_process_was_down_is_seen_afterwards() -> None:
    memory = Cell()
    feed(LoadCell(memory), 1.0, 0.0)
    restarted = LoadCell(Cell.model_validate_json(memory.model_dump_json()))
    (step,) = feed(restarted, 1.4, 100.0)
    assert abs(step.delta_n - 0.4) < 1e-9
    assert 1.0 <= step.after_s < 2.0
    assert step.time_s > 100.0


def test_a_sensor_whose_clock_goes_back_starts_a_new_window() -> None:
    cell = LoadCell(Cell(settled_n=0.0))
    feed(cell, 0.0, 100.0)
    (step,) = feed(cell, 0.5, 0.0)
    assert step.delta_n == 0.5
