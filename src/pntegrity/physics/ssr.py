"""Corrections of a state-space service (QZSS CLAS) to broadcast orbits and clocks, as precise products.

Conventions, each checked on real data against final orbits and clocks:

- A correction belongs to one broadcast message, named by its issue of data; no other message will do.
- Orbit: ``position = broadcast - (radial, along, cross)``; along is the direction of the Earth-fixed
  velocity, cross that of position x velocity, radial = along x cross (RTCM 10403, SSR). It is the antenna
  phase centre.
- Clock: ``clock = broadcast polynomial + dclk / c``, without relativity and without any group delay.
- Biases: ``observed(signal) - bias(signal)`` of code and carrier is what orbit, clock and slant delay fit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pntegrity.physics._rows import rows_by_kind
from pntegrity.physics.ephemeris import is_healthy, toc_ns, toe_ns
from pntegrity.physics.orbits import MAX_AGE_S, STEP_S
from pntegrity.physics.products import GAP_FACTOR, most_frequent_step_s
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS
from pntegrity.physics.ssr_corrections import (
    MAX_CORRECTION_AGE_S,
    ClasCorrections,
    Kind,
    in_force,
)
from pntegrity.physics.tables import Navigation
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import FloatArray

__all__ = ["SsrBiases", "SsrClocks", "SsrOrbits"]

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ReasonArray = npt.NDArray[np.object_]


@dataclass(frozen=True, eq=False)
class _Job:
    """Rows that one broadcast message serves, with the corrections of each."""

    record: Any
    rows: npt.NDArray[np.intp]
    orbit_m: FloatArray
    clock_m: FloatArray


class _Broadcast:
    """Corrections beside the broadcast messages that they belong to."""

    def __init__(self, corrections: ClasCorrections, nav: Navigation, max_age_s: float) -> None:
        self.corrections, self.max_age_s = corrections, max_age_s
        self.messages: dict[tuple[str, int], list[tuple[int, Any]]] = {}
        for sat in corrections.satellites:
            records, toe = nav.of(sat)
            for record, t in zip(records, toe.tolist(), strict=True):
                if record.issue is not None:
                    self.messages.setdefault((sat, int(record.issue)), []).append((t, record))

    def of(self, sat: str, t_ns: npt.ArrayLike) -> tuple[ReasonArray, list[_Job]]:
        """Return why nothing is in force at times, or ``""``, and each message with the rows it serves."""
        t = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
        c = self.corrections.satellites.get(sat)
        found = in_force(c, t, self.max_age_s)
        jobs: list[_Job] = []
        if c is None:
            return found.reason, jobs
        issues = np.where(found.ok, c.iode[np.maximum(found.row, 0)], -1)
        for issue in np.unique(issues[found.ok]).tolist():
            rows = np.flatnonzero(issues == issue)
            record, found.reason[rows] = self._message(sat, issue, int(t[rows[0]]))
            if record is not None:
                at = found.row[rows]
                jobs.append(_Job(record, rows, c.orbit_m[at], c.clock_m[at]))
        return found.reason, jobs

    def _message(self, sat: str, issue: int, t_ns: int) -> tuple[Any, str]:
        """Return the message of an issue next to a time, of equal ones the last; or why there is none."""
        known = self.messages.get((sat, issue), [])
        near = [(abs(t - t_ns), i) for i, (t, _) in enumerate(known)]
        least = min((d for d, _ in near), default=None)
        if least is None or least > MAX_AGE_S[sat[0]] * SECOND_NS:
            return None, f"no broadcast message of issue {issue}"
        record = known[max(i for d, i in near if d == least)][1]
        return (record, "") if is_healthy(record) else (None, "unhealthy")


@dataclass(frozen=True, eq=False)
class SsrOrbits:
    """Broadcast orbits with corrections; answers as `products.PreciseOrbits` does.

    The correction is the last that was there at `t_ns`, the receiver's time; `offset_s` moves the satellite
    only. Positions are those of the antenna phase centres.

    Parameters
    ----------
    corrections : ClasCorrections
    navigation : Navigation
        Must hold the messages that the corrections belong to.
    max_age_s : float
    """

    corrections: ClasCorrections
    navigation: Navigation
    max_age_s: float = MAX_CORRECTION_AGE_S
    agency: ClassVar[str] = "CLAS"
    known: _Broadcast = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "known", _Broadcast(self.corrections, self.navigation, self.max_age_s))

    @property
    def sats(self) -> tuple[str, ...]:
        """Satellites with corrections, sorted."""
        return tuple(sorted(self.corrections.satellites))

    @property
    def coverage_ns(self) -> tuple[int, int]:
        """First and last correction, ns of GPS time."""
        return self.corrections.coverage_ns

    def reasons(self, sat: str, t_ns: npt.ArrayLike) -> ReasonArray:
        """Return why there is no orbit and clock at times, ``""`` where there are; shape (n,)."""
        return self.known.of(sat, t_ns)[0]

    def position_m(
        self, sat: str, t_ns: npt.ArrayLike, offset_s: npt.ArrayLike = 0.0
    ) -> tuple[FloatArray, BoolArray]:
        """Return the phase centre at ``t_ns + offset_s``, (n, 3), Earth-fixed then, and where it is known."""
        t, offset = np.broadcast_arrays(np.atleast_1d(np.asarray(t_ns, dtype=np.int64)), offset_s)
        out = np.full((len(t), 3), np.nan)
        for job in self.known.of(sat, t)[1]:
            known = np.isfinite(offset[job.rows])
            rows = job.rows[known]
            position, velocity = _evaluated(job.record, t[rows], offset[rows])
            out[rows] = position - _earth_fixed(position, velocity, job.orbit_m[known])
        return out, np.isfinite(out).all(axis=1)


def _evaluated(record: Any, t_ns: IntArray, offset_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position and Earth-fixed velocity by a broadcast message, shapes (n, 3)."""
    tow = (t_ns - toe_ns(record)) * 1e-9 + offset_s + record.elements.toe_sow
    ends = []
    for times in (tow - STEP_S, tow + STEP_S):
        states = [record.evaluate(s) for s in times.tolist()]
        ends.append(np.array([(s.x_m, s.y_m, s.z_m) for s in states], dtype=np.float64).reshape(-1, 3))
    return 0.5 * (ends[0] + ends[1]), (ends[1] - ends[0]) / (2.0 * STEP_S)


