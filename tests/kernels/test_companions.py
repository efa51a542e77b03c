"""What goes beside a bank: nominal biases against filters fed with them, covariances against many runs."""

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
KEYS = tuple(f"G{i:02d}:C1C" for i in range(1, ROWS + 1))
USED = np.array([[1] * 6, [0, 1, 1, 1, 1, 1], [1, 1, 1, 1, 0, 0]], dtype=bool)
NOMINAL = np.array([0.5, 0.2, 0.0, 0.3, 0.0, 1.0])


def steps(epochs: int):
    """Yield the transition and its noise, epoch by epoch; the first is none."""
    for k in range(epochs):
        yield (F, Q) if k else (np.eye(N), np.zeros((N, N)))


def beside(epochs: int, actual: np.ndarray | None, nominal: np.ndarray) -> tuple[Subfilters, Companions]:
    bank, found = replicate(P0).take(np.zeros(3, np.intp)), None
    for f, q in steps(epochs):
        found = accompany(found, bank, f, q, H, R, actual, nominal, KEYS, USED)
        bank = advance(bank, f, q, H, R, np.zeros(ROWS), USED)
    assert found is not None
    return bank, found


def errors(z: np.ndarray) -> np.ndarray:
    """Return the estimates of the members from rows `z` (epochs, runs, rows), shape (runs, 3, N)."""
    x, bank = np.zeros((z.shape[1], 3, N)), replicate(P0).take(np.zeros(3, np.intp))
    for (f, q), rows in zip(steps(len(z)), z, strict=True):
        K = gains(predicted(bank.P, f, q), H, R, USED)
        bank = advance(bank, f, q, H, R, np.zeros(ROWS), USED)
        x = x @ f.T
        x = x + np.einsum("inm,rim->rin", K, rows[:, None] - x @ H.T)
    return x


def test_each_bias_is_what_a_filter_makes_of_it() -> None:
    _, found = beside(7, None, NOMINAL)
    assert found.keys == tuple(k for k, b in zip(KEYS, NOMINAL, strict=True) if b)
    fed = np.array([np.diag(NOMINAL)[np.flatnonzero(NOMINAL)]] * 7)
    np.testing.assert_allclose(found.bias, np.moveaxis(errors(fed), 0, 2), atol=1e-12)


def test_no_signs_of_the_biases_do_worse_than_the_sum() -> None:
    _, found = beside(7, None, NOMINAL)
    signs = np.array(list(product((-1.0, 1.0), repeat=ROWS)))
    brute = np.abs(errors(np.array([signs * NOMINAL] * 7))).max(axis=0)
    np.testing.assert_allclose(np.abs(found.bias).sum(axis=2), brute, atol=1e-12)


def test_a_row_that_comes_late_or_goes_has_its_own_column() -> None:
    # GIVEN a row that is there in the second half only, and one in the first only
    bank, found = replicate(P0).take(np.zeros(3, np.intp)), None
    x = np.zeros((1, 3, N))
    for k, (f, q) in enumerate(steps(8)):
        seen = np.array([i for i in range(ROWS) if i != (0 if k < 4 else 1)])
        sub = (H[seen], R[np.ix_(seen, seen)])
        keys = tuple(KEYS[i] for i in seen)
        found = accompany(found, bank, f, q, *sub, None, NOMINAL[seen], keys, USED[:, seen])
        K = gains(predicted(bank.P, f, q), *sub, USED[:, seen])
        x = x @ f.T
        x = x + np.einsum("inm,rim->rin", K, np.where(seen == 0, NOMINAL[0], 0.0)[None, None] - x @ sub[0].T)
        bank = advance(bank, f, q, *sub, np.zeros(len(seen)), USED[:, seen])
    # THEN the columns are of all rows that ever had a bias, and that of the late one is right
    assert found is not None
    assert set(found.keys) == {k for k, b in zip(KEYS, NOMINAL, strict=True) if b}
    np.testing.assert_allclose(found.bias[:, :, found.keys.index(KEYS[0])], x[0], atol=1e-12)


def test_where_the_model_is_right_own_and_shared_covariances_are_those_of_the_bank() -> None:
    bank, found = beside(6, None, np.zeros(ROWS))
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
    bank, found = beside(epochs, actual, np.zeros(ROWS))
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
    _, found = beside(3, 0.5 * R, NOMINAL)
    other = found.take(np.array([2, 0, 2]))
    for name in ("bias", "own", "shared"):
        np.testing.assert_array_equal(getattr(other, name), getattr(found, name)[[2, 0, 2]])
    assert other.keys == found.keys
