"""The campaign on the published detection factor's false-alarm rate, at a size for every day."""

from __future__ import annotations

import numpy as np

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.kernels.factor_set import FactorSet
from pntegrity.scenarios.evidence_factor_set_rate import alarms, recursive, sky, subsets


def test_the_exact_factor_keeps_its_rate_and_the_published_one_multiplies_it():
    rows, rng = sky(12, np.random.default_rng(2)), np.random.default_rng(3)
    low, high = binomial_interval(alarms(rows, "exact", 1e-3, 200_000, rng), 200_000, 0.999)
    assert low <= 1e-3 <= high
    published = alarms(rows, "published", 1e-3, 200_000, rng)
    assert binomial_interval(published, 200_000, 0.999)[0] > 1e-2


def test_adaptation_ends_at_the_settled_sigmas_or_below():
    rows, rng = sky(12, np.random.default_rng(2)), np.random.default_rng(4)
    options = FactorSet("published", p_fa=1e-3, window=200, missed_limit_m=1e3, false_alarm_limit_m=1e3)
    adapting = recursive(options, rows, 400, 3000, rng)
    settled = alarms(rows, "published", 1e-3, 300_000, rng) / 300_000
    low, high = binomial_interval(adapting, 3000, 0.999)
    assert settled < high  # what is left out never enters the window
    assert low < 2.0 * settled


def test_more_faults_need_more_subsets_but_never_all():
    rng = np.random.default_rng(5)
    one, six = subsets(16, 1, 20, rng), subsets(16, 6, 20, rng)
    assert max(one) <= 16 + 15
    assert np.median(one) < np.median(six)
    assert max(six) <= 115
