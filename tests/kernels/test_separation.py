"""The bank of subfilters against a plain Kalman filter a member, and what it must leave alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from pntegrity.kernels.separation import Subfilters, advance, gains, predicted, replicate
from pntegrity.simulate.linear import gains as linear_gains
from pntegrity.simulate.linear import spp_model

Plain = list[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Step:
    """One epoch of a random system; `used` tells which rows each member has."""

    F: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    R: np.ndarray
    z: np.ndarray
    used: np.ndarray


@dataclass(frozen=True)
class Kind:
    """How states come and go, and which matrices are full."""

    sizes: tuple[int, ...] = (9, 9, 9, 9)
    turned: bool = False
    noisy: bool = False
    correlated: bool = False


KINDS = {
    "walk": Kind(),
    "births and deaths": Kind((7, 12, 12, 5, 10)),
    "several sources": Kind((8, 8, 11, 6), turned=True),
    "process noise between states": Kind((9, 13, 7), noisy=True),
    "correlated rows": Kind((9, 12, 7), correlated=True),
    "all at once": Kind((6, 14, 10, 17, 4), turned=True, noisy=True, correlated=True),
    "many states": Kind((33, 34, 35, 32)),
}


def spread(n: int, rng: np.random.Generator, full: bool) -> np.ndarray:
    A = rng.standard_normal((n, n)) if full else np.diag(rng.uniform(0.2, 2.0, n))
    return A @ A.T + 0.01 * np.eye(n)


def transition(n: int, before: int, turned: bool, rng: np.random.Generator) -> np.ndarray:
    """Return a step: states that live on (in another order, scaled), some anew, some mixed."""
    F = np.zeros((n, before))
    kept = min(n, before) - 2
    F[rng.permutation(n)[:kept], rng.permutation(before)[:kept]] = rng.uniform(0.5, 1.0, kept)
    return F + 0.3 * (rng.random((n, before)) < 0.2) if turned else F


def system(kind: Kind, seed: int, members: int = 5, rows: int = 21) -> tuple[np.ndarray, list[Step]]:
    """Return the covariance before, and the epochs; the first member has all rows."""
    rng = np.random.default_rng(seed)
    out, before = [], kind.sizes[0]
    for n in kind.sizes:
        F = transition(n, before, kind.turned, rng)
        Q = spread(n, rng, kind.noisy)
        H = rng.standard_normal((rows, n)) * (rng.random((rows, n)) < 0.4)
        used = rng.random((members, rows)) < 0.7
        used[0] = True
        used[-1] = False
        R = spread(rows, rng, kind.correlated)
        out.append(Step(F, Q, H, R, rng.standard_normal(rows), used))
        before = n
    return spread(kind.sizes[0], rng, full=True), out


def kalman(x: np.ndarray, P: np.ndarray, s: Step, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return one epoch of the textbook filter with some rows, in Joseph's form."""
    x, P, H, R = s.F @ x, s.F @ P @ s.F.T + s.Q, s.H[used], s.R[np.ix_(used, used)]
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    A = np.eye(len(x)) - K @ H
    return x + K @ (s.z[used] - H @ x), A @ P @ A.T + K @ R @ K.T


def side_by_side(P0: np.ndarray, steps: list[Step]) -> list[tuple[Subfilters, Plain]]:
    """Return the bank and the plain filters of all members, epoch by epoch."""
    members = len(steps[0].used)
    bank = replicate(P0).take(np.zeros(members, np.intp))
    plain: Plain = [(np.zeros(len(P0)), P0)] * members
    out = []
    for s in steps:
        nu = s.z - s.H @ (s.F @ plain[0][0])
        bank = advance(bank, s.F, s.Q, s.H, s.R, nu, s.used)
        plain = [kalman(x, P, s, u) for (x, P), u in zip(plain, s.used, strict=True)]
        out.append((bank, plain))
    return out


def assert_same(bank: Subfilters, plain: Plain, p_tol: float = 1e-9, x_tol: float = 1e-6) -> None:
    """Both, in standard deviations of each member's states."""
    for i, (x, P) in enumerate(plain):
        sigma = np.sqrt(np.diagonal(P))
        np.testing.assert_allclose(bank.P[i] / np.outer(sigma, sigma), P / np.outer(sigma, sigma), atol=p_tol)
        np.testing.assert_allclose(bank.delta[i] / sigma, (x - plain[0][0]) / sigma, atol=x_tol)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", KINDS)
