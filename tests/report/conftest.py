"""Runs that the tests of the report share."""

from __future__ import annotations

import numpy as np
import pytest
import simulated

from pntegrity.pipeline import Outcome
from pntegrity.report.facts import RunFacts


@pytest.fixture(scope="session")
def faulty() -> list[Outcome]:
    """Two faults, both excluded and readmitted, one of them with a repair; a gap."""
    return simulated.run(simulated.epochs(fault=simulated.faults))


@pytest.fixture(scope="session")
def unresolved() -> list[Outcome]:
    """The same faults, nothing excluded."""
    return simulated.run(simulated.epochs(fault=simulated.faults), exclude=False)


@pytest.fixture(scope="session")
def clean() -> list[Outcome]:
    return simulated.run(simulated.epochs(60))


@pytest.fixture
def facts() -> RunFacts:
    return RunFacts(
        estimator="spp_kf",
        config={"obs": "rover.rnx", "monitor": {"aime": {"window": 5}}},
        noise_name="default",
        blind_spots=("slow ramps",),
        truth_m=np.tile(simulated.TRUTH, (100, 1)),
        notes=("E20: no ephemeris",),
        started="2019-01-14T06:15:00",
    )
