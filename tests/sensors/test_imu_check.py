"""Angles in another unit than the table says: told where gravity or a track tells it, or not at all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.formats._imu_checks import check_gravity
from pntegrity.formats.fixes import read_fixes
from pntegrity.formats.imu_table import read_imu
from pntegrity.imu_lag import tracks
from pntegrity.records import Inertial
from pntegrity.sensors.imu_check import check_level, check_turns

HZ, G, DEG = 100, 9.8, np.pi / 180.0
TABLE = Path("imu.csv")
FUSION = "imu-gnss-fusion/urban-{}-nominal-001"
REAL = [
    ("imu-drive-2025189", "imu_gpst.csv.gz", "gnss_1934_sf.pos.gz", "-x,y,-z"),
    ("imu-walk-2025240", "imu_gpst.csv.gz", "gnss_1730_sf.pos.gz", "-y,-x,-z"),
    (FUSION.format("mixed-turns"), "imu.csv.gz", "gnss.csv.gz", "rfu"),
    (FUSION.format("stop-go-tight-turns"), "imu.csv.gz", "gnss.csv.gz", "rfu"),
]


def unit(rates, forces):
    """Return increments of rates, rad/s, and forces, m/s^2, by sample."""
    dt = np.full(len(rates), 1.0 / HZ)
    t_ns = (np.arange(1, len(rates) + 1) * (10**9 // HZ)).astype(np.int64)
    return Inertial(t_ns, dt, rates * dt[:, None], forces * dt[:, None])


def winding(seconds=200.0, speed=5.0, seed=3):
    """Return a level vehicle that winds its way, and its places of each second: a unit, times, track."""
    t = np.arange(1, round(seconds * HZ) + 1) / HZ
    rate = 0.25 * np.sin(2.0 * np.pi * t / 17.0) + 0.1 * np.sin(2.0 * np.pi * t / 41.0)
    heading = np.cumsum(rate) / HZ
    rng, zero = np.random.default_rng(seed), np.zeros(len(t))
    place = np.cumsum(speed * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) / HZ
    gyro = np.stack([zero, zero, rate], axis=1) + 0.002 * rng.normal(size=(len(t), 3))
    force = np.stack([zero, speed * rate, zero - G], axis=1) + 0.02 * rng.normal(size=(len(t), 3))
    made = unit(gyro, force)
    k = np.arange(HZ - 1, len(t), HZ)
    return made, made.t_ns[k], place[k] + 0.05 * rng.normal(size=(len(k), 2))


def swing(amplitude_deg, seconds=100.0, length_m=2.2):
    """Return a unit that hangs from a rope, free: what it feels never leaves its axis down."""
    n, fine = round(seconds * HZ), 20
    angle, rate, found = amplitude_deg * DEG, 0.0, []
    for i in range(n * fine):
        rate -= G / length_m * np.sin(angle) / (HZ * fine)
        angle += rate / (HZ * fine)
        if i % fine == fine - 1:
            found.append((rate, G * np.cos(angle) + rate**2 * length_m))
    rates, tension = np.array(found).T
    zero = np.zeros(n)
    return unit(np.stack([rates, zero, zero], axis=1), np.stack([zero, zero, -tension], axis=1))


def scaled(whole, factor):
    return replace(whole, angle_rad=whole.angle_rad * factor)


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0 / DEG, ("57.3 times too large", "gyro_x_dps", "dtheta_x_deg")),
        (DEG, ("57.3 times too small", "gyro_x_rps", "dtheta_x_rad")),
        (100.0, ("100 times too large", "rates that are named increments")),
        (0.01, ("100 times too small", "increments that are named rates")),
        (3600.0, ("3600 times too large", "gyro_x_deg_h")),
        (1e-3, ("1000 times too small", "named mrad")),
    ],
)
def test_turns_of_the_track_tell_the_factor_and_what_to_name(factor, words):
    whole, t_ns, track = winding()
    with pytest.raises(InputError) as error:
        check_turns(scaled(whole, factor), t_ns, track, 0.05, TABLE)
    assert error.value.path == TABLE
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.5, -1.0])
def test_of_turns_that_are_about_right_nothing_is_said(factor):
    whole, t_ns, track = winding()
    check_turns(scaled(whole, factor), t_ns, track, 0.05, TABLE)


@pytest.mark.parametrize("factor", [DEG, 1.0, 1.0 / DEG])
def test_a_track_that_cannot_tell_says_nothing(factor):
    whole, t_ns, track = winding()
    whole = scaled(whole, factor)
    rng = np.random.default_rng(5)
    straight = np.stack([np.linspace(0.0, 1000.0, len(t_ns)), np.zeros(len(t_ns))], axis=1)
    at_rest = rng.normal(size=(len(t_ns), 2))
    astray = np.cumsum(rng.normal(size=(len(t_ns), 2)), axis=0) * 5.0
    for other in (straight, at_rest, astray, np.full_like(track, np.nan), track[:0]):
        check_turns(whole, t_ns[: len(other)], other, 1.0, TABLE)
    check_turns(whole, t_ns[:10], track[:10], 0.05, TABLE)
    check_turns(whole, t_ns + 10**15, track, 0.05, TABLE)
    check_turns(whole, t_ns, track, 200.0, TABLE)


def test_a_vehicle_that_moves_sideways_as_it_likes_is_let_pass():
    for seed in range(200):
        whole, t_ns, _ = winding(100.0)
        astray = np.cumsum(np.random.default_rng(seed).normal(size=(len(t_ns), 2)), axis=0) * 8.0
        check_turns(whole, t_ns, astray, 0.05, TABLE)


@pytest.mark.parametrize("amplitude", [5.0, 40.0, 80.0])
def test_a_free_swing_is_let_pass_and_told_where_its_rates_are_in_degrees(amplitude):
    whole = swing(amplitude)
    check_gravity(whole, TABLE, True, np.eye(3))
    check_level(whole, TABLE)
    check_level(scaled(whole, DEG), TABLE)
    if amplitude < 45.0:
        with pytest.raises(InputError, match=r"too large.*gyro_x_dps") as error:
            check_level(scaled(whole, 1.0 / DEG), TABLE)
        assert error.value.path == TABLE


def test_a_unit_at_rest_a_short_log_and_a_gyroscope_that_fails_halfway_are_let_pass():
    zero = np.zeros((60 * HZ, 3))
    rest = unit(zero + 0.0005, zero + np.array([0.0, 0.0, -G]))
    for factor in (1.0, 1.0 / DEG, DEG):
        check_level(scaled(rest, factor), TABLE)
    short = scaled(swing(40.0, 20.0), 1.0 / DEG)
    check_level(short, TABLE)
    late = np.where(np.arange(60 * HZ)[:, None] > 32 * HZ, np.array([0.5, 0.0, 0.0]), 0.0)
    check_level(unit(late, zero + np.array([0.0, 0.0, -G])), TABLE)
    check_level(unit(zero[:1], zero[:1] - G), TABLE)


@pytest.mark.parametrize(("folder", "table", "fixes", "axes"), REAL)
def test_real_logs_are_let_pass_and_told_in_any_wrong_unit(shared, folder, table, fixes, axes):
    table, fixes = shared / folder / table, shared / folder / fixes
    if not table.is_file():
        pytest.skip(f"{folder} is not here")
    whole, epochs = read_imu(table, axes=axes, origin_ns=0), read_fixes(fixes, origin_ns=0)
    place, _, sigma_m = tracks(epochs, GnssOptions())
    t_ns = np.array([e.t_ns for e in epochs], dtype=np.int64)
    for begin_s in (0, 60, 100):
        part = replace_span(whole, begin_s)
        check_level(part, table)
        check_turns(part, t_ns, place, sigma_m, table)
    check_level(whole, table)
    check_turns(whole, t_ns, place, sigma_m, table)
    for factor, word in ((1.0 / DEG, "57.3 times too large"), (DEG, "57.3 times too small")):
        with pytest.raises(InputError, match=word):
            check_turns(scaled(whole, factor), t_ns, place, sigma_m, table)
    with pytest.raises(InputError, match="too large"):
        check_level(scaled(whole, 1.0 / DEG), table)


def replace_span(whole, begin_s, seconds=40.0):
    """Return a short part of a log."""
    since = (whole.t_ns - whole.t_ns[0]) * 1e-9
    i = slice(*np.searchsorted(since, [begin_s, begin_s + seconds]))
    return Inertial(whole.t_ns[i], whole.dt_s[i], whole.angle_rad[i], whole.velocity_mps[i])
