"""Frames: Earth-fixed (ECEF, WGS 84) positions, geodetic coordinates, local east-north-up."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.axes import axes_at
from pntegrity.records import FloatArray

__all__ = [
    "ecef_to_geodetic", "elevation_azimuth", "enu_rotation", "enu_rotations", "geodetic_of",
    "geodetic_to_ecef",
]  # fmt: skip


def ecef_to_geodetic(position_m: npt.ArrayLike) -> FloatArray:
    """Return latitude, longitude (rad), height (m) of ECEF positions (3,) or (n, 3); nan where not finite."""
    import sidereon

    p = np.asarray(position_m, dtype=np.float64)
    rows = np.atleast_2d(p)
    out = np.full(rows.shape, np.nan)
    good = np.isfinite(rows).all(axis=1)
    if good.any():
        degrees_km = sidereon.ecef_to_geodetic(np.ascontiguousarray(rows[good]) * 1e-3)
        out[good] = degrees_km * (np.pi / 180.0, np.pi / 180.0, 1e3)
    return out.reshape(p.shape)


def geodetic_to_ecef(
    latitude_rad: npt.ArrayLike, longitude_rad: npt.ArrayLike, height_m: npt.ArrayLike
) -> FloatArray:
    """Return ECEF positions (n, 3), m; (3,) for scalars; nan where there is no such place."""
    import sidereon

    columns = np.broadcast_arrays(
        np.degrees(latitude_rad), np.degrees(longitude_rad), np.multiply(height_m, 1e-3)
    )
    rows = np.stack([np.atleast_1d(c).astype(np.float64) for c in columns], axis=-1)
    out = np.full(rows.shape, np.nan)
    good = np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 0]) <= 90.0) & (np.abs(rows[:, 1]) <= 360.0)
    rows[:, 1] = np.mod(rows[:, 1] + 180.0, 360.0) - 180.0  # sidereon takes -180 to 180 only
    if good.any():
        out[good] = sidereon.geodetic_to_ecef(rows[good]) * 1e3
    return out[0] if columns[0].ndim == 0 else out


@lru_cache(maxsize=64)
def geodetic_of(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
    """Return latitude, longitude (rad) and height (m) of one ECEF position; nan where not finite.

    Kept for the last positions: an epoch asks for the same one several times.
    """
    import sidereon

    if not (math.isfinite(x_m) and math.isfinite(y_m) and math.isfinite(z_m)):
        return math.nan, math.nan, math.nan
    lat, lon, height = sidereon.ecef_to_geodetic(np.array([[x_m, y_m, z_m]]) * 1e-3)[0].tolist()
    return math.radians(lat), math.radians(lon), height * 1e3


def enu_rotation(position_m: npt.ArrayLike) -> FloatArray:
    """Return the matrix (3, 3) that turns ECEF differences at a position into east, north, up."""
    return _rotation(*np.asarray(position_m, dtype=np.float64).tolist())


def enu_rotations(positions_m: FloatArray) -> FloatArray:
    """Return `enu_rotation` of each of the positions (n, 3), shape (n, 3, 3)."""
    lat, lon, _ = ecef_to_geodetic(positions_m).T
    (sp, cp), (sl, cl), zero = (np.sin(lat), np.cos(lat)), (np.sin(lon), np.cos(lon)), np.zeros(len(lat))
    rows = [[-sl, cl, zero], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]]
    return np.moveaxis(np.array(rows), 2, 0)


@lru_cache(maxsize=64)
def _rotation(x_m: float, y_m: float, z_m: float) -> FloatArray:
    lat, lon, _ = geodetic_of(x_m, y_m, z_m)
    return axes_at(lat, lon)


def elevation_azimuth(receiver_m: npt.ArrayLike, los: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return elevation and azimuth (from north, clockwise, 0 to 2 pi), rad, of unit vectors (n, 3)."""
    east, north, up = enu_rotation(receiver_m) @ np.asarray(los, dtype=np.float64).T
    return np.arcsin(np.clip(up, -1.0, 1.0)), np.mod(np.arctan2(east, north), 2.0 * np.pi)
