"""Smooth motions: what they keep of a reference, and that a vehicle moves as one does."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from pntegrity.formats.truth import Truth, read_truth
from pntegrity.kernels.rotations import attitude_angles, from_angles
from pntegrity.physics.frames import enu_rotation, enu_rotations, geodetic_to_ecef
from pntegrity.simulate.motion import motion_of, motion_of_drive
from pntegrity.simulate.trajectory import Leg, car

PLACE = np.array(geodetic_to_ecef(np.deg2rad(35.1), np.deg2rad(136.9), 40.0))
START = 10**18
NAGOYA, TST = "nagoya-truth/20230711/reference.csv.gz", "tst-urban-2019118/groundTruth_TST.csv.gz"
LEGS = (
    Leg(5.0, 0.0),
    Leg(10.0, 9.0),
    Leg(10.0, 9.0, np.pi / 2),
    Leg(10.0, 9.0),
    Leg(9.0, 0.0),
    Leg(20.0, 0.0),
)


@lru_cache(maxsize=4)
def reference(path):
    return read_truth(path)


def drive():
    return motion_of_drive(car(PLACE, LEGS, 0.4), START, 60.0)


def angles(motion, t_ns):
    position, _, C = motion.at(t_ns)
    return attitude_angles(enu_rotations(position) @ C)


def grid(motion, step_ns=10**8):
    return np.arange(motion.span_ns[0], motion.span_ns[1] + 1, step_ns)


def test_velocity_acceleration_and_rate_are_derivatives_and_go_on_without_jumps():
    motion = drive()
    s = np.linspace(0.001, 59.99, 59990)
    here, after, before = (motion.moments(s + d) for d in (0.0, 1e-3, -1e-3))
    slope = (after.position_m - before.position_m) / 2e-3
    np.testing.assert_allclose(here.velocity_mps, slope, atol=1e-5)
    np.testing.assert_allclose(
        here.acceleration_mps2, (after.velocity_mps - before.velocity_mps) / 2e-3, atol=0.01
    )
    turning = np.einsum("nji,njk->nik", here.C, (after.C - before.C) / 2e-3)
    np.testing.assert_allclose(here.rate_radps[:, 2], turning[:, 1, 0], atol=1e-5)
    for values, bound in ((here.acceleration_mps2, 0.02), (here.rate_radps, 0.002)):
        assert np.abs(np.diff(values, axis=0)).max() < bound


def test_a_drive_is_followed_with_its_nose_ahead():
    motion, way = drive(), car(PLACE, LEGS, 0.4)
    t = grid(motion)
    position, velocity, _ = motion.at(t)
    expected = np.array([way(float(s)) for s in (t - START) * 1e-9])
    assert np.linalg.norm(position - expected[:, 0], axis=1).max() < 0.05
    assert np.linalg.norm(velocity - expected[:, 1], axis=1).max() < 0.2
    roll, pitch, heading = angles(motion, t).T
    assert np.abs(roll).max() < 1e-6
    assert np.abs(pitch).max() < 1e-3
    speed = np.linalg.norm(velocity, axis=1)
    east, north, _ = enu_rotation(PLACE) @ velocity.T
    off = np.angle(np.exp(1j * (heading - np.arctan2(east, north))))
    assert np.abs(off[speed > 3.0]).max() < np.deg2rad(1.0)


def test_nothing_turns_at_a_standstill():
    motion = drive()
    s = np.concatenate([np.linspace(0.0, 4.0, 100), np.linspace(46.0, 60.0, 200)])
    still = motion.moments(s)
    assert np.linalg.norm(still.velocity_mps, axis=1).max() < 0.02
    assert np.abs(still.rate_radps).max() < 2e-3
    heading = attitude_angles(enu_rotation(PLACE) @ still.C)[:, 2]
    np.testing.assert_allclose(heading[:100], 0.4, atol=2e-3)
    np.testing.assert_allclose(heading[100:], 0.4 + np.pi / 2, atol=2e-3)


def test_flickering_positions_and_repeated_times_make_no_wild_accelerations():
    rng = np.random.default_rng(4)
    way = car(PLACE, LEGS, 0.4)
    t = START + 2 * 10**8 * np.arange(301)
    position = np.array([way(0.2 * k)[0] for k in range(301)]) + rng.uniform(-5e-4, 5e-4, (301, 3))
    again = np.repeat(np.arange(301), 1 + (np.arange(301) % 7 == 0))
    motion = motion_of(Truth(t[again], position[again]))
    still = motion.moments(np.linspace(47.0, 59.0, 1000))
    assert np.linalg.norm(still.acceleration_mps2, axis=1).max() < 0.05
    assert np.linalg.norm(motion.moments(np.linspace(0, 60, 5000)).acceleration_mps2, axis=1).max() < 2.5


def test_the_lever_arm_leads_from_antenna_to_unit_and_back():
    t = START + 10**8 * np.arange(601)
    base = drive()
    arm = np.array([0.8, -0.4, -1.5])
    antenna, speed = base.of_point(t, arm)
    turned = angles(base, t)
    motion = motion_of(Truth(t, antenna, attitude_rad=turned), lever_arm_m=arm)
    position, velocity, _ = base.at(t)
    np.testing.assert_allclose(motion.at(t)[0], position, atol=0.03)
    np.testing.assert_allclose(motion.of_point(t, arm)[0], antenna, atol=0.03)
    slope = (base.of_point(t[1:-1] + 10**6, arm)[0] - base.of_point(t[1:-1] - 10**6, arm)[0]) / 2e-3
    np.testing.assert_allclose(speed[1:-1], slope, atol=1e-4)
    assert np.abs(np.linalg.norm(speed - velocity, axis=1)).max() > 0.1, "the drive must turn"


def test_bad_times_and_short_references_are_refused():
    motion = drive()
    with pytest.raises(ValueError, match="not within the motion"):
        motion.at([START - 1])
    with pytest.raises(ValueError, match="at least 5 epochs"):
        motion_of(Truth(START + 10**9 * np.arange(4), np.tile(PLACE, (4, 1))))
    with pytest.raises(ValueError, match="no course"):
        motion_of(Truth(START + 10**9 * np.arange(9), np.tile(PLACE, (9, 1))))


def test_angles_and_matrices_are_inverse_and_signed_as_on_a_car():
    rng = np.random.default_rng(1)
    some = np.stack([rng.uniform(-3, 3, 50), rng.uniform(-1.5, 1.5, 50), rng.uniform(0, 6.2, 50)], 1)
    np.testing.assert_allclose(attitude_angles(from_angles(some)), some, atol=1e-12)
    nose, right, down = from_angles(np.deg2rad([10.0, 20.0, 90.0])).T
    assert nose[0] > 0.9, "heading 90 deg is east"
    assert nose[2] == pytest.approx(np.sin(np.deg2rad(20.0))), "pitch lifts the nose"
    assert right[2] < 0.0, "roll lowers the right side"
    assert np.cross(nose, right) == pytest.approx(down)


# ---- real references ----------------------------------------------------------------------------------


def test_nagoya_is_followed(shared):
    truth = reference(shared / NAGOYA)
    motion = motion_of(truth)
    position, velocity, _ = motion.at(truth.t_ns)
    off = np.linalg.norm(position - truth.position_m, axis=1)
    assert np.percentile(off, 95) < 0.01
    assert off.max() < 0.05
    assert np.median(np.linalg.norm(velocity - truth.velocity_mps, axis=1)) < 0.02
    turned = np.angle(np.exp(1j * (angles(motion, truth.t_ns) - truth.attitude_rad)))
    assert np.degrees(np.percentile(np.abs(turned), 99)) < 0.5
    still = np.linalg.norm(truth.velocity_mps, axis=1) < 0.005
    here = motion.moments(motion.seconds(truth.t_ns[still]))
    assert np.percentile(np.linalg.norm(here.acceleration_mps2, axis=1), 99) < 0.1


def test_a_course_stands_in_for_the_attitude_of_nagoya(shared):
    """Where the car is driven ahead (it parks backwards at the end): heading within a degree, mostly."""
    truth = reference(shared / NAGOYA)
    motion = motion_of(replace(truth, attitude_rad=None))
    fast = np.linalg.norm(truth.velocity_mps, axis=1) > 2.0
    off = np.angle(np.exp(1j * (angles(motion, truth.t_ns) - truth.attitude_rad)))[:, 2]
    assert np.degrees(np.median(np.abs(off[fast]))) < 1.0
    assert np.degrees(np.percentile(np.abs(off[fast]), 99)) < 5.0


def test_hong_kong_is_a_plausible_drive(shared):
    truth = reference(shared / TST)
    motion = motion_of(truth)
    assert np.linalg.norm(motion.at(truth.t_ns)[0] - truth.position_m, axis=1).max() < 0.15
    here = motion.moments(motion.seconds(grid(motion)))
    assert np.linalg.norm(here.acceleration_mps2, axis=1).max() < 5.0
    assert np.abs(here.rate_radps).max() < 0.8
    speed = np.linalg.norm(here.velocity_mps, axis=1)
    assert np.abs(here.rate_radps[speed < 0.05]).max() < 0.02
