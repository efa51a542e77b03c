"""The static BRUX log: position, silence on clean data, and faults put into it."""

import numpy as np
import pytest

from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.calibrate import updates_of
from pntegrity.evaluate.whiteness import whiteness
from pntegrity.exclusion import Policy
from pntegrity.pipeline import Pipeline
from pntegrity.scenarios._real_logs import NAMES, monitors, rms
from pntegrity.scenarios.evidence_real import known_fault_delay, ratios, snapshots
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.faults import apply_faults, parse_fault


@pytest.fixture(scope="module")
def calibrated(brux, fitted):
    return updates_of(brux.epochs, brux.options(fitted), ())


def test_default_positions_are_within_a_metre(brux):
    run = updates_of(brux.epochs, brux.options(), ())
    assert rms(brux.horizontal_m([u.posterior.mean[:3] for u in run])) <= 1.0


def test_snapshots_are_within_a_metre(brux):
    run = snapshots(brux, NoiseModel())
    assert rms(brux.horizontal_m([u.posterior.mean[:3] for u in run])) <= 1.0


def test_calibrated_positions_are_within_a_metre(brux, calibrated):
    assert rms(brux.horizontal_m([u.posterior.mean[:3] for u in calibrated])) <= 1.0


@pytest.mark.parametrize("name", NAMES)
def test_no_alarm_on_the_clean_second_half(brux, calibrated, fitted, name):
    (monitor,) = monitors(1e-6, fitted, (name,))
    ratio = ratios(monitor, calibrated)[brux.half :]
    assert np.isfinite(ratio).all()
    assert ratio.max() <= 1.0


def test_calibrated_innovations_are_white(brux, calibrated):
    found = whiteness(calibrated[brux.half :])["level"]
    assert np.abs(found["autocorrelation"]).max() < 0.1


def test_three_satellites_of_two_constellations_are_found_exactly(brux):
    texts = ("G01 bias 60 m 505:510", "R05 bias -45 m 505:510", "G22 bias 90 m 505:510")
    guilty = {"G01", "R05", "G22"}
    epochs = apply_faults(brux.epochs[:515], [parse_fault(t) for t in texts])[400:]
    pipeline = Pipeline(SppKf(brux.options()), monitors(1e-6, NoiseModel()), Policy())
    outcomes = [pipeline.push(e) for e in epochs]
    assert {e.group for e in outcomes[105].exclusions} == guilty
    assert {e.group for o in outcomes for e in o.exclusions} == guilty
    positions = [o.update.posterior.mean[:3] for o in outcomes[100:]]
    assert brux.horizontal_m(positions, first=500).max() < 3.0


def test_no_test_can_be_faster_than_the_one_that_knows_the_fault(calibrated):
    bias, ramp = (
        known_fault_delay(calibrated[500:560], "G01:C1C", k, s) for k, s in (("bias", 15.0), ("ramp", 0.1))
    )
    assert bias == 0.0
    assert 2.0 <= ramp <= 10.0
