"""Mechanisation in the Earth frame: against an independent program, by hand, and its linear step."""

import numpy as np
import pytest
from pyins import sim, strapdown, transform

from pntegrity.kernels.axes import local_axes
from pntegrity.kernels.gravity import EARTH_RATE, gravity
from pntegrity.kernels.rotations import from_angles, rotation, rotvec_of
from pntegrity.kernels.strapdown import mechanise
from pntegrity.physics.frames import ecef_to_geodetic, geodetic_to_ecef
from pntegrity.sensors.imu import STIM300

PLACE = np.array(geodetic_to_ecef(np.deg2rad(35.1), np.deg2rad(136.9), 40.0))
SPIN = np.array([0.0, 0.0, EARTH_RATE])
NO_ERRORS, NO_NOISE = np.zeros(12), np.zeros(4)
ANGLES = np.deg2rad([3.0, -5.0, 70.0])


def attitude(position, angles=ANGLES):
    return local_axes(position).T @ from_angles(angles)


def still(seconds, rate_hz, position=PLACE, angles=ANGLES):
    """Increments of a unit fixed to the Earth, and its attitude: C's own turn cancels the Earth's."""
    C = attitude(position, angles)
    dt = np.full(round(seconds * rate_hz), 1.0 / rate_hz)
    return C, dt, np.outer(dt, C.T @ SPIN), np.outer(dt, -C.T @ np.array(gravity(*position)))


def lively(n, dt_s, seed=3):
    """A lively second of a car: coning, sculling, speed, on an uneven clock."""
    rng = np.random.default_rng(seed)
    dt = dt_s * rng.uniform(0.8, 1.2, n)
    t = np.cumsum(dt) - 0.5 * dt
    wave = np.stack([np.sin(3 * t), np.cos(3 * t + 0.3), np.sin(2 * t + 1.0)], axis=1)
    C = attitude(PLACE)
    force = -C.T @ np.array(gravity(*PLACE)) + 4.0 * wave[:, ::-1]
    velocity = local_axes(PLACE).T @ np.array([12.0, 8.0, 0.5])
    return velocity, C, dt, dt[:, None] * (0.8 * wave + [0.5, -0.4, 0.6]), dt[:, None] * force


# ---- against python-ins -------------------------------------------------------------------------------


def _ours(trajectory, imu, seconds):
    """Our track at whole seconds from the increments of python-ins."""
    start = trajectory.iloc[0]
    lat, lon = np.deg2rad(start[["lat", "lon"]])
    r = np.array(geodetic_to_ecef(lat, lon, start.alt))
    ned_to_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    v = local_axes(r).T @ ned_to_enu @ start[["VN", "VE", "VD"]].to_numpy(float)
    C = attitude(r, np.deg2rad(start[["roll", "pitch", "heading"]].to_numpy(float)))
    values, dt = imu.to_numpy()[1:], np.diff(imu.index)
    rate = round(1.0 / dt[0])
    track = [r]
    for k in range(seconds):
        part = slice(k * rate, (k + 1) * rate)
        r, v, C, *_ = mechanise(r, v, C, dt[part], values[part, :3], values[part, 3:], NO_ERRORS, NO_NOISE)
        track.append(r)
    return np.array(track)


@pytest.mark.filterwarnings("ignore:.*copy keyword is deprecated")
@pytest.mark.parametrize(("seconds", "bound_m"), [(60, 0.01), (300, 0.10)])
def test_position_agrees_with_python_ins_on_the_same_increments(seconds, bound_m):
    trajectory, imu = sim.generate_sine_velocity_motion(
        0.01, seconds + 0.02, [35.1, 136.9, 20.0], [8.0, 5.0, 0.0], [6.0, 8.0, 0.2], 20.0,
        sensor_type="increment",
    )  # fmt: skip
    theirs = strapdown.Integrator(trajectory.iloc[0])
    theirs.integrate(strapdown.compute_increments_from_imu(imu, "increment"))
    lla = theirs.trajectory[["lat", "lon", "alt"]].to_numpy()[:: round(1 / 0.01)][: seconds + 1]
    expected = transform.lla_to_ecef(lla)
    got = _ours(trajectory, imu, seconds)
    difference = np.linalg.norm(got - expected, axis=1)
    assert difference.max() < bound_m
    assert np.linalg.norm(expected[-1] - expected[0]) > 5.0 * seconds, "it must have moved"


