"""What cameras saw with noise and losses, as motion."""

import numpy as np

from rodeo.checks.motion.smoothing import smoothed

TIME_S = np.arange(0.0, 30.0, 0.02)


def way_m(time_s: np.ndarray) -> np.ndarray:
    """(n, 2) of a base that drives 0.6 m/s twice, with a second of acceleration, and stands between."""
    speed_m_s = np.clip(np.minimum(time_s - 4, 10 - time_s), 0, 1) * 0.6
    speed_m_s += np.clip(np.minimum(time_s - 15, 22 - time_s), 0, 1) * 0.6
    along_m = np.cumsum(speed_m_s) * (time_s[1] - time_s[0])
    return np.stack([along_m * 0.8, along_m * 0.6], axis=1)


def lossy(time_s: np.ndarray, chance: np.random.Generator) -> np.ndarray:
    return time_s[chance.random(len(time_s)) > 0.07]


def test_a_parabola_passes_unchanged() -> None:
    values = np.stack([1 + 0.3 * TIME_S, 2 - 0.5 * TIME_S**2], axis=1)
    at_s = TIME_S[50:-50]
    assert np.abs(smoothed(TIME_S, values, at_s) - values[50:-50])[20:-20].max() < 1e-4


def test_the_motion_under_noise_is_found_to_a_millimetre_and_shakes_nothing() -> None:
    chance = np.random.default_rng(1)
    time_s = lossy(TIME_S, chance) + chance.normal(0, 0.001, 1)
    noisy = way_m(TIME_S)[np.searchsorted(TIME_S, time_s - 0.01)]
    noisy = noisy + chance.normal(0, 0.002, noisy.shape)
    fine_s = np.arange(1.0, 29.0, 0.002)
    found = smoothed(time_s, noisy, fine_s)
    true = np.stack([np.interp(fine_s, TIME_S, column) for column in way_m(TIME_S).T], axis=1)
    error_m = found - true - np.median(found - true, axis=0)
    assert error_m.std() < 0.0015
    standing = (fine_s > 11) & (fine_s < 14)
    shakes_m_s2 = np.diff(found[standing], 2, axis=0) / 0.002**2
    assert shakes_m_s2.std() < 0.5


def test_who_starts_and_stops_at_once_is_followed_to_two_centimetres() -> None:
    """A cubic that comes up in 40 ms would be no motion of 170 kg: the fit rounds it."""
    abrupt = np.clip(TIME_S - 10, 0, 5)[:, None] * 0.6
    assert np.abs(smoothed(TIME_S, abrupt, TIME_S) - abrupt).max() < 0.02
