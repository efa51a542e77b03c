"""Delays of ionosphere and troposphere towards satellites, by sidereon's models.

Nothing here raises for a strange geometry, as an iteration may pass through one: rows below the horizon, not
finite, or seen from a place that is no place for an antenna get the delay 0.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from pntegrity.physics.frames import ecef_to_geodetic
from pntegrity.physics.tables import Klobuchar
from pntegrity.physics.time import DAY_NS, SECOND_NS, to_unix_us
from pntegrity.records import FloatArray

__all__ = ["klobuchar_m", "troposphere_m"]

LOWEST_M, HIGHEST_M = -1_000.0, 20_000.0
"""Heights between which a receiver has a troposphere above it."""
HUMIDITY = 0.5


def klobuchar_m(
    coefficients: Klobuchar | None,
    receiver_m: npt.ArrayLike,
    el_rad: FloatArray,
    az_rad: FloatArray,
    t_ns: int,
    freq_hz: npt.ArrayLike,
) -> FloatArray:
    """Return the ionosphere's code delay by the broadcast model, m, shape (n,).

    Parameters
    ----------
    coefficients : Klobuchar or None
        None gives zeros.
    receiver_m : array, shape (3,)
        ECEF.
    el_rad, az_rad : ndarray, shape (n,)
        Elevation and azimuth.
    t_ns : int
        GPS time.
    freq_hz : float or ndarray, shape (n,)
        Carrier frequency.

    References
    ----------
    IS-GPS-200, 20.3.3.5.2.5.
    """
    import sidereon

    n = len(el_rad)
    lat, lon, height = ecef_to_geodetic(receiver_m)
    if coefficients is None or not LOWEST_M < height < 1e6:
        return np.zeros(n)
    time_of_day = t_ns % DAY_NS / SECOND_NS
    place = math.degrees(lat), math.degrees(lon)
    el, az = np.degrees(el_rad), np.degrees(az_rad)
    usable = (el >= 0.0) & np.isfinite(az) & (np.asarray(freq_hz) > 0.0)
    model = sidereon.klobuchar_native
    a, b = coefficients.alpha, coefficients.beta
    rows = zip(usable.tolist(), az.tolist(), el.tolist(), np.broadcast_to(freq_hz, n).tolist(), strict=True)
    return np.array(
        [model(a, b, *place, azi, ele, time_of_day, f) if use else 0.0 for use, azi, ele, f in rows]
    )


def troposphere_m(receiver_m: npt.ArrayLike, el_rad: FloatArray, t_ns: int) -> FloatArray:
    """Return the troposphere's delay, m, shape (n,): Saastamoinen's zenith delays, Niell's mapping.

    Pressure and temperature are the standard atmosphere's at the receiver's height, humidity 50 %.

    Parameters
    ----------
    receiver_m : array, shape (3,)
        ECEF.
    el_rad : ndarray, shape (n,)
        Elevation.
    t_ns : int
        GPS time (for the season of the mapping function).
    """
    import sidereon

    lat, lon, height = ecef_to_geodetic(receiver_m)
    if not LOWEST_M < height < HIGHEST_M:
        return np.zeros(len(el_rad))
    pressure_hpa = 1013.25 * (1.0 - 2.2557e-5 * height) ** 5.2568
    temperature_k = 288.15 - 6.5e-3 * height
    when = to_unix_us(t_ns)
    model = sidereon.tropo_slant_delay
    fixed = (lat, lon, height, pressure_hpa, temperature_k, HUMIDITY, when)
    return np.array([model(el, *fixed) if el > 0.0 else 0.0 for el in np.asarray(el_rad).tolist()])
