"""GLONASS orbits: numerical integration of a broadcast state vector (ICD L1/L2 5.1, appendix A.3.1.2).

The frame is PZ-90.11, taken as the WGS 84 of the other systems (they agree within centimetres).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.records import FloatArray

__all__ = ["glonass_states"]

MU = 3.986_004_4e14
RADIUS_M = 6_378_136.0
J2 = 1.082_625_75e-3
EARTH_RATE = 7.292_115e-5
STEP_S = 60.0


def glonass_states(
    records: Sequence[Any], which: npt.NDArray[np.intp], since_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return position (n, 3), velocity (n, 3), clock offset (s) and its rate at the times of emission.

    Parameters
    ----------
    records : sequence of sidereon.GlonassRecord
        State vectors.
    which : ndarray of int, shape (n,)
        The record of each row.
    since_s : ndarray, shape (n,)
        Time of reception less travel time, from the record's reference time; the satellite's clock offset,
        which the time of emission lacks, is taken off here.

    Notes
    -----
    The clock ``-tau_n + gamma_n (t - t_b)`` holds the relativistic effect, as GLONASS broadcasts it;
    sidereon's ``clock_bias_s`` is ``-tau_n``, as in RINEX.
    """
    bias = np.array([r.clock_bias_s for r in records])[which]
    drift = np.array([r.gamma_n for r in records])[which]
    since = since_s - (bias + drift * since_s)
    start = np.array([[*r.position_m, *r.velocity_m_s] for r in records], dtype=np.float64)
    push = np.array([r.acceleration_m_s2 for r in records], dtype=np.float64)
    state = _integrate(start, push, which, since)
    return state[:, :3], state[:, 3:], bias + drift * since, drift


def _integrate(
    start: FloatArray, push: FloatArray, which: npt.NDArray[np.intp], since_s: FloatArray
) -> FloatArray:
    """Runge-Kutta 4: whole steps once for all records, from node to node, then one part step for each row."""
    node = np.trunc(since_s / STEP_S).astype(np.int64)
    begin = np.empty((len(which), 6))
    for sign in (1, -1):
        state, step = start, np.full(len(start), sign * STEP_S)
        for k in range(int(np.max(sign * node, initial=0)) + 1):
            at = np.flatnonzero(node == sign * k)
            begin[at] = state[which[at]]
            state = _step(state, step, push)
    return _step(begin, since_s - node * STEP_S, push[which])


def _step(state: FloatArray, h: FloatArray, push: FloatArray) -> FloatArray:
    h = h[:, None]
    k1 = _rate(state, push)
    k2 = _rate(state + 0.5 * h * k1, push)
    k3 = _rate(state + 0.5 * h * k2, push)
    k4 = _rate(state + h * k3, push)
    return state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _rate(state: FloatArray, push: FloatArray) -> FloatArray:
    """Time derivative in the rotating frame: gravity, J2, centrifugal, Coriolis, Sun and Moon (`push`)."""
    x, v = state[:, :3], state[:, 3:]
    r2 = np.sum(x * x, axis=1)
    r3 = r2 * np.sqrt(r2)
    a = 1.5 * J2 * MU * RADIUS_M**2 / (r2 * r3)
    b = 5.0 * x[:, 2] ** 2 / r2
    flat = -MU / r3 - a * (1.0 - b)
    out = np.empty_like(state)
    out[:, :3] = v
    out[:, 3] = (flat + EARTH_RATE**2) * x[:, 0] + 2.0 * EARTH_RATE * v[:, 1] + push[:, 0]
    out[:, 4] = (flat + EARTH_RATE**2) * x[:, 1] - 2.0 * EARTH_RATE * v[:, 0] + push[:, 1]
    out[:, 5] = (flat - 2.0 * a) * x[:, 2] + push[:, 2]
    return out
