"""Normal gravity of the WGS 84 ellipsoid, as a vector in the Earth frame."""

from __future__ import annotations

from math import sqrt

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

__all__ = ["EARTH_RATE", "gravities", "gravity", "gravity_gradient"]

#: Rotation of the Earth, rad/s.
EARTH_RATE = 7.292115e-5
#: WGS 84: semi-major axis (m), flattening, normal gravity at the equator and the poles (m/s^2), and
#: ``omega^2 a^2 b / GM``.
A_M, FLATTENING = 6378137.0, 1.0 / 298.257223563
AT_EQUATOR, AT_POLES, CENTRIFUGAL = 9.7803253359, 9.8321849378, 0.00344978650684
B_M, E2 = A_M * (1.0 - FLATTENING), FLATTENING * (2.0 - FLATTENING)
SOMIGLIANA = B_M * AT_POLES / (A_M * AT_EQUATOR) - 1.0
#: Normal gravity above the ellipsoid leans north or south by this times ``h sin(2 latitude)``, 1/s^2.
LEAN = 8.08e-9
#: Half the distance over which its gradient is taken, m.
REACH_M = 200.0

Vector = tuple[float, float, float]


@njit(cache=True, nogil=True)
def gravity(x: float, y: float, z: float) -> Vector:
    """Return gravity (attraction and centrifugal acceleration), m/s^2, at an ECEF position.

    Somigliana's formula on the ellipsoid with the second-order height correction along its normal (WGS 84,
    NGA.STND.0036, eq. 4-3), and the small northern component of Groves (2013), eq. 2.140. Latitude by
    Bowring's formula, right to 1e-9 rad below 10 km.
    """
    p = sqrt(x * x + y * y)
    t = z * A_M / (p * B_M) if p > 1.0 else z * A_M / B_M
    cos_b = 1.0 / sqrt(1.0 + t * t)
    sin_b = t * cos_b
    up, out = z + E2 / (1.0 - E2) * B_M * sin_b**3, p - E2 * A_M * cos_b**3
    length = sqrt(up * up + out * out)
    s, c = up / length, out / length
    root = sqrt(1.0 - E2 * s * s)
    h = p * c + z * s - A_M * root
    ground = AT_EQUATOR * (1.0 + SOMIGLIANA * s * s) / root
    lapse = 2.0 / A_M * (1.0 + FLATTENING + CENTRIFUGAL - 2.0 * FLATTENING * s * s)
    down = ground * (1.0 - lapse * h + 3.0 * h * h / (A_M * A_M))
    north = -LEAN * h * 2.0 * s * c
    level = -down * c - north * s
    return level * x / max(p, 1.0), level * y / max(p, 1.0), -down * s + north * c


@njit(cache=True, nogil=True)
def gravity_gradient(x: float, y: float, z: float) -> FloatArray:
    """Return the derivative of `gravity` with respect to the position, 1/s^2, shape (3, 3)."""
    G = np.empty((3, 3))
    for j in range(3):
        dx, dy, dz = REACH_M * (j == 0), REACH_M * (j == 1), REACH_M * (j == 2)
        after, before = gravity(x + dx, y + dy, z + dz), gravity(x - dx, y - dy, z - dz)
        for i in range(3):
            G[i, j] = (after[i] - before[i]) / (2.0 * REACH_M)
    return G


@njit(cache=True, nogil=True)
def gravities(positions_m: FloatArray) -> FloatArray:
    """Return `gravity` at ECEF positions (n, 3), shape (n, 3)."""
    out = np.empty(positions_m.shape)
    for i in range(len(positions_m)):
        out[i, 0], out[i, 1], out[i, 2] = gravity(positions_m[i, 0], positions_m[i, 1], positions_m[i, 2])
    return out
