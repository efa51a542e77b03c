"""Simulated increments: mechanised, they follow the motion; their errors are those of the specification."""

import time
from functools import lru_cache

import numpy as np
import pytest

from pntegrity.formats.truth import read_truth
from pntegrity.kernels.gravity import gravity
from pntegrity.kernels.rotations import rotvec_of
from pntegrity.kernels.strapdown import mechanise
from pntegrity.physics.frames import geodetic_to_ecef
from pntegrity.records import Inertial
from pntegrity.sensors.imu import LOW_COST, STIM300
from pntegrity.simulate.imu import increments, with_errors
from pntegrity.simulate.motion import motion_of, motion_of_drive
from pntegrity.simulate.trajectory import CIRCUIT, Leg, car

PLACE = np.array(geodetic_to_ecef(np.deg2rad(35.1), np.deg2rad(136.9), 40.0))
START = 10**18
MINUTE = 60 * 10**9
NO_ERRORS, NO_NOISE = np.zeros(12), np.zeros(4)
TRACKS = ("nagoya-truth/20230711/reference.csv.gz", "tst-urban-2019118/groundTruth_TST.csv.gz")


@lru_cache(maxsize=1)
def drive():
    return motion_of_drive(car(PLACE, (Leg(5.0, 0.0), *CIRCUIT), heading_rad=0.4), START, 200.0)


@lru_cache(maxsize=2)
def track(path):
    return motion_of(read_truth(path))


def run(start, inertial, errors=NO_ERRORS, densities=NO_NOISE):
    return mechanise(*start, inertial.dt_s, inertial.angle_rad, inertial.velocity_mps, errors, densities)


def at(motion, t_ns):
    return [part[0] for part in motion.at([t_ns])]


def closure(motion, begin, end, rate_hz):
    """How far the mechanised increments are from the motion: position, velocity, attitude."""
    step = run(at(motion, begin), increments(motion, begin, end, rate_hz))
    position, velocity, C = at(motion, end)
    off = (step.position_m - position, step.velocity_mps - velocity, rotvec_of(step.C @ C.T))
    return [float(np.linalg.norm(part)) for part in off]


@pytest.mark.parametrize("rate_hz", [50.0, 125.0, 200.0])
def test_a_drive_is_closed(rate_hz):
    for begin in (0, MINUTE, 2 * MINUTE):
        position, velocity, turn = closure(drive(), START + begin, START + begin + MINUTE, rate_hz)
        assert position < 0.002
        assert velocity < 1e-4
        assert turn < 1e-7


@pytest.mark.parametrize("name", TRACKS)
def test_every_minute_of_a_real_track_is_closed_below_a_centimetre(shared, name):
    motion = track(shared / name)
    first, last = motion.span_ns
    starts = range(first, last - MINUTE, MINUTE)
    assert len(starts) >= 8
    assert max(closure(motion, t, t + MINUTE, 125.0)[0] for t in starts) < 0.002


