"""An epoch of the ship with four sources: the filter alone, and with all monitors, in the same run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import pytest

from benchmarks.timing import cpu_of
from pntegrity.exclusion import Policy
from pntegrity.pipeline import Pipeline
from pntegrity.protocols import Monitor
from pntegrity.scenarios._vessel_logs import Ship, estimator, facts, ship, ship_log
from pntegrity.scenarios._vessel_pipeline import monitors_of
from pntegrity.simulate.vessel_log import VesselLog

pytestmark = pytest.mark.benchmark(timer=time.process_time, warmup=True, min_rounds=3)

SECONDS, SEED = 60.0, 5000


@pytest.fixture(scope="module")
def made() -> tuple[Ship, VesselLog]:
    """Satellites, four beacons, a transponder and a pressure sensor at 1 Hz, increments at 100 Hz."""
    vessel = ship(SECONDS, 1.0, depth=True)
    return vessel, ship_log(vessel, SEED)


def _through(vessel: Ship, log: VesselLog, monitors: Sequence[Monitor]) -> None:
    model = estimator(log, vessel.spec)
    driver = Pipeline(model, monitors, Policy(**dict(model.policy)))
    for epoch in log.epochs:
        driver.push(epoch)


def test_all_monitors_beside_the_filter_alone(
    benchmark: Any, noted: Any, made: tuple[Ship, VesselLog]
) -> None:
    vessel, log = made
    monitors = monitors_of(facts())
    benchmark.group = "vessel"
    benchmark.pedantic(lambda: _through(vessel, log, monitors), rounds=3, warmup_rounds=1)
    if benchmark.stats is None:
        return
    _through(vessel, log, ())
    alone = cpu_of(lambda: _through(vessel, log, ())) / len(log.epochs)
    spent = benchmark.stats.stats.min / len(log.epochs)
    seconds = (log.epochs[-1].t_ns - log.epochs[0].t_ns) * 1e-9 / len(log.epochs)
    benchmark.extra_info["times_the_filter_alone"] = spent / alone
    benchmark.extra_info["times_real_time"] = seconds / spent
    noted("ship", "multi_source, four sources, no monitor", alone)
    noted("ship", f"multi_source, all monitors: {spent / alone:.1f} times the filter alone", spent)
