"""The linear simulator against a Kalman filter that is run on drawn measurements."""

import numpy as np
import pytest

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.monitors.aime import Aime
from pntegrity.simulate.linear import (
    Disturbance,
    draw,
    filter_drift_fault,
    gains,
    linear_epochs,
    linear_updates,
    receiver_drift_fault,
    shifts,
    spp_model,
    whites,
)

N = 60


@pytest.fixture(scope="module")
def model():
    return spp_model(8)


@pytest.fixture(scope="module")
def updates(model):
    return gains(model, N)


def kalman(model, epochs, estimate=None):
    """A textbook filter, written here on its own: innovations and estimates."""
    x, P, nus, xs = np.zeros(8), model.P0, [], []
    for k, epoch in enumerate(epochs):
        if k:
            x, P = model.F @ x, model.F @ P @ model.F.T + model.Q
        S = model.H @ P @ model.H.T + model.R
        K = np.linalg.solve(S, model.H @ P).T
        nu = epoch.observations[0].y - model.H @ x
        x, P = x + K @ nu, P - K @ S @ K.T
        if estimate is not None:
            x = x + estimate[k]
        nus.append(nu)
        xs.append(x)
    return np.array(nus), np.array(xs)


def ramp(rows, onset=20, rate=0.1, row=3):
    f = np.zeros((N, rows))
    f[:, row] = rate * np.maximum(np.arange(N) - onset, 0)
    return f


def test_gains_are_those_of_a_textbook_filter(model, updates):
    epochs, _ = linear_epochs(model, N, np.random.default_rng(0))
    nus, xs = kalman(model, epochs)
    white = np.stack([np.linalg.solve(u.L, nu) for u, nu in zip(updates, nus, strict=True)])
    run = draw(updates, white)
    np.testing.assert_allclose([u.posterior.mean for u in run], xs, atol=1e-6)
    np.testing.assert_allclose([u.nu for u in run], nus, atol=1e-9)


DRIFT = 0.01 * np.maximum(np.arange(N) - 20, 0)


@pytest.mark.parametrize(
    "make",
    [
        lambda m: Disturbance(rows=ramp(16)),
        lambda m: receiver_drift_fault(m, DRIFT),
        lambda m: filter_drift_fault(m, DRIFT),
    ],
    ids=["rows", "receiver", "filter"],
)
def test_means_move_exactly_as_a_filter_run_with_and_without_the_fault(model, updates, make):
    disturbance = make(model)
    clean, x = linear_epochs(model, N, np.random.default_rng(1))
    faulty, x_faulty = linear_epochs(model, N, np.random.default_rng(1), disturbance)
    nu0, xs0 = kalman(model, clean)
    nu1, xs1 = kalman(model, faulty, disturbance.estimate)
    g, e = shifts(updates, disturbance)
    np.testing.assert_allclose(nu1 - nu0, g, atol=1e-8)
    np.testing.assert_allclose((xs1 - x_faulty) - (xs0 - x), e, atol=1e-8)


def test_a_receiver_clock_keeps_its_phase_when_the_drift_is_back(model):
    drift = np.where((np.arange(N) >= 20) & (np.arange(N) < 30), 1.0, 0.0)
    quiet = spp_model(8, accel_mps2=0.0, clock_drift_mps=0.0, clock_m=0.0)
    _, x = linear_epochs(quiet, N, np.random.default_rng(2))
    _, y = linear_epochs(quiet, N, np.random.default_rng(2), receiver_drift_fault(model, drift))
    np.testing.assert_allclose((y - x)[-1, 6:], [10.0, 0.0], atol=1e-9)


def test_drawn_innovations_are_white_and_of_unit_variance(updates):
    white = whites(updates[:20], np.random.default_rng(3), 20_000)
    flat = white.reshape(-1, white.shape[2])
    cov = flat @ flat.T / white.shape[2]
    assert np.abs(cov - np.eye(len(cov))).max() < 6.0 / np.sqrt(white.shape[2])


def test_innovations_of_a_real_run_are_white_too(model, updates):
    lags = np.zeros(3)
    for seed in range(40):
        epochs, _ = linear_epochs(model, N, np.random.default_rng(seed))
        nus, _ = kalman(model, epochs)
        white = np.stack([np.linalg.solve(u.L, nu) for u, nu in zip(updates, nus, strict=True)])[1:]
        lags += [np.mean(white[lag:] * white[: len(white) - lag]) for lag in range(3)]
    lags /= 40
    assert lags[0] == pytest.approx(1.0, abs=0.05)
    assert np.abs(lags[1:]).max() < 4.0 / np.sqrt(40 * 58 * 16)


def test_an_exact_monitor_keeps_its_rate_on_drawn_updates(model):
    count, tests, monitor = 0, 0, Aime(p_fa=0.02, window=3)
    for seed in range(12):
        memory = monitor.start()
        for u in linear_updates(model, N, np.random.default_rng(100 + seed)):
            verdict, memory = monitor.step(memory, u)
            count += verdict.status == "alert"
            tests += verdict.status != "unavailable"
    low, high = binomial_interval(count, tests, 0.999)
    assert low < 0.02 < high


def test_matrices_may_change_from_epoch_to_epoch(model):
    H = np.repeat(model.H[None], 5, axis=0)
    H[3] *= 2.0
    changing = type(model)(model.F, model.Q, H, model.R, model.P0, model.keys, model.layout)
    plain = gains(model, 5)
    varied = gains(changing, 5)
    np.testing.assert_array_equal(varied[2].S, plain[2].S)
    assert not np.allclose(varied[3].S, plain[3].S)


def test_shapes_are_checked(model):
    with pytest.raises(ValueError, match="`R` must end in shape"):
        type(model)(model.F, model.Q, model.H, model.R[:3, :3], model.P0, model.keys, model.layout)


def test_the_first_update_is_a_start_and_thresholds_are_finite(updates):
    assert not updates[0].F.any()
    assert np.isfinite(chi2_threshold(1e-6, len(updates[0].keys)))
