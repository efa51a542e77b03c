"""Real acoustic ranges: they fit where GNSS and attitude say that the vessel was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pntegrity.formats.acoustic_gnatss import read_gnatss
from pntegrity.physics.acoustics import SoundSpeed
from pntegrity.scenarios._acoustic_logs import lbl_of, open_log, residuals
from pntegrity.scenarios.evidence_acoustics import columns, fit, metres
from pntegrity.sensors.lbl import Lbl


@pytest.fixture(scope="module")
def ncl1(shared):
    if not (shared / "ncl1-gnssa").is_dir():
        pytest.skip(f"ncl1-gnssa is not in {shared}")
    return open_log("NCL1", shared)


@pytest.fixture(scope="module")
def saga(shared):
    if not (shared / "saga-gnssa").is_dir():
        pytest.skip(f"saga-gnssa is not in {shared}")
    return open_log("SAGA", shared)


@pytest.fixture(scope="module")
def at_truth(ncl1, saga):
    """Residuals of both logs."""
    return {name: residuals(log, lbl_of(log)) for name, log in (("NCL1", ncl1), ("SAGA", saga))}


def some(log, step):
    """Return a log with every `step`-th observation."""
    return replace(log, observations=log.observations[::step])


def test_ranges_of_a_wave_glider_fit_where_it_was(ncl1, shared, at_truth):
    assert (len(ncl1.observations), len(ncl1.fixes)) == (1475, 31217)
    found = at_truth["NCL1"]
    assert (found.rows, found.reasons) == (2976, ())
    assert 0.1 < np.sqrt(np.mean(metres(found) ** 2)) < 0.2
    assert np.abs(metres(found)).max() < 1.0
    raw = read_gnatss(shared / "ncl1-gnssa", undulation_m=0.0)
    unchanged = residuals(some(raw, 10), lbl_of(raw, sea_height_m=ncl1.sea_height_m))
    assert np.mean(metres(unchanged)) == pytest.approx(19.5, abs=0.5)


def test_shots_of_a_ship_fit_where_it_was(saga, at_truth):
    found = at_truth["SAGA"]
    assert (found.rows, found.reasons) == (3614, ())
    assert metres(found).mean() == pytest.approx(0.63, abs=0.02)
    assert metres(found).std() < 0.22
    # the roll of the file is right side down, as ours: turned round, the long lever arm doubles the spread
    a = saga.attitude
    other = replace(some(saga, 10), attitude=replace(a, attitude_rad=a.attitude_rad * [-1.0, 1.0, 1.0]))
    assert metres(residuals(other, lbl_of(other))).std() > 0.4


def test_what_is_left_is_slow_changes_of_the_sound_speed(at_truth):
    for name, most in (("NCL1", 0.06), ("SAGA", 0.08)):
        found = at_truth[name]
        places = np.std(fit(found, ("transponders",))[1])
        changing = np.std(fit(found, ("transponders", "sound speed in time"))[1])
        assert changing < most < places


def test_least_squares_finds_what_was_put_in(saga):
    """A known delay, sound speed and lever arm, put into the model, come out of the residuals."""
    log = some(saga, 20)
    base = residuals(log, lbl_of(log))

    def change(kind, **changes):
        return fit(residuals(log, lbl_of(log, **changes)), (kind,))[0] - fit(base, (kind,))[0]

    delayed = {n: {**b, "delay_s": 1e-3} for n, b in saga.beacons.items()}
    assert change("delay", beacons=delayed)[0] == pytest.approx(-1e-3, rel=1e-6)
    faster = SoundSpeed(saga.profile.depth_m, saga.profile.speed_mps * 1.0005)
    assert change("sound speed", profile=faster)[0] == pytest.approx(-5e-4, rel=0.01)
    arm = tuple(np.add(saga.lever_arm_m, (0.0, 0.0, 0.5)))
    assert change("lever arm", lever_arm_m=arm)[2] == pytest.approx(-0.5, rel=0.01)
    assert columns(base, "transponders").shape == (base.rows, 12)


def test_a_profile_that_ends_above_the_transponders(ncl1):
    short = SoundSpeed(ncl1.profile.depth_m[:500], ncl1.profile.speed_mps[:500])
    with pytest.raises(ValueError, match=r"profile ends at \d+\.\d m, beacon 'T1' is 1176\.6 m deep"):
        Lbl(beacons=ncl1.beacons, profile=short, sea_height_m=ncl1.sea_height_m)
    lbl_of(ncl1, profile=short.extended(1180.0))
