"""Frames: Earth-fixed (ECEF, WGS 84) positions, geodetic coordinates, local east-north-up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pntegrity.records import FloatArray

__all__ = ["ecef_to_geodetic", "elevation_azimuth", "enu_rotation", "geodetic_to_ecef"]


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
    """Return ECEF positions (n, 3), m; (3,) for scalars; nan where an input is not finite."""
    import sidereon

    columns = np.broadcast_arrays(
        np.degrees(latitude_rad), np.degrees(longitude_rad), np.multiply(height_m, 1e-3)
    )
    rows = np.stack([np.atleast_1d(c).astype(np.float64) for c in columns], axis=-1)
    out = np.full(rows.shape, np.nan)
    good = np.isfinite(rows).all(axis=1)
    if good.any():
        out[good] = sidereon.geodetic_to_ecef(rows[good]) * 1e3
    return out[0] if columns[0].ndim == 0 else out


def enu_rotation(position_m: npt.ArrayLike) -> FloatArray:
    """Return the matrix (3, 3) that turns ECEF differences at a position into east, north, up."""
    lat, lon, _ = ecef_to_geodetic(position_m)
    (sp, cp), (sl, cl) = (np.sin(lat), np.cos(lat)), (np.sin(lon), np.cos(lon))
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


def elevation_azimuth(receiver_m: npt.ArrayLike, los: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return elevation and azimuth (from north, clockwise, 0 to 2 pi), rad, of unit vectors (n, 3)."""
    east, north, up = enu_rotation(receiver_m) @ np.asarray(los, dtype=np.float64).T
    return np.arcsin(np.clip(up, -1.0, 1.0)), np.mod(np.arctan2(east, north), 2.0 * np.pi)
