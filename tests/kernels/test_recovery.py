"""Tests of rows that are left out: w-tests in a row, and a trial whose re-admission is known."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.kernels.recovery import Passes, Trial, sensor_verification, w_test
from pntegrity.scenarios._vessel_repairs import window_gains
from pntegrity.scenarios._vessel_runs import Study


def test_w_statistics_are_unit_normals():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((4, 4))
    cov = A @ A.T + np.eye(4)
    w, limit = w_test(np.linalg.cholesky(cov) @ rng.standard_normal((4, 40_000)), cov, 1e-2)
    assert (w > limit).mean() == pytest.approx(1e-2, rel=0.1)


def test_five_passes_in_a_row_are_needed():
    passes = Passes()
    for passed in (True, True, False, True, True, True, True):
        passes = passes.after(passed)
    assert (passes.count, passes.recovered) == (4, False)
    assert passes.after(True).recovered


def test_the_sum_over_a_verification_period_keeps_its_rate():
    white = np.random.default_rng(2).standard_normal((30, 20_000))
    square, limit = sensor_verification(white, 1e-2)
    assert (square > limit).mean() == pytest.approx(1e-2, rel=0.15)


@pytest.fixture(scope="module")
def trial():
    study = Study("consistent", 1)
    found = window_gains(study, study.updates[100].posterior.P, 101, 12)
    rows = np.array([11, 12])
    return Trial(tuple(found), (rows,) * 12, np.array([2.0, 2.5]), 1e-2, 1e-2)


def test_a_row_that_is_off_passes_with_the_probability_stated(trial):
    rng = np.random.default_rng(3)
    for i in range(2):
        white = rng.standard_normal((len(trial.means), 40_000)) + (trial.means[:, i] * trial.size[i])[:, None]
        passed = trial.passed(white).mean()
        assert passed <= 1.2 * trial.readmission[i]
        assert trial.readmission[i] <= trial.p_readmit * (1.0 + 1e-9)
        estimate = trial.means[:, i] @ white / np.linalg.norm(trial.means[:, i])
        assert (np.abs(estimate) <= trial.limits[i]).mean() == pytest.approx(trial.readmission[i], rel=0.2)


def test_a_healthy_source_passes_a_long_trial(trial):
    easy = Trial(trial.window, trial.rows, np.array([30.0, 30.0]), 1e-4, 1e-2)
    white = np.random.default_rng(4).standard_normal((len(trial.means), 20_000))
    assert easy.passed(white).mean() >= 0.99 - 0.003
    assert easy.passed(white).mean() <= 0.999


def test_rows_and_sizes_must_fit(trial):
    with pytest.raises(ValueError, match="`rows` must be as many"):
        Trial(trial.window, trial.rows, np.array([1.0]), 1e-3, 1e-2)