# ---- by hand ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angles_deg", [(0.0, 0.0, 0.0), (4.0, 10.0, 200.0), (-80.0, 70.0, 95.0)])
def test_a_unit_at_rest_on_the_rotating_earth_stays_where_it_is(angles_deg):
    C, dt, angle, velocity = still(300.0, 50.0, angles=np.deg2rad(angles_deg))
    step = mechanise(PLACE, np.zeros(3), C, dt, angle, velocity, NO_ERRORS, NO_NOISE)
    np.testing.assert_allclose(step.position_m, PLACE, atol=1e-5)
    np.testing.assert_allclose(step.velocity_mps, 0.0, atol=1e-7)
    np.testing.assert_allclose(rotvec_of(step.C @ C.T), 0.0, atol=1e-11)
    np.testing.assert_allclose(step.rate_radps, C.T @ SPIN, rtol=1e-9)
    np.testing.assert_allclose(step.force_mps2, -C.T @ np.array(gravity(*PLACE)), rtol=1e-9)


def test_errors_given_are_taken_out_of_the_increments():
    C, dt, angle, velocity = still(20.0, 100.0)
    errors = np.concatenate(
        [[1e-3, -2e-3, 5e-4], [0.02, -0.03, 0.05], [2e-3, -1e-3, 3e-3], [1e-3, 4e-4, -2e-3]]
    )
    measured = angle * (1.0 + errors[6:9]) + np.outer(dt, errors[:3])
    felt = velocity * (1.0 + errors[9:]) + np.outer(dt, errors[3:6])
    step = mechanise(PLACE, np.zeros(3), C, dt, measured, felt, errors, NO_NOISE)
    np.testing.assert_allclose(step.position_m, PLACE, atol=1e-6)
    np.testing.assert_allclose(rotvec_of(step.C @ C.T), 0.0, atol=1e-11)


def test_coning_is_integrated():
    """A classical coning motion: the attitude follows, which the plain sum of the angles would not."""
    cone, wave, dt, n = np.deg2rad(2.0), 2.0 * np.pi * 5.0, 0.01, 1000

    def turned(t):
        return rotation(cone * np.array([np.cos(wave * t), np.sin(wave * t), 0.0]))

    def rate(t):  # of the rotation vector phi(t) with constant length, body axes
        c, s = np.cos(wave * t), np.sin(wave * t)
        across = np.array([-s, c, 0.0])
        return wave * (np.sin(cone) * across - (1.0 - np.cos(cone)) * np.array([0.0, 0.0, 1.0]))

    nodes, weights = np.polynomial.legendre.leggauss(6)
    middle = (np.arange(n) + 0.5) * dt
    angle = (
        0.5
        * dt
        * sum(
            w * np.array([rate(t + 0.5 * dt * x) for t in middle])
            for x, w in zip(nodes, weights, strict=True)
        )
    )
    base = attitude(PLACE)
    end = dt * n
    earth = rotation(-SPIN * end)
    zero = np.zeros((n, 3))
    step = mechanise(PLACE, np.zeros(3), base @ turned(0.0), np.full(n, dt), angle, zero, NO_ERRORS, NO_NOISE)
    off = np.linalg.norm(rotvec_of(step.C @ (earth @ base @ turned(end)).T))
    plain = end * wave * 0.5 * cone**2 * (1.0 - np.sinc(wave * dt / np.pi))
    assert plain > 1e-3
    assert off < 0.1 * plain


def test_gravity_is_that_of_the_ellipsoid():
    """Values of the WGS 84 standard: at the equator, at the pole, and the lapse with height."""
    assert gravity(6378137.0, 0.0, 0.0)[0] == pytest.approx(-9.7803253359, abs=1e-10)
    assert gravity(0.0, 0.0, 6356752.314245)[2] == pytest.approx(-9.8321849378, abs=1e-9)
    high, low = (np.array(gravity(*geodetic_to_ecef(np.pi / 4, 0.3, h))) for h in (1000.0, 0.0))
    assert np.linalg.norm(low) == pytest.approx(9.80619777, abs=1e-7)
    assert (np.linalg.norm(low) - np.linalg.norm(high)) / 1000.0 == pytest.approx(3.085e-6, rel=1e-3)
    up = local_axes(np.array(geodetic_to_ecef(np.pi / 4, 0.3, 0.0)))[2]
    assert up @ low == pytest.approx(-np.linalg.norm(low), abs=1e-11)


# ---- the linear step ----------------------------------------------------------------------------------


def perturbed(start, d):
    """The start and the sensor errors moved by errors (21,)."""
    r, v, C, errors = start
    bias_scale = np.concatenate([d[9:12], d[12:15], d[15:18], d[18:21]])
    return r + d[:3], v + d[3:6], rotation(d[6:9]) @ C, errors + bias_scale


def difference(after, before):
    return np.concatenate([
        after.position_m - before.position_m, after.velocity_mps - before.velocity_mps,
        rotvec_of(after.C @ before.C.T),
    ])  # fmt: skip


