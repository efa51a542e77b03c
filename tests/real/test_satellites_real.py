"""The walk with its satellites as a source of `multi_source`, beside the tight filter with clock states."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.config import make_config
from pntegrity.estimators._ins_solution import solution_of
from pntegrity.physics.time import SECOND_NS
from pntegrity.run import RunResult, run
from pntegrity.scenarios import _ins_logs as logs

END_S = 90.0


@pytest.fixture(scope="module")
def walk(shared):
    folder = shared / logs.WALK_FOLDER
    if not folder.is_dir():
        pytest.skip(f"{logs.WALK_FOLDER} is not here")

    def go(*faults: str) -> RunResult:
        gnss = {"type": "gnss", "obs": str(folder / "walk.obs.gz"), "nav": [str(folder / "walk.nav.gz")]}
        return run(make_config({
            "estimator": "multi_source", "imu": folder / "imu_gpst.csv.gz", "imu_spec": "low-cost",
            "imu_axes": "-y,-x,-z", "imu_lag_s": "auto", "source": [gnss], "monitors": ["sensor_window"],
            "truth": folder / "gnss_1730_sf.pos.gz", "end": str(END_S), "faults": list(faults),
        }))  # fmt: skip

    return go


@pytest.fixture(scope="module")
def clean(walk):
    return walk()


def about_the_median(enu_m):
    """Return the root mean square of three-dimensional differences about their median: the base station of
    the truth stands some ten metres from its stated coordinates.
    """
    known = enu_m[np.isfinite(enu_m).all(axis=1)]
    assert len(known) > 150
    return np.sqrt(np.mean(np.sum((known - np.median(known, axis=0)) ** 2, axis=1)))


def differences(result):
    found = [solution_of(o.update.posterior) for o in result.outcomes]
    place = np.array([np.full(3, np.nan) if s is None else s.position_m for s in found])
    return place - result.facts.truth_m


def test_a_clean_walk_has_no_alarm_and_the_position_of_the_tight_filter(clean, shared):
    assert not any(v.status == "alert" for o in clean.outcomes for v in o.first)
    beside = logs.tracked(logs.walk_log(shared).until(END_S)).enu_m
    assert about_the_median(differences(clean)) < 1.2 * about_the_median(beside) + 0.1


def test_innovations_are_not_larger_than_the_filter_believes(clean):
    updates = [o.update for o in clean.outcomes if o.update.keys]
    nis = np.array([float(u.white @ u.white) / len(u.keys) for u in updates])
    assert len(nis) > 150
    assert 0.1 < nis.mean() < 1.0


def test_a_false_pseudorange_is_left_out_as_a_sensor_and_comes_back(walk):
    told = walk("gnss:R.G10 bias 60 m 60:75")
    first = told.outcomes[0].t_ns
    out = [((o.t_ns - first) / SECOND_NS, e.group) for o in told.outcomes for e in o.exclusions]
    back = [((o.t_ns - first) / SECOND_NS, o.readmitted) for o in told.outcomes if o.readmitted]
    assert [name for _, name in out] == ["gnss.G10"]
    assert 60.0 <= out[0][0] < 61.0
    assert [name for _, name in back] == [("gnss.G10",)]
    assert 75.0 <= back[0][0] < END_S
    assert about_the_median(differences(told)) < 1.0
