"""The inversion of a quadratic form's characteristic function against what is known in closed form."""

import numpy as np
import pytest

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.kernels.quadratic_tail import quadratic_tail, quadratic_threshold
from pntegrity.kernels.tails import chi2_tail, chi2_threshold, noncentral_tail


@pytest.mark.parametrize("dof", [1, 2, 3, 20, 100])
@pytest.mark.parametrize("p", [0.9999, 0.5, 1e-3, 1e-6, 1e-12])
def test_equal_weights_are_a_chi_square(dof: int, p: float) -> None:
    value = chi2_threshold(p, dof)
    assert quadratic_tail(3.7 * value, np.full(dof, 3.7)) == pytest.approx(
        float(chi2_tail(value, dof)), rel=1e-9
    )


@pytest.mark.parametrize("dof", [1, 3, 20])
@pytest.mark.parametrize("lam", [0.5, 20.0, 200.0])
def test_shifted_equal_weights_are_a_noncentral_chi_square(dof: int, lam: float) -> None:
    value = chi2_threshold(1e-6, dof)
    shift = np.random.default_rng(0).standard_normal(dof)
    shift *= np.sqrt(lam) / np.linalg.norm(shift)
    expected = float(noncentral_tail(value, dof, lam))
    assert quadratic_tail(value, np.ones(dof), shift) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("value", [1.0, 30.0, 100.0, 250.0])
def test_pairs_of_weights_are_a_sum_of_exponentials(value: float) -> None:
    w = np.array([5.0, 3.0, 1.0, 0.2])
    part = [np.prod([a / (a - b) for b in w if b != a]) for a in w]
    exact = float(sum(c * np.exp(-0.5 * value / a) for c, a in zip(part, w, strict=True)))
    assert quadratic_tail(value, np.repeat(w, 2)) == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("value", [20.0, 150.0, 400.0])
def test_unequal_shifted_weights_against_monte_carlo(value: float) -> None:
    rng, runs = np.random.default_rng(3), 400_000
    w, d = np.array([30.0, 10.0, 4.0, 1.0, 0.1]), np.array([0.0, 3.0, 0.0, 1.0, 5.0])
    q = ((rng.standard_normal((runs, 5)) + d) ** 2) @ w
    low, high = binomial_interval(int((q > value).sum()), runs, 0.9999)
    assert low <= quadratic_tail(value, w, d) <= high


@pytest.mark.parametrize("p", [0.3, 1e-3, 1e-9])
def test_threshold_inverts_the_tail(p: float) -> None:
    w = np.array([9.0, 2.0, 2.0, 0.01, 0.0])
    assert quadratic_tail(quadratic_threshold(p, w), w) == pytest.approx(p, rel=1e-8)


def test_edges() -> None:
    assert quadratic_tail(-1.0, [1.0, 2.0]) == 1.0
    assert quadratic_tail(0.0, [1.0]) == 1.0
    assert quadratic_tail(1.0, np.zeros(3)) == 0.0
    with pytest.raises(ValueError, match="negative"):
        quadratic_tail(1.0, [1.0, -0.5])