def blocks(F):
    """The largest entry of each 3 by 3 block."""
    return np.abs(F).reshape(7, 3, 7, 3).max(axis=(1, 3))


#: What a perturbation is, and the rounding of positions, velocities and attitudes in the differences.
ROUNDING = np.array([4e-9, 4e-13, 2e-15])
SIZES = np.repeat([50.0, 0.5, 1e-4, 1e-5, 1e-3, 1e-4, 1e-4], 3)


@pytest.mark.parametrize(("n", "dt_s"), [(1, 0.01), (2, 0.01), (12, 0.008), (125, 0.008), (100, 0.1)])
def test_the_transition_is_the_derivative_of_the_mechanisation(n, dt_s):
    v, C, dt, angle, velocity = lively(n, dt_s)
    errors = np.concatenate([np.full(3, 1e-4), np.full(3, 0.01), np.full(3, 1e-3), np.full(3, -2e-3)])
    start = (PLACE, v, C, errors)

    def moved(d):
        r, vel, turn, errs = perturbed(start, d)
        return mechanise(r, vel, turn, dt, angle, velocity, errs, NO_NOISE)

    step = moved(np.zeros(21))
    numeric = np.zeros((21, 21))
    numeric[9:, 9:] = np.eye(12)
    for j, size in enumerate(SIZES):
        d = np.zeros(21)
        d[j] = size
        numeric[:9, j] = difference(moved(d), moved(-d)) / (2.0 * size)
    off = blocks(step.F - numeric)[:3] - ROUNDING[:, None] / SIZES[None, ::3]
    # Not in F: the third order of an increment, which counts where the second is all there is: speed from
    # gyroscopes.
    turn = np.abs(angle).max()
    relative = np.full((3, 7), max(1e-4, turn**2 / 2.0))
    relative[:2, [3, 5]] += turn / n
    assert (off <= relative * blocks(numeric)[:3]).all()
    assert (blocks(numeric)[:3] == 0.0).sum() <= 4, "the test must see all that should not be zero"


def simulated_errors(start, dt, angle, velocity, densities, rng):
    """One run with noise: true minus mechanised errors (15,), the biases walking from 0."""
    root = np.sqrt(densities)[:, None]
    n = len(dt)
    gyro_bias, accel_bias = (
        root[i] * np.cumsum(np.sqrt(dt)[:, None] * rng.normal(size=(n, 3)), 0) for i in (2, 3)
    )
    white = [root[i] * np.sqrt(dt)[:, None] * rng.normal(size=(n, 3)) for i in (0, 1)]

    def felt(bias):
        before = np.vstack([np.zeros(3), bias[:-1]])
        return 0.5 * dt[:, None] * (before + bias)

    noisy = mechanise(
        *start[:3], dt, angle + white[0] + felt(gyro_bias), velocity + white[1] + felt(accel_bias),
        NO_ERRORS, NO_NOISE,
    )  # fmt: skip
    return noisy, gyro_bias[-1], accel_bias[-1]


def test_the_noise_is_that_of_monte_carlo_and_so_is_the_carried_covariance():
    """``F P F^T + Q`` and Q alone: errors of start and sensors and noise, whitened, have unit covariance."""
    v, C, dt, angle, velocity = lively(60, 0.02)
    densities = np.array([1e-6, 1e-5, 1e-7, 1e-6])
    sigma = np.repeat([2.0, 0.2, 2e-3, 1e-3, 0.02, 1e-3, 1e-3], 3)
    truth = mechanise(PLACE, v, C, dt, angle, velocity, NO_ERRORS, densities)
    rng = np.random.default_rng(8)
    for P in (np.zeros((21, 21)), np.diag(sigma**2)):
        cov = (truth.F @ P @ truth.F.T + truth.Q)[:15, :15]
        L = np.linalg.cholesky(cov)
        runs = 2500
        white = np.empty((runs, 15))
        for i in range(runs):
            d = np.sqrt(np.diagonal(P)) * rng.normal(size=21)
            start = perturbed((PLACE, v, C, NO_ERRORS), d)
            gyro = angle * (1 + d[15:18]) + np.outer(dt, d[9:12])
            accel = velocity * (1 + d[18:21]) + np.outer(dt, d[12:15])
            noisy, bg, ba = simulated_errors((PLACE, v, C), dt, gyro, accel, densities, rng)
            true = mechanise(*start[:3], dt, angle, velocity, NO_ERRORS, NO_NOISE)
            error = np.concatenate([difference(true, noisy), d[9:12] + bg, d[12:15] + ba])
            white[i] = np.linalg.solve(L, error)
        sample = white.T @ white / runs
        assert np.abs(sample - np.eye(15)).max() < 5.0 * np.sqrt(2.0 / runs)
        assert np.abs(white.mean(axis=0)).max() < 5.0 / np.sqrt(runs)


