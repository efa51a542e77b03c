"""Cycle slips: where a satellite's carrier cannot be the continuation of what it was."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

#: Why an arc begins.
FIRST, GAP, LOST_LOCK, HALF_CYCLE, RESTART, GEOMETRY_FREE, WIDE_LANE, TIME_DIFFERENCE = range(1, 9)
WORDS = {
    FIRST: "rises", GAP: "gap", LOST_LOCK: "loss of lock", HALF_CYCLE: "half-cycle ambiguity",
    RESTART: "other signal or clock", GEOMETRY_FREE: "slip (geometry-free)", WIDE_LANE: "slip (wide lane)",
    TIME_DIFFERENCE: "slip (Doppler)",
}  # fmt: skip
#: A wide-lane change must exceed this many wavelengths, and this many standard deviations of its own past.
#: Only the past is looked at: on a clean log of 6 h all 14 changes found were multipath, which costs an arc.
WIDE_LANE_CYCLES, WIDE_LANE_SIGMAS = 0.8, 5.0
#: Standard deviation of a wide lane before there is a past, m, and how much past that counts for, epochs.
WIDE_LANE_START_M, WIDE_LANE_PAST = 0.4, 4.0
#: Past epochs that the running mean and variance of the wide lane remember.
MEMORY = 40.0
#: The ionosphere's rate is that over the last epochs: at least, at most so many, within so many seconds.
#: Between epochs closer than this the ionosphere does not change, and a rate would be noise.
RATE_LEAST, RATE_EPOCHS, RATE_S, RATE_FROM_S = 3, 10, 160.0, 5.0


@njit(cache=True, nogil=True)
def _rate(i: int, arc: int, t_s: FloatArray, geometry_free_m: FloatArray) -> float:
    """Return the rate of the geometry-free combination up to row `i` of an arc that began at row `arc`."""
    k = i
    while k > arc and i - k < RATE_EPOCHS and t_s[i] - t_s[k - 1] <= RATE_S:
        k -= 1
    slope = (geometry_free_m[i] - geometry_free_m[k]) / (t_s[i] - t_s[k]) if i - k >= RATE_LEAST else 0.0
    return 0.0 if np.isnan(slope) else slope


@njit(cache=True, nogil=True)
def arc_starts(
    satellite: IntArray, t_s: FloatArray, lli: IntArray, piece: IntArray, geometry_free_m: FloatArray,
    wide_lane_m: FloatArray, wide_lane_cycle_m: FloatArray, step_error_m: FloatArray,
    max_gap_s: float, gf_limit_m: float, gf_rate_mps: float, step_limit_m: float,
) -> IntArray:  # fmt: skip
    """Return for each carrier why a new arc begins there, 0 where the arc goes on.

    Parameters
    ----------
    satellite, t_s, lli, piece : ndarray, shape (n,)
        Rows sorted by satellite and time; RINEX loss-of-lock bits; an identifier that changes where another
        signal is tracked or the satellite's clock product begins anew.
    geometry_free_m, wide_lane_m, wide_lane_cycle_m : ndarray, shape (n,)
        Carrier minus carrier, Melbourne-Wuebbena combination and its wavelength; nan where there is one
        frequency.
    step_error_m : ndarray, shape (n,)
        Change of the carrier since the row before less what Doppler says; nan: not known.
    max_gap_s : float
        A longer gap ends an arc.
    gf_limit_m, gf_rate_mps : float
        Largest change of the geometry-free combination against its rate before: a constant, and a part that
        grows with time.
    step_limit_m : float
        Largest `step_error_m`.
    """
    out = np.zeros(len(satellite), dtype=np.int64)
    mean, variance, count = 0.0, WIDE_LANE_START_M**2, 0.0
    arc = 0
    for i in range(len(satellite)):
        why = FIRST
        if i and satellite[i] == satellite[i - 1]:
            dt = t_s[i] - t_s[i - 1]
            why = 0
            sigma = np.sqrt(
                (variance * count + WIDE_LANE_START_M**2 * WIDE_LANE_PAST) / (count + WIDE_LANE_PAST)
            )
            limit = max(WIDE_LANE_CYCLES * wide_lane_cycle_m[i], WIDE_LANE_SIGMAS * sigma)
            change = geometry_free_m[i] - geometry_free_m[i - 1]
            off = change - (dt * _rate(i - 1, arc, t_s, geometry_free_m) if dt >= RATE_FROM_S else 0.0)
            if dt > max_gap_s:
                why = GAP
            elif lli[i] & 1:
                why = LOST_LOCK
            elif (lli[i] ^ lli[i - 1]) & 2:
                why = HALF_CYCLE
            elif piece[i] != piece[i - 1]:
                why = RESTART
            elif abs(off) > gf_limit_m + gf_rate_mps * dt:
                why = GEOMETRY_FREE
            elif count and abs(wide_lane_m[i] - mean) > limit:
                why = WIDE_LANE
            elif abs(step_error_m[i]) > step_limit_m:
                why = TIME_DIFFERENCE
        out[i] = why
        if why:
            count = 0.0
            arc = i
        if not np.isnan(wide_lane_m[i]):
            count = min(count + 1.0, MEMORY)
            before = wide_lane_m[i] - mean
            mean = wide_lane_m[i] if count == 1.0 else mean + before / count
            square = before * (wide_lane_m[i] - mean)
            variance = 0.0 if count == 1.0 else variance + (square - variance) / count
    return out
