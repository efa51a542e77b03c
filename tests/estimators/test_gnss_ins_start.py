"""How the inertial filter finds its attitude: standing and moving, with and without a heading, and why not
yet.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ins_logs import blind, drive, filter_of, heading_off, off_m, updates

from pntegrity.estimators._ins_alignment import Alignment, Velocity, aligned, felt
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators._ins_solution import solution_of
from pntegrity.kernels.rotations import attitude_angles, from_angles
from pntegrity.records import Inertial
from pntegrity.sensors.imu import LOW_COST, STIM300

COURSE = "waiting for a course of the GNSS velocity to tell the heading (or give one)"


def increments(angles_rad, force_enu_mps2, rate_radps=(0.0, 0.0, 0.0), seconds=1.0, hz=50.0) -> Inertial:
    """Return what a unit of constant attitude feels beside gravity."""
    n = round(seconds * hz)
    body = from_angles(angles_rad).T @ np.add(force_enu_mps2, (0.0, 0.0, 9.81))
    dt = np.full(n, 1.0 / hz)
    ends = np.round(np.cumsum(dt) * 1e9).astype(np.int64)
    return Inertial(ends, dt, np.outer(dt, rate_radps), np.outer(dt, body))


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.2, -0.1, 2.0), (-0.5, 0.6, 5.0)])
def test_a_standing_vehicle_is_level_as_it_stands(angles):
    rest = Velocity(np.zeros(3), 0.05)
    known = felt(Alignment(), increments(angles, (0.0, 0.0, 0.0)), rest, STIM300)
    found = aligned(known, InsOptions(heading_rad=angles[2]), rest)
    np.testing.assert_allclose(attitude_angles(found.C), angles, atol=1e-9)
    assert found.sigma_rad[0] < np.deg2rad(0.6)
    assert found.sigma_rad[2] == pytest.approx(np.deg2rad(2.0), rel=0.05)


def test_a_start_from_rest_is_level_in_spite_of_its_acceleration():
    # GIVEN a vehicle that stood, and then went off to the north-east at 3 m/s^2 for 2 s
    angles, course = (0.05, -0.03, np.pi / 4), np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    rest, going = Velocity(np.zeros(3), 0.05), Velocity(6.0 * course, 0.05)
    known = felt(Alignment(), increments(angles, (0.0, 0.0, 0.0)), rest, STIM300)
    known = replace(known, force_mps=np.zeros(3), time_s=0.0)
    known = felt(known, increments(angles, 3.0 * course, seconds=2.0), going, STIM300)
    # WHEN its course tells the heading
    found = aligned(known, InsOptions(), going)
    # THEN its level is right, where taking all force for gravity would be 17 degrees off
    np.testing.assert_allclose(attitude_angles(found.C), angles, atol=np.deg2rad(0.5))
    assert found.sigma_rad[0] < np.deg2rad(3.0)


def test_standing_tells_the_bias_of_poor_gyroscopes_and_not_of_good_ones():
    rest, bias = Velocity(np.zeros(3), 0.05), np.array([2e-3, -3e-3, 1e-3])
    known = Alignment()
    for _ in range(10):
        known = felt(known, increments((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), bias), rest, LOW_COST)
    poor, good = (aligned(known, InsOptions(spec=s, heading_rad=0.0), rest) for s in (LOW_COST, STIM300))
    np.testing.assert_allclose(poor.gyro_bias_radps, bias, atol=1e-9)
    assert poor.gyro_sigma_radps < 2e-4 < LOW_COST.start_sigma()[0]
    assert not good.gyro_bias_radps.any()
    assert good.gyro_sigma_radps == STIM300.start_sigma()[0]


def test_a_slow_turn_is_no_bias():
    creeping = Velocity(np.array([0.3, 0.0, 0.0]), 0.05)
    known = felt(Alignment(), increments((0.0, 0.0, 0.0), (0.0,) * 3, (0.0, 0.0, 0.025)), creeping, STIM300)
    assert known.still_s == 0.0


def test_a_given_heading_is_carried_on_until_there_is_a_fix():
    # GIVEN a quarter turn to the right before satellites are seen
    known = Alignment()
    for _ in range(10):
        known = felt(known, increments((0.0, 0.0, 0.0), (0.0,) * 3, (0.0, 0.0, np.pi / 20.0)), None, STIM300)
    found = aligned(known, InsOptions(heading_rad=0.5), None)
    # THEN the heading is that of the first epoch and the turn since then
    turned = np.pi / 20.0 * 9.0
    assert attitude_angles(found.C)[2] == pytest.approx(0.5 + turned, abs=1e-6)


# --- whole drives
# ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [STIM300, LOW_COST], ids=lambda s: s.name)
def test_the_course_of_a_vehicle_that_drives_off_tells_its_heading(spec):
    log = drive(70, spec=spec)
    found = updates(filter_of(log, heading_rad=None, spec=spec), log.epochs)
    begins = next(k for k, u in enumerate(found) if len(u.posterior))
    assert 4 <= begins <= 12
    assert all(u.reason == COURSE and not u.keys for u in found[1:begins])
    sigma = solution_of(found[begins].posterior).attitude_sigma_rad
    angles = solution_of(found[begins].posterior).attitude_rad
    assert np.abs((angles[:2] + 1.0) % 2.0 - 1.0).max() < 4.0 * sigma[:2].max() < np.deg2rad(30.0)
    assert abs(heading_off(log, found)[begins]) < 4.0 * sigma[2]
    assert np.rad2deg(np.abs(heading_off(log, found)[60:]).max()) < 2.0
    assert np.nanmax(off_m(log, found)) < 4.0


def test_a_filter_that_begins_in_the_midst_of_a_drive_finds_its_level():
    log = drive(50, late_s=12)
    found = updates(filter_of(log, heading_rad=None), log.epochs)
    assert len(found[0].posterior)
    assert np.rad2deg(np.abs(heading_off(log, found)[30:]).max()) < 2.0
    assert off_m(log, found).max() < 4.0


def test_without_range_rates_the_way_between_fixes_tells_the_heading():
    log = drive(80)
    found = updates(filter_of(log, heading_rad=None, doppler=False), log.epochs)
    begins = next(k for k, u in enumerate(found) if len(u.posterior))
    assert 9 <= begins <= 40
    assert all(k[4] == "C" for u in found for k in u.keys)
    assert np.rad2deg(np.abs(heading_off(log, found)[65:]).max()) < 5.0
    assert np.nanmax(off_m(log, found)[begins + 5 :]) < 6.0


def test_with_a_heading_and_without_range_rates_the_velocity_comes_from_positions():
    log = drive(60, late_s=20)
    found = updates(filter_of(log, doppler=False), log.epochs)
    speed = [np.linalg.norm(u.posterior.mean[3:6] - v) for u, v in zip(found, log.velocity_mps, strict=True)]
    assert max(speed[:1]) > 3.0
    assert max(speed[30:]) < 0.7


def test_before_it_starts_it_says_what_it_waits_for():
    log = drive(20)
    no_imu = updates(filter_of(log), [replace(e, imu=None) for e in log.epochs[:3]])
    no_gnss = updates(filter_of(log), blind(log.epochs, 0, 5))
    assert {u.reason for u in no_imu} == {"no inertial data at this epoch"}
    assert all("satellites" in u.reason for u in no_gnss[:5])
    assert len(no_gnss[6].posterior)
    assert all(len(u.keys) == len(u.nu) == 0 for u in no_imu)


def test_after_a_long_gap_the_heading_given_for_the_start_is_not_used_again():
    log = drive(40)
    estimator = filter_of(log)
    state = updates(estimator, log.epochs[:1])[-1].posterior
    later = [replace(e, t_ns=e.t_ns + 700 * 10**9) for e in log.epochs[1:4]]
    found = updates(estimator, later, state)
    assert found[0].events[0].startswith("restart after a gap of 70")
    assert all(u.reason == COURSE for u in found)


@pytest.mark.parametrize("arm", [(np.nan, 0.0, 0.0), (60.0, 0.0, 0.0), (1.0, 2.0)])
def test_a_lever_arm_that_cannot_be_is_refused(arm):
    with pytest.raises(ValueError, match="lever arm"):
        InsOptions(lever_arm_m=arm)


def test_a_receiver_that_stands_for_ever_is_kept_waiting_with_a_reason():
    log = drive(5)
    found = updates(filter_of(log, heading_rad=None), log.epochs)
    assert [u.reason for u in found[:3]] == [COURSE] * 3