def _earth_fixed(position_m: FloatArray, velocity_mps: FloatArray, orbit_m: FloatArray) -> FloatArray:
    """Return radial, along and cross components as Earth-fixed vectors, shape (n, 3)."""
    along = velocity_mps / np.linalg.norm(velocity_mps, axis=1, keepdims=True)
    normal = np.cross(position_m, velocity_mps)
    cross = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    radial = np.cross(along, cross)
    return np.asarray(orbit_m[:, :1] * radial + orbit_m[:, 1:2] * along + orbit_m[:, 2:] * cross)


@dataclass(frozen=True, eq=False)
class SsrClocks:
    """Broadcast clocks with corrections; answers as `products.PreciseClocks` does, without relativity.

    `series` holds the corrections alone (s), whose times are the nodes.
    """

    orbits: SsrOrbits
    kind: ClassVar[str] = "SSR"
    agency: ClassVar[str] = "CLAS"

    @property
    def series(self) -> dict[str, tuple[IntArray, FloatArray]]:
        """By satellite: times, ns of GPS time, and corrections of the broadcast clock, s."""
        rows = self.orbits.corrections.satellites
        return {sat: (c.t_ns, c.clock_m / SPEED_OF_LIGHT_MPS) for sat, c in rows.items()}

    @property
    def interval_s(self) -> float:
        """Most frequent step of the corrections, s."""
        return most_frequent_step_s(c.t_ns for c in self.orbits.corrections.satellites.values())

    def clock_s(
        self, sat: str, t_ns: npt.ArrayLike, offset_s: npt.ArrayLike = 0.0
    ) -> tuple[FloatArray, BoolArray]:
        """Return the clock offset at ``t_ns + offset_s``, s, shape (n,), and where it is known."""
        t, offset = np.broadcast_arrays(np.atleast_1d(np.asarray(t_ns, dtype=np.int64)), offset_s)
        out = np.full(len(t), np.nan)
        for job in self.orbits.known.of(sat, t)[1]:
            since = (t[job.rows] - toc_ns(job.record)) * 1e-9 + offset[job.rows]
            k = job.record.clock
            polynomial = k.af0 + since * (k.af1 + since * k.af2)
            out[job.rows] = polynomial + job.clock_m / SPEED_OF_LIGHT_MPS
        return out, np.isfinite(out)

    def restarts(self, sat: str) -> IntArray:
        """Return the times at which corrections begin anew after a gap longer than their largest age, ns."""
        c = self.orbits.corrections.satellites.get(sat)
        if c is None:
            return np.zeros(0, dtype=np.int64)
        longest = max(self.orbits.max_age_s, GAP_FACTOR * self.interval_s) * SECOND_NS
        return np.asarray(c.t_ns[1:][np.diff(c.t_ns) > longest])


@dataclass(frozen=True, eq=False)
class SsrBiases:
    """Biases of code and carrier of each signal, as they change; answers as `products.CodeBiases` does too.

    Parameters
    ----------
    corrections : ClasCorrections
    max_age_s : float
    """

    corrections: ClasCorrections
    max_age_s: float = MAX_CORRECTION_AGE_S
    notes: tuple[str, ...] = ()

    def difference_s(self, sat: str, used: str, reference: str) -> float:
        """Return 0: the clocks refer to no signal, each has its whole bias in `of_m`."""
        return 0.0

    def of_m(
        self, kind: Kind, sats: npt.NDArray[np.str_], signals: npt.NDArray[np.str_], t_ns: IntArray
    ) -> FloatArray:
        """Return by how much observations are longer than what orbits and clocks tell, m, shape (n,).

        Parameters
        ----------
        kind : "code" or "phase"
        sats, signals : ndarray of str, shape (n,)
            ``"G05"``, ``"2W"``.
        t_ns : ndarray of int64, shape (n,)
            Receiver time tags.

        Returns
        -------
        ndarray, shape (n,)
            nan where it is not known: such an observation must not be used.
        """
        out = np.full(len(sats), np.nan)
        names = np.char.add(sats.astype("<U3"), signals.astype("<U2"))
        for name, rows in rows_by_kind(names):
            c = self.corrections.satellites.get(name[:3])
            known = None if c is None else c.bias_m(kind, name[3:])
            if known is not None:
                found = in_force(c, t_ns[rows], self.max_age_s)
                out[rows] = np.where(found.ok, known[np.maximum(found.row, 0)], np.nan)
        return out