def test_increments_fill_the_time_and_add_up():
    fine, coarse = (increments(drive(), START, START + 10 * 10**9 + 5, hz) for hz in (125.0, 100.0))
    assert fine.t_ns[-1] == START + 10 * 10**9 + 5
    assert fine.dt_s.sum() == pytest.approx(10.000000005, abs=1e-12)
    assert (np.diff(fine.t_ns) > 0).all()
    np.testing.assert_allclose(fine.angle_rad.sum(axis=0), coarse.angle_rad.sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(fine.velocity_mps.sum(axis=0), coarse.velocity_mps.sum(axis=0), atol=1e-7)
    down = fine.velocity_mps[:400].sum(axis=0) / fine.dt_s[:400].sum()
    assert np.linalg.norm(down) == pytest.approx(np.linalg.norm(gravity(*PLACE)), abs=1e-3)
    assert down[2] < -9.7, "at rest the force points up, away from the body's down"


def test_times_without_increments_are_refused():
    with pytest.raises(ValueError, match="no increments"):
        increments(drive(), START + 5, START + 5, 125.0)
    with pytest.raises(ValueError, match="not within the motion"):
        increments(drive(), START - 5, START + 10**9, 125.0)


def test_twenty_minutes_take_less_than_two_seconds(shared):
    motion = track(shared / TRACKS[0])
    increments(motion, motion.span_ns[0], motion.span_ns[0] + 10**9, 125.0)
    began = time.process_time()
    made = increments(motion, *motion.span_ns, 125.0)
    with_errors(made, STIM300, np.random.default_rng(1))
    assert time.process_time() - began < 2.0
    assert len(made.dt_s) == 153750


def still(n, rate_hz):
    dt = np.full(n, 1.0 / rate_hz)
    t_ns = START + np.round(np.cumsum(dt) * 1e9).astype(np.int64)
    return Inertial(t_ns, dt, np.zeros((n, 3)), np.zeros((n, 3)))


@pytest.mark.parametrize("spec", [STIM300, LOW_COST], ids=lambda s: s.name)
def test_errors_are_those_of_the_specification(spec):
    """White noise, walk and start of many axes against the specification, by their chi-square limits."""
    runs, n = 300, 200
    rng = np.random.default_rng(5)
    measured, errors = zip(*(with_errors(still(n, 50.0), spec, rng) for _ in range(runs)), strict=True)
    bias = np.array([e[:, :6] for e in errors])
    density = np.repeat(spec.densities(), 3)
    walk = np.diff(bias, axis=1) ** 2 / (density[6:] * 0.02)
    assert abs(walk.mean() - 1.0) < 5.0 * np.sqrt(2.0 / walk.size)
    start = np.array([e[0] for e in errors]) / spec.start_sigma()
    assert abs((start**2).mean() - 1.0) < 5.0 * np.sqrt(2.0 / start.size)
    before = np.concatenate([bias[:, :1], bias[:, :-1]], axis=1)
    felt = (
        np.array([np.hstack([m.angle_rad, m.velocity_mps]) for m in measured]) - 0.5 * (before + bias) * 0.02
    )
    white = felt[:, 1:] ** 2 / (density[:6] * 0.02)
    assert abs(white.mean() - 1.0) < 5.0 * np.sqrt(2.0 / white.size)


def test_the_true_errors_undo_the_measured_increments():
    quiet = increments(drive(), START, START + MINUTE, 125.0)
    spec = LOW_COST
    measured, errors = with_errors(quiet, spec, np.random.default_rng(3))
    again, same = with_errors(quiet, spec, np.random.default_rng(3))
    np.testing.assert_array_equal(again.angle_rad, measured.angle_rad)
    np.testing.assert_array_equal(same, errors)
    back = (measured.angle_rad - errors[:, :3] * measured.dt_s[:, None]) / (1.0 + errors[:, 6:9])
    left = (back - quiet.angle_rad) / np.sqrt(spec.densities()[0] * measured.dt_s[:, None])
    assert abs(left.std() - 1.0) < 0.03
    back = (measured.velocity_mps - errors[:, 3:6] * measured.dt_s[:, None]) / (1.0 + errors[:, 9:])
    left = (back - quiet.velocity_mps) / np.sqrt(spec.densities()[1] * measured.dt_s[:, None])
    assert abs(left.std() - 1.0) < 0.03


@pytest.mark.parametrize(
    ("spec", "known"),
    [(STIM300, False), (STIM300, True), (LOW_COST, True)],
    ids=lambda s: getattr(s, "name", str(s)),
)
def test_the_linear_step_predicts_the_errors_of_a_simulated_unit(spec, known):
    """Navigation errors after 20 s of driving, over their predicted covariance: a chi-square of 9 each.

    Biases and scales at the start are unknown, or known: those of the low-cost unit leave the linear range.
    """
    begin, end, runs = START + 10 * 10**9, START + 30 * 10**9, 200
    quiet = increments(drive(), begin, end, 50.0)
    start, (position, velocity, C) = at(drive(), begin), at(drive(), end)
    step = run(start, quiet, densities=spec.densities())
    P = np.diag(np.concatenate([np.zeros(9), np.zeros(12) if known else spec.start_sigma() ** 2]))
    L = np.linalg.cholesky((step.F @ P @ step.F.T + step.Q)[:9, :9])
    rng = np.random.default_rng(11)
    square = 0.0
    for _ in range(runs):
        measured, errors = with_errors(quiet, spec, rng)
        got = run(start, measured, errors[0] if known else NO_ERRORS)
        off = (position - got.position_m, velocity - got.velocity_mps, rotvec_of(C @ got.C.T))
        square += float(np.sum(np.linalg.solve(L, np.concatenate(off)) ** 2))
    assert abs(square / (9 * runs) - 1.0) < 5.0 * np.sqrt(2.0 / (9 * runs))