def test_every_member_is_a_plain_kalman_filter(kind: str, seed: int) -> None:
    for bank, plain in side_by_side(*system(KINDS[kind], seed)):
        assert_same(bank, plain)


@pytest.mark.parametrize("rows", [0, 1, 3, 4, 5, 7, 8, 9, 16, 17])
def test_any_number_of_rows_and_of_states(rows: int) -> None:
    for n in (1, 2, 3, 4, 5, 8, 15, 16, 17):
        rng = np.random.default_rng(rows)
        used = rng.random((3, rows)) < 0.6
        used[0] = True
        R, H = spread(rows, rng, False), rng.standard_normal((rows, n))
        step = Step(0.9 * np.eye(n), spread(n, rng, False), H, R, rng.standard_normal(rows), used)
        for bank, plain in side_by_side(spread(n, rng, True), [step, step]):
            assert_same(bank, plain)


def test_the_first_member_is_the_filter_of_the_updates() -> None:
    updates = linear_gains(spp_model(6), 8)
    bank = replicate(updates[0].prior.P)
    for k, u in enumerate(updates):
        F, Q = (u.F, u.Q) if k else (np.eye(8), np.zeros((8, 8)))
        bank = advance(bank, F, Q, u.H, u.R, u.nu, np.ones((1, len(u.keys)), bool))
        sigma = np.sqrt(np.diagonal(u.posterior.P))
        unit = np.outer(sigma, sigma)
        np.testing.assert_allclose(bank.P[0] / unit, u.posterior.P / unit, atol=1e-9)


def test_members_that_use_the_same_rows_are_the_same_to_the_last_bit() -> None:
    P0, steps = system(KINDS["many states"], 4)
    bank = replicate(P0).take(np.zeros(4, np.intp))
    for s in steps:
        bank = advance(bank, s.F, s.Q, s.H, s.R, s.z, np.ones((4, len(s.z)), bool))
        assert not bank.delta.any()
        assert (bank.P[:1] == bank.P).all()


@pytest.mark.parametrize("kind", ["births and deaths", "correlated rows"])
def test_another_order_and_another_origin_are_taken_on_the_way(kind: str) -> None:
    P0, steps = system(KINDS[kind], 7)
    source, origin = np.array([2, 0, 2, 3]), 2
    bank, plain = side_by_side(P0, steps[:-1])[-1]
    s = steps[-1]
    used = s.used[source]
    # the filter itself goes on from member 2, with its rows
    nu = s.z - s.H @ (s.F @ plain[origin][0])
    after = advance(bank, s.F, s.Q, s.H, s.R, nu, used, source, origin)
    assert_same(after, [kalman(*plain[i], s, u) for i, u in zip(source, used, strict=True)])
    moved = advance(bank.take(source, origin), s.F, s.Q, s.H, s.R, nu, used)
    np.testing.assert_array_equal(after.P, moved.P)
    np.testing.assert_array_equal(after.delta, moved.delta)


def test_a_step_leaves_what_it_was_given_alone() -> None:
    P0, steps = system(KINDS["several sources"], 1)
    s, bank = steps[0], replicate(P0).take(np.zeros(5, np.intp))
    given = [a.copy() for a in (bank.delta, bank.P, s.F, s.Q, s.H, s.R, s.z, s.used)]
    advance(bank, s.F, s.Q, s.H, s.R, s.z, s.used)
    for a, b in zip(given, (bank.delta, bank.P, s.F, s.Q, s.H, s.R, s.z, s.used), strict=True):
        np.testing.assert_array_equal(a, b)


def test_covariances_stay_symmetric_and_positive_definite_with_carriers_beside_wide_births() -> None:
    # GIVEN ambiguities born with 100 m beside carriers of 3 mm, a clock of 1 km every epoch
    rng, n = np.random.default_rng(3), 30
    bank = replicate(np.diag([1e4] * 3 + [1e6] + [1e4] * 26)).take(np.zeros(27, np.intp))
    H = np.zeros((52, n))
    H[:, :3], H[:, 3] = rng.standard_normal((26, 3)).repeat(2, axis=0), 1.0
    H[1::2, 4:] = np.eye(26)
    used = np.ones((27, 52), bool)
    for i in range(26):
        used[1 + i, 2 * i : 2 * i + 2] = False
    F, Q = np.eye(n), np.diag([1e4] * 3 + [1e6] + [1e-8] * 26)
    F[:4] = 0.0
    # WHEN it runs for a while
    for _ in range(60):
        bank = advance(bank, F, Q, H, np.diag([1.0, 9e-6] * 26), rng.standard_normal(52), used)
    # THEN nothing is lost
    assert (np.swapaxes(bank.P, 1, 2) == bank.P).all()
    sigma = np.sqrt(np.einsum("iaa->ia", bank.P))
    unit = bank.P / sigma[:, :, None] / sigma[:, None, :]
    assert np.linalg.eigvalsh(unit).min() > 0.0
    # and a member never knows more than the filter, but for the last digits of a variance of 1e6
    assert np.linalg.eigvalsh((bank.P - bank.P[:1])[:, :3, :3]).min() > -1e-15 * 1e6


