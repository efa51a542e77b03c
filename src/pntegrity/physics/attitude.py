"""How satellites stand in space, and what it does to a carrier: body axes and phase wind-up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pntegrity.physics.time import to_unix_us
from pntegrity.records import FloatArray

__all__ = ["body_axes", "sun_directions", "wind_up_cycles"]


def sun_directions(t_ns: npt.NDArray[np.int64]) -> FloatArray:
    """Return unit vectors from the Earth's centre to the Sun, Earth-fixed, shape (n, 3)."""
    import sidereon

    sun = np.asarray(sidereon.sun_moon_ecef(np.array([to_unix_us(int(t)) for t in t_ns])).sun)
    return np.asarray(sun / np.linalg.norm(sun, axis=1)[:, None])


def _unit(a: FloatArray) -> FloatArray:
    return np.asarray(a / np.linalg.norm(a, axis=1)[:, None])


def body_axes(position_m: FloatArray, sun: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the body axes x, y, z of satellites in nominal yaw steering, Earth-fixed, shapes (n, 3).

    z points to the Earth's centre, y is normal to the plane of satellite, Earth and Sun, x on the Sun's side.
    Turns at noon and midnight, eclipses, and the orbit-normal mode of BDS-2 and QZSS are not modelled.

    Parameters
    ----------
    position_m : ndarray, shape (n, 3)
        Earth-fixed.
    sun : ndarray, shape (n, 3)
        Unit vectors from the Earth's centre (the Sun is far enough away).

    References
    ----------
    Montenbruck et al. (2015), GNSS satellite geometry and attitude models.
    """
    z = -_unit(position_m)
    y = _unit(np.cross(z, sun))
    return np.cross(y, z), y, z


def wind_up_cycles(
    satellite: npt.NDArray[np.int64], axes: tuple[FloatArray, FloatArray, FloatArray], los: FloatArray,
    north: FloatArray, west: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the phase wind-up, cycles, without jumps along the rows of each satellite.

    Parameters
    ----------
    satellite : ndarray, shape (n,)
        Which satellite; rows are sorted by satellite and time.
    axes : tuple of ndarray, shapes (n, 3)
        Body axes of the satellites.
    los : ndarray, shape (n, 3)
        Unit vectors from receiver to satellite.
    north, west : ndarray, shape (n, 3)
        Local directions at the receiver: a right-handed antenna's dipole axes.

    References
    ----------
    Wu et al. (1993), Effects of antenna orientation on GPS carrier phase.
    """
    k = -los
    x, y, _ = axes
    sent = x - k * _dot(k, x) - np.cross(k, y)
    received = north - k * _dot(k, north) + np.cross(k, west)
    cosine = _dot(_unit(sent), _unit(received))[:, 0]
    sign = np.sign(_dot(k, np.cross(sent, received))[:, 0])
    turns = sign * np.arccos(np.clip(cosine, -1.0, 1.0)) / (2.0 * np.pi)
    return _unwrapped(turns, satellite)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, b)[:, None])


def _unwrapped(turns: FloatArray, satellite: npt.NDArray[np.int64]) -> FloatArray:
    whole = -np.rint(np.diff(turns, prepend=turns[:1]))
    first = np.diff(satellite, prepend=satellite[:1] - 1) != 0 if len(satellite) else np.zeros(0, dtype=bool)
    whole[first] = 0.0
    total = np.cumsum(whole)
    begins = np.flatnonzero(first)
    counts = np.diff(np.append(begins, len(turns)))
    return np.asarray(turns + total - np.repeat(total[begins], counts))
