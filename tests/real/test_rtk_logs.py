"""PPP-RTK with solution separation on real logs: nothing is blamed for nothing, faults are found at once."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.scenarios._ppp_logs import OPEC
from pntegrity.scenarios._rtk_logs import (
    CLAS_NOISE,
    CLAS_TRUTH_M,
    OPEC_NOISE,
    OPEC_TRUTH_M,
    clas,
    clas_missing,
    opec,
    pipeline,
    run,
    tracked,
)
from pntegrity.scenarios._rtk_simulated import updates_of
from pntegrity.simulate.faults import apply_faults, parse_fault

START = 240  # 02:00, after the part on which the noise model was chosen


@pytest.fixture(scope="module")
def station(shared):
    if missing := OPEC.missing(shared):
        pytest.skip(missing)
    return opec(shared, 1)


@pytest.fixture(scope="module")
def service(shared):
    if missing := clas_missing(shared):
        pytest.skip(missing)
    return clas(shared)


@pytest.fixture(scope="module")
def before(station):
    """A run with exclusion up to ten minutes after its start."""
    driver = pipeline(OPEC_NOISE)
    for epoch in station[START : START + 20]:
        driver.push(epoch)
    return driver.checkpoint


def test_half_an_hour_of_opec_is_within_its_levels_and_silent(station):
    track = run(station[START : START + 60], OPEC_TRUTH_M, OPEC_NOISE)
    assert track.beyond == 0
    assert not track.alarm.any()
    assert float(np.abs(track.error_m[40:]).max()) < 0.5
    assert np.isfinite(track.level_m).all()


def test_levels_shrink_as_the_filter_converges(station):
    track = run(station[START : START + 60], OPEC_TRUTH_M, OPEC_NOISE)
    assert track.hpl_m[59] < track.hpl_m[20] < track.hpl_m[2]


@pytest.mark.parametrize("satellite", ["C20", "G10", "G24", "G21"])
def test_a_satellite_clock_5_m_off_is_left_out_at_the_first_epoch(station, before, satellite):
    span = station[START + 20 : START + 26]
    spoilt = apply_faults(span, [parse_fault(f"{satellite}:* bias 5 m 0:89")])
    track = run(spoilt, OPEC_TRUTH_M, OPEC_NOISE, pairs=True, checkpoint=before)
    assert track.first == 0
    assert track.suspects == (satellite,)
    assert track.beyond == 0
    assert not track.alert.any()


def test_a_code_78_m_off_is_blamed_on_its_satellite_and_not_on_all_products(station):
    driver = pipeline(OPEC_NOISE)
    outcomes = [driver.push(e) for e in station[400:440]]
    assert outcomes[-1].first[0].status == "alert"
    assert [e.group for e in outcomes[-1].exclusions] == ["C25"]


def test_five_minutes_of_clas_are_within_their_levels_and_silent(service):
    track = run(service[:320], CLAS_TRUTH_M, CLAS_NOISE)
    assert track.beyond == 0
    assert not track.alarm.any()
    assert np.isnan(track.error_m[0]).all()  # corrections are not complete then
    assert float(np.nanmax(np.abs(track.error_m[60:]))) < 0.5


@pytest.mark.parametrize("satellite", ["G17", "G03"])
def test_a_satellite_that_runs_away_is_out_before_half_a_metre(service, satellite):
    driver = pipeline(CLAS_NOISE)
    for epoch in service[:300]:
        driver.push(epoch)
    spoilt = apply_faults(service[300:360], [parse_fault(f"{satellite}:* ramp 2 cm/s 0:")])
    track = run(spoilt, CLAS_TRUTH_M, CLAS_NOISE, pairs=True, checkpoint=driver.checkpoint)
    clean = tracked(updates_of(service[:360], CLAS_NOISE), CLAS_TRUTH_M).error_m[300:]
    induced = np.abs(track.error_m - clean)
    assert track.first is not None
    assert set(track.suspects) == {satellite}
    assert float(induced[: track.first, 2].max()) < 0.5
    assert float(induced[track.first :].max()) < 0.5
