"""How a marker moves with the Earth: solid tide, pole tide, ocean loading, by sidereon's models."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.physics.products import OceanLoading, PolarMotion
from pntegrity.physics.time import SECOND_NS, leap_seconds
from pntegrity.records import FloatArray

__all__ = ["displacements_m"]

SPACING_NS = 60 * SECOND_NS
"""Tides are evaluated this far apart and are linear between (under 0.01 mm off)."""
FAR_M = 5_000.0
"""Nor further apart than this along the way (0.2 mm)."""


def displacements_m(
    t_ns: npt.NDArray[np.int64],
    track_m: FloatArray,
    *,
    ocean: OceanLoading | None = None,
    pole: PolarMotion | None = None,
    solid: bool = True,
) -> FloatArray:
    """Return the displacement of the marker at each epoch, Earth-fixed, m, shape (n, 3).

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
    track_m : ndarray, shape (n, 3)
        Where the marker is, good to a kilometre.
    ocean : OceanLoading, optional
        Coefficients of the station; without them no loading.
    pole : PolarMotion, optional
        Without it, and at times outside its table, no pole tide.
    solid : bool
        Whether there is a solid Earth tide.
    """
    nodes = _nodes(t_ns, track_m)
    values = np.array([_at(int(t_ns[i]), track_m[i], ocean, pole, solid) for i in nodes])
    return np.stack([np.interp(t_ns, t_ns[nodes], values[:, k]) for k in range(3)], axis=1)


def _nodes(t_ns: npt.NDArray[np.int64], track_m: FloatArray) -> list[int]:
    """Return the epochs at which to evaluate: the first, the last, and every one that is far from the last
    taken.
    """
    nodes = [0]
    for i in range(1, len(t_ns)):
        far = np.abs(track_m[i] - track_m[nodes[-1]]).max() > FAR_M
        if far or t_ns[i] - t_ns[nodes[-1]] >= SPACING_NS or i == len(t_ns) - 1:
            nodes.append(i)
    return nodes


def _at(
    t_ns: int, position_m: FloatArray, ocean: OceanLoading | None, pole: PolarMotion | None, solid: bool
) -> FloatArray:
    import sidereon

    if not (solid or ocean or pole):
        return np.zeros(3)
    when = datetime(1980, 1, 6) + timedelta(seconds=t_ns / SECOND_NS)
    when -= timedelta(seconds=leap_seconds(when.year, when.month, when.day))
    loading = None if ocean is None else sidereon.OceanLoadingBlq(*(a.tolist() for a in _coefficients(ocean)))
    x, y = (np.nan, np.nan) if pole is None else pole.at(t_ns)
    known = bool(np.isfinite(x) and np.isfinite(y))
    permissive: Any = sidereon.ValidityMode.PERMISSIVE
    found = sidereon.station_displacement_ecef_m(
        np.ascontiguousarray(position_m), when.year, when.month, when.day, when.hour, when.minute,
        when.second + when.microsecond * 1e-6, solid_earth_tide=solid, pole_tide=known,
        ocean_loading=loading, validity=permissive,
        polar_motion_arcsec=(float(x), float(y)) if known else None,
    )  # fmt: skip
    return np.asarray(found.ecef_m, dtype=np.float64)


def _coefficients(ocean: OceanLoading) -> tuple[FloatArray, FloatArray]:
    return ocean.amplitude_m, ocean.phase_deg
