"""Directions on the Earth and along a track."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.kernels.axes import local_axes, track_axes
from pntegrity.physics.frames import enu_rotation, geodetic_to_ecef

PLACES = [(0.0, 0.0), (50.85, 4.35), (-33.9, 151.2), (89.9, -30.0), (-89.99, 170.0), (60.0, -179.9)]


@pytest.mark.parametrize("height", [-50.0, 0.0, 9_000.0, 600_000.0])
@pytest.mark.parametrize("place", PLACES)
def test_east_north_up_are_those_of_the_ellipsoid(place: tuple[float, float], height: float) -> None:
    x = geodetic_to_ecef(*np.deg2rad(place), height)
    axes = local_axes(x)
    # the place is rounded to a metre: that turns it, near a pole
    np.testing.assert_allclose(axes, enu_rotation(x), atol=3e-7 + 1.0 / float(np.hypot(x[0], x[1])))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("pole", [6_356_753.0, -6_356_753.0])
def test_at_a_pole_up_is_along_the_axis(pole: float) -> None:
    axes = local_axes(np.array([0.0, 0.0, pole]))
    np.testing.assert_allclose(axes[2], [0.0, 0.0, np.sign(pole)], atol=1e-9)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def test_a_step_of_a_millimetre_does_not_turn_them() -> None:
    x = geodetic_to_ecef(0.8, 0.1, 100.0)
    assert local_axes(x) is local_axes(np.round(x) + 1e-3)
    assert not local_axes(x).flags.writeable


def test_local_coordinates_are_their_own_axes() -> None:
    np.testing.assert_array_equal(local_axes(np.array([3.0, -5.0, 100.0])), np.eye(3))
    np.testing.assert_array_equal(local_axes(np.zeros(2)), np.eye(3, 2))
    np.testing.assert_array_equal(local_axes(np.zeros(1)), np.eye(3, 1))


@pytest.mark.parametrize("course_deg", [0.0, 30.0, 90.0, 200.0, 359.0])
def test_along_and_across_are_the_course_and_the_right_angle_to_its_left(course_deg: float) -> None:
    axes = enu_rotation(geodetic_to_ecef(0.9, 0.2, 50.0))
    c = np.deg2rad(course_deg)
    east, north = np.sin(c), np.cos(c)
    track = track_axes(axes, axes.T @ np.array([12.0 * east, 12.0 * north, 3.0]), 0.5)
    assert track is not None
    np.testing.assert_allclose(track @ axes.T, [[east, north, 0.0], [-north, east, 0.0]], atol=1e-12)


def test_a_short_way_has_no_course() -> None:
    axes = np.eye(3)
    assert track_axes(axes, np.array([0.3, 0.39, 100.0]), 0.5) is None
    assert track_axes(axes, np.array([0.31, 0.4, 0.0]), 0.5) is not None
    assert track_axes(axes, np.zeros(3), 0.5) is None
    assert track_axes(axes, np.full(3, np.nan), 0.5) is None
