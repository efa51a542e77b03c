"""Precise point positioning on a real log: its noise is fitted on one part and holds on the next."""

from __future__ import annotations

from pathlib import Path

import pytest

from pntegrity.config import RunConfig, make_config
from pntegrity.estimators.ppp import Ppp
from pntegrity.evaluate.calibrate import Calibration, calibrate
from pntegrity.run import load_epochs, options_for

FOLDER = "esbc-static-2020177"


@pytest.fixture(scope="module")
def config(shared: Path) -> RunConfig:
    """The first 240 epochs of ESBC, GPS and GLONASS."""
    folder, antennas = shared / FOLDER, shared / "antex" / "igs14_sats_only.atx.gz"
    if not folder.is_dir() or not antennas.is_file():
        pytest.skip(f"{FOLDER} or the antennas are not in {shared}")
    values = {
        "obs": folder / "ESBC00DNK_R_20201770000_06H_30S_MO.rnx.gz",
        "sp3": tuple(sorted(folder.glob("*ORB.SP3.gz"))), "clk": tuple(folder.glob("*CLK.CLK.gz")),
        "antex": (antennas,), "estimator": "ppp", "systems": "GR", "end": "7170",
    }  # fmt: skip
    return make_config(values)


@pytest.fixture(scope="module")
def fitted(config: RunConfig) -> Calibration:
    loaded = load_epochs(config)
    return calibrate(loaded.epochs, options_for(config, loaded), config.build_monitors, estimator=Ppp)


def test_sizes_of_a_geodetic_receiver_are_found(fitted):
    noise = fitted.noise
    assert 5e-4 < noise.carrier_m < 5e-3
    assert 2e-5 < noise.ambiguity_m < 1e-3
    assert 0.1 < noise.code_white_m < 1.5
    assert noise.satellites == ()
    assert fitted.gain > 1.0


def test_fitted_innovations_are_whiter_and_bounded(fitted):
    carrier = {name: numbers["carrier"] for name, numbers in fitted.whiteness.items()}
    assert carrier["calibrated"]["autocorrelation"][0] < carrier["white"]["autocorrelation"][0]
    assert 0.1 < carrier["calibrated"]["mean_square"] <= 1.0


def test_no_alarm_on_what_was_not_fitted(fitted):
    assert set(fitted.alarms) == {"rctm", "srctm", "aime", "sraime", "glr"}
    assert {name: counts["1e-06"] for name, counts in fitted.alarms.items()} == dict.fromkeys(
        fitted.alarms, 0
    )
