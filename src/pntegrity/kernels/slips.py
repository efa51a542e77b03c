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
WIDE_LANE_CYCLES, WIDE_LANE_SIGMAS = 0.8, 4.0
#: Standard deviation of a wide lane before there is a past, m, and how much past that counts for, epochs.
WIDE_LANE_START_M, WIDE_LANE_PAST = 0.6, 10.0
#: Past epochs that the running mean and variance of the wide lane remember.
MEMORY = 300.0


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
        Largest change of the geometry-free combination: a constant, and a part that grows with time.
    step_limit_m : float
        Largest `step_error_m`, used where there is no second frequency.
    """
    out = np.zeros(len(satellite), dtype=np.int64)
    mean, variance, count = 0.0, WIDE_LANE_START_M**2, 0.0
    for i in range(len(satellite)):
        why = FIRST
        if i and satellite[i] == satellite[i - 1]:
            dt = t_s[i] - t_s[i - 1]
            why = 0
            sigma = np.sqrt(
                (variance * count + WIDE_LANE_START_M**2 * WIDE_LANE_PAST) / (count + WIDE_LANE_PAST)
            )
            limit = max(WIDE_LANE_CYCLES * wide_lane_cycle_m[i], WIDE_LANE_SIGMAS * sigma)
            if dt > max_gap_s:
                why = GAP
            elif lli[i] & 1:
                why = LOST_LOCK
            elif (lli[i] ^ lli[i - 1]) & 2:
                why = HALF_CYCLE
            elif piece[i] != piece[i - 1]:
                why = RESTART
            elif abs(geometry_free_m[i] - geometry_free_m[i - 1]) > gf_limit_m + gf_rate_mps * dt:
                why = GEOMETRY_FREE
            elif count and abs(wide_lane_m[i] - mean) > limit:
                why = WIDE_LANE
            elif np.isnan(geometry_free_m[i]) and abs(step_error_m[i]) > step_limit_m:
                why = TIME_DIFFERENCE
        out[i] = why
        if why:
            count = 0.0
        if not np.isnan(wide_lane_m[i]):
            count = min(count + 1.0, MEMORY)
            before = wide_lane_m[i] - mean
            mean = wide_lane_m[i] if count == 1.0 else mean + before / count
            square = before * (wide_lane_m[i] - mean)
            variance = 0.0 if count == 1.0 else variance + (square - variance) / count
    return out
