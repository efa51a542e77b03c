"""Protection levels against the equation itself, in 60 digits, and against what really happens."""

import numpy as np
import pytest
from scipy import integrate, optimize
from scipy.stats import norm

from pntegrity.kernels.protection import (
    dominant_mode,
    false_alert_factor,
    largest_threshold,
    least_level,
    observed_level,
    protection_level,
)

mpmath = pytest.importorskip("mpmath")
Bank = tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def bank(seed: int, modes: int = 20, p_fa: float = 2.5e-7) -> Bank:
    """Return sigma0, p, sigma, sigma_ss, bias and threshold of a bank of optimal filters."""
    rng = np.random.default_rng(seed)
    s0 = float(rng.uniform(0.05, 2.0))
    ss = s0 * 10.0 ** rng.uniform(-2.0, 0.7, modes)
    p = 10.0 ** rng.uniform(-8.0, -4.0, modes)
    bias = rng.uniform(0.0, 0.5, modes) * s0
    return s0, p, np.hypot(s0, ss), ss, bias, ss * false_alert_factor(p_fa, modes)


def log_risk(level: float, s0: float, b0: float, p, s, b, t) -> float:
    """Return the logarithm of the right side of the equation, in 60 digits."""
    with mpmath.workdps(60):
        tail = [
            mpmath.mpf(float(pi)) * q((level - ti - bi) / si)
            for pi, si, bi, ti in zip(p, s, b, t, strict=True)
        ]
        return float(mpmath.log(2 * q((level - b0) / s0) + sum(tail)))


def q(z: float):
    return mpmath.erfc(mpmath.mpf(float(z)) / mpmath.sqrt(2)) / 2


@pytest.mark.parametrize("risk", [1e-2, 1e-7, 2.5e-9, 1e-15, 1e-30, 1e-200])
@pytest.mark.parametrize("seed", range(5))
def test_the_root_is_one_in_60_digits(risk: float, seed: int) -> None:
    s0, p, s, _, b, t = bank(seed)
    level = protection_level(risk, s0, 0.1, p, s, b, t)
    around = [log_risk(level * (1.0 + e), s0, 0.1, p, s, b, t) for e in (-1e-9, 1e-9)]
    assert around[0] > np.log(risk) > around[1]


def test_without_modes_it_is_the_quantile() -> None:
    for risk in (0.3, 1e-7, 1e-12):
        level = protection_level(risk, 2.0, 0.3, [], [], [], [])
        assert level == pytest.approx(0.3 + 2.0 * norm.isf(risk / 2), rel=1e-12)
        assert least_level(risk, 2.0, [], [], []) == pytest.approx(2.0 * norm.isf(risk / 2), rel=1e-9)


def test_modes_that_change_nothing_and_sure_faults() -> None:
    # sigma_i = sigma0 and no threshold; a fault that is always there; both have a closed form
    level = protection_level(1e-7, 1.0, 0.0, [1e-5], [1.0], [0.0], [0.0])
    assert level == pytest.approx(norm.isf(1e-7 / (2.0 + 1e-5)), rel=1e-12)
    level = protection_level(1e-7, 1e-3, 0.0, [1.0], [2.0], [0.5], [4.0])
    assert level == pytest.approx(4.5 + 2.0 * norm.isf(1e-7), rel=1e-12)


@pytest.mark.parametrize("undetected", [np.inf, np.nan])
def test_what_nothing_detects_is_charged_whole_or_makes_it_infinite(undetected: float) -> None:
    args = ([1e-5, 4e-8], [1.2, undetected], [0.0, 0.0], [3.0, undetected])
    level = protection_level(1e-7, 1.0, 0.0, *args)
    assert level == pytest.approx(protection_level(6e-8, 1.0, 0.0, [1e-5], [1.2], [0.0], [3.0]), rel=1e-12)
    assert protection_level(3e-8, 1.0, 0.0, *args) == np.inf
    assert dominant_mode(np.inf, 1.0, 0.0, *args) == 1
    assert least_level(3e-8, 1.0, [1e-5, 4e-8], [0.7, undetected], [3.0, undetected]) == np.inf


@pytest.mark.parametrize(
    ("risk", "s0", "b0"),
    [(0.0, 1.0, 0.0), (-1e-9, 1.0, 0.0), (np.nan, 1.0, 0.0), (1e-7, np.inf, 0.0), (1e-7, np.nan, 0.0)],
)
def test_no_bound_is_infinite_not_nan(risk: float, s0: float, b0: float) -> None:
    assert protection_level(risk, s0, b0, [1e-5], [1.0], [0.0], [1.0]) == np.inf


@pytest.mark.parametrize("p", [-1e-9, 1.1, np.nan])
def test_a_probability_that_is_none_is_refused(p: float) -> None:
    with pytest.raises(ValueError, match="probability"):
        protection_level(1e-7, 1.0, 0.0, [p], [1.0], [0.0], [1.0])


