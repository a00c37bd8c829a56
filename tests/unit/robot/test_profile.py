"""Motions from rest to rest are the fastest that keep the limits."""

import math

import numpy as np
import pytest

from rodeo.robot.arm import RestToRest
from rodeo.robot.errors import Unreachable


def problems(count: int) -> list[list[float]]:
    """Lengths and limits over some orders of magnitude, so that each limit is the one that counts in some."""
    logs = np.random.default_rng(1).uniform((-4, -2, -2, -1), (1.5, 1, 1.5, 3), (count, 4))
    return (10.0**logs).tolist()


@pytest.mark.long
def test_the_limits_are_kept_and_the_speed_is_the_change_of_place() -> None:
    for length, speed, acceleration, jerk in problems(200):
        profile = RestToRest(length, speed, acceleration, jerk)
        times_s = np.linspace(0, profile.duration_s, 2001)
        places, speeds = profile.at(times_s)
        step_s = times_s[1]
        assert (places[0], speeds[0], places[-1], speeds[-1]) == (0, 0, length, 0)
        assert (speeds >= -1e-9 * speed).all() and speeds.max() <= speed * (1 + 1e-9)
        assert np.abs(np.diff(speeds)).max() <= acceleration * step_s * (1 + 1e-6)
        assert np.abs(np.diff(speeds, 2)).max() <= jerk * step_s**2 * (1 + 1e-6)
        travelled = np.cumsum((speeds[1:] + speeds[:-1]) / 2) * step_s
        assert travelled == pytest.approx(places[1:], abs=2 * speeds.max() * step_s)
    assert profile.at(np.array([profile.duration_s + 1]))[0] == length


@pytest.mark.parametrize(
    "limits, duration_s",
    [
        # Each phase of the acceleration lasts 1 s; then the speed stays for 1 s.
        ((12.0, 4.0, 2.0, 2.0), 6.0),
        ((6.0, 10.0, 2.0, 2.0), math.sqrt(13) + 1.0),
        ((2.0, 10.0, 10.0, 1.0), 4.0),
    ],
    ids=["speed", "acceleration", "jerk"],
)
def test_a_motion_lasts_as_long_as_the_limit_that_counts_demands(
    limits: tuple[float, float, float, float], duration_s: float
) -> None:
    assert RestToRest(*limits).duration_s == pytest.approx(duration_s, abs=1e-12)


def test_the_motions_are_those_of_ruckig() -> None:
    ruckig = pytest.importorskip("ruckig", reason="ruckig has no wheel for this machine")
    for length, speed, acceleration, jerk in problems(1000):
        problem, theirs = ruckig.InputParameter(1), ruckig.Trajectory(1)
        problem.current_position, problem.target_position = [0.0], [length]
        problem.max_velocity, problem.max_acceleration, problem.max_jerk = [speed], [acceleration], [jerk]
        assert ruckig.Ruckig(1).calculate(problem, theirs) == ruckig.Result.Working
        profile = RestToRest(length, speed, acceleration, jerk)
        assert profile.duration_s == pytest.approx(theirs.duration, rel=1e-9)
        times_s = np.linspace(0, profile.duration_s, 20)
        places, speeds = profile.at(times_s)
        expected = np.array([theirs.at_time(time_s)[:2] for time_s in times_s]).reshape(-1, 2)
        assert places == pytest.approx(expected[:, 0], abs=1e-9 * length)
        assert speeds == pytest.approx(expected[:, 1], abs=1e-9 * speed)


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("which", range(4))
def test_limits_that_allow_no_motion_are_refused(which: int, wrong: float) -> None:
    limits = [1.0, 1.0, 1.0, 1.0]
    limits[which] = wrong
    with pytest.raises(Unreachable, match="no motion within the limits"):
        RestToRest(*limits)
