"""Rows left out of an epoch, and what a window says without some of its rows."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.kernels.source_test import (
    WithoutSource,
    courses,
    left_out,
    literal_separation,
    responses,
    separated,
)
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.kernels.windows import inverse_root, respond
from pntegrity.scenarios._vessel_epoch import _position_without, as_fixes, first_epoch_power, later_power
from pntegrity.scenarios._vessel_runs import Study
from pntegrity.simulate.ensembles import filtered
from pntegrity.states import group_of


@pytest.fixture(scope="module")
def study():
    return Study("consistent", 20)


@pytest.fixture(scope="module")
def epoch(study):
    u = study.updates[160]
    nu = u.L @ np.random.default_rng(1).standard_normal(len(u.keys))
    return u, nu


def rows(keys, *sources):
    return np.array([i for i, k in enumerate(keys) if group_of(k) in sources])


@pytest.mark.parametrize("source", ["gnss", "lbl", "usbl"])
def test_left_out_rows_are_measured_less_predicted_by_the_others(epoch, source):
    u, nu = epoch
    out, P, H, R = rows(u.keys, source), u.prior.P, u.H, u.R
    rest = np.setdiff1d(np.arange(len(nu)), out)
    K = P @ H[rest].T @ np.linalg.inv(H[rest] @ P @ H[rest].T + R[np.ix_(rest, rest)])
    x, P_c = K @ nu[rest], (np.eye(len(P)) - K @ H[rest]) @ P
    found = left_out(nu, u.S, out)
    np.testing.assert_allclose(found.residual, nu[out] - H[out] @ x, atol=1e-9)
    np.testing.assert_allclose(found.covariance, R[np.ix_(out, out)] + H[out] @ P_c @ H[out].T, atol=1e-9)


@pytest.mark.parametrize("source", ["gnss", "lbl", "usbl"])
def test_left_out_fixes_are_the_separation_of_full_solutions(epoch, source):
    u, nu = epoch
    H, z, groups = as_fixes(u.H, u.R, nu, [group_of(k) for k in u.keys])
    out = np.array([i for i, g in enumerate(groups) if g == source])
    found = left_out(z, H @ u.prior.P @ H.T + np.eye(len(z)), out)
    apart, cov = separated(z, H, np.eye(len(z)), u.prior.P, out)
    white = inverse_root(cov) @ apart
    assert len(white) == len(out)
    assert white @ white == pytest.approx(found.square, rel=1e-9)


def test_the_power_of_both_is_the_same(study):
    power = first_epoch_power(study, 80.0, 20.0, 1e-4)
    assert power["left-out fix"] == pytest.approx(power["full separation"], abs=1e-9)


def test_left_out_rows_forget_a_bias_and_a_window_does_not(study):
    power = later_power(study, 80.0, 10.0, 1e-4)
    first = first_epoch_power(study, 80.0, 10.0, 1e-4)
    assert power["left-out rows"][0] == pytest.approx(first["left-out rows"], abs=1e-12)
    assert power["left-out rows"] == sorted(power["left-out rows"], reverse=True)
    for name in ("recursive separation of each", "window's GLR"):
        assert power[name] == sorted(power[name])
        assert power[name][1] > 0.99


def test_a_recursive_separation_has_the_covariance_stated(study):
    """Positions of the filter with all rows and of one that has left out a satellite, by simulation."""
    many = Study("consistent", 600)
    quiet = np.zeros((400, 18))
    used = np.ones_like(quiet, dtype=bool)
    used[140:, 3] = False
    full = many.full(quiet)
    other = filtered(many.model, many.noise, quiet, used, after=full, first=140, last=165)
    apart = (other.error[-1] - full.error[164])[:3]
    cov = _position_without(many, np.array([3]), 140, [164])[164] - many.updates[164].posterior.P[:3, :3]
    assert np.cov(apart) == pytest.approx(cov, abs=0.15 * np.abs(cov).max())


def test_the_statistic_taken_literally_never_comes_near_its_threshold(study):
    nu = study.full(np.zeros((400, 18))).nu
    worst = 0.0
    for k in range(5, 400, 7):
        u = study.updates[k]
        for source in ("gnss", "lbl", "usbl"):
            for r in range(5):
                square, dof = literal_separation(nu[k][:, r], u.H, u.R, u.prior.P, rows(u.keys, source))
                worst = max(worst, square / chi2_threshold(1e-4, dof))
    assert worst < 0.1


@pytest.fixture(scope="module")
def window(study):
    chosen = study.updates[150:165]
    return chosen, responses([(u.F, u.H, u.L, u.K) for u in chosen])[0]


def test_responses_are_those_of_single_faults(window):
    updates, A = window
    row, begin = 4, 3
    E, out = np.zeros((17, 1)), []
    for k, u in enumerate(updates):
        f = np.zeros((len(u.keys), 1))
        f[row, 0] = float(k == begin)
        g, E = respond(E, u.F, u.H, u.K, f)
        out.append(np.linalg.solve(u.L, g))
    np.testing.assert_allclose(A[:, begin * 18 + row], np.concatenate(out)[:, 0], atol=1e-12)


def test_courses_add_up_the_responses(window):
    updates, A = window
    grows, jumps = np.zeros((18, 2)), np.zeros((18, 2))
    grows[3, 0], jumps[12, 1] = 1.0, 1.0
    t = 0.5 * np.arange(len(updates))
    found = courses(A, [(grows, jumps)] * len(updates), t, 0.5, [4, 9])
    assert found.signature.tolist() == [0, 0, 1, 1]
    assert found.onset.tolist() == [4, 9, 4, 9]
    ramp = sum(A[:, 18 * k + 3] * (t[k] - t[9] + 0.5) for k in range(9, 15))
    bias = sum(A[:, 18 * k + 12] for k in range(4, 15))
    np.testing.assert_allclose(found.means[:, 1], ramp, atol=1e-12)
    np.testing.assert_allclose(found.means[:, 2], bias, atol=1e-12)


def test_a_window_without_a_source_is_a_filter_that_did_not_use_it(study, window):
    updates, A = window
    quiet = np.zeros((400, 18))
    full = study.full(quiet)
    white = study.white(full.nu)[150:165].reshape(-1, 20)
    out = np.concatenate([18 * k + rows(u.keys, "gnss") for k, u in enumerate(updates)])
    one = courses(A, [(np.zeros((18, 1)), np.eye(18)[:, 14:15])] * 15, np.arange(15.0), 1.0, [0])
    rest = WithoutSource(one, A[:, out])
    left = white - rest.base @ (rest.base.T @ white)
    used = quiet == 0.0
    used[:, rows(study.model.keys, "gnss")] = False
    other = filtered(study.model, study.noise, quiet, used, after=full, first=150, last=165)
    squares = np.zeros(20)
    for k in range(150, 165):
        P = (full if k == 150 else other).prior(study.model, k)
        H, keep = study.model.at("H", k), used[k]
        S = H[keep] @ P @ H[keep].T + study.model.at("R", k)[np.ix_(keep, keep)]
        nu = other.nu[k - 150][keep]
        squares += (nu * np.linalg.solve(S, nu)).sum(axis=0)
    np.testing.assert_allclose((left**2).sum(axis=0), squares, rtol=1e-8)
    spoilt = white + A[:, out] @ np.random.default_rng(2).standard_normal((len(out), 20)) * 100.0
    np.testing.assert_allclose(rest.explained(spoilt), rest.explained(white), atol=1e-6)
