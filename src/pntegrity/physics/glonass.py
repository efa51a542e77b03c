"""GLONASS orbits: numerical integration of a broadcast state vector (ICD L1/L2 5.1, appendix A.3.1.2).

The frame is PZ-90.11, taken as the WGS 84 of the other systems (they agree within centimetres).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.records import FloatArray

__all__ = ["glonass_states"]

MU = 3.986_004_4e14
RADIUS_M = 6_378_136.0
J2 = 1.082_625_75e-3
EARTH_RATE = 7.292_115e-5
LIGHT = 299_792_458.0
STEP_S = 60.0


def glonass_states(
    record: Any, toe: int, t_rx_ns: npt.NDArray[np.int64], travel_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return position (n, 3), velocity (n, 3), clock offset (s) and its rate at the times of emission.

    The clock ``-tau_n + gamma_n (t - t_b)`` holds the relativistic effect, as GLONASS broadcasts it; sidereon gives
    ``clock_bias_s = -tau_n`` as RINEX does.
    """
    since = (t_rx_ns - toe) * 1e-9 - travel_s
    offset = record.clock_bias_s + record.gamma_n * since
    since = since - offset
    clock = record.clock_bias_s + record.gamma_n * since
    state = _integrate(record, since)
    return state[:, :3], state[:, 3:], clock, np.full(len(since), record.gamma_n)


def _integrate(record: Any, since_s: FloatArray) -> FloatArray:
    """Runge-Kutta 4: whole steps once for all rows, from node to node, then one part step for each row."""
    start = np.concatenate([record.position_m, record.velocity_m_s])[None, :]
    push = np.asarray(record.acceleration_m_s2)
    nodes = np.trunc(since_s / STEP_S).astype(np.int64)
    at = {0: start}
    for sign in (1, -1):
        for k in range(1, int(np.max(sign * nodes, initial=0)) + 1):
            at[sign * k] = _step(at[sign * (k - 1)], np.array([sign * STEP_S]), push)
    begin = np.concatenate([at[k] for k in nodes.tolist()])
    return _step(begin, since_s - nodes * STEP_S, push)


def _step(state: FloatArray, h: FloatArray, push: FloatArray) -> FloatArray:
    h = h[:, None]
    k1 = _rate(state, push)
    k2 = _rate(state + 0.5 * h * k1, push)
    k3 = _rate(state + 0.5 * h * k2, push)
    k4 = _rate(state + h * k3, push)
    return state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _rate(state: FloatArray, push: FloatArray) -> FloatArray:
    """Time derivative in the rotating frame: gravity with J2, centrifugal and Coriolis terms, Sun and Moon (`push`)."""
    x, v = state[:, :3], state[:, 3:]
    r2 = np.sum(x * x, axis=1)
    r3 = r2 * np.sqrt(r2)
    a = 1.5 * J2 * MU * RADIUS_M**2 / (r2 * r3)
    b = 5.0 * x[:, 2] ** 2 / r2
    flat = -MU / r3 - a * (1.0 - b)
    out = np.empty_like(state)
    out[:, :3] = v
    out[:, 3] = (flat + EARTH_RATE**2) * x[:, 0] + 2.0 * EARTH_RATE * v[:, 1] + push[0]
    out[:, 4] = (flat + EARTH_RATE**2) * x[:, 1] - 2.0 * EARTH_RATE * v[:, 0] + push[1]
    out[:, 5] = (flat - 2.0 * a) * x[:, 2] + push[2]
    return out
