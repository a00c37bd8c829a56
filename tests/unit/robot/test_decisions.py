"""What a robot decided and why is kept, compactly and for a limited time."""

from __future__ import annotations

from pathlib import Path

from rodeo.robot.decisions import KEPT, Decided, Decisions


def decided(time_s: float, intent: str = "rest", task_id: int | None = None) -> Decided:
    return Decided(time_s=time_s, intent=intent, reason="because", soc=1 - time_s / 1e6, task_id=task_id)


def test_a_decision_is_kept_when_it_differs_from_the_last_and_survives_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "decisions.jsonl"
    decisions = Decisions(path)
    for one in (decided(1), decided(2), decided(3, "work", 7), decided(4)):
        decisions.add(one)
    assert [one.time_s for one in Decisions(path).about(None, 10)] == [1, 3, 4]
    assert [one.intent for one in Decisions(path).about(7, 10)] == ["work"]
    assert [one.time_s for one in Decisions(path).about(None, 2)] == [3, 4]


def test_old_decisions_are_pruned(tmp_path: Path) -> None:
    path = tmp_path / "decisions.jsonl"
    decisions = Decisions(path)
    for number in range(2 * KEPT + 1):
        decisions.add(decided(number, task_id=number))
    assert len(path.read_text().splitlines()) == KEPT
    assert decisions.about(None, 1)[0].time_s == 2 * KEPT


def test_half_a_line_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "decisions.jsonl"
    Decisions(path).add(decided(1))
    with path.open("a") as file:
        file.write('{"time_s": 2, "int')
    decisions = Decisions(path)
    assert [one.time_s for one in decisions.about(None, 10)] == [1]
    decisions.add(decided(3, "work"))
    decisions.add(decided(4))
    assert [one.time_s for one in Decisions(path).about(None, 10)] == [1, 3, 4]
