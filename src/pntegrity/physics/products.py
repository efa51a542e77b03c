"""What the files of precise products hold, as plain values: orbits, clocks, biases, antennas, loading, pole.

They stand here, below ``formats/``, since both the readers and the physics use them. Times are int ns of GPS
time; nothing is extrapolated by more than half a second, and nothing is interpolated across a gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.physics.product_antennas import ReceiverAntenna, SatelliteAntenna
from pntegrity.physics.time import SECOND_NS, to_j2000_s
from pntegrity.records import FloatArray
from pntegrity.states import frozen

__all__ = [
    "GAP_FACTOR", "CodeBiases", "OceanLoading", "PolarMotion", "PreciseClocks", "PreciseOrbits",
    "ReceiverAntenna", "SatelliteAntenna", "most_frequent_step_s",
]  # fmt: skip

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
GAP_FACTOR = 1.5
"""Two samples further apart than this many intervals are a gap."""
EDGE_NS = SECOND_NS // 2
"""So far outside the samples products are used: signals of the first epoch of a day left before midnight."""
_NONE = np.zeros(0, dtype=np.int64)


def most_frequent_step_s(series: Iterable[IntArray]) -> float:
    """Return the most frequent step between the times (ns) of each series, s; nan where there is none."""
    steps = np.concatenate([_NONE, *(np.diff(t) for t in series)])
    if not len(steps):
        return math.nan
    values, counts = np.unique(steps, return_counts=True)
    return float(values[np.argmax(counts)]) / SECOND_NS


def _frozen_int(a: npt.ArrayLike) -> IntArray:
    out = np.asarray(a, dtype=np.int64).view()
    out.flags.writeable = False
    return out


def _joined(t_ns: IntArray, interval_s: float, breaks: IntArray = _NONE) -> BoolArray:
    """Return for each pair of adjacent samples whether one may interpolate between them, shape (n - 1,)."""
    limit = GAP_FACTOR * (interval_s if math.isfinite(interval_s) else 0.0) * SECOND_NS
    return (np.diff(t_ns) <= limit) & ~np.isin(t_ns[1:], breaks)


def _query_ns(t_ns: npt.ArrayLike, offset_s: npt.ArrayLike) -> tuple[IntArray, BoolArray]:
    """Return ``t_ns + offset_s`` in ns and where it is finite."""
    offset = np.asarray(offset_s, dtype=np.float64)
    known = np.isfinite(offset)
    whole = np.rint(np.where(known, offset, 0.0) * SECOND_NS).astype(np.int64)
    t, known = np.broadcast_arrays(np.asarray(t_ns, dtype=np.int64) + whole, known)
    return t, known


def _bracket(q: IntArray, t_ns: IntArray, joined: BoolArray) -> tuple[npt.NDArray[np.intp], BoolArray]:
    """Return the sample at or before each time, and whether it is that time or joined to the next.

    Up to `EDGE_NS` outside a piece the line of its first or last two samples goes on.
    """
    to_next = np.append(joined, False)
    i = np.searchsorted(t_ns, q, side="right") - 1
    at, after = np.maximum(i, 0), np.minimum(i + 1, len(t_ns) - 1)
    inside = (i >= 0) & (to_next[at] | (t_ns[at] == q))
    early = ~inside & (t_ns[after] > q) & (t_ns[after] - q <= EDGE_NS) & to_next[after]
    late = ~inside & ~early & (i > 0) & (q - t_ns[at] <= EDGE_NS) & to_next[at - 1]
    return np.where(early, after, np.where(late, at - 1, at)), inside | early | late


@dataclass(frozen=True, eq=False)
class PreciseClocks:
    """Satellite clocks of precise products, as sampled: without the relativistic effect of eccentricity.

    Parameters
    ----------
    series : mapping of str to (ndarray of int64, ndarray), shapes (n,)
        By satellite: times, ns of GPS time, strictly rising; clock offsets, s.
    interval_s : float
        Most frequent step, s; nan where no satellite has two samples.
    kind : str
        ``"SP3"`` or ``"CLK"``.
    agency : str
        Who made them.
    sources, notes : tuple of str
        Names of the files; what was dropped, in words.
    breaks : mapping of str to ndarray of int64
        By satellite: times of samples before which the clock jumped, so that nothing is interpolated to them
        from the sample before. Add some with `dataclasses.replace`.
    """

    series: Mapping[str, tuple[IntArray, FloatArray]]
    interval_s: float
    kind: str
    agency: str = ""
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    breaks: Mapping[str, IntArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = {sat: (_frozen_int(t), frozen(b)) for sat, (t, b) in self.series.items()}
        for sat, (t, b) in rows.items():
            if t.shape != b.shape or (np.diff(t) <= 0).any():
                raise ValueError(f"the clock of {sat} needs as many values as strictly rising times")
        object.__setattr__(self, "series", rows)
        object.__setattr__(self, "breaks", {s: _frozen_int(t) for s, t in self.breaks.items()})

    @property
    def sats(self) -> tuple[str, ...]:
        """Satellites with at least one sample, sorted."""
        return tuple(sorted(s for s, (t, _) in self.series.items() if len(t)))

    def clock_s(
        self, sat: str, t_ns: npt.ArrayLike, offset_s: npt.ArrayLike = 0.0
    ) -> tuple[FloatArray, BoolArray]:
        """Return the clock offset at ``t_ns + offset_s``, linear between two samples.

        Parameters
        ----------
        sat : str
            ``"G05"``.
        t_ns : array_like of int64, shape (n,)
            Times, ns of GPS time.
        offset_s : array_like, shape (n,)
            Added to them, s (an emission is that of minus the travel time); nan gives nan.

        Returns
        -------
        clock_s : ndarray, shape (n,)
            Clock offset, s; nan in a gap, across a break, more than half a second outside the
            samples, and for a satellite not there.
        ok : ndarray of bool, shape (n,)
            Where it is known.
        """
        q, known = _query_ns(t_ns, offset_s)
        t, bias = self.series.get(sat, (_NONE, np.zeros(0)))
        if not len(t):
            return np.full(q.shape, np.nan), np.zeros(q.shape, dtype=bool)
        i, ok = _bracket(q, t, _joined(t, self.interval_s, self.breaks.get(sat, _NONE)))
        ok = ok & known
        j = np.minimum(i + 1, len(t) - 1)
        share = (q - t[i]) / np.maximum(t[j] - t[i], 1)
        value = np.where(t[i] == q, bias[i], bias[i] + share * (bias[j] - bias[i]))
        return np.where(ok, value, np.nan), ok

    def restarts(self, sat: str) -> IntArray:
        """Return the times at which a new piece begins: the first sample after each gap or jump, ns."""
        t = self.series.get(sat, (_NONE, _NONE))[0]
        return t[1:][~_joined(t, self.interval_s, self.breaks.get(sat, _NONE))]


@dataclass(frozen=True, eq=False)
class PreciseOrbits:
    """Orbits of one or several SP3 files.

    Parameters
    ----------
    interpolant : sidereon.PreciseEphemerisInterpolant
        Over all files, in GPS time. Alone it answers up to an interval outside its samples and into a gap,
        wrong by metres: ask `position_m`, or mask with `covers`.
    sats : tuple of str
        Satellites with positions, sorted.
    t_ns : ndarray of int64, shape (n_epochs,)
        Epochs, ns of GPS time, strictly rising.
    nodes : mapping of str to ndarray of int64
        By satellite: the times at which it has a position.
    clocks : PreciseClocks
        Of the clock columns.
    interval_s : float
        Most frequent step, s.
    agency, frame : str
        Of the headers; several are joined by ``/``.
    sources, notes : tuple of str
        Names of the files; what was dropped and what to know, in words.
    """

    interpolant: Any
    sats: tuple[str, ...]
    t_ns: IntArray
    nodes: Mapping[str, IntArray]
    clocks: PreciseClocks
    interval_s: float
    agency: str = ""
    frame: str = ""
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", _frozen_int(self.t_ns))
        object.__setattr__(self, "nodes", {s: _frozen_int(t) for s, t in self.nodes.items()})

    @property
    def coverage_ns(self) -> tuple[int, int]:
        """First and last epoch, ns of GPS time."""
        return int(self.t_ns[0]), int(self.t_ns[-1])

    def covers(self, sat: str, t_ns: npt.ArrayLike, offset_s: npt.ArrayLike = 0.0) -> BoolArray:
        """Return where ``t_ns + offset_s`` is a node of the satellite or lies between two adjacent ones."""
        q, known = _query_ns(t_ns, offset_s)
        t = self.nodes.get(sat, _NONE)
        if not len(t):
            return np.zeros(q.shape, dtype=bool)
        return _bracket(q, t, _joined(t, self.interval_s))[1] & known

    def position_m(
        self, sat: str, t_ns: npt.ArrayLike, offset_s: npt.ArrayLike = 0.0
    ) -> tuple[FloatArray, BoolArray]:
        """Return the centre of mass at ``t_ns + offset_s``.

        Parameters
        ----------
        sat : str
            ``"G05"``.
        t_ns, offset_s : array_like, shape (n,)
            Times, ns of GPS time, and what to add to them, s.

        Returns
        -------
        position_m : ndarray, shape (n, 3)
            Earth-fixed, frame of that time; nan in a gap, outside the nodes, or where the piece between two
            gaps has too few nodes for the polynomial (11).
        ok : ndarray of bool, shape (n,)
            Where it is known.
        """
        q, _ = _query_ns(t_ns, offset_s)
        ok = np.atleast_1d(self.covers(sat, t_ns, offset_s))
        out = np.full((len(ok), 3), np.nan)
        asked = to_j2000_s(np.atleast_1d(q)[ok])
        if len(asked):
            states = self.interpolant.observable_states_at_j2000_s([sat] * len(asked), asked)
            out[ok] = np.asarray(states.positions_ecef_m)
        return out, np.isfinite(out).all(axis=1)


@dataclass(frozen=True, eq=False)
class CodeBiases:
    """Code biases of satellites that hold at one time.

    ``observed(a) - observed(b)`` of two signals of a satellite contains ``bias(a) - bias(b)``.

    The sign is that of Bias-SINEX: a bias is part of the observation (subtract it); a differential one of
    ``(a, b)`` is ``bias(a) - bias(b)``.

    Parameters
    ----------
    osb_s : mapping of (str, str) to float
        Absolute biases, s: ``{("G05", "1C"): -1.1e-9}``.
    dsb_s : mapping of (str, str, str) to float
        Differential biases, s: ``{("G05", "1C", "1W"): 0.9e-9}``.
    t_ns : int
        The time for which they were asked.
    clock_reference : mapping of str to (str, str)
        By system letter: the two signals to whose ionosphere-free combination the clocks refer, where told.
    sources, notes : tuple of str
        Names of the files; what was left out, in words.
    """

    osb_s: Mapping[tuple[str, str], float]
    dsb_s: Mapping[tuple[str, str, str], float]
    t_ns: int
    clock_reference: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def difference_s(self, sat: str, used: str, reference: str) -> float | None:
        """Return bias of `used` minus that of `reference` on a satellite, s; None where it is not known.

        From absolute biases where both are there, else from differential ones, taken either way round, in as
        few steps as possible (``1C-1W``, ``1W-2W``, ``2W-2X``). Correct ``observed(used)`` into
        ``observed(reference)`` by subtracting it.
        """
        if used == reference:
            return 0.0
        a, b = self.osb_s.get((sat, used)), self.osb_s.get((sat, reference))
        if a is not None and b is not None:
            return a - b
        return self._through_pairs(sat, used, reference)

    def _through_pairs(self, sat: str, used: str, reference: str) -> float | None:
        steps: dict[str, dict[str, float]] = {}
        for (s, a, b), value in self.dsb_s.items():
            if s == sat:
                steps.setdefault(a, {})[b] = value
                steps.setdefault(b, {}).setdefault(a, -value)
        reached = {used: 0.0}
        front = [used]
        while front and reference not in reached:
            new = {b: reached[a] + v for a in front for b, v in steps.get(a, {}).items() if b not in reached}
            reached |= new
            front = list(new)
        return reached.get(reference)


@dataclass(frozen=True, eq=False)
class OceanLoading:
    """Ocean loading of one station: amplitudes and phases in BLQ's order.

    Parameters
    ----------
    station : str
        Its name in the file.
    amplitude_m, phase_deg : ndarray, shape (3, 11)
        Rows up, west, south; columns M2 S2 N2 K2 K1 O1 P1 Q1 MF MM SSA. Lags are positive, to Greenwich.
    """

    station: str
    amplitude_m: FloatArray
    phase_deg: FloatArray

    def __post_init__(self) -> None:
        for name in ("amplitude_m", "phase_deg"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
            if getattr(self, name).shape != (3, 11):
                raise ValueError(f"`{name}` must have shape (3, 11)")


@dataclass(frozen=True, eq=False)
class PolarMotion:
    """Coordinates of the pole.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        Times, ns of GPS time, strictly rising.
    xp_arcsec, yp_arcsec : ndarray, shape (n,)
        Coordinates, seconds of arc.
    sources, notes : tuple of str
        Names of the files; what was left out, in words.
    """

    t_ns: IntArray
    xp_arcsec: FloatArray
    yp_arcsec: FloatArray
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", _frozen_int(self.t_ns))
        for name in ("xp_arcsec", "yp_arcsec"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def at(self, t_ns: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return both coordinates at times, seconds of arc, linear; nan outside the table."""
        q = (np.asarray(t_ns, dtype=np.int64) - self.t_ns[0]) / SECOND_NS
        t = (self.t_ns - self.t_ns[0]) / SECOND_NS
        x, y = (np.interp(q, t, v, left=np.nan, right=np.nan) for v in (self.xp_arcsec, self.yp_arcsec))
        return x, y
