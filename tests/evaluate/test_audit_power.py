"""What an audit says of power: against Monte Carlo, and in words where nothing can be seen."""

from typing import Any

import numpy as np
import pytest

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.evaluate.montecarlo import count_alarms, plans
from pntegrity.evaluate.power import Probe, Shape, detection
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.sraime import Sraime
from pntegrity.monitors.srctm import Srctm
from pntegrity.records import Update

ONSET, RUNS = 100, 4000


@pytest.mark.parametrize("kind", ["bias", "ramp"])
@pytest.mark.parametrize(
    "monitor",
    [Rctm(1e-3), Srctm(1e-3), Aime(1e-3), Sraime(1e-3), Aime(1e-3, "published"), Glr(1e-3)],
    ids=lambda m: f"{m.name}-{m.variant}" if hasattr(m, "name") else m,
)
def test_predicted_power_is_that_of_monte_carlo(steady: tuple[Update, ...], monitor: Any, kind: str) -> None:
    # GIVEN a fault that is seen in four of five runs at some epoch
    planned, late = list(plans(steady, monitor))[: ONSET + 21], 1 if kind == "bias" else 20
    probe = Probe([Shape("G02:C1C", kind)], steady[ONSET])
    reach = [probe.take(p) for p in planned[ONSET:]]
    size = reach[late].size(0, 0.8)
    assert reach[late].power(0, size) == pytest.approx(0.8, abs=1e-4)
    predicted = list(detection(planned[ONSET:], Shape("G02:C1C", kind), size))
    # WHEN it is drawn with noise
    none = [np.zeros(20)] * ONSET
    means = [*none, *(size * w[:, 0] for w in probe.white)]
    count = count_alarms(planned, RUNS, np.random.default_rng(1), means=means)
    # THEN it is seen as often as predicted (a bank: at least as often)
    for delay in sorted({late, 5, 15}):
        low, high = binomial_interval(int(count.alarms[ONSET + delay]), RUNS, 0.9999)
        assert predicted[delay] <= high
        assert low <= predicted[delay] or monitor.name == "glr"


def test_no_test_no_power(eventful: tuple[Update, ...]) -> None:
    powers = list(detection(list(plans(eventful, Rctm(1e-3)))[30:40], Shape("G04:C1C", "bias"), 100.0))
    assert powers[5] is None
    assert powers[0] == pytest.approx(1.0)


def test_a_fault_of_no_size_alarms_as_often_as_none(steady: tuple[Update, ...]) -> None:
    for monitor in (Rctm(1e-3), Aime(1e-3)):
        assert next(detection(plans(steady, monitor), Shape("G02:C1C", "bias"), 0.0)) == pytest.approx(1e-3)


def test_a_row_that_is_not_there_is_not_seen(steady: tuple[Update, ...]) -> None:
    probe = Probe([Shape("E99:C1C", "bias")], steady[0])
    reach = probe.take(next(plans(steady, Rctm(1e-3))))
    assert reach.size(0, 0.9) == np.inf
