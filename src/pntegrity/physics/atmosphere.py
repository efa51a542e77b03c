"""Delays of ionosphere and troposphere towards satellites, by sidereon's models.

Nothing here raises for a strange geometry, as an iteration may pass through one: rows below the horizon, not
finite, or seen from a place that is no place for an antenna get the delay 0.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from pntegrity.physics.frames import geodetic_of
from pntegrity.physics.tables import Klobuchar
from pntegrity.physics.time import DAY_NS, SECOND_NS, to_unix_us
from pntegrity.records import FloatArray

__all__ = ["klobuchar_m", "mapping_factors", "troposphere_m", "zenith_delays_m"]

LOWEST_M, HIGHEST_M = -1_000.0, 20_000.0
"""Heights between which a receiver has a troposphere above it."""
HUMIDITY = 0.5
NIELL_LOWEST_RAD, NIELL_M = 0.0524, (-100.0, 10_000.0)
LOWEST_RAD, HIGHEST_RAD = 0.0175, 1.5708
"""Elevations: below 1 degree the mapping functions grow without bound and are kept at their value there."""


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
    lat, lon, height = geodetic_of(*np.asarray(receiver_m, dtype=np.float64).tolist())
    if coefficients is None or not LOWEST_M < height < 1e6:
        return np.zeros(n)
    time_of_day = t_ns % DAY_NS / SECOND_NS
    place = math.degrees(lat), math.degrees(lon)
    model = sidereon.klobuchar_native
    a, b = coefficients.alpha, coefficients.beta
    el, az = np.degrees(el_rad).tolist(), (np.degrees(az_rad) % 360.0).tolist()
    f = np.broadcast_to(freq_hz, n).tolist()
    return np.array(
        [
            model(a, b, *place, az[i], el[i], time_of_day, f[i])
            if 0.0 <= el[i] <= 90.0 and f[i] > 0.0 and math.isfinite(az[i])
            else 0.0
            for i in range(n)
        ]
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

    lat, lon, height = geodetic_of(*np.asarray(receiver_m, dtype=np.float64).tolist())
    if not LOWEST_M < height < HIGHEST_M:
        return np.zeros(len(el_rad))
    when = to_unix_us(t_ns)
    model = sidereon.tropo_slant_delay
    fixed = (lat, lon, height, *_standard(height), HUMIDITY, when)
    return np.array(
        [
            model(max(el, LOWEST_RAD), *fixed) if 0.0 < el < HIGHEST_RAD else 0.0
            for el in np.asarray(el_rad).tolist()
        ]
    )


def zenith_delays_m(receiver_m: npt.ArrayLike) -> tuple[float, float]:
    """Return dry and wet zenith delay, m, of the standard atmosphere; zeros where there is no troposphere."""
    import sidereon

    lat, _, height = geodetic_of(*np.asarray(receiver_m, dtype=np.float64).tolist())
    if not LOWEST_M < height < HIGHEST_M:
        return 0.0, 0.0
    dry, wet = sidereon.tropo_zenith_delay(lat, height, *_standard(height), HUMIDITY)
    return float(dry), float(wet)


def _standard(height_m: float) -> tuple[float, float]:
    """Return pressure (hPa) and temperature (K) of the standard atmosphere."""
    return 1013.25 * (1.0 - 2.2557e-5 * height_m) ** 5.2568, 288.15 - 6.5e-3 * height_m


def mapping_factors(
    receiver_m: npt.ArrayLike, el_rad: FloatArray, t_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Return Niell's dry and wet mapping factors, shapes (n,): how much longer than at the zenith a delay is.

    Below 3 degrees, and beyond the heights of `NIELL_M`, they are kept at their value there.
    """
    import sidereon

    lat, _, height = geodetic_of(*np.asarray(receiver_m, dtype=np.float64).tolist())
    if not LOWEST_M < height < HIGHEST_M:
        return np.zeros(len(el_rad)), np.zeros(len(el_rad))
    when, factors = to_unix_us(t_ns), sidereon.tropo_mapping_factors
    height = min(max(height, NIELL_M[0]), NIELL_M[1])
    elevations = np.clip(el_rad, NIELL_LOWEST_RAD, HIGHEST_RAD - 1e-9).tolist()
    pairs = np.array([factors(el, lat, height, when) for el in elevations]).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]
