"""Ionosphere and troposphere: sizes, signs, mappings, RTKLIB; nothing raises."""

import numpy as np
import pyrtklib as rtk
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pntegrity.physics.atmosphere import klobuchar_m, troposphere_m
from pntegrity.physics.frames import ecef_to_geodetic
from pntegrity.physics.signals import frequency_hz
from pntegrity.physics.tables import Klobuchar
from pntegrity.physics.time import civil_to_ns, to_week_tow

PLACE = np.array([4027881.628, 306998.537, 4919498.984])
NOON = civil_to_ns(2019, 1, 14, 12, 30)
COEFFICIENTS = Klobuchar((1.118e-8, -7.451e-9, -5.961e-8, 1.192e-7), (1.167e5, -2.294e5, -1.311e5, 1.049e6))
L1 = frequency_hz("G", "1C")


def rtklib_llh():
    out = rtk.Arr1Ddouble(3)
    for i, v in enumerate(ecef_to_geodetic(PLACE)):
        out[i] = float(v)
    return out


@pytest.mark.parametrize("el", [0.1, 0.5, 1.0, 1.5])
@pytest.mark.parametrize("az", [0.0, 2.0, 5.0])
@pytest.mark.parametrize("hours", [0, 4, 9])
def test_klobuchar_agrees_with_rtklib(el, az, hours):
    t = NOON + hours * 3600 * 10**9
    ion, angles = rtk.Arr1Ddouble(8), rtk.Arr1Ddouble(2)
    for i, v in enumerate(COEFFICIENTS.alpha + COEFFICIENTS.beta):
        ion[i] = v
    angles[0], angles[1] = az, el
    theirs = rtk.ionmodel(rtk.gpst2time(*to_week_tow(t)), ion, rtklib_llh(), angles)
    ours = klobuchar_m(COEFFICIENTS, PLACE, np.array([el]), np.array([az]), t, L1)
    assert ours[0] == pytest.approx(theirs, abs=2e-3)


# RTKLIB maps by 1 / cos, which is too much near the horizon: 5 % at 9 degrees.
@pytest.mark.parametrize(("el", "tolerance"), [(0.15, 0.05), (0.5, 0.01), (1.5, 0.01)])
def test_troposphere_is_near_rtklibs_saastamoinen(el, tolerance):
    angles = rtk.Arr1Ddouble(2)
    angles[0], angles[1] = 0.0, el
    theirs = rtk.tropmodel(rtk.gpst2time(*to_week_tow(NOON)), rtklib_llh(), angles, 0.5)
    assert troposphere_m(PLACE, np.array([el]), NOON)[0] == pytest.approx(theirs, rel=tolerance)


def test_ionosphere_goes_with_the_inverse_square_of_frequency():
    el, az = np.full(2, 0.7), np.full(2, 1.0)
    f = np.array([L1, frequency_hz("G", "5Q")])
    a, b = klobuchar_m(COEFFICIENTS, PLACE, el, az, NOON, f)
    assert b / a == pytest.approx((f[0] / f[1]) ** 2)


def test_both_grow_towards_the_horizon():
    el = np.radians(np.arange(90.0, 3.0, -1.0))
    assert (np.diff(troposphere_m(PLACE, el, NOON)) > 0).all()
    assert (
        np.diff(klobuchar_m(COEFFICIENTS, PLACE, el, np.zeros_like(el), NOON + 8 * 3600 * 10**9, L1)) > 0
    ).all()


@given(st.lists(st.floats(-2e7, 2e7), min_size=3, max_size=3), st.floats(-7, 7), st.floats(-7, 7))
def test_no_geometry_raises(place, el, az):
    el, az = np.array([el, np.nan]), np.array([az, 1.0])
    for delay in (klobuchar_m(COEFFICIENTS, place, el, az, NOON, L1), troposphere_m(place, el, NOON)):
        assert np.isfinite(delay).all()
        assert (delay >= 0.0).all()


@given(st.floats(-7, 7), st.floats(-700, 700))
def test_no_direction_raises(el, az):
    el, az = np.array([el]), np.array([az])
    assert np.isfinite(klobuchar_m(COEFFICIENTS, PLACE, el, az, NOON, L1)).all()
    assert np.isfinite(troposphere_m(PLACE, el, NOON)).all()


@pytest.mark.parametrize("place", [np.zeros(3), np.full(3, np.nan), np.array([0.0, 0.0, 6.3568e6])])
def test_no_place_raises(place):
    assert klobuchar_m(COEFFICIENTS, place, np.array([-0.1]), np.array([1.0]), NOON, L1).tolist() == [0.0]
    assert troposphere_m(place, np.array([-0.1]), NOON).tolist() == [0.0]
    assert np.isfinite(klobuchar_m(COEFFICIENTS, place, np.array([0.4]), np.array([1.0]), NOON, np.nan)).all()


def test_without_coefficients_there_is_no_delay():
    assert klobuchar_m(None, PLACE, np.array([0.5]), np.array([0.5]), NOON, L1).tolist() == [0.0]
