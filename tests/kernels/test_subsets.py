"""The search for the smallest set of groups whose absence makes an epoch consistent."""

from itertools import combinations

import numpy as np
import pytest

from pntegrity.kernels.linear import cholesky
from pntegrity.kernels.subsets import explained_by, search
from pntegrity.records import Update
from pntegrity.simulate.linear import gains, spp_model

UPDATE = gains(spp_model(10), 60)[-1]
ROWS = [np.array([i, i + 10], dtype=np.int64) for i in range(10)]


def statistic_without(nu: np.ndarray, left_out: list[int]) -> float:
    """Re-run the update without some rows: its residual chi-square."""
    keep = [i for i in range(20) if i not in left_out]
    H, R = UPDATE.H[keep], UPDATE.R[np.ix_(keep, keep)]
    u = Update.from_filter(0, F=UPDATE.F, Q=UPDATE.Q, H=H, R=R, P_prior=UPDATE.prior.P, nu=nu[keep])
    return float(u.white @ u.white)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_explained_is_what_the_update_without_the_rows_loses(size: int) -> None:
    nu = np.random.default_rng(size).standard_normal(20) * 5.0
    V = np.linalg.inv(UPDATE.S)
    sets = np.array(list(combinations(range(10), size))[::7], dtype=np.int64)
    total = float(nu @ V @ nu)
    found = explained_by(V @ nu, V, np.array(ROWS), sets)
    for chosen, value in zip(sets, found, strict=True):
        rest = statistic_without(nu, [int(r) for g in chosen for r in ROWS[g]])
        assert total - value == pytest.approx(rest, rel=1e-8)


@pytest.mark.parametrize("planted", [(3,), (1, 8), (0, 4, 9)])
def test_planted_sets_are_found(planted: tuple[int, ...]) -> None:
    rng = np.random.default_rng(len(planted))
    for _ in range(20):
        nu = UPDATE.L @ rng.standard_normal(20)
        for g in planted:
            nu[g] += rng.choice([-1.0, 1.0]) * rng.uniform(40.0, 100.0)
        result = search(nu, UPDATE.L, ROWS, 0, 1e-6)
        assert result.passed
        assert result.removed == planted
        assert not result.alternatives


def test_nothing_is_removed_from_consistent_rows() -> None:
    nu = UPDATE.L @ np.random.default_rng(5).standard_normal(20)
    result = search(nu, UPDATE.L, ROWS, 0, 1e-6)
    assert result.passed
    assert result.removed == ()


def test_two_satellites_that_cannot_be_told_apart_are_reported() -> None:
    # GIVEN two rows that alone see one unknown, and two that see another
    S = 1e8 * np.kron(np.eye(2), np.ones((2, 2))) + np.eye(4)
    rows = [np.array([i], dtype=np.int64) for i in range(4)]
    # WHEN one of the first pair is wrong
    result = search(np.array([50.0, 0.0, 0.1, 0.0]), cholesky(S), rows, 0, 1e-6)
    # THEN either of them may be left out, and it is said so
    assert result.passed
    assert {result.removed, *result.alternatives} == {(0,), (1,)}


def test_more_faults_than_are_searched_do_not_pass() -> None:
    nu = UPDATE.L @ np.random.default_rng(6).standard_normal(20)
    nu[[0, 2, 4, 6]] += [80.0, -90.0, 70.0, -60.0]
    result = search(nu, UPDATE.L, ROWS, 0, 1e-6, largest=2)
    assert not result.passed
    assert len(result.removed) == 2


def test_states_born_of_the_rows_cost_redundancy() -> None:
    nu = np.array([30.0, -30.0])
    result = search(nu, np.eye(2), [np.array([0]), np.array([1])], 1, 1e-6)
    assert not result.passed
