"""Alarms against known faults."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from pntegrity.evaluate.alarms import evaluate
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.simulate.faults import parse_fault

SECOND = 10**9
T = SECOND * np.arange(100, dtype=np.int64)


def flags(*epochs, unavailable=()):
    return [None if k in unavailable else k in epochs for k in range(100)]


def test_rates_and_delays():
    faults = [parse_fault("G05 bias 5 m 20:30"), parse_fault("E11 ramp 1 m/s 60:70")]
    score = evaluate(T, flags(10, 23, 24, 35), faults, recovery_s=10.0)
    assert score.clean_epochs == 100 - 2 * 20
    assert score.false_alarms == 1  # 35 s is in the first fault's recovery
    assert score.p_fa == pytest.approx(1 / 60)
    assert score.p_md == 0.5
    assert score.delays_s == (3.0, None)
    assert score.median_delay_s == 3.0
    assert score.right_satellite == (None, None)
    assert score.wrong_exclusions is None


def test_nothing_to_count_is_none():
    score = evaluate(T, [None] * 100, [parse_fault("G05 bias 5 m")])
    assert (score.p_fa, score.p_fa_interval, score.p_md, score.p_md_interval) == (None,) * 4
    assert score.median_delay_s is None
    assert evaluate([], [], []).p_fa is None


def test_without_a_fault_there_is_no_missed_detection():
    score = evaluate(T, flags(3, unavailable=(0, 1)), [])
    assert score.p_fa == pytest.approx(1 / 98)
    assert score.p_md is None


def test_an_unavailable_epoch_is_neither_clean_nor_a_test_of_a_fault():
    score = evaluate(T, flags(unavailable=range(20, 30)), [parse_fault("G05 bias 5 m 20:30")])
    assert score.tested_faults == 0
    assert score.p_md is None
    assert score.delays_s == (None,)


def test_who_was_blamed():
    faults = [parse_fault("G05 bias 5 m 20:40"), parse_fault("E11 bias 5 m 60:80")]
    excluded = [set() for _ in range(100)]
    for k in range(22, 45):
        excluded[k] = {"G05"}
    excluded[10] = excluded[11] = {"G07"}
    for k in range(61, 70):
        excluded[k] = {"G09"}
    score = evaluate(T, flags(22, 61), faults, excluded=excluded)
    assert score.right_satellite == (True, False)
    assert score.wrong_exclusions == ((10 * SECOND, "G07"), (61 * SECOND, "G09"))
    assert score.delays_s == (2.0, 1.0)


def test_an_exclusion_without_an_alarm_is_a_detection():
    excluded = [{"G05"} if 25 <= k < 30 else set() for k in range(100)]
    score = evaluate(T, flags(), [parse_fault("G05 bias 5 m 20:40")], excluded=excluded)
    assert score.delays_s == (5.0,)
    assert score.p_md == 0.0


def test_a_readmitted_satellite_that_goes_again_in_recovery_is_not_wrong():
    excluded = [{"G05"} if k in (25, 44) else set() for k in range(100)]
    score = evaluate(T, flags(25), [parse_fault("G05 bias 5 m 20:40")], excluded=excluded, recovery_s=10.0)
    assert score.wrong_exclusions == ()


def test_lengths_must_fit():
    with pytest.raises(ValueError, match="same length"):
        evaluate(T, [True], [])


@given(st.integers(0, 200), st.integers(1, 200), st.floats(0.5, 0.999))
def test_the_interval_is_clopper_and_pearsons(k, n, confidence):
    k = min(k, n)
    low, high = binomial_interval(k, n, confidence)
    half = 0.5 * (1.0 - confidence)
    assert 0.0 <= low <= k / n <= high <= 1.0
    if k > 0:
        assert binom.sf(k - 1, n, low) == pytest.approx(half, rel=1e-6)
    if k < n:
        assert binom.cdf(k, n, high) == pytest.approx(half, rel=1e-6)


def test_no_trial_tells_nothing_and_nonsense_is_refused():
    assert binomial_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match="`k`"):
        binomial_interval(3, 2)
    with pytest.raises(ValueError, match="`confidence`"):
        binomial_interval(1, 2, 1.0)
