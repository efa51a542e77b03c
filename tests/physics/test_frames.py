"""Frames."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pntegrity.physics.frames import ecef_to_geodetic, elevation_azimuth, enu_rotation, geodetic_to_ecef

latitudes = st.floats(-1.57, 1.57)
longitudes = st.floats(-3.14, 3.14)


@given(latitudes, longitudes, st.floats(-1000.0, 3e7))
def test_geodetic_round_trip(lat, lon, height):
    back = ecef_to_geodetic(geodetic_to_ecef(lat, lon, height))
    np.testing.assert_allclose(back[:2], (lat, lon), atol=1e-9)
    assert abs(back[2] - height) < 1e-4


@given(latitudes, longitudes)
def test_enu_is_a_rotation_and_up_is_up(lat, lon):
    p = geodetic_to_ecef(lat, lon, 100.0)
    r = enu_rotation(p)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(r @ (geodetic_to_ecef(lat, lon, 101.0) - p), (0.0, 0.0, 1.0), atol=1e-6)


@given(latitudes, longitudes, st.floats(-1.5, 1.5), st.floats(0.0, 6.28))
def test_elevation_and_azimuth_come_back(lat, lon, el, az):
    p = geodetic_to_ecef(lat, lon, 0.0)
    los = np.array([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)]) @ enu_rotation(p)
    e, a = elevation_azimuth(p, los[None, :])
    assert abs(e[0] - el) < 1e-7
    assert abs(np.angle(np.exp(1j * (a[0] - az)))) < 1e-6


def test_strange_positions_do_not_raise():
    assert np.isnan(ecef_to_geodetic([np.nan, 0.0, 0.0])).all()
    assert np.isfinite(ecef_to_geodetic([0.0, 0.0, 0.0])).all()
    many = ecef_to_geodetic([[4e6, 3e5, 4.9e6], [np.inf, 0.0, 0.0]])
    assert np.isfinite(many[0]).all()
    assert np.isnan(many[1]).all()
    assert geodetic_to_ecef(np.zeros(4), np.zeros(4), 0.0).shape == (4, 3)
