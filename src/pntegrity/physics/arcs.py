"""Arcs of carriers: from one cycle slip to the next; and receiver clocks that jump in code and not in
carrier.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.slips import arc_starts
from pntegrity.physics._assembly import Bands, take
from pntegrity.physics._choice import Chosen
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS
from pntegrity.physics.tables import SignalTable
from pntegrity.records import FloatArray

__all__ = ["Arcs", "SlipLimits", "arcs_of", "clock_resets_m"]

Index = npt.NDArray[np.intp]
DOPPLER_S = 2.5
"""Over longer steps the mean of two Dopplers says too little."""
MILLISECOND_M = SPEED_OF_LIGHT_MPS * 1e-3


@dataclass(frozen=True)
class SlipLimits:
    """How far apart epochs may be, and how large changes may be, before an arc ends.

    Parameters
    ----------
    max_gap_s : float
        A longer gap ends an arc.
    geometry_free_m, geometry_free_mps : float
        Change of the geometry-free combination: a constant and a part that grows with time. One cycle on both
        carriers of GPS is 5.4 cm; with 3 cm a receiver on the road loses one arc in thirty epochs.
    doppler_m : float
        Change of the first carrier against its Doppler.
    """

    max_gap_s: float = 130.0
    geometry_free_m: float = 0.05
    geometry_free_mps: float = 5e-5
    doppler_m: float = 0.5


@dataclass(frozen=True, eq=False)
class Arcs:
    """Number of the arc of each row, counted from 1 a satellite, and why it begins there (0: it goes on)."""

    number: npt.NDArray[np.int64]
    reason: npt.NDArray[np.int64]


def clock_resets_m(table: SignalTable, chosen: Chosen, band: Bands, order: Index) -> tuple[FloatArray, int]:
    """Return what to add to carriers for whole milliseconds that the receiver put into its codes only, and
    how often.

    Parameters
    ----------
    table, chosen, band
        Rows, with the frequencies of all of them.
    order : ndarray
        The rows sorted by satellite and time.
    """
    carrier = band.wavelengths_m[0] * take(table.carrier_cycles, chosen.carrier_first)
    apart = take(table.pseudorange_m, chosen.first) - carrier
    step = np.full(len(chosen), np.nan)
    same = chosen.sat[order][1:] == chosen.sat[order][:-1]
    step[order[1:]] = np.where(same, np.diff(apart[order]), np.nan)
    first = int(chosen.epoch[0]) if len(chosen) else 0
    n = int(chosen.epoch[-1]) - first + 1 if len(chosen) else 0
    whole = np.zeros(n)
    for k, value in _medians(step, chosen.epoch - first):
        ms = np.rint(value / MILLISECOND_M)
        whole[k] = ms * MILLISECOND_M if abs(value - ms * MILLISECOND_M) < 100.0 else 0.0
    total = np.cumsum(whole)
    return total[chosen.epoch - first], int(np.count_nonzero(whole))


def _medians(step: FloatArray, epoch: npt.NDArray[np.int64]) -> list[tuple[int, float]]:
    """Return the median step of the epochs at which most satellites step by more than half a millisecond."""
    large = np.isfinite(step) & (np.abs(step) > 0.5 * MILLISECOND_M)
    out = []
    for k in np.unique(epoch[large]).tolist():
        here = step[(epoch == k) & np.isfinite(step)]
        if np.mean(np.abs(here) > 0.5 * MILLISECOND_M) > 0.6:
            out.append((int(k), float(np.median(here))))
    return out


def arcs_of(
    table: SignalTable, chosen: Chosen, band: Bands, order: Index, piece: npt.NDArray[np.int64],
    shift_m: FloatArray, limits: SlipLimits | None = None,
) -> Arcs:  # fmt: skip
    """Return the arcs of the chosen rows' carriers.

    Parameters
    ----------
    table, chosen, band, order
        As for `clock_resets_m`.
    piece : ndarray of int64, shape (n,)
        Changes where a satellite's clock product begins anew.
    shift_m : ndarray, shape (n,)
        What `clock_resets_m` gives.
    """
    limits = limits or SlipLimits()
    whole = (chosen.carrier_first >= 0) & ((chosen.carrier_second >= 0) | (chosen.second < 0))
    here = order[whole[order]]
    first, second = chosen.carrier_first[here], chosen.carrier_second[here]
    wave, wave2 = (w[here] for w in band.wavelengths_m)
    L1, L2 = wave * take(table.carrier_cycles, first), wave2 * take(table.carrier_cycles, second)
    P1, P2 = (take(table.pseudorange_m, c[here]) for c in (chosen.first, chosen.second))
    f1, f2 = band.freq_hz[here], band.freq2_hz[here]
    wide = (f1 * L1 - f2 * L2) / (f1 - f2) - (f1 * P1 + f2 * P2) / (f1 + f2) + shift_m[here]
    t_s = (table.t_ns[chosen.epoch[here]] - table.t_ns[0]) * 1e-9
    satellite = np.unique(chosen.sat[here], return_inverse=True)[1].astype(np.int64)
    lli = (table.lli[first] | np.where(second >= 0, table.lli[second], 0)).astype(np.int64)
    reason = arc_starts(
        satellite, t_s, lli, piece[here] * 64 + _signals(table, first, second), L1 - L2, wide,
        SPEED_OF_LIGHT_MPS / (f1 - f2),
        _step_errors(satellite, chosen.epoch[here], t_s, L1 + shift_m[here], wave * table.doppler_hz[first]),
        limits.max_gap_s, limits.geometry_free_m, limits.geometry_free_mps, limits.doppler_m,
    )  # fmt: skip
    out = Arcs(np.zeros(len(chosen), dtype=np.int64), np.zeros(len(chosen), dtype=np.int64))
    counted = np.cumsum(reason > 0)
    begins = np.flatnonzero(np.diff(satellite, prepend=-1))
    runs = np.diff(np.append(begins, len(here)))
    out.number[here] = counted - np.repeat(counted[begins] - 1, runs) if len(here) else counted
    out.reason[here] = reason
    return out


def _signals(table: SignalTable, first: Index, second: Index) -> npt.NDArray[np.int64]:
    names = np.char.add(table.signal[first], np.where(second >= 0, table.signal[second], ""))
    return np.unique(names, return_inverse=True)[1].astype(np.int64)


def _step_errors(
    satellite: npt.NDArray[np.int64], epoch: npt.NDArray[np.int64], t_s: FloatArray, carrier_m: FloatArray,
    approach_mps: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the change of each carrier since its last row less what Doppler and the receiver's clock
    explain.
    """
    out = np.full(len(carrier_m), np.nan)
    if len(out) < 2:
        return out
    mean_rate = -0.5 * (approach_mps[1:] + approach_mps[:-1])
    near = (satellite[1:] == satellite[:-1]) & (np.diff(t_s) < DOPPLER_S)
    out[1:] = np.where(near, np.diff(carrier_m) - mean_rate * np.diff(t_s), np.nan)
    known = np.flatnonzero(np.isfinite(out))
    if not len(known):
        return out
    order = known[np.argsort(epoch[known], kind="stable")]
    cuts = np.flatnonzero(np.diff(epoch[order])) + 1
    for rows in np.split(order, cuts):
        out[rows] -= np.median(out[rows])
    return out
