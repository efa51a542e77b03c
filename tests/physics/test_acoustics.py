"""Sound in water: travel times, their derivatives, and what a profile refuses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from pntegrity.physics.acoustics import SoundSpeed, arrival_at, effective_speed, path_between, rays
from pntegrity.physics.frames import geodetic_to_ecef

OCEAN = SoundSpeed([0.0, 30.0, 100.0, 500.0, 700.0, 3000.0], [1520.0, 1519.0, 1495.0, 1484.0, 1484.0, 1515.0])
EQUATOR_M = 6378137.0


def integrated(sound, p, z1, z2):
    """Return horizontal way and time of a ray by quadrature."""
    top, bottom = min(z1, z2), max(z1, z2)
    inside = [z for z in sound.depth_m if top < z < bottom]
    ends = [top, *inside, bottom]

    def over(f):
        return sum(quad(f, a, b, epsabs=1e-12, epsrel=1e-12)[0] for a, b in pairwise(ends))

    def cosine(z):
        return np.sqrt(1.0 - (p * sound.at(z)) ** 2)

    return over(lambda z: p * sound.at(z) / cosine(z)), over(lambda z: 1.0 / (sound.at(z) * cosine(z)))


@pytest.mark.parametrize(
    ("z1", "z2", "x"),
    [(3.0, 1340.0, 0.0), (3.0, 1340.0, 1e-3), (3.0, 1340.0, 900.0), (2000.0, 40.0, 3500.0),
     (5.0, 73.0, 342.0), (510.0, 690.0, 400.0), (0.0, 2900.0, 9000.0)],
)  # fmt: skip
def test_travel_times_are_those_of_numerical_integration(z1, z2, x):
    ray = rays(OCEAN, z1, z2, x)
    way, time = integrated(OCEAN, float(ray.p_spm[0]), z1, z2)
    assert way == pytest.approx(x, abs=1e-7)
    assert ray.time_s[0] == pytest.approx(time, rel=1e-12)


def test_a_ray_takes_the_least_time_of_all_ways():
    """Fermat: any way bent otherwise takes longer, the straight one too."""
    z, x, rng = np.linspace(5.0, 1300.0, 400), 1500.0, np.random.default_rng(1)
    c = OCEAN.at(0.5 * (z[1:] + z[:-1]))
    ray = rays(OCEAN, z[0], z[-1], x)
    straight = np.linspace(0.0, x, len(z))
    for bend in (0.0, *rng.normal(0.0, 40.0, 20)):
        side = straight + bend * np.sin(np.pi * (z - z[0]) / np.ptp(z))
        assert ray.time_s[0] < np.sum(np.hypot(np.diff(side), np.diff(z)) / c)


def test_constant_speed_gives_the_straight_line():
    still = SoundSpeed.constant(1500.0)
    nearly = SoundSpeed([0.0, 700.0, 4000.0], [1500.0, 1500.0, 1500.0 + 1e-9])
    for sound in (still, nearly):
        ray = rays(sound, [10.0, 10.0, 900.0], [1000.0, 1000.0, 20.0], [0.0, 3000.0, 500.0])
        length = np.hypot([990.0, 990.0, 880.0], [0.0, 3000.0, 500.0])
        np.testing.assert_allclose(ray.time_s, length / 1500.0, rtol=1e-11)
        np.testing.assert_allclose(ray.p_spm, [0.0, 3000.0 / length[1] / 1500.0, 500.0 / length[2] / 1500.0])
    level = rays(still, 50.0, 50.0, 700.0)
    assert (level.time_s[0], level.dt_dz1[0]) == (pytest.approx(700.0 / 1500.0), 0.0)
    assert rays(still, 50.0, 50.0, 0.0).time_s[0] == 0.0


def test_derivatives_are_those_of_numerical_differentiation():
    z1, z2, x, e = 60.0, 1290.0, 2100.0, 0.05
    ray = rays(OCEAN, z1, z2, x)

    def by(name, *d):
        more, less = (rays(OCEAN, z1 + s * d[0], z2 + s * d[1], x + s * d[2]) for s in (e, -e))
        return (getattr(more, name)[0] - getattr(less, name)[0]) / (2.0 * e)

    assert by("time_s", 0, 0, 1) == pytest.approx(ray.p_spm[0], rel=1e-8)
    assert by("time_s", 1, 0, 0) == pytest.approx(ray.dt_dz1[0], rel=1e-6)
    assert by("time_s", 0, 1, 0) == pytest.approx(ray.dt_dz2[0], rel=1e-6)
    assert by("p_spm", 0, 0, 1) == pytest.approx(ray.dp_dx[0], rel=1e-6)
    assert by("p_spm", 1, 0, 0) == pytest.approx(ray.dp_dz1[0], rel=1e-5)


def test_there_and_back_take_the_same_time():
    down, up = rays(OCEAN, 5.0, 1200.0, 2500.0), rays(OCEAN, 1200.0, 5.0, 2500.0)
    assert down.time_s[0] == pytest.approx(up.time_s[0], rel=1e-15)
    assert down.dt_dz1[0] == pytest.approx(up.dt_dz2[0])


def test_a_ray_that_would_have_to_turn_is_none():
    """In a channel the direct rays end where the fastest layer lets none through."""
    ray = rays(OCEAN, [600.0, 600.0, 600.0], [610.0, 40.0, 40.0], [50.0, 1000.0, 9000.0])
    assert np.isfinite(ray.time_s[:2]).all()
    assert np.isnan(ray.time_s[2])
    assert np.isnan(ray.p_spm[2])
    assert np.isnan(rays(OCEAN, 50.0, 50.0, 100.0).time_s[0])


def test_the_effective_speed_lies_within_the_profile():
    speeds = effective_speed(OCEAN, np.full(5, 4.0), np.full(5, 1200.0), np.linspace(0.0, 3000.0, 5))
    assert ((speeds > 1484.0) & (speeds < 1520.0)).all()
    z = np.linspace(4.0, 1200.0, 200_001)
    assert speeds[0] == pytest.approx(1.0 / np.mean(1.0 / OCEAN.at(z)), rel=1e-6)


def on_equator(x_m, depth_m):
    return geodetic_to_ecef(0.0, x_m / EQUATOR_M, -depth_m)


@pytest.mark.parametrize(("x", "most"), [(1000.0, 1e-7), (3000.0, 1e-6), (10_000.0, 1e-5)])
def test_curvature_of_the_earth_leaves_what_the_module_says(x, most):
    """Against the exact transformation of layers about a sphere to flat ones: z' = R ln(R/r), c' = c R/r."""
    R, z = EQUATOR_M, np.linspace(0.0, 3000.0, 30_001)
    flat = SoundSpeed(R * np.log(R / (R - z)), OCEAN.at(z) * R / (R - z))
    ends = [R * np.log(R / (R - d)) for d in (5.0, 2800.0)]
    exact = rays(flat, ends[0], ends[1], x).time_s[0]
    found = path_between(OCEAN, on_equator(0.0, 5.0), on_equator(x, 2800.0))
    assert found.time_s == pytest.approx(exact, rel=most)


@pytest.mark.parametrize("sound", [OCEAN, SoundSpeed.constant(1490.0)], ids=["profile", "constant"])
def test_slowness_and_direction_on_the_ellipsoid(sound):
    here = geodetic_to_ecef(0.6, -2.1, 32.0)
    there = geodetic_to_ecef(0.60013, -2.1001, -1200.0)
    path, arrival, e = path_between(sound, here, there, 40.0), arrival_at(sound, here, there, 40.0), 0.2

    def by_place(f):
        return np.stack([(f(here + d) - f(here - d)) / (2.0 * e) for d in e * np.eye(3)], axis=-1)

    slowness = by_place(lambda x: path_between(sound, x, there, 40.0).time_s)
    turning = by_place(lambda x: arrival_at(sound, x, there, 40.0).direction)
    # the vertical turns with the place too, by 1/2R, which the derivatives leave out
    np.testing.assert_allclose(path.slowness_spm, slowness, atol=1e-8)
    np.testing.assert_allclose(arrival.by_place, turning, atol=1e-7)
    assert np.abs(turning).max() > 3e-4
    assert np.linalg.norm(arrival.direction) == pytest.approx(1.0)
    np.testing.assert_allclose(arrival.direction, -path.slowness_spm / np.linalg.norm(path.slowness_spm))
    assert arrival.direction @ (there - here) > 0.99 * np.linalg.norm(there - here)


def test_depths_count_from_the_sea_surface():
    """A higher sea surface is more depth: the speed changes, not the length."""
    here, there = geodetic_to_ecef(0.6, -2.1, -5.0), geodetic_to_ecef(0.6, -2.1, -1005.0)
    shallow, deep = (path_between(OCEAN, here, there, h).time_s for h in (0.0, 1.0))
    c = OCEAN.at([5.0, 1005.0])
    assert deep - shallow == pytest.approx(1.0 / c[1] - 1.0 / c[0], rel=0.05)


def test_a_profile_that_does_not_reach_names_both_depths():
    with pytest.raises(ValueError, match=r"ends at 3000\.0 m, beacon 'A' is 3100\.0 m deep.*add a row"):
        OCEAN.check(3100.0, "beacon 'A'")
    with pytest.raises(ValueError, match=r"begins at 0\.0 m, a place is -43\.0 m deep.*sea surface"):
        OCEAN.check(-43.0)
    longer = OCEAN.extended(3100.0)
    longer.check(3100.0)
    assert longer.at(3100.0) == pytest.approx(1515.0 + 100.0 * 31.0 / 2300.0)
    here, there = geodetic_to_ecef(0.6, -2.1, -5.0), geodetic_to_ecef(0.6, -2.1, -3050.0)
    with pytest.raises(ValueError, match="ends at"):
        path_between(OCEAN, here, there)


@pytest.mark.parametrize(
    ("depth", "speed", "match"),
    [([0.0], [1500.0], "two or more"), ([0.0, 1.0], [1500.0], "same length"),
     ([0.0, 5.0, 5.0], [1500.0] * 3, "must rise"), ([0.0, np.nan], [1500.0] * 2, "must rise"),
     ([0.0, 5.0], [1500.0, 4900.0], r"not 4900 at a depth of 5 m"),
     ([0.0, 5.0], [1.5, 1.5], "1300 and 1800")],
)  # fmt: skip
def test_what_is_no_profile(depth, speed, match):
    with pytest.raises(ValueError, match=match):
        SoundSpeed(depth, speed)
