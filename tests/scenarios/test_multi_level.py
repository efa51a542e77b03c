"""The multi-level study with few runs: who is named, what comes back, and whether levels hold."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.scenarios._vessel_bounds import levels
from pntegrity.scenarios._vessel_doubt import doubtful
from pntegrity.scenarios._vessel_repairs import isolated_error, recovery, sensor_delays
from pntegrity.scenarios._vessel_runs import Study


@pytest.fixture(scope="module")
def study():
    return Study("consistent", 20)


def case_of(study, name):
    return next(c for c in study.cases() if c.name == name)


def test_two_beacons_are_named_at_once_and_left_out(study):
    case = case_of(study, "4")
    faults = study.faults(case)
    found = study.detect(faults, case.from_s, case.to_s)
    assert set(found.sources) == {("lbl",)}
    assert sum(set(s) == {"lbl.AP2", "lbl.AP3"} for s in found.sensors) >= 19
    assert np.median(found.named_s) == 0.0
    quiet = study.full(np.zeros_like(faults)).error[:, :3]
    left = isolated_error(study, faults, found, case.to_s + 5.0)
    ratio = np.sqrt((left**2).mean(axis=(0, 2)) / (quiet**2).mean(axis=(0, 2)))
    assert (ratio < 1.2).all()


def test_a_common_ramp_is_ambiguous(study):
    found = study.detect(study.shifted(("gnss", "lbl"), (0.3, 0.0, 0.0), 80.0, 100.0), 80.0, 100.0)
    alarmed = np.isfinite(found.alarm_s)
    assert alarmed.mean() >= 0.9
    assert found.ambiguous[alarmed].all()
    assert not any("usbl" in names for names in found.certain)


def test_levels_cover_who_is_left_out_in_doubt(study):
    faults = study.shifted(("gnss", "lbl"), (0.0, 0.3, 0.0), 80.0, 100.0)
    found = study.detect(faults, 80.0, 100.0)
    doubted = doubtful(study, faults, found)
    assert len(doubted.ratio) >= 10
    assert (doubted.ratio < 1.0).all()
    assert np.median(doubted.level_m) > 2.0 * np.median(doubted.alone_m)


def test_a_range_that_drifts_is_left_out_in_doubt_and_named_later(study):
    case = case_of(study, "6")
    found = study.detect(study.faults(case), case.from_s, case.to_s)
    assert sum(names == ("usbl",) for names in found.sources) >= 19
    assert np.median(found.named_s) <= 6.0
    assert sum(names == ("usbl",) for names in found.certain) >= 10
    assert sum(set(rivals) <= {("gnss", "lbl")} for rivals in found.rivals) >= 18


def test_published_windows_are_slow_where_they_begin_anew(study):
    case = case_of(study, "2")
    found = sensor_delays(study, study.faults(case), "gnss", case.from_s, case.to_s)
    assert np.median(found["restarted"]) == 10.0
    assert np.median(found["expanded"]) == 0.5


def test_a_beacon_comes_back_after_the_fault_and_not_within_it(study):
    case = case_of(study, "3")
    span = (case.from_s, case.from_s + 5.0, case.to_s + 10.0)
    found = recovery(study, study.faults(case), ["lbl.AP1"], span, np.array([7.5]))
    for t in (found.passes_s, found.trial_s):
        assert (t >= 20.0).all()
        assert np.median(t) <= 23.0
    assert found.readmission <= 1e-2


def test_levels_of_the_bank_are_above_those_of_one_epoch():
    found = levels(Study("consistent", 1))
    late = slice(200, None)
    assert (found.bank[late] > found.published[late]).mean() > 0.9
    assert np.median(found.horizontal("bank")[late]) == pytest.approx(4.0, abs=0.3)
    assert found.sets == ((), ("gnss",), ("lbl",), ("usbl",))
