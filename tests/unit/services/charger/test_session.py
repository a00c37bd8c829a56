"""A charging session under simulated time: robot, battery and contactor played by the test."""

from __future__ import annotations

from dataclasses import replace

import pytest

from services.charger.session import End, Phase, Session, SessionLimits, SessionState

LIMITS = SessionLimits(voltage_v=42.0, cutoff_a=1.0, max_energy_wh=880.0, soc_target=0.95, deadline_s=14000.0)


class Dock:
    """Dock, robot and battery on a bench; 1 Hz readings."""

    def __init__(self, state: SessionState | None = None, limits: SessionLimits = LIMITS) -> None:
        self.session = Session(state or SessionState(wait_until_s=1800.0), limits)
        self.covered = True
        """Whether the robot signed for all but a step."""
        self.time_s = 0.0
        self.present = False
        self.closed = False
        self.answers = True
        """Whether the contactor's service answers."""
        self.delivers = True
        self.soc = 0.5
        self.energy_wh = 0.0
        self.commands: list[bool] = []
        self.current_a = 0.0

    @property
    def phase(self) -> Phase:
        return self.session.state.phase

    @property
    def end(self) -> End | None:
        return self.session.state.end

    def run(self, seconds: int) -> None:
        for _ in range(seconds):
            self.time_s += 1.0
            flows = self.closed and self.present and self.delivers
            open_circuit_v = 32 + 10 * self.soc
            self.current_a = max(0.0, min(10.0, (42.0 - open_circuit_v) / 0.15)) if flows else 0.0
            voltage_v = open_circuit_v + self.current_a * 0.15 if flows else 42.0 * self.closed
            self.soc = min(1.0, self.soc + self.current_a / 3600 / 20)
            self.energy_wh += voltage_v * self.current_a / 3600
            self.session.signed(self.soc)
            self.session.reading(
                self.time_s, voltage_v, self.current_a, self.present, self.energy_wh, self.covered
            )
            if self.session.commands_contactor and self.answers:
                self.closed = self.session.contactor_wanted
                self.commands.append(self.closed)
                self.session.contactor(self.closed, self.time_s)


def charging() -> Dock:
    dock = Dock()
    dock.run(30)
    dock.present = True
    dock.run(60)
    assert dock.phase is Phase.CHARGING
    return dock


def test_the_contactor_closes_only_once_a_robot_stands_on_the_contacts() -> None:
    dock = Dock()
    dock.run(100)
    assert (dock.phase, dock.commands) == (Phase.WAITING, [])
    dock.present = True
    dock.run(10)
    assert (dock.phase, dock.commands) == (Phase.CHARGING, [True])


@pytest.mark.parametrize("present", [True, False], ids=["a robot without current", "nobody"])
def test_nothing_comes_of_time_before_the_session_names_it(present: bool) -> None:
    dock = Dock()
    dock.present, dock.delivers = present, False
    changes = 0
    while dock.phase is not Phase.ENDED and dock.time_s < 2000:
        due_s, before = dock.session.due_s, (dock.phase, len(dock.commands))
        dock.run(1)
        if (dock.phase, len(dock.commands)) != before:
            changes += 1
            # That somebody came is a reading, and not the time.
            assert due_s <= dock.time_s or dock.time_s <= LIMITS.present_s + 1
    assert dock.end is (End.NO_CURRENT if present else End.NO_ROBOT)
    assert changes > (10 if present else 0)


def test_a_touch_of_the_contacts_does_not_close_the_contactor() -> None:
    dock = Dock()
    for _ in range(20):
        dock.present = not dock.present
        dock.run(1)
    assert dock.commands == []


def test_a_session_ends_with_an_open_contactor_when_the_target_is_reached() -> None:
    dock = charging()
    dock.run(6000)
    assert (dock.phase, dock.end) == (Phase.ENDED, End.TARGET_REACHED)
    assert not dock.closed
    assert 0.95 <= dock.soc < 0.952
    assert dock.session.state.started_s is not None
    assert dock.session.state.ended_s is not None


def test_a_target_of_one_hundred_percent_ends_although_the_battery_only_comes_close() -> None:
    dock = Dock(limits=SessionLimits(42.0, 0.1, 880.0, soc_target=1.0, deadline_s=40000.0))
    dock.present = True
    dock.run(20000)
    assert dock.end is End.TARGET_REACHED
    assert dock.soc >= 0.995


def test_a_tapered_current_at_the_voltage_limit_means_full() -> None:
    dock = charging()
    dock.soc, dock.session.signed = 0.99, lambda soc: None  # type: ignore[method-assign]
    dock.run(2000)
    assert dock.end is End.FULL


def test_more_energy_than_the_battery_takes_ends_the_session() -> None:
    dock = charging()
    dock.energy_wh = 880.0
    dock.run(2)
    assert dock.end is End.ENERGY_LIMIT


def test_a_robot_that_leaves_and_stays_away_ends_the_session() -> None:
    dock = charging()
    dock.present = False
    dock.run(10)
    assert (dock.phase, dock.closed) == (Phase.WAITING, False)
    dock.run(200)
    assert (dock.phase, dock.end) == (Phase.ENDED, End.ROBOT_LEFT)