def test_it_grows_with_everything_that_makes_it_worse() -> None:
    s0, p, s, _, b, t = bank(3)
    level = protection_level(1e-7, s0, 0.1, p, s, b, t)
    i = dominant_mode(level, s0, 0.1, p, s, b, t)
    more = np.where(np.arange(20) == i, 2.0, 1.0)
    for args in (
        (1e-7, s0, 0.1, p * more, s, b, t),
        (1e-7, s0, 0.1, p, s * more, b, t),
        (1e-7, s0, 0.1, p, s, b + more - 1.0, t),
        (1e-7, s0, 0.1, p, s, b, t * more),
        (1e-8, s0, 0.1, p, s, b, t),
    ):
        assert protection_level(*args) > 1.0001 * level
    grown = [protection_level(1e-7, s0, 0.1, f * p, s, b, t) for f in (0.0, 0.1, 1.0, 10.0, 100.0)]
    assert (np.diff(grown) > 0.0).all()


def test_the_dominant_mode_is_that_without_which_the_level_falls_most() -> None:
    for seed in range(10):
        s0, p, s, _, b, t = bank(seed)
        level = protection_level(1e-7, s0, 0.0, p, s, b, t)
        others = [
            protection_level(1e-7, s0, 0.0, np.delete(p, i), *(np.delete(a, i) for a in (s, b, t)))
            for i in range(20)
        ]
        assert dominant_mode(level, s0, 0.0, p, s, b, t) == int(np.argmin(others))
    assert dominant_mode(5.0, 1.0, 0.0, [1e-9], [1.0], [0.0], [0.0]) == -1


@pytest.mark.parametrize("seed", range(5))
def test_an_observed_level_is_a_root_of_two_tails_and_what_is_more_than_expected(seed: int) -> None:
    s0, p, s, _, b, expected = bank(seed)
    apart = np.random.default_rng(seed).uniform(-2.0, 2.0, len(p)) * expected
    over = np.abs(apart) - expected
    level, mode = observed_level(1e-7, s0, 0.1, p, s, b, expected, apart)
    root = level - over.max()
    around = [log_risk(root * (1.0 + e), s0, 0.1, 2.0 * p, s, b, expected) for e in (-1e-9, 1e-9)]
    assert around[0] > np.log(1e-7) > around[1]
    assert over.max() > 0.0
    assert mode == int(np.argmax(over))


def test_an_observed_level_without_surprises_is_that_of_the_dominant_mode() -> None:
    s0, p, s, _, b, expected = bank(3)
    level, mode = observed_level(1e-7, s0, 0.1, p, s, b, expected, 0.5 * expected)
    assert level == pytest.approx(protection_level(1e-7, s0, 0.1, 2.0 * p, s, b, expected), rel=1e-12)
    assert mode == dominant_mode(level, s0, 0.1, p, s, b, expected)
    undetected = np.where(np.arange(20) == 4, np.inf, s)
    assert observed_level(p[4], s0, 0.1, p, undetected, b, expected, 0.0 * p) == (np.inf, 4)


def hidden(b, level: float, s0: float, ss: float, t: float):
    """Return the probability of an error above `level` and no alert under a fault that moves both by `b`."""
    exceeds = norm.sf((level - b) / s0) + norm.cdf((-level - b) / s0)
    return exceeds * (norm.sf((b - t) / ss) - norm.sf((b + t) / ss))


def worst(level: float, s0: float, ss: float, t: float) -> float:
    """Return the worst such probability, by a search of a fine grid and a polish."""
    grid = np.linspace(0.0, level + t + 8.0 * (s0 + ss), 4001)
    k = int(np.argmax(hidden(grid, level, s0, ss, t)))
    near = (grid[max(k - 1, 0)], grid[min(k + 1, 4000)])
    best = optimize.minimize_scalar(
        lambda b: -hidden(b, level, s0, ss, t), bounds=near, method="bounded", options={"xatol": 1e-10}
    )
    return max(-float(best.fun), hidden(float(grid[k]), level, s0, ss, t))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("p_fa", [1e-2, 2.5e-7])
def test_the_least_level_has_the_exact_worst_risk(seed: int, p_fa: float) -> None:
    s0, p, _, ss, _, t = bank(seed, 6, p_fa)
    for risk in (1e-4, 2.5e-8, 1e-12):
        level = least_level(risk, s0, p, ss, t)
        total = (1.0 - p.sum()) * 2.0 * norm.sf(level / s0)
        total += sum(pi * worst(level, s0, si, ti) for pi, si, ti in zip(p, ss, t, strict=True))
        assert total == pytest.approx(risk, rel=1e-6)


@pytest.mark.parametrize("seed", range(40))
def test_no_least_level_is_above_the_protection_level(seed: int) -> None:
    p_fa = (0.5, 1e-2, 2.5e-7)[seed % 3]
    s0, p, s, ss, _, t = bank(seed, 1 + seed, p_fa)
    for risk in (1e-3, 1e-7, 1e-10, 1e-15):
        least, level = least_level(risk, s0, p, ss, t), protection_level(risk, s0, 0.0, p, s, 0.0 * s, t)
        assert least <= level
        assert least >= 0.6 * level


