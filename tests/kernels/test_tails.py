"""Tails and thresholds against references of their own."""

import numpy as np
import pytest
from scipy import integrate, special

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.kernels.tails import (
    chi2_tail,
    chi2_threshold,
    effective_tests,
    joint_exceedance,
    max_threshold,
    noncentral_tail,
    noncentrality_for,
    two_sided_tail,
)

mpmath = pytest.importorskip("mpmath")


def reference_tail(value: float, dof: int) -> float:
    with mpmath.workdps(40):
        half = mpmath.mpf(dof) / 2
        return float(mpmath.gammainc(half, mpmath.mpf(value) / 2, mpmath.inf, regularized=True))


@pytest.mark.parametrize("dof", [1, 2, 3, 8, 20, 60, 200])
@pytest.mark.parametrize("p", [0.5, 1e-3, 1e-6, 1e-9, 1e-12])
def test_chi2_threshold_has_its_tail_by_mpmath(dof: int, p: float) -> None:
    value = chi2_threshold(p, dof)
    assert reference_tail(value, dof) == pytest.approx(p, rel=1e-9)
    assert float(chi2_tail(value, dof)) == pytest.approx(reference_tail(value, dof), rel=1e-9)


@pytest.mark.parametrize("h", [2.0, 4.0, 6.0, 8.0])
def test_two_sided_tail_by_mpmath(h: float) -> None:
    with mpmath.workdps(40):
        assert float(two_sided_tail(h)) == pytest.approx(float(mpmath.erfc(h / mpmath.sqrt(2))), rel=1e-12)


@pytest.mark.parametrize(("dof", "lam"), [(1, 4.0), (3, 30.0), (20, 10.0), (20, 80.0)])
def test_noncentral_tail_is_a_poisson_mixture(dof: int, lam: float) -> None:
    value = chi2_threshold(1e-6, dof)
    n = np.arange(400)
    weight = np.exp(n * np.log(lam / 2) - lam / 2 - special.gammaln(n + 1))
    mixture = float((weight * chi2_tail(value, dof + 2 * n)).sum())
    assert float(noncentral_tail(value, dof, lam)) == pytest.approx(mixture, rel=1e-9)


def test_noncentral_tail_without_a_fault_is_the_central_one() -> None:
    assert float(noncentral_tail(30.0, 5, 0.0)) == pytest.approx(float(chi2_tail(30.0, 5)), rel=1e-12)


@pytest.mark.parametrize("power", [0.5, 0.9, 0.999])
def test_noncentrality_gives_the_power(power: float) -> None:
    value = chi2_threshold(1e-6, 20)
    lam = noncentrality_for(power, value, 20)
    assert float(noncentral_tail(value, 20, lam)) == pytest.approx(power, rel=1e-8)


@pytest.mark.parametrize("h", [2.0, 3.3, 5.0, 7.0, 10.0])
@pytest.mark.parametrize("rho", [0.0, 0.3, 0.9, 0.99, -0.7])
def test_joint_exceedance_against_integration(rho: float, h: float) -> None:
    scale = np.sqrt(1.0 - rho * rho)

    def joint(a: float) -> float:  # the density of a, scaled by that of h, times what b does given a
        both = special.ndtr((rho * a - h) / scale) + special.ndtr((-rho * a - h) / scale)
        return float(np.exp(0.5 * (h * h - a * a)) * both)

    breaks = [h + x / h for x in (1.0, 3.0, 10.0)]
    top = integrate.quad(joint, h, h + 14.0, points=breaks, epsabs=0.0, epsrel=1e-11, limit=400)[0]
    base = integrate.quad(lambda a: np.exp(0.5 * (h * h - a * a)), h, h + 14.0, points=breaks, epsrel=1e-12)[
        0
    ]
    assert float(joint_exceedance(rho, h)) == pytest.approx(top / base, rel=2e-6)


def test_effective_tests_of_independent_and_of_equal_hypotheses() -> None:
    assert effective_tests(np.zeros(50), 4.0) == pytest.approx(50.0, rel=1e-3)
    equal = np.array([0.0, *np.full(49, 1.0 - 1e-12)])
    assert effective_tests(equal, 4.0) == pytest.approx(1.0, abs=1e-3)


def test_effective_tests_is_the_sum_over_the_tree() -> None:
    rho, h = np.array([0.0, 0.95, 0.5, 0.99, 0.0, 0.8]), 4.37
    exact = len(rho) - float(joint_exceedance(rho[rho > 0.0], h).sum()) - float(two_sided_tail(h))
    assert effective_tests(rho, h) == pytest.approx(exact, rel=2e-4)


@pytest.mark.parametrize("rho", [0.3, 0.9, 0.98])
def test_max_threshold_holds_its_rate_for_a_chain(rho: float) -> None:
    rng, n, runs, p = np.random.default_rng(4), 40, 200_000, 0.01
    h = max_threshold(np.array([0.0, *np.full(n - 1, rho)]), p)
    u = rng.standard_normal(runs)
    largest = np.abs(u)
    for _ in range(n - 1):
        u = rho * u + np.sqrt(1.0 - rho * rho) * rng.standard_normal(runs)
        np.maximum(largest, np.abs(u), out=largest)
    low, high = binomial_interval(int((largest > h).sum()), runs, 0.9999)
    assert low <= p
    assert high >= 0.7 * p


def test_no_hypotheses_no_alarm() -> None:
    assert max_threshold(np.zeros(0), 1e-6) == np.inf
