"""What the GNSS files hold, as plain values: the table of signals and the navigation data.

They stand here, below ``formats/``, since both the readers and the physics use them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.physics.ephemeris import MESSAGES, toe_ns, upload_s
from pntegrity.physics.time import from_j2000_s
from pntegrity.records import FloatArray

__all__ = ["Klobuchar", "Navigation", "SignalTable"]


@dataclass(frozen=True, eq=False)
class SignalTable:
    """Observations as columns: one row for each epoch, satellite and signal, sorted in that order.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n_epochs,)
        Time tags of the receiver, ns of GPS time, strictly rising.
    epoch : ndarray of int32, shape (n,)
        Index into `t_ns`.
    sat, signal : ndarray of str, shape (n,)
        ``"G05"`` and RINEX 3 band and attribute, ``"1C"``.
    pseudorange_m, carrier_cycles, doppler_hz, cn0_dbhz : ndarray, shape (n,)
        Observed values; nan where absent (a zero in the file means absent). A positive Doppler means
        approach.
    lli : ndarray of int8, shape (n,)
        Loss-of-lock indicator of the carrier, 0 where blank.
    version : float
        RINEX version of the file.
    marker, receiver, antenna : str
        Header facts.
    approx_position_m : ndarray, shape (3,), or None
        Header position, ECEF; None where absent or zero.
    antenna_delta_hen_m : ndarray, shape (3,)
        Antenna reference point above the marker: up, east, north.
    interval_s : float or None
        Header interval, or the most frequent step.
    glonass_channels : mapping of str to int
        ``{"R01": 1}``.
    notes : tuple of str
        What was dropped or repaired, in words.
    source : str
        Path of the file.
    """

    t_ns: npt.NDArray[np.int64]
    epoch: npt.NDArray[np.int32]
    sat: npt.NDArray[np.str_]
    signal: npt.NDArray[np.str_]
    pseudorange_m: FloatArray
    carrier_cycles: FloatArray
    doppler_hz: FloatArray
    cn0_dbhz: FloatArray
    lli: npt.NDArray[np.int8]
    version: float = 3.04
    marker: str = ""
    receiver: str = ""
    antenna: str = ""
    approx_position_m: FloatArray | None = None
    antenna_delta_hen_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    interval_s: float | None = None
    glonass_channels: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        n = len(self.epoch)
        for name in ("sat", "signal", "pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz", "lli"):
            if getattr(self, name).shape != (n,):
                raise ValueError(f"`{name}` must have shape ({n},), as `epoch` has")
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                view = value.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)

    def __len__(self) -> int:
        return len(self.epoch)

    @property
    def systems(self) -> str:
        """Letters of the systems, in the order G, R, E, C, J, then others: ``"GREC"``."""
        letters = set(np.unique(self.sat.astype("<U1")).tolist())
        return "".join(sorted(letters, key=lambda s: ("GRECJ".find(s) % 99, s)))


@dataclass(frozen=True)
class Klobuchar:
    """Coefficients of the broadcast ionosphere model (IS-GPS-200, 20.3.3.5.2.5), in the message's units."""

    alpha: tuple[float, float, float, float]
    beta: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Navigation:
    """Broadcast ephemerides of one or several files.

    Parameters
    ----------
    kepler : tuple of sidereon.BroadcastRecord
        GPS, Galileo, BeiDou and QZSS, as read, unhealthy ones included.
    glonass : tuple of sidereon.GlonassRecord
        GLONASS state vectors.
    klobuchar : mapping of str to Klobuchar
        By system letter (``"G"``, ``"C"``, ...), as far as the files give them.
    leap_seconds : float or None
        Of the header.
    sources : tuple of str
        Names of the files, with the days they cover.
    notes : tuple of str
        What was dropped, in words.
    """

    kepler: tuple[Any, ...]
    glonass: tuple[Any, ...] = ()
    klobuchar: Mapping[str, Klobuchar] = field(default_factory=dict)
    leap_seconds: float | None = None
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    kepler_toe_ns: npt.NDArray[np.int64] = field(init=False)
    glonass_toe_ns: npt.NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kepler_toe_ns", np.array([toe_ns(r) for r in self.kepler], dtype=np.int64))
        object.__setattr__(
            self, "glonass_toe_ns", from_j2000_s([r.toe_gpst_j2000_s for r in self.glonass]).reshape(-1)
        )

    def of(self, sat: str, *, fnav: bool = False) -> tuple[tuple[Any, ...], npt.NDArray[np.int64]]:
        """Return the ephemerides of a satellite and their reference times, rising; equal times by upload.

        Of Galileo's two messages the one asked for, I/NAV or F/NAV; of GPS and QZSS the legacy message.
        """
        return self._index.get((sat, fnav and sat[0] == "E"), ((), np.zeros(0, dtype=np.int64)))

    @cached_property
    def _index(self) -> dict[tuple[str, bool], tuple[tuple[Any, ...], npt.NDArray[np.int64]]]:
        found: dict[tuple[str, bool], list[tuple[int, float, int, Any]]] = {}
        for i, (record, toe) in enumerate(zip(self.kepler, self.kepler_toe_ns.tolist(), strict=True)):
            if record.message.label in MESSAGES:
                key = (record.satellite, record.message.label == "galileo_fnav")
                found.setdefault(key, []).append((toe, upload_s(record), i, record))
        for i, (record, toe) in enumerate(zip(self.glonass, self.glonass_toe_ns.tolist(), strict=True)):
            found.setdefault((record.satellite, False), []).append((toe, 0.0, i, record))
        out = {}
        for key, rows in found.items():
            rows.sort(key=lambda r: r[:3])
            out[key] = tuple(r[3] for r in rows), np.array([r[0] for r in rows], dtype=np.int64)
        return out

    @property
    def coverage_ns(self) -> tuple[int, int]:
        """First and last reference time of the ephemerides, ns of GPS time."""
        both = np.concatenate([self.kepler_toe_ns, self.glonass_toe_ns])
        return int(both.min()), int(both.max())

    @property
    def systems(self) -> str:
        """Letters of the systems with at least one ephemeris."""
        found = {r.satellite[0] for r in self.kepler} | {r.satellite[0] for r in self.glonass}
        return "".join(sorted(found, key=lambda s: ("GRECJ".find(s) % 99, s)))

    @property
    def glonass_channels(self) -> dict[str, int]:
        """Frequency channel of each GLONASS satellite."""
        return {r.satellite: int(r.freq_channel) for r in self.glonass}
