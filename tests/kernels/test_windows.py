"""Windowed forms: their maps, their covariance, and what a fault does to a filter."""

import numpy as np
import pytest

from pntegrity.kernels.extrapolation import innovation_maps, state_maps
from pntegrity.kernels.windows import Form, exact_form, inverse_root, respond
from pntegrity.records import Update
from pntegrity.simulate.linear import draw, gains, spp_model

UPDATES = gains(spp_model(6), 12)


def drawn(seed: int = 0) -> tuple[Update, ...]:
    white = np.random.default_rng(seed).standard_normal((len(UPDATES), len(UPDATES[0].keys)))
    return draw(UPDATES, white)


def extrapolated(window: tuple[Update, ...]) -> list[np.ndarray]:
    """Innovations against the state before the window, propagated without measurements (AIME as printed)."""
    state = np.zeros(8)
    filtered, out = np.zeros(8), []
    for i, u in enumerate(window):
        state, prior = (state, filtered) if i == 0 else (u.F @ state, u.F @ filtered)
        out.append(u.nu + u.H @ (prior - state))
        filtered = prior + u.K @ u.nu
    return out


def test_innovation_maps_are_the_weighted_innovations_against_the_propagated_state() -> None:
    window = drawn()[5:10]
    maps, believed = innovation_maps(window)
    coasting = np.zeros((8, 8))
    total, weights = np.zeros(12), np.zeros((12, 12))
    for i, (u, e) in enumerate(zip(window, extrapolated(window), strict=True)):
        if i:
            coasting = u.F @ (coasting + window[i - 1].absorbed) @ u.F.T
        weight = np.linalg.inv(u.S + u.H @ coasting @ u.H.T)
        total, weights = total + weight @ e, weights + weight
    np.testing.assert_allclose(sum(M @ u.white for M, u in zip(maps, window, strict=True)), total, rtol=1e-9)
    np.testing.assert_allclose(believed, weights, rtol=1e-9)


def test_covariance_of_a_window_is_that_of_many_runs() -> None:
    window = UPDATES[5:10]
    maps, _ = state_maps(window, [np.arange(3)] * 5)
    form = Form(maps, np.eye(3), 3)
    white = np.random.default_rng(1).standard_normal((5, 12, 100_000))
    y = form.project(list(white))
    np.testing.assert_allclose(
        np.cov(y) / np.diag(form.covariance()).max(),
        form.covariance() / np.diag(form.covariance()).max(),
        atol=0.02,
    )


def test_the_exact_form_has_unit_covariance_and_is_the_mahalanobis_distance() -> None:
    window = drawn()[5:10]
    maps, _ = innovation_maps(window)
    form = exact_form(maps)
    np.testing.assert_allclose(form.covariance(), np.eye(12), atol=1e-9)
    y = sum(M @ u.white for M, u in zip(maps, window, strict=True))
    cov = sum(M @ M.T for M in maps)
    white = [u.white for u in window]
    assert float(form.statistic(white)) == pytest.approx(float(y @ np.linalg.solve(cov, y)), rel=1e-9)
    np.testing.assert_allclose(form.stacked() @ np.concatenate(white), form.project(white), rtol=1e-12)


def test_inverse_root_drops_what_has_no_variance() -> None:
    A = np.random.default_rng(2).standard_normal((5, 3))
    root = inverse_root(A @ A.T)
    assert root.shape == (3, 5)
    np.testing.assert_allclose(root @ A @ A.T @ root.T, np.eye(3), atol=1e-9)


def test_inverse_root_does_not_care_about_units() -> None:
    A = np.random.default_rng(3).standard_normal((4, 4))
    scale = np.diag([1.0, 1e6, 1e-6, 1.0])
    assert inverse_root(scale @ A @ A.T @ scale).shape == (4, 4)


def test_respond_is_the_difference_of_two_filters() -> None:
    model, rng, n = spp_model(6), np.random.default_rng(4), 9
    fault = rng.standard_normal((n, 12))
    z = rng.standard_normal((n, 12))

    def run(extra: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
        x, innovations = np.zeros(8), []
        for k, u in enumerate(UPDATES[:n]):
            x = model.F @ x if k else x
            innovations.append(z[k] + extra[k] - u.H @ x)
            x = x + u.K @ innovations[-1]
        return innovations, x

    clean, x = run(np.zeros_like(fault))
    faulty, x_faulty = run(fault)
    e = np.zeros((0, 1))
    for k, u in enumerate(UPDATES[:n]):
        g, e = respond(e, u.F, u.H, u.K, fault[k][:, None])
        np.testing.assert_allclose(g[:, 0], faulty[k] - clean[k], atol=1e-9)
    np.testing.assert_allclose(e[:, 0], x_faulty - x, atol=1e-9)