def test_composition_of_two_calls_is_one_call():
    v, C, dt, angle, velocity = lively(80, 0.01)
    densities = STIM300.densities()
    whole = mechanise(PLACE, v, C, dt, angle, velocity, NO_ERRORS, densities)
    first = mechanise(PLACE, v, C, dt[:40], angle[:40], velocity[:40], NO_ERRORS, densities)
    second = mechanise(*first[:3], dt[40:], angle[40:], velocity[40:], NO_ERRORS, densities)
    np.testing.assert_allclose(second.position_m, whole.position_m, atol=1e-4)
    np.testing.assert_allclose(second.F @ first.F, whole.F, rtol=1e-4, atol=1e-5)
    Q = second.F @ first.Q @ second.F.T + second.Q
    scale = np.sqrt(np.maximum(np.diagonal(whole.Q), 1e-30))
    np.testing.assert_allclose(Q / np.outer(scale, scale), whole.Q / np.outer(scale, scale), atol=2e-3)
    assert not whole.Q[15:].any()


def test_no_increments_change_nothing():
    C, empty = attitude(PLACE), np.zeros((0, 3))
    step = mechanise(PLACE, np.ones(3), C, np.zeros(0), empty, empty, NO_ERRORS, STIM300.densities())
    np.testing.assert_array_equal(step.F, np.eye(21))
    assert not step.Q.any()
    np.testing.assert_array_equal(step.C, C)


# ---- how errors grow ----------------------------------------------------------------------------------


def offset(seconds, rate_hz, *, gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 0.0), tilt_north=0.0, position=PLACE):
    """East, north, up error of a unit at rest, level, heading north, with a bias (body axes) or a tilt."""
    C, dt, angle, velocity = still(seconds, rate_hz, position, np.zeros(3))
    axes = local_axes(position)
    C = rotation(axes.T @ np.array([0.0, tilt_north, 0.0])) @ C
    measured, felt = angle + np.outer(dt, gyro), velocity + np.outer(dt, accel)
    step = mechanise(position, np.zeros(3), C, dt, measured, felt, NO_ERRORS, NO_NOISE)
    return axes @ (step.position_m - position)


def test_an_accelerometer_bias_grows_with_the_square_of_time():
    b, t = STIM300.accel_turn_on_mps2, 60.0
    assert offset(t, 125.0, accel=(b, 0.0, 0.0))[1] == pytest.approx(0.5 * b * t**2, rel=2e-3)
    assert offset(t, 125.0, accel=(0.0, b, 0.0))[0] == pytest.approx(0.5 * b * t**2, rel=2e-3)
    assert offset(t, 125.0, accel=(0.0, 0.0, b))[2] == pytest.approx(-0.5 * b * t**2, rel=2e-3)


def test_a_gyroscope_bias_grows_with_the_cube_of_time():
    b, t = STIM300.gyro_turn_on_radps, 60.0
    g = np.linalg.norm(gravity(*PLACE))
    # Turning right about the forward (north) axis: the lift leans east.
    assert offset(t, 125.0, gyro=(b, 0.0, 0.0))[0] == pytest.approx(g * b * t**3 / 6.0, rel=5e-3)
    assert offset(t, 125.0, gyro=(0.0, b, 0.0))[1] == pytest.approx(-g * b * t**3 / 6.0, rel=5e-3)


def test_a_tilt_grows_with_the_square_of_time():
    t, tilt = 60.0, np.deg2rad(0.02)
    g = np.linalg.norm(gravity(*PLACE))
    assert offset(t, 125.0, tilt_north=tilt)[0] == pytest.approx(0.5 * g * tilt * t**2, rel=5e-3)


def test_over_half_a_schuler_period_a_bias_gives_a_bounded_offset():
    place = np.array(geodetic_to_ecef(0.0, 0.5, 0.0))
    g = np.linalg.norm(gravity(*place))
    radius = 6378137.0 * (1.0 - 6.69438e-3)  # of the meridian
    t, b = np.pi * np.sqrt(radius / g), 1e-3
    north = offset(t, 10.0, accel=(b, 0.0, 0.0), position=place)[1]
    assert north == pytest.approx(2.0 * b * radius / g, rel=0.01)
    assert north < 0.5 * 0.5 * b * t**2, "far below what free fall would give"


def test_the_latitude_used_by_gravity_is_geodetic():
    lat, lon, _ = ecef_to_geodetic(PLACE)
    down = -np.array(gravity(*PLACE))
    down /= np.linalg.norm(down)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    assert np.linalg.norm(np.cross(down, up)) < 1e-6
