"""Subfilters without some sensors: what follows from their tests."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.kernels.sensor_window import SensorTests, expanded, sets_of, squares, used_rows


def seen(failing, faults):
    """Return the tests in which every subfilter that uses a failing sensor sees it."""
    sensors = 4
    sets = sets_of(sensors, faults)
    window = np.ones((10, len(sets), sensors))
    for j, own in enumerate(sets):
        for i in failing:
            if i not in own:
                window[:, j, i] = 100.0
    return SensorTests.of(sets, window, [1] * sensors, 1e-3)


def test_nobody_is_at_fault_where_all_pass():
    found = seen([], 1)
    assert found.outcome.clear
    assert not found.scores.any()


def test_one_sensor_is_at_fault_where_one_subfilter_passes():
    assert seen([2], 1).outcome.faulty == (2,)
    assert seen([2], 1).scores.tolist() == [1, 1, 0, 1]


def test_more_must_be_at_fault_where_none_passes():
    assert seen([1, 2], 1).outcome.grow
    assert seen([1, 2], 2).outcome.faulty == (1, 2)


def test_it_cannot_be_told_where_several_pass():
    outcome = seen([2], 2).outcome
    assert (outcome.clear, outcome.faulty, outcome.grow) == (False, (), False)


def test_larger_sets_begin_with_the_mean_of_their_parents():
    old, new = sets_of(3, 1), sets_of(3, 2)
    window = np.random.default_rng(1).random((5, 3, 3))
    found = expanded(window, old, new)
    np.testing.assert_allclose(found[:, new.index((0, 2))], 0.5 * (window[:, 0] + window[:, 2]))


def test_subfilters_use_the_other_sensors_and_all_other_sources():
    used = used_rows(sets_of(2, 1), np.array([0, 0, 1, -1]))
    assert used.tolist() == [[False, False, True, True], [True, True, False, True]]


def test_squares_are_chi_squares_of_each_subfilter():
    rng = np.random.default_rng(2)
    H, R = rng.standard_normal((2, 3)), np.diag([1.0, 2.0])
    P = np.stack([np.eye(3), 4.0 * np.eye(3)])
    nu = rng.standard_normal((2, 2))
    for j in range(2):
        S = R + H @ P[j] @ H.T
        assert squares(nu, H, R, P)[j] == pytest.approx(nu[j] @ np.linalg.solve(S, nu[j]))
