"""Satellite positions, velocities and clocks from precise products, for all rows of a file at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pntegrity.physics._rows import rows_by_kind
from pntegrity.physics.orbits import SatelliteStates
from pntegrity.physics.products import PreciseClocks, PreciseOrbits
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS
from pntegrity.records import FloatArray

__all__ = ["clock_nodes_s", "clock_pieces", "precise_states"]

STEP_S = 0.2
"""Half-width of the central difference that gives the velocity."""
RANGE_SIGMA_M = 0.03
"""What final products leave in a range."""
NO_ORBIT, NO_CLOCK = "no precise orbit", "no precise clock"


def precise_states(
    orbits: PreciseOrbits, clocks: PreciseClocks, sats: npt.NDArray[np.str_],
    t_rx_ns: npt.NDArray[np.int64], range_m: FloatArray,
) -> SatelliteStates:  # fmt: skip
    """Return the satellites' centres of mass and clocks at the emission of what was received.

    Parameters
    ----------
    orbits, clocks : PreciseOrbits, PreciseClocks
        Nothing is interpolated across a gap of either, nothing extrapolated by more than half a second.
    sats : ndarray of str, shape (n,)
    t_rx_ns : ndarray of int64, shape (n,)
        Receiver time tags; the emission time is tag - pseudorange / c - satellite clock offset.
    range_m : ndarray, shape (n,)
        Pseudoranges; nan where there is none.

    Returns
    -------
    SatelliteStates
        Clocks with the relativistic term ``-2 r.v/c`` and without code biases; `reason` "no pseudorange", "no
        precise orbit" or "no precise clock".
    """
    has_range = np.isfinite(range_m)
    travel_s = np.where(has_range, range_m, 0.0) / SPEED_OF_LIGHT_MPS
    clock_s, timed = _clocks(clocks, sats, t_rx_ns, -travel_s)
    position, velocity, placed = _orbit(orbits, sats, t_rx_ns, -travel_s - np.where(timed, clock_s, 0.0))
    relativity_m = -2.0 * np.einsum("ij,ij->i", position, velocity) / SPEED_OF_LIGHT_MPS
    ok = has_range & timed & placed
    reason = np.where(has_range, np.where(placed, np.where(timed, "", NO_CLOCK), NO_ORBIT), "no pseudorange")
    hidden = np.where(ok, 0.0, np.nan)
    return SatelliteStates(
        position + hidden[:, None], velocity + hidden[:, None],
        SPEED_OF_LIGHT_MPS * clock_s + relativity_m + hidden,
        SPEED_OF_LIGHT_MPS * _rates(clocks, sats, t_rx_ns, clock_s) + hidden,
        np.full(len(sats), RANGE_SIGMA_M**2) + hidden, ok, reason.astype(object),
    )  # fmt: skip


def _clocks(
    clocks: PreciseClocks, sats: npt.NDArray[np.str_], t_ns: npt.NDArray[np.int64], offset_s: FloatArray
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    value, ok = np.full(len(sats), np.nan), np.zeros(len(sats), dtype=bool)
    for sat, rows in rows_by_kind(sats):
        value[rows], ok[rows] = clocks.clock_s(sat, t_ns[rows], offset_s[rows])
    return value, ok


def _rates(
    clocks: PreciseClocks, sats: npt.NDArray[np.str_], t_ns: npt.NDArray[np.int64], clock_s: FloatArray
) -> FloatArray:
    """Return clock rates (s/s), by a difference over a second to whichever side there is a clock."""
    forth, ahead = _clocks(clocks, sats, t_ns, np.full(len(sats), 1.0))
    back, behind = _clocks(clocks, sats, t_ns, np.full(len(sats), -1.0))
    both = np.where(ahead & behind, 0.5 * (forth - back), 0.0)
    return np.where(np.isfinite(clock_s), both, 0.0)


def _orbit(
    orbits: PreciseOrbits, sats: npt.NDArray[np.str_], t_ns: npt.NDArray[np.int64], offset_s: FloatArray
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Return position, velocity and whether there is an orbit on both sides of each time."""
    n = len(sats)
    parts = np.full((3, n, 3), np.nan)
    ok = np.ones(n, dtype=bool)
    for sat, rows in rows_by_kind(sats):
        for part, step in zip(parts, (-STEP_S, 0.0, STEP_S), strict=True):
            part[rows], here = orbits.position_m(sat, t_ns[rows], offset_s[rows] + step)
            ok[rows] &= here
    return parts[1], (parts[2] - parts[0]) / (2.0 * STEP_S), ok


def clock_nodes_s(
    clocks: PreciseClocks, sats: npt.NDArray[np.str_], t_ns: npt.NDArray[np.int64]
) -> FloatArray:
    """Return how long ago the last clock sample is and how far ahead the next, s, shape (n, 2)."""
    out = np.zeros((len(sats), 2))
    for sat, rows in rows_by_kind(sats):
        nodes = clocks.series[sat][0] if sat in clocks.series else np.zeros(0, dtype=np.int64)
        if len(nodes) > 1:
            i = np.clip(np.searchsorted(nodes, t_ns[rows], side="right"), 1, len(nodes) - 1)
            out[rows] = np.stack([t_ns[rows] - nodes[i - 1], nodes[i] - t_ns[rows]], axis=1) * 1e-9
    return np.maximum(out, 0.0)


def clock_pieces(
    clocks: PreciseClocks, sats: npt.NDArray[np.str_], t_ns: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Return a number for each row that changes where a satellite's clock begins anew after a gap."""
    out = np.zeros(len(sats), dtype=np.int64)
    for sat, rows in rows_by_kind(sats):
        out[rows] = np.searchsorted(clocks.restarts(sat), t_ns[rows], side="right")
    return out
