"""Windowed forms: their maps, their covariance, and what a fault does to a filter."""

import numpy as np
import pytest

from pntegrity.kernels.windows import Form, inverse_root, pivoted_root, respond
from pntegrity.monitors._carried import LazyMaps, Rows, States
from pntegrity.monitors.aime import Aime
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


def test_aime_sums_the_weighted_innovations_against_the_propagated_state() -> None:
    window = drawn()[5:10]
    passage, weights, _ = Rows().course(window)
    coasting = np.zeros((8, 8))
    total, believed = np.zeros(12), np.zeros((12, 12))
    for i, (u, e) in enumerate(zip(window, extrapolated(window), strict=True)):
        if i:
            coasting = u.F @ (coasting + window[i - 1].absorbed) @ u.F.T
        weight = np.linalg.inv(u.S + u.H @ coasting @ u.H.T)
        np.testing.assert_allclose(weights[i], weight, rtol=1e-9, atol=1e-12)
        total, believed = total + weight @ e, believed + weight
    np.testing.assert_allclose(passage.eta, total, rtol=1e-9)
    np.testing.assert_allclose(passage.weight, believed, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("view", [Rows(), States("pos"), States("pos+clk"), States("")], ids=str)
def test_the_maps_give_the_same_vector_and_covariance_as_the_passage(view: Rows | States) -> None:
    window = drawn()[5:10]
    passage = view.course(window)[0]
    maps = LazyMaps(view, window)
    total = sum(M @ u.white for M, u in zip(maps, window, strict=True))
    np.testing.assert_allclose(total, passage.eta, rtol=1e-9, atol=1e-9 * np.abs(passage.eta).max())
    cov = sum(M @ M.T for M in maps)
    np.testing.assert_allclose(cov, passage.cov, rtol=1e-8, atol=1e-10 * np.abs(passage.cov).max())


def test_covariance_of_a_window_is_that_of_many_runs() -> None:
    window = UPDATES[5:10]
    form = Form(LazyMaps(States("pos"), window), np.eye(3), 3)
    white = np.random.default_rng(1).standard_normal((5, 12, 100_000))
    y = form.project(list(white))
    np.testing.assert_allclose(
        np.cov(y) / np.diag(form.covariance()).max(),
        form.covariance() / np.diag(form.covariance()).max(),
        atol=0.02,
    )


def test_the_exact_form_has_unit_covariance_and_is_the_mahalanobis_distance() -> None:
    window = drawn()[5:10]
    form = Aime().form(window)
    assert form is not None
    np.testing.assert_allclose(form.covariance(), np.eye(12), atol=1e-9)
    y = sum(M @ u.white for M, u in zip(form.maps, window, strict=True))
    cov = sum(M @ M.T for M in form.maps)
    white = [u.white for u in window]
    assert float(form.statistic(white)) == pytest.approx(float(y @ np.linalg.solve(cov, y)), rel=1e-9)
    np.testing.assert_allclose(form.stacked() @ np.concatenate(white), form.project(white), rtol=1e-12)


@pytest.mark.parametrize("rank", [1, 3, 5])
def test_a_pivoted_root_is_the_pseudo_inverse_on_what_the_covariance_allows(rank: int) -> None:
    A = np.random.default_rng(7).standard_normal((5, rank)) * np.array([[1.0], [1e4], [1e-3], [1.0], [1.0]])
    y = A @ np.random.default_rng(8).standard_normal(rank)
    root = pivoted_root(A @ A.T)
    assert root.shape == (rank, 5)
    np.testing.assert_allclose(root @ A @ A.T @ root.T, np.eye(rank), atol=1e-7)
    whitened = np.linalg.lstsq(A, y, rcond=1e-12)[0]
    assert float((root @ y) @ (root @ y)) == pytest.approx(float(whitened @ whitened), rel=1e-6)


def test_a_pivoted_root_of_no_variance_is_empty() -> None:
    assert pivoted_root(np.zeros((4, 4))).shape == (0, 4)
    assert pivoted_root(np.zeros((0, 0))).shape == (0, 0)


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