def test_separations_that_do_not_exist_cost_nothing() -> None:
    alone = least_level(1e-7, 1.0, [], [], [])
    assert least_level(1e-7, 1.0, [1e-5], [0.0], [0.0]) <= protection_level(
        1e-7, 1.0, 0.0, [1e-5], [1.0], [0.0], [0.0]
    )
    assert least_level(1e-7, 1.0, [1e-5], [0.0], [0.0]) == pytest.approx(alone, rel=1e-6)


def test_an_integral_over_errors_and_separations_gives_the_same_probability() -> None:
    # GIVEN one mode and the least level of a risk large enough to integrate
    s0, ss, p, risk = 1.0, 1.3, 0.02, 1e-3
    t = ss * false_alert_factor(1e-2, 1)
    level = least_level(risk, s0, [p], [ss], [t])

    # WHEN the joint density of the error of a solution and of its subset is integrated, with a fault b in the
    # full one only: e0 = e1 + d, and d is independent of e0
    def misleading(b: float) -> float:
        def given(e1: float) -> float:
            # d | e1 for optimal solutions: cov(e1, d) = -ss^2, var(e1) = s0^2 + ss^2
            mean, sd = b - ss**2 / (s0**2 + ss**2) * e1, s0 * ss / np.hypot(s0, ss)
            high = norm.cdf((t - mean) / sd) - norm.cdf((max(-t, level - e1) - mean) / sd)
            low = norm.cdf((min(t, -level - e1) - mean) / sd) - norm.cdf((-t - mean) / sd)
            return (max(high, 0.0) + max(low, 0.0)) * norm.pdf(e1, scale=np.hypot(s0, ss))

        kinks = [-level - t, -level + t, level - t, level + t]
        return float(integrate.quad(given, -15.0, 15.0, points=kinks, limit=400, epsabs=1e-12)[0])

    found = optimize.minimize_scalar(lambda b: -misleading(b), bounds=(0.0, 8.0), method="bounded")
    # THEN at its worst the risk is the one asked for, and the protection level keeps it
    assert (1.0 - p) * 2.0 * norm.sf(level / s0) - p * found.fun == pytest.approx(risk, rel=1e-6)
    assert protection_level(risk, s0, 0.0, [p], [np.hypot(s0, ss)], [0.0], [t]) > level


def test_drawn_errors_exceed_the_least_level_as_often_as_they_may() -> None:
    # GIVEN two solutions, the second without the row that may fail, and its worst fault
    rng, n = np.random.default_rng(11), 2_000_000
    s0, ss, p, risk = 0.8, 0.9, 0.05, 4e-3
    t = ss * false_alert_factor(0.02, 1)
    least = least_level(risk, s0, [p], [ss], [t])
    level = protection_level(risk, s0, 0.0, [p], [np.hypot(s0, ss)], [0.0], [t])
    b = float(
        optimize.minimize_scalar(lambda x: -hidden(x, least, s0, ss, t), bounds=(0, 9), method="bounded").x
    )
    # WHEN faults come and go
    fault = rng.random(n) < p
    e0, d = s0 * rng.standard_normal(n) + b * fault, ss * rng.standard_normal(n) + b * fault
    silent = ~fault | (np.abs(d) <= t)
    # THEN the misleading share is the risk at the least level, and below it at the protection level
    share = float((silent & (np.abs(e0) > least)).mean())
    assert share == pytest.approx(risk, abs=4.0 * np.sqrt(risk / n))
    assert float((silent & (np.abs(e0) > level)).mean()) < risk


def test_the_false_alert_factor_shares_the_probability() -> None:
    assert false_alert_factor(1e-6, 1) == pytest.approx(norm.isf(5e-7), rel=1e-12)
    assert 2.0 * 20 * norm.sf(false_alert_factor(2.5e-7, 20)) == pytest.approx(2.5e-7, rel=1e-12)
    assert false_alert_factor(1e-6, 0) == np.inf


def test_the_effective_threshold_is_of_probable_modes_only() -> None:
    assert largest_threshold([1e-5, 1e-6, 1e-4], [2.0, 9.0, 1.0], 1e-5) == 2.0
    assert largest_threshold([], [], 1e-5) == 0.0


def test_the_four_cases_of_the_paper_are_ordered() -> None:
    # GIVEN 16 satellites, and products that matter more and more
    s0, ss = 0.5, np.concatenate([np.linspace(0.05, 0.3, 16), [0.5, 1.5]])
    t = ss * false_alert_factor(2.5e-7, 18)
    satellites, trop, iono = (
        (np.arange(18) < 16) * 1e-5,
        (np.arange(18) == 16) * 1e-5,
        (np.arange(18) == 17) * 1e-5,
    )
    cases = (0.0 * satellites, satellites, satellites + trop, satellites + trop + iono)
    levels = [protection_level(5e-8, s0, 0.0, p, np.hypot(s0, ss), 0.0 * ss, t) for p in cases]
    least = [least_level(5e-8, s0, p, ss, t) for p in cases]
    assert (np.diff(levels) > 0.0).all()
    assert (np.diff(least) > 0.0).all()
    assert (np.array(least[1:]) < levels[1:]).all()
