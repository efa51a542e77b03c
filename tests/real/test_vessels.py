"""Real vessels as vehicles: fixes and ranges with a unit simulated on the track."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from pntegrity.scenarios._vehicle_logs import missing, vessel, vessels

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


@pytest.fixture(scope="module", params=["NCL1", "SAGA"])
def short(request, shared):
    lost = missing(shared)
    if lost:
        pytest.skip(lost)
    begin = vessels()[request.param]["spans"][0][0]
    return vessel(request.param, shared, (begin, begin + 600))


def test_nothing_alarms_without_a_fault_and_the_innovations_are_as_stated(short):
    ride = short.ride()
    assert not ride.first_alarms.any()
    assert not ride.left
    assert 0.2 < ride.nis("gnss", 100.0) < 1.3
    assert 0.05 < ride.nis("lbl", 100.0) < 1.3
    nu, _ = ride.innovations("lbl", 100.0)
    assert np.sqrt(np.mean(nu**2)) * 745.0 < 0.25


def test_a_beacon_that_is_wrong_is_left_out_and_nothing_else(short):
    name = f"lbl.{short.beacons[0]}"
    ride = short.ride([f"{name} bias 5 ms 300:"])
    assert {n for _, n in ride.left} == {name}
    assert 300.0 <= ride.left[0][0] <= 360.0
    assert not ride.back


def test_a_receiver_that_drifts_upwards_is_left_out_and_nothing_else(short):
    ride = short.ride(["gnss:up ramp 0.05 m/s 300:"])
    assert {n for _, n in ride.left} == {"gnss"}
    alone = short.ride(["gnss:up ramp 0.05 m/s 300:"], monitored=False)
    worst = [float(np.nanmax(np.linalg.norm(r.errors_m, axis=1))) for r in (ride, alone)]
    assert worst[0] < 0.4 * worst[1]


@pytest.mark.parametrize("name", ["NCL1", "SAGA"])
def test_the_examples_of_the_documentation_are_these_vehicles(name):
    table = vessels()[name]
    example = tomllib.loads((EXAMPLES / f"{name.lower()}.toml").read_text(encoding="utf-8"))
    files = {"file": table["folder"], "format": table["format"]}
    assert example["source"] == [source | files for source in table["source"]]
    assert [float(example["start"]), float(example["end"])] in table["spans"]
