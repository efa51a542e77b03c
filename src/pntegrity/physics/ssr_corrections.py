"""Corrections of a state-space service (QZSS CLAS) as plain values, and which of them are in force when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from pntegrity.physics.atmosphere_products import metres_per_tecu
from pntegrity.physics.signals import frequency_hz
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import FloatArray
from pntegrity.states import frozen

__all__ = [
    "MAX_CORRECTION_AGE_S", "ClasCorrections", "InForce", "Kind", "SatelliteCorrections", "in_force",
    "quality_tecu",
]  # fmt: skip

MAX_CORRECTION_AGE_S = 60.0
"""Older corrections are not used: those of clocks come every 5 s, of orbits and biases every 30 s."""
CHANNELS = frozenset("CBQILSP")
"""Attributes of a signal that is one channel (data or pilot) of what a service calls ``X``."""
Kind = Literal["code", "phase"]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ReasonArray = npt.NDArray[np.object_]


def quality_tecu(quality_m: npt.ArrayLike) -> FloatArray:
    """Return the accuracy of a slant content, TECU, of the indicator ``1e-3 (3^class (1 + value / 4) - 1)``.

    That formula, the one of the range accuracy (URA) too, is taken to give metres on L1. Taken as TECU it
    would be six times less: about the 0.05 TECU by which slant contents drift from a receiver's carriers
    within minutes, without their constant errors.
    """
    return np.asarray(quality_m, dtype=np.float64) / metres_per_tecu(frequency_hz("G", "1C"))


@dataclass(frozen=True, eq=False)
class SatelliteCorrections:
    """What was in force for one satellite at each time; nan where the service says "not available".

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        Times from which the values could be used, ns of GPS time, strictly rising.
    iode : ndarray of int64, shape (n,)
        Issue of data of the broadcast message that they correct.
    orbit_m : ndarray, shape (n, 3)
        Radial, along-track, cross-track; taken off the broadcast position.
    clock_m : ndarray, shape (n,)
        Added to the broadcast clock times the speed of light.
    ura_m : ndarray, shape (n,)
        Stated accuracy of orbit and clock.
    stec_tecu, stec_sigma_tecu : ndarray, shape (n,)
        Slant electron content at the receiver and its stated accuracy.
    code_bias_m, phase_bias_m : mapping of str to ndarray, shapes (n,)
        By signal, ``"2X"``.
    """

    t_ns: IntArray
    iode: IntArray
    orbit_m: FloatArray
    clock_m: FloatArray
    ura_m: FloatArray
    stec_tecu: FloatArray
    stec_sigma_tecu: FloatArray
    code_bias_m: Mapping[str, FloatArray] = field(default_factory=dict)
    phase_bias_m: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.t_ns)
        for name in ("t_ns", "iode"):
            whole = np.array(getattr(self, name), dtype=np.int64)
            whole.flags.writeable = False
            object.__setattr__(self, name, whole)
        for name in ("orbit_m", "clock_m", "ura_m", "stec_tecu", "stec_sigma_tecu"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
            if getattr(self, name).shape != ((n, 3) if name == "orbit_m" else (n,)):
                raise ValueError(f"`{name}` must have as many rows as `t_ns`, {n}")
        for name in ("code_bias_m", "phase_bias_m"):
            object.__setattr__(self, name, {s: frozen(v) for s, v in getattr(self, name).items()})
        if (np.diff(self.t_ns) <= 0).any():
            raise ValueError("`t_ns` must rise strictly")

    def bias_m(self, kind: Kind, signal: str) -> FloatArray | None:
        """Return the biases of a signal's code or phase, shape (n,); None where they are not known.

        A service that names a signal by both channels of a band together (``"2X"``) means each of them
        (``"2L"``) too, but not the encrypted code (``"2W"``).
        """
        rows = self.code_bias_m if kind == "code" else self.phase_bias_m
        return rows.get(signal, rows.get(signal[0] + "X") if signal[1:] in CHANNELS else None)


@dataclass(frozen=True, eq=False)
class ClasCorrections:
    """Corrections of CLAS as they were at hand in one place.

    Parameters
    ----------
    satellites : mapping of str to SatelliteCorrections
    t_ns : ndarray of int64, shape (n,)
        Times of the troposphere's values, ns of GPS time, strictly rising.
    zhd_m, zwd_m : ndarray, shape (n,)
        Hydrostatic and wet zenith delay at the place, reduced to the ellipsoid (height 0).
    network : int
        Number of the network whose grid points were used; 0 where not told.
    sources, notes : tuple of str
        Names of the files; what was left out, in words.
    """

    satellites: Mapping[str, SatelliteCorrections]
    t_ns: IntArray
    zhd_m: FloatArray
    zwd_m: FloatArray
    network: int = 0
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        whole = np.array(self.t_ns, dtype=np.int64)
        whole.flags.writeable = False
        object.__setattr__(self, "t_ns", whole)
        for name in ("zhd_m", "zwd_m"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
            if getattr(self, name).shape != whole.shape:
                raise ValueError(f"`{name}` must have shape {whole.shape}, as `t_ns` has")

    @property
    def coverage_ns(self) -> tuple[int, int]:
        """First and last time of the satellites' corrections, ns of GPS time."""
        times = [s.t_ns for s in self.satellites.values() if len(s.t_ns)]
        if not times:
            return 0, 0
        return int(min(t[0] for t in times)), int(max(t[-1] for t in times))


@dataclass(frozen=True, eq=False)
class InForce:
    """For each time asked: the row of the corrections (-1: none), and why it must not be used, or ``""``."""

    row: npt.NDArray[np.intp]
    reason: ReasonArray

    @property
    def ok(self) -> BoolArray:
        """Where there is a row that can be used."""
        return np.asarray(self.reason == "", dtype=bool)


def in_force(
    corrections: SatelliteCorrections | None, t_ns: npt.ArrayLike, max_age_s: float = MAX_CORRECTION_AGE_S
) -> InForce:
    """Return the last corrections that were there at each time, and why not: none, too old, not complete."""
    t = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
    reason = np.full(len(t), "no correction", dtype=object)
    if corrections is None or not len(corrections.t_ns):
        return InForce(np.full(len(t), -1), reason)
    c = corrections
    row = np.searchsorted(c.t_ns, t, side="right") - 1
    at = np.maximum(row, 0)
    whole = np.isfinite(c.orbit_m).all(axis=1) & np.isfinite(c.clock_m)
    reason[row >= 0] = ""
    reason[(row >= 0) & ~np.isfinite(c.ura_m[at])] = "correction states no accuracy"
    reason[(row >= 0) & ~whole[at]] = "correction is marked as not available"
    reason[(row >= 0) & (t - c.t_ns[at] > max_age_s * SECOND_NS)] = f"correction older than {max_age_s:g} s"
    return InForce(row, reason)
