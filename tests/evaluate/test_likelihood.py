"""Named numbers are walked to the largest likelihood, and raised where errors last."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.evaluate.likelihood import STEPS, walked
from pntegrity.evaluate.overbound import lasting
from pntegrity.sensors.noise import Fitted


def valley(best, weight=400.0):
    """Return a cost with its minimum at some values."""
    return lambda v: weight * sum(np.log(v[n] / x) ** 2 for n, x in best.items())


def walk(values, p, cost):
    best = cost(values)
    for step in STEPS:
        values, best = walked(values, best, cost, p, step)
    return values, best


@pytest.mark.parametrize("truth", [0.02, 0.7, 1.0, 30.0])
def test_a_value_is_found_up_and_down_and_the_others_stay(truth):
    cost = valley({"a": truth, "b": 5.0})
    found, best = walk({"a": 1.0, "b": 2.0}, Fitted("a", 1e-3, 1e3), cost)
    assert found["a"] == pytest.approx(truth, rel=0.06)
    assert found["b"] == 2.0
    assert best == pytest.approx(cost(found))


def test_it_stays_within_its_range_and_where_the_cost_is_flat():
    assert walk({"a": 1.0}, Fitted("a", 0.5, 1e3), valley({"a": 0.01}))[0]["a"] == 0.5
    assert walk({"a": 1.0}, Fitted("a", 1e-3, 1e3), valley({"a": 1.3}, weight=1.0))[0]["a"] == 1.0


def test_the_size_goes_with_its_correlation_time_at_equal_drive():
    found, _ = walk({"tau": 10.0, "size": 1.0}, Fitted("tau", 1.0, 1e3, size="size"), valley({"tau": 90.0}))
    assert found["size"] == pytest.approx(np.sqrt(found["tau"] / 10.0))


def walking(n, rho, seed):
    """Return unit values that are correlated by `rho` from one to the next."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=n)
    for i in range(1, n):
        x[i] = rho * x[i - 1] + np.sqrt(1.0 - rho**2) * x[i]
    return x


def test_white_errors_are_not_raised_and_those_that_last_are():
    # the mean of 20 with rho 0.8 has 6.6 times the variance of a white one
    for seed in range(20):
        assert lasting([walking(100, 0.0, [seed, i]) for i in range(4)]) < 1.15
        assert 1.6 < lasting([walking(300, 0.8, [seed, i]) for i in range(4)]) < 2.9
    # AND of too few values nothing is said
    assert lasting([walking(24, 0.95, 1)]) == 1.0
    assert lasting([]) == 1.0
