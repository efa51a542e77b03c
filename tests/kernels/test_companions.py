"""What a bank says of nominal biases, against filters fed with them, and covariances beside it, against many
runs.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from pntegrity.kernels.companions import Companions, accompany
from pntegrity.kernels.separation import Subfilters, advance, gains, predicted, replicate

N, ROWS = 4, 6
RNG = np.random.default_rng(12)
H = RNG.standard_normal((ROWS, N))
R = np.diag(RNG.uniform(0.5, 2.0, ROWS))
F, Q, P0 = 0.95 * np.eye(N), 0.05 * np.eye(N), np.eye(N)
USED = np.array([[1] * 6, [0, 1, 1, 1, 1, 1], [1, 1, 1, 1, 0, 0]], dtype=bool)
NOMINAL = np.array([0.5, 0.2, 0.0, 0.3, 0.0, 1.0])
SOME = np.flatnonzero(NOMINAL)


def steps(epochs: int):
    """Yield the transition and its noise, epoch by epoch; the first is none."""
    for k in range(epochs):
        yield (F, Q) if k else (np.eye(N), np.zeros((N, N)))


def beside(epochs: int, actual: np.ndarray | None) -> tuple[Subfilters, Companions]:
    bank, found = replicate(P0).take(np.zeros(3, np.intp)), None
    for f, q in steps(epochs):
        found = accompany(found, bank, f, q, H, R, actual, USED)
        bank = advance(bank, f, q, H, R, np.zeros(ROWS), USED)
    assert found is not None
    return bank, found


def biased(epochs: int, R: np.ndarray = R) -> np.ndarray:
    """Return the bias each row with a nominal one makes, shape (3, c, N)."""
    bank = replicate(P0).take(np.zeros(3, np.intp)).with_biases(np.full(len(SOME), -1))
    for f, q in steps(epochs):
        bank = advance(bank, f, q, H, R, np.zeros(ROWS), USED, biases=np.diag(NOMINAL)[SOME])
    return bank.bias


def errors(z: np.ndarray, R: np.ndarray = R) -> np.ndarray:
    """Return the estimates of the members from rows `z` (epochs, runs, rows), shape (runs, 3, N)."""
    x, bank = np.zeros((z.shape[1], 3, N)), replicate(P0).take(np.zeros(3, np.intp))
    for (f, q), rows in zip(steps(len(z)), z, strict=True):
        K = gains(predicted(bank.P, f, q), H, R, USED)
        bank = advance(bank, f, q, H, R, np.zeros(ROWS), USED)
        x = x @ f.T
        x = x + np.einsum("inm,rim->rin", K, rows[:, None] - x @ H.T)
    return x


@pytest.mark.parametrize("noise", [R, R + 0.1], ids=["diagonal", "full"])
def test_each_bias_is_what_a_filter_makes_of_it(noise: np.ndarray) -> None:
    fed = np.array([np.diag(NOMINAL)[SOME]] * 7)
    np.testing.assert_allclose(biased(7, noise), np.moveaxis(errors(fed, noise), 0, 1), atol=1e-12)


def test_no_signs_of_the_biases_do_worse_than_the_sum() -> None:
    signs = np.array(list(product((-1.0, 1.0), repeat=ROWS)))
    brute = np.abs(errors(np.array([signs * NOMINAL] * 7))).max(axis=0)
    np.testing.assert_allclose(np.abs(biased(7)).sum(axis=1), brute, atol=1e-12)


def test_a_bias_begins_goes_on_and_is_forgotten() -> None:
    bank = replicate(P0).take(np.zeros(3, np.intp)).with_biases(np.array([-1]))
    bank = advance(bank, *next(steps(1)), H, R, np.zeros(ROWS), USED, biases=np.eye(ROWS)[:1])
    both = bank.with_biases(np.array([-1, 0]))
    np.testing.assert_array_equal(both.bias[:, 0], 0.0)
    np.testing.assert_array_equal(both.bias[:, 1], bank.bias[:, 0])
    assert both.with_biases(np.array([], dtype=int)).bias.shape == (3, 0, N)


def test_where_the_model_is_right_own_and_shared_covariances_are_those_of_the_bank() -> None:
    bank, found = beside(6, None)
    np.testing.assert_allclose(found.own, bank.P, atol=1e-12)
    np.testing.assert_allclose(found.shared, np.broadcast_to(bank.P[0], found.shared.shape), atol=1e-12)
    np.testing.assert_allclose(found.separation(), bank.P - bank.P[:1], atol=1e-12)


@pytest.mark.parametrize("seed", [1, 2])
def test_where_errors_are_smaller_than_the_gains_believe_the_joint_covariance_is_that_of_many_runs(
    seed: int,
) -> None:
    # GIVEN rows whose errors have other variances than the gains are made of, some of them correlated
    rng, runs, epochs = np.random.default_rng(seed), 20_000, 6
    root = np.diag(rng.uniform(0.2, 0.9, ROWS)) @ np.sqrt(R)
    root[1, 0] = 0.3
    actual = root @ root.T
    bank, found = beside(epochs, actual)
    # WHEN many are drawn
    truth, z = rng.standard_normal((runs, N)), []
    for f, q in steps(epochs):
        truth = truth @ f.T + rng.standard_normal((runs, N)) * np.sqrt(q[0, 0])
        z.append(truth @ H.T + rng.standard_normal((runs, ROWS)) @ root.T)
    x = errors(np.array(z))
    # THEN errors and separations have the covariances that were carried
    for i in (1, 2):
        assert_covariance(x[:, i] - truth, found.own[i])
        apart = x[:, i] - x[:, 0]
        assert_covariance(apart, found.separation()[i])
        # and not what P_i - P_0 says
        claimed = np.diagonal(bank.P[i] - bank.P[0])
        assert (np.abs(apart.var(axis=0) / claimed - 1.0) > 0.05).any()


def assert_covariance(samples: np.ndarray, want: np.ndarray) -> None:
    """Within 4.5 standard deviations of what so many samples show."""
    var = np.diagonal(want)
    noise = np.sqrt((np.outer(var, var) + want**2) / len(samples))
    assert (np.abs(np.cov(samples.T) - want) < 4.5 * noise).all()


def test_members_are_taken_in_another_order() -> None:
    _, found = beside(3, 0.5 * R)
    other = found.take(np.array([2, 0, 2]))
    for name in ("own", "shared"):
        np.testing.assert_array_equal(getattr(other, name), getattr(found, name)[[2, 0, 2]])