def test_a_robot_that_slips_off_and_comes_back_is_charged_on() -> None:
    dock = charging()
    dock.present = False
    dock.run(30)
    dock.present = True
    dock.run(6000)
    assert dock.end is End.TARGET_REACHED
    assert dock.commands == [True, False, True, False]


def test_no_robot_in_time_is_said_so_and_nothing_was_switched_on() -> None:
    dock = Dock()
    dock.run(1900)
    assert (dock.phase, dock.end) == (Phase.ENDED, End.NO_ROBOT)
    assert True not in dock.commands
    assert dock.session.state.started_s is None


@pytest.mark.parametrize(("comes", "end"), [(False, End.NO_ROBOT), (True, End.NOT_SIGNED)])
def test_a_robot_that_does_not_come_or_sign_ends_the_session_while_the_task_can_be_given_back(
    comes: bool, end: End
) -> None:
    dock = Dock(limits=replace(LIMITS, give_back_s=1200.0))
    dock.covered = False
    dock.run(100)
    dock.present = comes
    dock.run(1000)
    assert dock.phase is (Phase.AWAITING_RECEIPT if comes else Phase.WAITING)
    assert dock.session.due_s <= 1200
    dock.run(100)
    assert (dock.phase, dock.end, dock.session.state.sold) == (Phase.ENDED, end, False)
    assert True not in dock.commands


def test_a_robot_that_stopped_signing_is_waited_for_only_if_it_bought_something() -> None:
    for sold in (False, True):
        dock = Dock(limits=replace(LIMITS, give_back_s=1200.0))
        dock.present = True
        dock.run(60)
        dock.session.state.sold, dock.covered = sold, False
        dock.run(1500)
        assert dock.end is (None if sold else End.NOT_SIGNED)


def test_a_closed_contactor_without_current_is_closed_again_then_given_up() -> None:
    dock = Dock()
    dock.present, dock.delivers = True, False
    dock.run(200)
    assert dock.end is End.NO_CURRENT
    assert dock.commands.count(True) > 5


def test_a_dock_that_restarted_is_told_to_close_again() -> None:
    dock = charging()
    dock.closed = False
    dock.run(30)
    assert dock.closed
    assert dock.phase is Phase.CHARGING
    assert dock.end is None


def test_the_deadline_opens_the_contactor_in_any_phase() -> None:
    dock = charging()
    dock.time_s = 14000.0
    dock.run(1)
    assert (dock.phase, dock.end, dock.closed) == (Phase.ENDED, End.DEADLINE, False)


def test_a_session_is_not_over_before_the_contactor_is_known_to_be_open() -> None:
    dock = charging()
    dock.answers = False
    dock.session.stop(End.CANCELLED)
    dock.run(100)
    assert dock.phase is Phase.OPENING
    dock.answers = True
    dock.run(1)
    assert dock.phase is Phase.ENDED


def test_the_first_reason_to_stop_stays() -> None:
    dock = charging()
    dock.session.stop(End.CANCELLED)
    dock.session.stop(End.DEADLINE)
    dock.run(1)
    assert dock.end is End.CANCELLED


def test_the_contactor_stays_open_until_the_robot_signed() -> None:
    dock = Dock()
    dock.present, dock.covered = True, False
    dock.run(500)
    assert (dock.phase, dock.commands) == (Phase.AWAITING_RECEIPT, [])
    dock.covered = True
    dock.run(5)
    assert (dock.phase, dock.commands) == (Phase.CHARGING, [True])


def test_a_receipt_that_is_missing_is_a_pause_and_not_the_end() -> None:
    dock = charging()
    dock.covered = False
    dock.run(3000)
    assert (dock.phase, dock.end, dock.closed) == (Phase.AWAITING_RECEIPT, None, False)
    dock.covered = True
    dock.run(6000)
    assert dock.end is End.TARGET_REACHED
    assert dock.commands == [True, False, True, False]


def test_a_robot_that_never_signs_again_ends_the_session_at_its_window() -> None:
    dock = charging()
    dock.covered = False
    dock.run(14000)
    assert (dock.phase, dock.end, dock.closed) == (Phase.ENDED, End.DEADLINE, False)


def test_a_robot_that_leaves_while_the_dock_waits_for_its_receipt_may_come_back() -> None:
    dock = charging()
    dock.covered = False
    dock.run(60)
    dock.present = False
    dock.run(10)
    assert dock.phase is Phase.WAITING
    dock.run(200)
    assert dock.end is End.ROBOT_LEFT


@pytest.mark.parametrize(
    "phase",
    [Phase.WAITING, Phase.AWAITING_RECEIPT, Phase.CLOSING, Phase.CHARGING, Phase.OPENING, Phase.ENDED],
)
def test_a_restarted_charger_goes_on_in_every_phase(phase: Phase) -> None:
    over = phase in (Phase.OPENING, Phase.ENDED)
    state = SessionState(phase=phase, wait_until_s=1800.0, end=End.TARGET_REACHED if over else None)
    dock = Dock(SessionState.model_validate_json(state.model_dump_json()))
    dock.present = True
    dock.closed = phase is Phase.CHARGING
    dock.run(6000)
    assert (dock.phase, dock.end, dock.closed) == (Phase.ENDED, End.TARGET_REACHED, False)
