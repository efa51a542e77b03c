"""The Monte Carlo of an audit: the tests that the monitor itself makes, counted with an honest interval."""

from typing import Any

import numpy as np
import pytest

from pntegrity.evaluate.montecarlo import Count, _Lane, _ready, count_alarms, plans
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.sraime import Sraime
from pntegrity.monitors.srctm import Srctm
from pntegrity.records import Update
from pntegrity.simulate.linear import draw

MONITORS = [
    Rctm(1e-2),
    Srctm(1e-2),
    Aime(1e-2),
    Sraime(1e-2),
    Glr(1e-2),
    Aime(1e-2, "published"),
    Sraime(1e-2, "published"),
]


def label(monitor: Any) -> str:
    return f"{monitor.name}-{monitor.variant}"


@pytest.mark.parametrize("monitor", MONITORS, ids=label)
def test_the_statistics_are_those_of_the_monitor(steady: tuple[Update, ...], monitor: Any) -> None:
    # GIVEN three runs drawn by the Monte Carlo over a short record
    updates, runs = steady[:12], 3
    dtype = np.float32 if monitor.name == "glr" else np.float64
    rng = np.random.default_rng(3)
    white = np.array([rng.standard_normal((20, runs), dtype=dtype) for _ in updates], dtype=np.float64)
    stretch = [_ready(p, None) for p in plans(updates, monitor)]
    found = {k: s.copy() for k, s in _Lane(np.random.default_rng(3), runs).statistics(stretch, None)}
    # WHEN the monitor itself sees the same innovations
    for r in range(runs):
        memory = monitor.start()
        for k, u in enumerate(draw(updates, white[:, :, r])):
            verdict, memory = monitor.step(memory, u)
            # THEN it has the same statistics, and makes no test where the Monte Carlo makes none
            assert (k in found) == (verdict.status != "unavailable")
            if k in found:
                assert verdict.statistic == pytest.approx(float(found[k][r]), rel=2e-5)
                assert verdict.threshold == stretch[k].threshold


@pytest.mark.parametrize("monitor", MONITORS[:5], ids=label)
def test_exact_monitors_keep_their_rate(steady: tuple[Update, ...], monitor: Any) -> None:
    low, high = count_alarms(plans(steady, monitor), 1500, np.random.default_rng(1)).interval(0.999)
    assert low <= 1e-2
    assert high >= (1e-2 / 3.0 if monitor.name == "glr" else 1e-2)


@pytest.mark.parametrize("monitor", MONITORS[:5], ids=label)
def test_also_where_satellites_come_and_go(eventful: tuple[Update, ...], monitor: Any) -> None:
    count = count_alarms(plans(eventful, monitor), 1500, np.random.default_rng(2))
    low, high = count.interval(0.999)
    assert low <= 1e-2
    assert high >= (1e-2 / 3.0 if monitor.name == "glr" else 1e-2)
    assert count.alarms[35] == -1  # no rows
    assert count.alarms[3] == -1  # states initialised from its own rows


@pytest.mark.parametrize("monitor", [Aime(1e-2), Glr(1e-2)], ids=label)
def test_the_count_does_not_depend_on_threads_or_stretches(
    steady: tuple[Update, ...], monitor: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned = list(plans(steady, monitor))
    one = count_alarms(planned, 500, np.random.default_rng(7), threads=1)
    two = count_alarms(planned, 500, np.random.default_rng(7), threads=2)
    np.testing.assert_array_equal(one.by_run, two.by_run)
    np.testing.assert_array_equal(one.alarms, two.alarms)
    assert one.alarms.sum() == one.total


def test_a_record_in_stretches_is_one_record(
    steady: tuple[Update, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    import pntegrity.evaluate.montecarlo as module

    planned, whole = list(plans(steady, Aime(1e-2))), module._stretches
    monkeypatch.setattr(module, "_stretches", lambda p: whole(p, 0))
    count = count_alarms(planned, 400, np.random.default_rng(8))
    assert len(count.alarms) == len(steady)
    low, high = count.interval(0.999)
    assert low <= 1e-2 <= high


def test_a_fault_raises_the_rate_from_its_onset(steady: tuple[Update, ...]) -> None:
    means = [np.full(20, 10.0 if k >= 100 else 0.0) for k in range(len(steady))]
    count = count_alarms(plans(steady, Rctm(1e-6)), 50, np.random.default_rng(9), means=means)
    assert count.alarms[:100].max() == 0
    assert count.alarms[100:].min() == 50


def test_overlapping_windows_widen_the_interval() -> None:
    rng = np.random.default_rng(0)
    independent = Count(np.zeros(100, dtype=np.int64), rng.binomial(100, 0.01, 5000), 5)
    clustered = Count(np.zeros(100, dtype=np.int64), 5 * rng.binomial(100, 0.002, 5000), 5)
    assert independent.tests_an_independent_one == pytest.approx(1.0, abs=0.1)
    assert clustered.tests_an_independent_one == pytest.approx(5.0, rel=0.1)
    assert np.diff(clustered.interval()) > 1.8 * np.diff(independent.interval())


def test_without_an_alarm_the_whole_overlap_is_assumed() -> None:
    count = Count(np.zeros(100, dtype=np.int64), np.zeros(50, dtype=np.int64), 5)
    assert count.tests_an_independent_one == 5.0
    assert count.interval()[0] == 0.0
    assert Count(np.full(3, -1), np.zeros(2, dtype=np.int64), 1).interval() == (0.0, pytest.approx(0.995))