def test_a_state_that_no_row_of_a_member_touched_is_as_it_was_born() -> None:
    P0, steps = system(Kind((8, 8, 8, 8)), 5)
    bank = replicate(np.diag(np.diagonal(P0))).take(np.zeros(2, np.intp))
    variance = P0[7, 7]
    for s in steps:
        H = s.H.copy()
        H[:, 7] = 0.0
        H[:3, 7] = 1.0  # rows 0, 1, 2 see state 7, and member 1 does without
        used = np.ones((2, len(H)), bool)
        used[1, :3] = False
        F, Q = np.diag([0.9] * 7 + [1.0]), np.diag([0.1] * 7 + [0.01])
        bank = advance(bank, F, Q, H, np.diag(np.diagonal(s.R)), s.z, used)
        variance += 0.01
        assert not bank.P[1, 7, :7].any()
        assert bank.P[1, 7, 7] == pytest.approx(variance, rel=1e-12)
        assert bank.P[0, 7, 7] < 0.5 * variance


@pytest.mark.parametrize("correlated", [False, True])
def test_gains_are_those_of_the_textbook_and_zero_for_rows_not_used(correlated: bool) -> None:
    P0, (s, *_) = system(Kind((9, 9), correlated=correlated), 2)
    prior = predicted(np.array([P0] * 5), s.F, s.Q)
    K = gains(prior, s.H, s.R, s.used)
    np.testing.assert_allclose(prior[3], s.F @ P0 @ s.F.T + s.Q, rtol=1e-12)
    for k, P, u in zip(K, prior, s.used, strict=True):
        H = s.H[u]
        np.testing.assert_allclose(k[:, u] @ (H @ P @ H.T + s.R[np.ix_(u, u)]), P @ H.T, atol=1e-9)
        assert not k[:, ~u].any()


def test_what_separates_a_member_has_the_variance_p_i_less_p_0() -> None:
    # GIVEN a small filter whose model is right; WHEN 20,000 runs are drawn
    rng, n, runs = np.random.default_rng(8), 4, 20_000
    H, R = rng.standard_normal((7, n)), np.diag(rng.uniform(0.5, 2.0, 7))
    F, Q, P = 0.95 * np.eye(n), 0.05 * np.eye(n), np.eye(n)
    used = np.ones((3, 7), bool)
    used[1, :2] = used[2, 4:] = False
    x = np.zeros((runs, 3, n))
    truth = rng.standard_normal((runs, n))
    bank = replicate(P).take(np.zeros(3, np.intp))
    for k in range(6):
        step, noise = (F, Q) if k else (np.eye(n), np.zeros((n, n)))
        prior = predicted(bank.P, step, noise)
        K = gains(prior, H, R, used)
        bank = advance(bank, step, noise, H, R, np.zeros(7), used)
        if k:
            truth = truth @ F.T + rng.standard_normal((runs, n)) * np.sqrt(0.05)
            x = x @ F.T
        z = truth @ H.T + rng.standard_normal((runs, 7)) * np.sqrt(np.diagonal(R))
        x = x + np.einsum("inm,rim->rin", K, z[:, None] - x @ H.T)
    # THEN separations have that covariance, to the noise of the draw (4.5 standard deviations)
    for i in (1, 2):
        want = bank.P[i] - bank.P[0]
        got = np.cov((x[:, i] - x[:, 0]).T)
        noise = np.sqrt((np.outer(np.diagonal(want), np.diagonal(want)) + want**2) / runs)
        assert (np.abs(got - want) < 4.5 * noise).all()
        # and no part of it is in the error of the filter
        both = np.cov((x[:, i] - x[:, 0]).T, (x[:, 0] - truth).T)[:n, n:]
        noise = np.sqrt(np.outer(np.diagonal(want), np.diagonal(bank.P[0])) / runs)
        assert (np.abs(both) < 4.5 * noise).all()
