"""Real inertial logs: a drive with RTK fixes, faults in them, an outage beside python-ins, a walk."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.scenarios import _ins_logs as logs
from pntegrity.scenarios.evidence_ins_real import ins_real
from pntegrity.scenarios.evidence_mechanisation import mechanisation


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return str(logs.write_spec(tmp_path_factory.mktemp("spec")))


@pytest.fixture(scope="module")
def data(shared):
    for folder in (logs.DRIVE, logs.WALK_FOLDER):
        if not (shared / folder).is_dir():
            pytest.skip(f"{folder} is not here")
    return shared


def test_a_clean_drive_has_no_alarm(data, spec):
    track = logs.tracked(logs.drive_log(data, spec))
    assert not any(v.status == "alert" for o in track.outcomes for v in o.first)
    assert np.nanmax(track.horizontal_m) < 0.2
    assert np.isfinite(track.horizontal_m).sum() > 2000


def test_a_jump_of_the_fixes_is_seen_at_once_and_they_come_back(data, spec):
    log = logs.drive_log(data, spec).until(180.0).with_fault("fix bias 20 m 100:120")
    track = logs.tracked(log)
    (exclusion,) = [(track.at(o.t_ns), e.group) for o in track.outcomes for e in o.exclusions]
    assert exclusion == (100.0, "fix")
    (back,) = [track.at(o.t_ns) for o in track.outcomes if o.readmitted]
    assert 120.0 <= back <= 130.0
    assert np.nanmax(track.horizontal_m[track.seconds > back + 5.0]) < 0.2


def test_a_start_without_velocities(data, spec):
    track = logs.tracked(logs.drive_log(data, spec, fix_velocity=False).until(120.0))
    assert np.isfinite(track.horizontal_m[track.seconds > 60.0]).all()
    assert np.nanmax(track.horizontal_m[track.seconds > 60.0]) < 0.5


def test_three_minutes_without_fixes_end_without_a_lock_out(data, spec):
    branches = logs.Branches(logs.drive_log(data, spec))
    errors, seconds = branches.without(240.0, 420.0)
    assert errors[seconds > 425.0].max() < 0.3
    assert errors[(seconds > 240.0) & (seconds < 420.0)].max() > 100.0


def test_heights_of_the_walk_are_above_the_geoid(data):
    heights = logs.ellipsoidal_m(data / logs.WALK_FOLDER / "gnss_1730.ubx")
    assert len(heights) > 500
    assert np.ptp(heights[:, 1] - heights[:, 0]) < 0.01
    assert heights[0, 1] - heights[0, 0] == pytest.approx(21.387)


def test_every_figure_of_the_mechanisation_is_in_its_bounds(tmp_path):
    rows = mechanisation(tmp_path)
    assert len(rows) >= 5
    assert [r["quantity"] for r in rows if r["ok"] is False] == []


def test_a_campaign_without_data_says_so(tmp_path):
    rows = ins_real(tmp_path)
    assert [r["quantity"] for r in rows] == ["not run"] * 3
