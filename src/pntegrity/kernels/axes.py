"""Directions in which a position is judged: east, north and up on the Earth, and along and across a track."""

from __future__ import annotations

from functools import lru_cache
from math import atan2, cos, hypot, sin, sqrt

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

__all__ = ["axes_at", "local_axes", "track_axes"]

#: WGS 84: semi-major axis, m, and flattening.
A_M, FLATTENING = 6378137.0, 1.0 / 298.257223563
#: Nearer to the origin than this, coordinates are local ones already, m.
SURFACE_M = 6.3e6


def local_axes(position_m: FloatArray) -> FloatArray:
    """Return the matrix (3, n) that turns differences of a position (n,) into east, north and up.

    Of an Earth-fixed position on the ground or above; any other has local coordinates, in that order, and
    where it has fewer than three the rows of the others are zero.
    """
    if len(position_m) == 3 and float(position_m @ position_m) > SURFACE_M**2:
        return _axes(*np.round(position_m).tolist())
    return np.eye(3, len(position_m))


@lru_cache(maxsize=64)
def _axes(x: float, y: float, z: float) -> FloatArray:
    """Return the axes at a place, whose latitude is that of Bowring's formula (right to 1e-9 rad)."""
    b, p = A_M * (1.0 - FLATTENING), hypot(x, y)
    beta = atan2(z * A_M, p * b)
    e2 = FLATTENING * (2.0 - FLATTENING)
    lat = atan2(z + e2 / (1.0 - e2) * b * sin(beta) ** 3, p - e2 * A_M * cos(beta) ** 3)
    return axes_at(lat, atan2(y, x))


def axes_at(lat_rad: float, lon_rad: float) -> FloatArray:
    """Return the unit vectors east, north and up at a geodetic latitude and longitude, shape (3, 3),
    read-only.
    """
    (sp, cp), (sl, cl) = (sin(lat_rad), cos(lat_rad)), (sin(lon_rad), cos(lon_rad))
    out = np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
    out.flags.writeable = False
    return out


def track_axes(axes: FloatArray, moved_m: FloatArray, least_m: float) -> FloatArray | None:
    """Return the rows along and across a track, shape (2, n); None where it is too short to have a course.

    Parameters
    ----------
    axes : ndarray, shape (3, n)
        As `local_axes` gives.
    moved_m : ndarray, shape (n,)
        The way that was made.
    least_m : float
        Shorter horizontal ways have no course.
    """
    east, north, _ = (axes @ moved_m).tolist()
    length = sqrt(east * east + north * north)
    if not length > least_m:
        return None
    s, c = east / length, north / length
    return np.array([s * axes[0] + c * axes[1], -c * axes[0] + s * axes[1]])
