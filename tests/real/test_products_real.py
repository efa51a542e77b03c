"""Products of a real station: what they say of the troposphere and the ionosphere over it is plausible."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pntegrity.config import make_config
from pntegrity.estimators.ppp import Ppp
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.physics.atmosphere import klobuchar_m
from pntegrity.physics.atmosphere_products import metres_per_tecu
from pntegrity.physics.frames import elevation_azimuth
from pntegrity.records import State
from pntegrity.run import load_epochs, options_for
from pntegrity.sensors.ranges import geometry
from pntegrity.stations import pinned, products_from_station

OPEC = np.array([3149785.49, 598261.34, 5495348.98])
HOUR = 120
L1_M = float(metres_per_tecu(1575.42e6))
SECOND = 10**9


@pytest.fixture(scope="module")
def folder(shared):
    found = shared / "opec-static-2022001"
    if not found.is_dir():
        pytest.skip("opec-static-2022001 not in the shared data")
    return found


def loaded(folder, estimator):
    config = make_config({
        "obs": next(folder.glob("*_MO.rnx.gz")), "sp3": tuple(folder.glob("*SP3.gz")), "systems": "GC",
        "antex": (folder.parent / "antex/igs14_sats_only.atx.gz",), "estimator": estimator,
    })  # fmt: skip
    found = load_epochs(config)
    return found.epochs, options_for(config, found)


@pytest.fixture(scope="module")
def log(folder):
    return loaded(folder, "ppp_rtk")


@pytest.fixture(scope="module")
def made(log):
    epochs, options = log
    return products_from_station(epochs, OPEC, options, latency_s=30.0)


def test_the_wet_delay_is_that_of_the_ionosphere_free_filter(made, folder):
    epochs, options = loaded(folder, "ppp")
    estimator, state, other = Ppp(options), State.empty(), []
    for epoch in epochs:
        state = pinned(estimator.correct(estimator.predict(state, epoch), epoch).posterior, OPEC)
        other.append(state.mean[state.layout.index["zwd"]])
    wet, sigma = made.troposphere[1:]
    assert len(wet) == len(epochs) == 440
    # measured: 0.053 to 0.064 m, at most 0.005 m apart; with slant delays that walk 1e-3 m/sqrt(s) -0.05 m
    assert np.abs(wet - other)[HOUR:].max() < 0.01
    assert (wet[HOUR:] > 0.0).all()
    assert (wet[HOUR:] < 0.3).all()
    assert np.abs(np.diff(wet))[HOUR:].max() < 0.005
    assert sigma[HOUR:].max() < 0.015


def test_slant_delays_follow_the_broadcast_model_but_for_code_biases(made, log, folder):
    model = read_navigation(sorted(folder.glob("*GN.rnx.gz"))).klobuchar["G"]
    apart = {}
    for epoch in log[0]:
        o = epoch.sensor("code")
        first = np.flatnonzero(o.aux["iono_factor"] == 1.0) if o else ()
        el, az = elevation_azimuth(OPEC, geometry(OPEC, o.aux["sv_pos_m"]).los) if o else (0, 0)
        delay = klobuchar_m(model, OPEC, el, az, epoch.t_ns, o.aux["freq_hz"]) if o else ()
        for i in first:
            valid = made.at(epoch.t_ns + 30 * SECOND, 1.0).stec_tecu.get(o.keys[i][:3])
            if valid and valid[1] * L1_M < 0.3:
                per_tecu = float(metres_per_tecu(o.aux["freq_hz"][i]))
                apart.setdefault(o.keys[i][:3], []).append(valid[0] * per_tecu - delay[i])
    # the part that does not change is code biases; the rest is what the model does not know of a quiet night
    spread = {sat: np.std(v) for sat, v in apart.items() if len(v) > HOUR}
    assert len(spread) >= 12
    assert max(spread.values()) < 1.0, spread
    assert np.median(list(spread.values())) < 0.4
    gps = [np.median(v) for sat, v in apart.items() if sat[0] == "G"]
    assert np.ptp(gps) < 12.0  # code biases of GPS satellites lie within 25 ns, times 1.55


def test_differences_between_satellites_are_smooth(made):
    steps = []
    gps = {sat: s for sat, s in made.ionosphere.items() if sat[0] == "G"}
    for one, two in combinations(gps.values(), 2):
        common, i, j = np.intersect1d(one[0], two[0], return_indices=True)
        if len(common) > HOUR:
            apart = L1_M * (one[1][i] - two[1][j])
            steps.append(np.diff(apart)[20:][np.diff(common)[20:] == 30 * SECOND])
    assert len(steps) >= 20
    assert np.median([s.std() for s in steps]) < 0.02
    joined = np.concatenate(steps)
    assert np.quantile(np.abs(joined), 0.99) < 0.06


def test_sigmas_fall_as_time_goes_on(made):
    whole = [s for s in made.ionosphere.values() if len(s[0]) == 440]
    assert len(whole) >= 3
    for _, _, sigma in whole:
        assert L1_M * sigma[-1] < 0.2 < L1_M * sigma[0]
