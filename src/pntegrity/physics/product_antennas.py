"""Phase centres of satellite and receiver antennas, as plain values (part of `physics.products`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.physics.signals import frequency_hz
from pntegrity.records import FloatArray
from pntegrity.states import frozen

__all__ = ["ReceiverAntenna", "SatelliteAntenna"]


@dataclass(frozen=True, eq=False)
class SatelliteAntenna:
    """Phase centre of a satellite's antenna in one span of time.

    Parameters
    ----------
    sat, block : str
        ``"G05"`` and the type, ``"BLOCK IIF"``.
    pco_m : mapping of str to ndarray, shape (3,)
        By RINEX band (``"1"``, ``"2"``, ...): offset from the centre of mass in body axes x, y, z of the IGS.
    pcv : mapping of str to (ndarray, ndarray), shapes (n,)
        By band: nadir angles, rad, and phase centre variations, m.
    valid_ns : (int or None, int or None)
        First and last time, ns of GPS time; None is without end.
    """

    sat: str
    block: str
    pco_m: Mapping[str, FloatArray]
    pcv: Mapping[str, tuple[FloatArray, FloatArray]]
    valid_ns: tuple[int | None, int | None] = (None, None)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pco_m", {b: frozen(v) for b, v in self.pco_m.items()})
        object.__setattr__(self, "pcv", {b: (frozen(z), frozen(v)) for b, (z, v) in self.pcv.items()})

    def calibrated_band(self, band: str) -> tuple[str, str]:
        """Return the band to take, and a note where it is another one: the nearest in frequency."""
        found = _nearest((self.sat[0], band), [(self.sat[0], b) for b in self.pco_m])[1]
        return found, "" if found == band else f"{self.sat}: no offset for band {band}, band {found} taken"

    def pcv_m(self, band: str, nadir_rad: npt.ArrayLike) -> FloatArray:
        """Return the variation at nadir angles, m: linear, the end value beyond the grid, 0 without one."""
        angles, values = self.pcv.get(self.calibrated_band(band)[0], (np.zeros(1), np.zeros(1)))
        return np.interp(np.asarray(nadir_rad, dtype=np.float64), angles, values)


@dataclass(frozen=True, eq=False)
class ReceiverAntenna:
    """Phase centre of a receiver's antenna type.

    Parameters
    ----------
    antenna, radome : str
        As calibrated: ``"TRM59800.00"``, ``"SCIS"``.
    pco_neu_m : mapping of (str, str) to ndarray, shape (3,)
        By system letter and band: offset from the antenna reference point to the north, east and up.
    pcv : mapping of (str, str) to (ndarray, ndarray or None, ndarray)
        Zenith angles (nz,), azimuths (na,) rising over a full turn or None, and variations, m: (na, nz), or
        (nz,) without azimuths.
    notes : tuple of str
        What to know about the choice, in words.
    """

    antenna: str
    radome: str
    pco_neu_m: Mapping[tuple[str, str], FloatArray]
    pcv: Mapping[tuple[str, str], tuple[FloatArray, FloatArray | None, FloatArray]]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "pco_neu_m", {k: frozen(v) for k, v in self.pco_neu_m.items()})
        grids = {
            k: (frozen(z), None if a is None else frozen(a), frozen(v)) for k, (z, a, v) in self.pcv.items()
        }
        object.__setattr__(self, "pcv", grids)

    def calibrated_band(self, system: str, band: str) -> tuple[tuple[str, str], str]:
        """Return the system and band to take, and a note where they are others: nearest in frequency."""
        found = _nearest((system, band), list(self.pco_neu_m))
        same = found == (system, band)
        return found, "" if same else f"{self.antenna}: {''.join(found)} taken for {system}{band}"

    def pcv_m(
        self, system: str, band: str, zenith_rad: npt.ArrayLike, azimuth_rad: npt.ArrayLike = 0.0
    ) -> FloatArray:
        """Return the variation in directions, m: bilinear, the end value beyond the grid, 0 without one."""
        zenith = np.asarray(zenith_rad, dtype=np.float64)
        grid = self.pcv.get(self.calibrated_band(system, band)[0])
        if grid is None:
            return np.zeros(zenith.shape)
        angles, azimuths, values = grid
        if azimuths is None:
            return np.interp(zenith, angles, values)
        turn = np.asarray(azimuth_rad, dtype=np.float64) % (2.0 * math.pi)
        i, u = _place(azimuths, turn)
        k, v = _place(angles, zenith)
        low = values[i, k] * (1.0 - v) + values[i, k + 1] * v
        high = values[i + 1, k] * (1.0 - v) + values[i + 1, k + 1] * v
        return np.asarray(low * (1.0 - u) + high * u)


def _place(grid: FloatArray, x: FloatArray) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return the cell of each value and its place in it, 0 to 1."""
    i = np.clip(np.searchsorted(grid, x, side="right") - 1, 0, len(grid) - 2)
    return i, np.clip((x - grid[i]) / (grid[i + 1] - grid[i]), 0.0, 1.0)


def _nearest(wanted: tuple[str, str], there: list[tuple[str, str]]) -> tuple[str, str]:
    """Return the calibrated system and band nearest in frequency, the own system first among equals."""
    if wanted in there:
        return wanted
    hz = frequency_hz(*wanted, 0)

    def distance(key: tuple[str, str]) -> tuple[float, bool, tuple[str, str]]:
        away = abs(frequency_hz(*key, 0) - hz)
        return away if math.isfinite(away) else math.inf, key[0] != wanted[0], key

    return min(there, key=distance)
