"""Rows tested one by one: against brute force, in any order, and with a limit that keeps its rate."""

import numpy as np
import pytest
from scipy.stats import binom, norm

from pntegrity.kernels.row_tests import leave_out


def model(seed, rows=12, states=5):
    """Innovations of rows on a prior that is wide in some states, and their covariance."""
    rng = np.random.default_rng(seed)
    H = rng.standard_normal((rows, states))
    P = np.diag(rng.uniform(0.1, 100.0, states))
    S = H @ P @ H.T + np.diag(rng.uniform(0.5, 2.0, rows))
    return np.linalg.cholesky(S) @ rng.standard_normal(rows), S, rng


def deviation(nu, S, kept, j):
    """How far row `j` is off from what the other kept rows say of it, by its conditional distribution."""
    others = [i for i in kept if i != j]
    gain = np.linalg.solve(S[np.ix_(others, others)], S[others, j])
    return abs(nu[j] - gain @ nu[others]) / np.sqrt(S[j, j] - gain @ S[others, j])


@pytest.mark.parametrize("seed", range(8))
def test_each_pass_leaves_out_the_row_furthest_off_of_those_kept(seed):
    nu, S, rng = model(seed)
    nu[rng.choice(len(nu), 3, replace=False)] += rng.uniform(15.0, 40.0, 3)
    passes, first, last = leave_out(nu, S, 3.3)
    kept = list(range(len(nu)))
    assert first == pytest.approx(max(deviation(nu, S, kept, j) for j in kept))
    order = sorted(np.flatnonzero(passes).tolist(), key=lambda j: passes[j])
    if list(passes[order]) == list(range(1, len(order) + 1)):  # nobody returned
        for j in order:
            worst = max(kept, key=lambda i: deviation(nu, S, kept, i))
            assert worst == j
            assert deviation(nu, S, kept, j) > 3.3
            kept.remove(j)
    kept = np.flatnonzero(passes == 0).tolist()
    assert last == pytest.approx(max(deviation(nu, S, kept, j) for j in kept))
    assert last <= 3.3
    assert all(deviation(nu, S, [*kept, j], j) >= 3.3 for j in np.flatnonzero(passes))


@pytest.mark.parametrize("seed", range(8))
def test_the_order_of_rows_does_not_matter(seed):
    nu, S, rng = model(seed, rows=20)
    nu[:6] += rng.uniform(5.0, 60.0, 6)
    mix = rng.permutation(len(nu))
    passes, first, last = leave_out(nu, S, 3.3)
    again, first_again, last_again = leave_out(nu[mix], S[np.ix_(mix, mix)], 3.3)
    np.testing.assert_array_equal(again, passes[mix])
    assert (first_again, last_again) == (pytest.approx(first), pytest.approx(last))


def test_a_row_that_was_masked_returns():
    # GIVEN two rows of one error that make a good third one the worst
    S = np.eye(3) + 100.0
    nu = np.array([20.0, 20.4, 0.0]) + 0.1
    S[2, 2] = 100.4
    nu[2] = 20.3
    nu[0] = 60.0
    passes, _, _ = leave_out(nu, S, 3.0)
    assert passes.tolist() == [1, 0, 0]
    # a limit that is passed by all leaves none out
    assert not leave_out(nu, S, np.inf)[0].any()


def test_clean_rows_are_left_out_as_often_as_the_limit_says():
    # GIVEN clean rows, each with a conditional distribution given all others
    limit, draws, (_, S, rng) = 2.5, 4000, model(9, rows=6)
    root = np.linalg.cholesky(S)
    # WHEN one of them is tested alone against what the others say of it
    gain = np.linalg.solve(S[1:, 1:], S[0, 1:])
    spread = S[0, 0] - gain @ S[1:, 0]
    alone = [nu[0] - gain @ nu[1:] for nu in (root @ rng.standard_normal((6, draws))).T]
    out = sum(leave_out(np.array([d]), np.array([[spread]]), limit)[0][0] for d in alone)
    # THEN it is left out at the rate of the normal distribution, within its 99.9 % interval
    low, high = binom.ppf([5e-4, 1.0 - 5e-4], draws, 2.0 * norm.sf(limit))
    assert low <= out <= high


def test_some_rows_are_kept_in_any_case_and_none_is_no_error():
    nu, S, _ = model(3)
    nu[:8] += np.linspace(50.0, 900.0, 8)
    assert int((leave_out(nu, S, 0.5, least=10)[0] == 0).sum()) >= 10
    passes, first, last = leave_out(np.zeros(0), np.zeros((0, 0)), 3.3)
    assert len(passes) == 0
    assert first == last == 0.0


def test_what_it_is_given_stays_as_it_is():
    nu, S, _ = model(4)
    nu[0] += 50.0
    before = nu.copy(), S.copy()
    leave_out(nu, S, 3.3)
    np.testing.assert_array_equal(nu, before[0])
    np.testing.assert_array_equal(S, before[1])
