"""Ranges and range rates: against central differences, and against numbers found another way."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.sensors.ranges import C_MPS, EARTH_RATE_RADPS, geometry, range_rate

RNG = np.random.default_rng(4)
PLACES = [
    np.array(p) for p in ([4027881.6, 306998.5, 4919499.0], [-2.7e6, -4.3e6, 3.85e6], [6378137.0, 0.0, 0.0])
]


def satellites(n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    direction = RNG.standard_normal((n, 3))
    position = 2.66e7 * direction / np.linalg.norm(direction, axis=1)[:, None]
    return position, np.cross(RNG.standard_normal((n, 3)), position) * 1e-4


def turned(position: np.ndarray, angle: float) -> np.ndarray:
    """Return an Earth-fixed position in the frame of `angle` earlier (the Earth turns eastwards)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * position[0] + s * position[1], -s * position[0] + c * position[1], position[2]])


@pytest.mark.parametrize("place", PLACES, ids=["Brussels", "California", "equator"])
def test_the_range_is_the_way_of_light_in_a_frame_that_does_not_turn(place):
    # the satellite in the frame of the time of reception, the travel time by iteration: no Sagnac formula
    position, _ = satellites()
    expected = []
    for sv in position:
        travel = 0.07
        for _ in range(6):
            distance = np.linalg.norm(turned(sv, EARTH_RATE_RADPS * travel) - place)
            travel = distance / C_MPS
        expected.append(distance)
    np.testing.assert_allclose(geometry(place, position).range_m, expected, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("place", PLACES, ids=["Brussels", "California", "equator"])
def test_the_range_rate_is_the_slope_of_the_range(place):
    position, speed = satellites()
    mine = RNG.standard_normal(3) * 30.0
    h = 0.01
    ahead, behind = (geometry(place + s * h * mine, position + s * h * speed).range_m for s in (1.0, -1.0))
    found = range_rate(mine, place, position, speed, geometry(place, position).los)
    np.testing.assert_allclose(found, (ahead - behind) / (2.0 * h), rtol=0.0, atol=1e-4)


def test_the_line_of_sight_is_a_unit_vector_towards_the_satellite():
    position, _ = satellites()
    los = geometry(PLACES[0], position).los
    np.testing.assert_allclose(np.linalg.norm(los, axis=1), 1.0, rtol=1e-14)
    assert np.all(np.einsum("ij,ij->i", los, position - PLACES[0]) > 0.0)


def test_sagnac_has_the_size_of_the_textbooks():
    # a satellite low in the east or west of a receiver on the equator: some 30 m, with the sign of the
    # Earth's turn
    place = PLACES[2]
    east, west = np.array([[1.0e7, 2.46e7, 0.0]]), np.array([[1.0e7, -2.46e7, 0.0]])
    by = [float(geometry(place, sv).range_m[0] - np.linalg.norm(sv - place)) for sv in (east, west)]
    assert by[0] == pytest.approx(-by[1], rel=1e-12)
    assert by[1] == pytest.approx(38.2, abs=0.5)  # omega x y / c = 7.292e-5 * 6.378e6 * 2.46e7 / 2.998e8
