"""The lag of inertial stamps: found where the motion tells it, wherever antenna and heading are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pntegrity.kernels.lag import Felt, find_lag


def ride(lag_s=0.0, seed=1, seconds=200.0, heading=0.7, tilt=(0.2, -0.1), slip_m=0.0):
    """Return what a unit felt on a ride with turns and stops, and the track at 4 Hz: times, positions,
    velocities, north and east.
    """
    rng = np.random.default_rng(seed)
    dt = 0.01
    t = np.arange(-5.0, seconds + 5.0, dt)
    speed = 6.0 + 3.0 * np.sin(0.31 * t) + 2.0 * np.sin(0.83 * t + 1.0)
    rate = 0.25 * np.sin(0.21 * t) + 0.3 * np.sin(0.57 * t + 2.0) * (np.sin(0.05 * t) > 0)
    psi = heading + np.cumsum(rate) * dt
    course = psi + np.arctan(slip_m * rate / np.maximum(speed, 1.0))  # in front of the axis of turning
    velocity = speed * np.exp(1j * course)
    position = np.cumsum(velocity) * dt
    acceleration = np.gradient(velocity, dt)
    body = acceleration * np.exp(-1j * psi) + complex(*tilt)
    body += 0.3 * (rng.normal(size=len(t)) + 1j * rng.normal(size=len(t)))
    felt = Felt(
        t + lag_s, np.full(len(t), dt), rate * dt + 0.002 * dt, np.stack([body.real, body.imag], 1) * dt
    )
    at = np.arange(0.0, seconds, 0.25)
    pairs = [np.stack([np.interp(at, t, x.real), np.interp(at, t, x.imag)], 1) for x in (position, velocity)]
    return felt, at, *pairs


@pytest.mark.parametrize("lag_s", [-0.4, -0.03, 0.0, 0.2, 0.5])
@pytest.mark.parametrize("order", [1, 2])
def test_the_lag_is_found(lag_s, order):
    felt, t, position, velocity = ride(lag_s)
    found = find_lag(felt, t, velocity if order == 1 else position, order)
    # an increment stands for its middle, half a step before its stamp
    assert found.lag_s == pytest.approx(lag_s, abs=0.02)
    assert found.correlation > 0.9
    assert found.sigma_s < 0.02
    assert found.stretches == 10


def test_noise_of_the_track_shows_in_sigma_and_correlation():
    errors, sigmas = [], []
    for seed in range(12):
        felt, t, _, velocity = ride(0.2, seed=seed)
        noisy = velocity + 0.3 * np.random.default_rng(seed).normal(size=velocity.shape)
        found = find_lag(felt, t, noisy, 1)
        errors.append(found.lag_s - 0.2)
        sigmas.append(found.sigma_s)
    assert 0.4 < np.std(errors) / np.median(sigmas) < 2.0
    assert found.correlation < 0.9


def test_an_antenna_ahead_of_the_axis_of_turning_is_no_lag():
    felt, t, position, velocity = ride(0.1, slip_m=2.0)
    assert find_lag(felt, t, velocity, 1).lag_s == pytest.approx(0.1, abs=0.02)
    assert find_lag(felt, t, position, 2).lag_s == pytest.approx(0.1, abs=0.02)


def test_a_gyroscope_with_the_wrong_sign_or_unit_explains_little():
    felt, t, _, velocity = ride(0.2)
    right = find_lag(felt, t, velocity, 1).correlation
    for factor in (-1.0, 57.3, 0.0):
        wrong = find_lag(replace(felt, turn_rad=factor * felt.turn_rad), t, velocity, 1)
        assert wrong.correlation < right - 0.1


def test_gaps_of_the_track_are_left_out():
    felt, t, _, velocity = ride(0.2)
    keep = (t < 50.0) | (t > 71.3)
    assert find_lag(felt, t[keep], velocity[keep], 1).lag_s == pytest.approx(0.2, abs=0.02)


def test_nothing_to_tell_it_from():
    felt, t, position, velocity = ride()
    assert find_lag(felt, t[:100], velocity[:100], 1) is None  # less than three stretches
    assert find_lag(felt, t + 1e4, velocity, 1) is None  # not the same time
    assert find_lag(felt, t[:2], position[:2], 2) is None
    still = find_lag(felt, t, np.zeros_like(velocity), 1)
    assert still is None or still.correlation == 0.0


@pytest.mark.parametrize(
    ("folder", "fixes", "axes", "expected"),
    [
        ("imu-drive-2025189", "gnss_1934_sf.pos.gz", "-x,y,-z", (0.220, 0.095)),
        ("imu-walk-2025240", "gnss_1730_sf.pos.gz", "-y,-x,-z", (0.022, -0.098)),
    ],
)
def test_real_units(shared, folder, fixes, axes, expected):
    """The receiver's velocities are 0.12 s late against its positions; both folders show it."""
    from pntegrity.formats.fixes import read_fixes
    from pntegrity.formats.imu_table import read_imu
    from pntegrity.physics.frames import enu_rotation

    whole = read_imu(shared / folder / "imu_gpst.csv.gz", axes=axes)
    epochs = read_fixes(shared / folder / fixes)
    y = np.array([e.observations[0].y for e in epochs])
    turn = enu_rotation(y[0, :3])[[1, 0]]
    t0 = epochs[0].t_ns
    felt = Felt((whole.t_ns - t0) * 1e-9, whole.dt_s, whole.angle_rad[:, 2], whole.velocity_mps[:, :2])
    t = np.array([e.t_ns - t0 for e in epochs]) * 1e-9
    place = find_lag(felt, t, (y[:, :3] - y[0, :3]) @ turn.T, 2)
    speed = find_lag(felt, t, y[:, 3:] @ turn.T, 1)
    assert place.lag_s == pytest.approx(expected[0], abs=0.005)
    assert speed.lag_s == pytest.approx(expected[1], abs=0.005)
    assert min(place.correlation, speed.correlation) > 0.84
    assert 0.10 < place.lag_s - speed.lag_s < 0.14
