"""Tests of rows that are left out: w-tests in a row, and a trial whose re-admission is known."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.kernels.recovery import ChangeTrial, Passes, Trial, w_test
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


BEARING = np.array([16])


@pytest.fixture(scope="module")
def changed():
    study = Study("consistent", 1)
    assert study.model.keys[16] == "usbl:A.bearing"
    found = tuple(window_gains(study, study.updates[79].posterior.P, 80, 60))
    size = np.array([0.5 * study.vessel.unit("deg")])
    return ChangeTrial(found, (BEARING,) * 60, 40, size, 1e-2, 1e-2)


def biased(trial, before, after, runs=20_000):
    early, late = trial._parts
    noise = np.random.default_rng(5).standard_normal((len(early), runs))
    return noise + (early @ before + late @ after)[:, None]


def test_a_bias_that_the_state_follows_is_not_shown_by_any_window(changed):
    def shown(window):
        return Trial(window, (BEARING,) * len(window), changed.size, 1e-2, 1e-2).shown[0]

    study = Study("consistent", 1)
    used = np.setdiff1d(np.arange(18), BEARING)
    P = study.updates[79].posterior.P
    for k in range(80, 120):
        H, R = study.model.at("H", k)[used], study.model.at("R", k)[np.ix_(used, used)]
        P = study.model.at("F", k) @ P @ study.model.at("F", k).T + study.model.at("Q", k)
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        P = (np.eye(len(P)) - K @ H) @ P
    long = tuple(window_gains(study, P, 120, 60))
    assert shown(long) < 2.6
    assert shown(long) < 1.15 * shown(long[:20])


def test_a_bias_that_stays_passes_a_change_trial_with_the_probability_stated(changed):
    for size in (0.5, 1.0, 3.0):
        bias = size * changed.size
        passed = changed.passed(biased(changed, bias, bias)).mean()
        assert passed <= 1.2 * changed.readmission[0]


def test_a_bias_that_ends_is_seen_to_end(changed):
    passed = changed.passed(biased(changed, changed.size, 0.0 * changed.size)).mean()
    assert passed == pytest.approx(changed.power[0] * 0.99, abs=0.01)
    assert passed >= 0.9


def test_a_bias_that_only_shrinks_a_little_does_not_pass(changed):
    assert changed.passed(biased(changed, 4.0 * changed.size, 3.0 * changed.size)).mean() <= 0.01


def test_a_change_trial_needs_epochs_before_and_after(changed):
    with pytest.raises(ValueError, match="`before` must be within"):
        ChangeTrial(changed.window, changed.rows, 60, changed.size, 1e-2, 1e-2)
