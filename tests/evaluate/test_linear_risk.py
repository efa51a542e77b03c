"""Errors of a bank under another truth: exact covariances, many runs, and errors that no test sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from pntegrity.bounds.ism import Ism
from pntegrity.evaluate.linear_risk import RowErrors, carry_exact, carry_runs, fresh_share, hidden
from pntegrity.kernels.protection import least_level
from pntegrity.monitors.separation import Separation
from pntegrity.records import Update
from pntegrity.scenarios._rtk_simulated import sky, updates_of
from pntegrity.sensors.noise import PPP_RTK_PUBLISHED

STEP_S, N = 30, 12
ISM = Ism(p_iono=0.0, p_trop=1e-5)


@pytest.fixture(scope="module")
def updates() -> list[Update]:
    epochs = sky(None).epochs(PPP_RTK_PUBLISHED, STEP_S, N, np.random.default_rng(1))
    return updates_of(epochs, PPP_RTK_PUBLISHED)


@pytest.fixture(scope="module")
def tests(updates):
    monitor = Separation(ism=ISM, pairs=False)
    memory, out = monitor.start(), []
    for u in updates:
        test, memory = monitor.plan(memory, u)
        out.append((test, memory))
    return out


def as_believed(u: Update) -> RowErrors:
    """What the filter takes for true; states that the data determine anew are left as they are."""
    m, q = len(u.keys), np.diagonal(u.Q)
    return RowErrors(np.sqrt(np.diagonal(u.R)), np.zeros(m), np.zeros(m), np.where(q < 1.0, q, 0.0))


def lasting(u: Update, tau_s: float) -> RowErrors:
    e = as_believed(u)
    return replace(
        e, white_m=0.5 * e.white_m, lasting_m=np.sqrt(0.75) * e.white_m, tau_s=np.full(len(u.keys), tau_s)
    )


def carried(updates, tests, errors):
    past = None
    for u, (test, _) in zip(updates, tests, strict=True):
        past = carry_exact(past, u, test, errors(u))
    return past


def position(test, covariance, n):
    return np.diagonal(test.axes @ covariance[:n, :n] @ test.axes.T)


def test_under_the_filters_own_model_its_covariances_come_out(updates, tests):
    past, u, (test, memory) = carried(updates, tests, as_believed), updates[-1], tests[-1]
    n = len(u.prior)
    assert position(test, past.own, n) == pytest.approx(position(test, u.posterior.P, n), rel=1e-3)
    gap = memory.bank.P - memory.bank.P[0]
    stated = np.einsum("da,iab,db->id", test.axes, gap, test.axes)[1:]
    found = np.einsum("da,iab,db->id", test.axes, past.apart, test.axes)[1:]
    assert found == pytest.approx(stated, rel=1e-3, abs=1e-9)


def test_the_error_of_an_optimal_filter_and_separations_are_independent(updates, tests):
    past, (test, _), n = carried(updates, tests, as_believed), tests[-1], len(updates[-1].prior)
    mixed = np.einsum("da,iab,db->id", test.axes, past.cross[:, :, :n], test.axes)[1:]
    spread = np.einsum("da,iab,db->id", test.axes, past.apart, test.axes)[1:]
    assert np.abs(mixed / np.sqrt(spread * position(test, past.own, n))).max() < 1e-2


@pytest.mark.parametrize("tau_s", [0.0, 300.0])
def test_many_runs_have_the_exact_covariances(updates, tests, tau_s):
    past, runs, rng = None, None, np.random.default_rng(2)
    for u, (test, _) in zip(updates, tests, strict=True):
        past = carry_exact(past, u, test, lasting(u, tau_s))
        runs = carry_runs(runs, u, test, lasting(u, tau_s), 4000, rng)
    n, axes = len(updates[-1].prior), tests[-1][0].axes
    assert (axes @ runs.error).var(axis=1) == pytest.approx(position(tests[-1][0], past.own, n), rel=0.1)
    apart = (axes @ runs.apart).var(axis=2)
    assert apart[1:] == pytest.approx(np.einsum("da,iab,db->id", axes, past.apart, axes)[1:], rel=0.12)
    mixed = ((axes @ runs.apart) * (axes @ runs.error)).mean(axis=2)
    scale = np.sqrt(apart * (axes @ runs.error).var(axis=1))
    expected = np.einsum("da,iab,db->id", axes, past.cross[:, :, :n], axes)
    assert np.abs((mixed - expected) / np.maximum(scale, 1e-12))[1:].max() < 0.1


def test_errors_that_last_make_a_white_filter_too_sure(updates, tests):
    n, test = len(updates[-1].prior), tests[-1][0]
    white, slow = (carried(updates, tests, lambda u, t=t: lasting(u, t)) for t in (0.0, 300.0))
    ratio = np.sqrt(position(test, slow.own, n) / position(test, white.own, n))
    assert (ratio > 1.5).all()


def test_a_fault_moves_what_it_would_move_in_the_filter(updates, tests):
    sat = next(iter(updates[0].groups()))
    runs = None
    for u, (test, _) in zip(updates, tests, strict=True):
        errors = replace(as_believed(u), white_m=np.zeros(len(u.keys)))
        fault = np.array([[5.0 * (u is updates[-1] and k.startswith(f"{sat}:"))] for k in u.keys])
        runs = carry_runs(runs, u, test, errors, 1, None, fault)
    u, (test, memory) = updates[-1], tests[-1]
    assert runs.error[:, 0] == pytest.approx(u.K @ fault[:, 0], abs=1e-9)
    without = memory.members.index((sat,))
    moved = runs.error[:, 0] + runs.apart[without, :, 0]
    assert np.abs(test.axes @ moved).max() < 1e-6 < np.abs(test.axes @ runs.error[:, 0]).max()


def test_hidden_errors_against_a_count():
    rng, n = np.random.default_rng(4), 400_000
    sigma, sigma_ss, rho = 1.0, 0.7, 0.3
    e = 2.0 + sigma * rng.standard_normal(n)
    d = 1.8 + sigma_ss * (rho * (e - 2.0) / sigma + np.sqrt(1 - rho**2) * rng.standard_normal(n))
    counted = ((np.abs(e) > 3.0) & (np.abs(d) <= 1.5)).mean()
    found = hidden(3.0, 1.5, 2.0, 1.8, sigma, sigma_ss, rho * sigma * sigma_ss)
    assert found == pytest.approx(counted, abs=4.0 * np.sqrt(counted / n))


def test_hidden_errors_without_a_test_are_all():
    assert hidden(1.0, 1e6, 0.0, 0.0, 1.0, 1.0, 0.0) == pytest.approx(0.3173105, rel=1e-6)


def test_the_worst_hidden_error_is_at_the_least_level_the_risk():
    level = least_level(1e-7, 1.0, [1e-4], [2.0], [10.0])
    size = np.linspace(0.0, 20.0, 20001)
    p = hidden(level, 10.0, size, size, 1.0, 2.0, 0.0)
    assert 1e-4 * p.max() + (1.0 - 1e-4) * 2.0 * special.ndtr(-level) == pytest.approx(1e-7, rel=1e-3)


def filtered(F: float, Q: float, R: float) -> list[Update]:
    """Return two epochs of a filter of three independent states."""
    out, P = [], 1.0
    for k in range(2):
        P = F * P * F + Q
        u = Update.from_filter(
            k, F=np.eye(3) * F, Q=np.eye(3) * Q, H=np.eye(3), R=np.eye(3) * R, P_prior=np.eye(3) * P,
            nu=np.zeros(3), states=("pos:x", "pos:y", "pos:z"),
        )  # fmt: skip
        P = float(u.posterior.P[0, 0])
        out.append(u)
    return out


def test_large_white_errors_are_all_new_and_constant_ones_none():
    assert fresh_share(*filtered(0.0, 1.0, 1.0), np.eye(3), 5.0) == pytest.approx(1.0, abs=1e-5)
    assert fresh_share(*filtered(1.0, 0.0, 1e9), np.eye(3), 5.0) == pytest.approx(0.0, abs=1e-2)


def test_how_many_large_errors_are_new_against_a_count():
    before, update = filtered(0.9, 0.2, 1.0)
    rng, n = np.random.default_rng(5), 400_000
    e = np.sqrt(before.posterior.P[0, 0]) * rng.standard_normal(n)
    prior = 0.9 * e - np.sqrt(0.2) * rng.standard_normal(n)
    now = prior + update.K[0, 0] * (rng.standard_normal(n) - prior)
    was, found = (np.abs(x) > 2.0 * np.sqrt(u.posterior.P[0, 0]) for x, u in ((e, before), (now, update)))
    assert fresh_share(before, update, np.eye(3), 2.0)[0] == pytest.approx((~was[found]).mean(), abs=0.01)
