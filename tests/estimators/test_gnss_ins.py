"""The inertial filter: Jacobians, accuracy, gaps of GNSS and IMU, detection, and that its steps are pure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ins_logs import ARM, DRIVE, blind, drive, filter_of, heading_off, off_m, shift_of, still_imu, updates
from scipy.stats import chi2

from gnss_logs import NOISE as NOISE_OF
from pntegrity.estimators._ins_solution import antenna_of
from pntegrity.estimators._ins_still import KEYS
from pntegrity.kernels.rotations import rotation
from pntegrity.records import Epoch, State
from pntegrity.sensors.imu import LOW_COST
from pntegrity.sensors.pseudoranges import code_rows, rate_rows
from pntegrity.sensors.ranges import EARTH_RATE_RADPS
from pntegrity.simulate.trajectory import Leg

LONG = (Leg(5.0, 0.0), Leg(8.0, 10.0), Leg(20.0, 10.0), Leg(8.0, 10.0, 0.8), Leg(60.0, 12.0), Leg(8.0, 0.0))
PLAIN = {"fde": "none"}

# --- what a row means
# ----------------------------------------------------------------------------------------


def rows_at(estimator, epoch: Epoch, state: State, error: np.ndarray) -> np.ndarray:
    """Return what code, range-rate rows and a fix should read where the true state is a belief plus an
    error.
    """
    aside, block = state.aside, state.layout.block
    x = state.mean + error
    C = rotation(error[block("att")]) @ aside.C
    earth = np.array([0.0, 0.0, EARTH_RATE_RADPS])
    measured = (aside.rate_radps + aside.C.T @ earth) * (1.0 + state.mean[block("sg")]) + state.mean[
        block("bg")
    ]
    rate = (measured - x[block("bg")]) / (1.0 + x[block("sg")]) - C.T @ earth
    place, speed = antenna_of(x[:3], x[3:6], aside.with_(C=C, rate_radps=rate))
    if estimator.options.ins.coupling == "loose":
        return np.concatenate([place, speed])
    code, rates = (
        code_rows(epoch, place, estimator.options),
        rate_rows(epoch, place, speed, estimator.options),
    )
    own = np.zeros(len(code.keys))
    for k, key in enumerate(code.keys):
        for name in (f"isb:{key[0]}", f"bias:{key}", f"mp:{key}"):
            own[k] += x[state.layout.index[name]] if name in state.layout.index else 0.0
    return np.concatenate([code.predicted + x[6] + own, rates.predicted + x[7]])


@pytest.mark.parametrize("coupling", ["tight", "loose"])
def test_the_jacobian_is_the_derivative_of_the_rows(coupling):
    # GIVEN a prior in a bend, so that the antenna swings about the IMU
    log = drive(60)
    estimator = filter_of(log, coupling=coupling, fde="none")
    epoch = log.epochs[38]
    found = updates(estimator, log.epochs[:38])
    prior = estimator.predict(found[-1].posterior, epoch)
    update = estimator.correct(prior, epoch)
    assert np.linalg.norm(prior.state.aside.rate_radps) > 0.1
    # WHEN every state in turn is a little off
    n, step = len(prior.state), np.full(len(prior.state), 1e-2)
    for kind, size in (("pos", 10.0), ("vel", 1.0), ("att", 1e-4), ("bg", 1e-4), ("ba", 1e-3), ("sg", 1e-3)):
        step[prior.state.layout.block(kind)] = size
    for i, name in enumerate(prior.state.layout.names):
        e = step[i] * np.eye(n)[i]
        slope = (rows_at(estimator, epoch, prior.state, e) - rows_at(estimator, epoch, prior.state, -e)) / (
            2.0 * step[i]
        )
        # THEN the rows change as the Jacobian says: but for delays of the troposphere with height (3e-4 over
        # sin el), how lines of sight turn (2e-4 1/s) and the Earth's rate on the lever arm (1e-4 m/s a rad)
        atol = 2e-3 if name.startswith(("pos", "att")) else 2e-4
        np.testing.assert_allclose(update.H[:, i], slope, atol=atol, rtol=1e-4, err_msg=name)


def test_innovations_are_rows_less_what_the_prior_says():
    log = drive(60)
    estimator = filter_of(log, **PLAIN)
    found = updates(estimator, log.epochs[:38])
    prior = estimator.predict(found[-1].posterior, log.epochs[38])
    update = estimator.correct(prior, log.epochs[38])
    y = np.concatenate([log.epochs[38].sensor(s).select(
        np.array([k in update.keys for k in log.epochs[38].sensor(s).keys])
    ).y for s in ("code", "doppler")])  # fmt: skip
    expected = rows_at(estimator, log.epochs[38], prior.state, np.zeros(len(prior.state)))
    np.testing.assert_allclose(update.nu, y - expected, atol=1e-6)


# --- accuracy and honesty
# ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("coupling", "fde"), [("tight", "ours"), ("tight", "none"), ("loose", "none"), ("loose", "factor-set")]
)
def test_without_errors_of_the_receiver_it_stays_on_the_truth(coupling, fde):
    log = drive(150, scale=0.0)
    found = updates(filter_of(log, coupling=coupling, fde=fde), log.epochs)
    # a least-squares velocity leaves the Sagnac terms of range rates out: some 5e-4 m/s
    assert off_m(log, found)[30:].max() < (0.05 if coupling == "tight" else 0.15)
    assert np.rad2deg(np.abs(heading_off(log, found)[60:]).max()) < 0.3


def test_its_errors_are_as_large_as_it_says():
    # GIVEN drives with errors of receiver and IMU as the filter believes them
    total, count = 0.0, 0
    for seed in range(2, 6):
        log = drive(60, seed=seed)
        found = updates(filter_of(log, noise=NOISE_OF, fde="none"), log.epochs)
        # WHEN position, velocity and attitude are compared with the truth
        for k in (40, 59):
            s, at = found[k].posterior, np.r_[0:6, found[k].posterior.layout.block("att")]
            turned = rotation(s.mean[at[6:]]) @ s.aside.C
            skewed = log.axes[k] @ turned.T
            phi = 0.5 * np.array(
                [skewed[2, 1] - skewed[1, 2], skewed[0, 2] - skewed[2, 0], skewed[1, 0] - skewed[0, 1]]
            )
            e = np.concatenate([log.position_m[k] - s.mean[:3], log.velocity_mps[k] - s.mean[3:6], phi])
            total, count = total + e @ np.linalg.solve(s.P[np.ix_(at, at)], e), count + 9
    # THEN their normalised square is chi-square: within its 99.9 % interval
    assert chi2.ppf(5e-4, count) < total < chi2.ppf(1.0 - 5e-4, count)


def test_a_lever_arm_that_nobody_tells_costs_what_it_is_long():
    log = drive(60)
    known, unknown = (updates(filter_of(log, lever_arm_m=a, **PLAIN), log.epochs) for a in (ARM, (0.0,) * 3))
    apart = np.linalg.norm(known[-1].posterior.mean[:3] - unknown[-1].posterior.mean[:3])
    assert apart == pytest.approx(np.linalg.norm(ARM), abs=0.3)


# --- with little or nothing to go on
# ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("spec", "most_m"), [(None, 25.0), (LOW_COST, 250.0)])
def test_after_a_minute_without_gnss_it_takes_up_where_it_is(spec, most_m):
    log = drive(160, legs=LONG, **({} if spec is None else {"spec": spec}))
    found = updates(filter_of(log, **({} if spec is None else {"spec": spec})), blind(log.epochs, 60, 120))
    off = off_m(log, found)
    sigma = np.sqrt([np.trace(u.posterior.P[:3, :3]) for u in found])
    assert not found[90].keys
    assert found[90].reason
    assert off[60:120].max() < min(most_m, 4.0 * sigma[119])
    assert off[122:].max() < 4.0
    assert len(found[121].keys) >= 20
    assert not any("re-acquisition" in e for u in found for e in u.events)


def test_three_satellites_hold_the_drift():
    log = drive(160, legs=LONG, spec=LOW_COST)
    none, three = (
        updates(filter_of(log, spec=LOW_COST), blind(log.epochs, 60, 120, keep)) for keep in (0, 3)
    )
    assert len(three[90].keys) == 6
    assert off_m(log, three)[119] < 0.5 * off_m(log, none)[119]


def test_a_filter_that_was_pulled_off_says_so_and_comes_back():
    # GIVEN codes that for half a minute agree on a place that runs away at 5 m/s, and then on the true one
    log = drive(110, legs=LONG)
    east, epochs = log.axes[0][:, 0], list(log.epochs)
    for k in range(40, 70):
        antenna = log.position_m[k] + log.axes[k] @ np.array(ARM)
        epochs[k] = shift_of(epochs[k], antenna, 5.0 * (k - 40) * east)
    # WHEN a filter follows them (it starts anew in the midst of it), and when one does not
    found = updates(filter_of(log, lost_s=10.0), epochs)
    off = off_m(log, found)
    events = [(k, e) for k, u in enumerate(found) for e in u.events if "re-acquisition" in e]
    # THEN each time after 10 s it says that it lost its position, and in the end it is where it should be
    assert off[40:80].max() > 30.0
    assert events
    assert all("refused for 10 s" in e for _, e in events)
    assert off[90:].max() < 3.0


def test_without_inertial_data_for_seconds_it_bridges_and_for_longer_aligns_again():
    log = drive(120, legs=LONG)
    short, long = (updates(filter_of(log), still_imu(log.epochs, 50, k)) for k in (53, 75))
    assert all(any("bridged" in e for e in u.events) for u in short[50:53])
    assert off_m(log, short)[48:].max() < 3.0
    again = [k for k, u in enumerate(long) if any("attitude was lost" in e for e in u.events)]
    assert again == [75]
    assert np.nanmax(off_m(log, long)[48:]) < 10.0
    assert np.rad2deg(np.abs(heading_off(log, long)[90:]).max()) < 6.0


def test_a_gap_of_the_imu_in_an_epoch_is_told_with_its_reason():
    log = drive(60)
    epochs = list(log.epochs)
    imu = epochs[40].imu
    assert imu is not None
    part = replace(
        imu, t_ns=imu.t_ns[:20], dt_s=imu.dt_s[:20], angle_rad=imu.angle_rad[:20],
        velocity_mps=imu.velocity_mps[:20], reason="the IMU has a gap of 0.60 s",
    )  # fmt: skip
    epochs[40] = replace(epochs[40], imu=part)
    found = updates(filter_of(log, **PLAIN), epochs)
    assert "the IMU has a gap of 0.60 s" in found[40].events
    assert off_m(log, found)[40:].max() < 3.0


def test_epochs_without_any_imu_after_a_long_gap_wait_with_a_reason():
    log = drive(60)
    estimator = filter_of(log)
    state = updates(estimator, log.epochs[:40])[-1].posterior
    late = replace(log.epochs[41], t_ns=log.epochs[41].t_ns + 700 * 10**9, imu=None)
    update = estimator.correct(estimator.predict(state, late), late)
    assert not len(update.posterior)
    assert update.reason == "no inertial data at this epoch"
    assert update.events[0].startswith("restart after a gap of 70")


def test_a_standstill_in_a_tunnel_is_worth_a_measurement():
    # GIVEN a stop of 20 s out of sight of all satellites
    stop = (
        Leg(5.0, 0.0),
        Leg(8.0, 8.0),
        Leg(30.0, 8.0),
        Leg(8.0, 0.0),
        Leg(60.0, 0.0),
        Leg(8.0, 8.0),
        Leg(8.0, 0.0),
    )
    log = drive(100, legs=stop, spec=LOW_COST)
    with_, plain = (
        updates(filter_of(log, spec=LOW_COST, zero_velocity=z), blind(log.epochs, 40, 95))
        for z in (True, False)
    )
    assert set(with_[80].keys) == set(KEYS)
    assert not any(set(KEYS) & set(u.keys) for u in with_[12:48])
    assert off_m(log, with_)[94] < 0.5 * off_m(log, plain)[94]
    speed = [np.linalg.norm(found[94].posterior.mean[3:6]) for found in (with_, plain)]
    assert speed[0] < 0.02 < 0.1 < speed[1]


def test_the_drive_has_bends_and_a_stop():
    """What the tests above rely on."""
    log = drive(150, scale=0.0)
    speed = np.linalg.norm(log.velocity_mps, axis=1)
    assert speed[:4].max() < 0.3
    assert speed.max() > 7.0
    assert np.ptp(np.unwrap([log.heading(k) for k in range(150)])) > np.pi
    assert DRIVE[0].speed_mps == 0.0
