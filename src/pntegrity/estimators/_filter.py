"""Steps that the filters of code and range rate share: births of satellites, clocks and their jumps."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from pntegrity.estimators._errors import error_states, propagate, stationary
from pntegrity.estimators._layout import columns, survivors
from pntegrity.estimators._navigation import MOTION, START_CLOCK_M
from pntegrity.kernels.sparse import sandwich
from pntegrity.records import FloatArray, Layout
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.pseudoranges import Rows, system_of
from pntegrity.sensors.ranges import C_MPS

__all__ = ["clock_walk", "clocks", "integrated_walk", "median", "mode", "next_layout", "transition"]

#: A common shift of the code residuals above this is a jump of the receiver clock, m.
CLOCK_JUMP_M = 300.0
#: Half the width of the window in which the mode has most residuals, m.
MODE_M = 8.0


def median(a: FloatArray) -> float:
    """Return the median: `numpy.median`, without what that does for arrays of any shape."""
    a = np.sort(a)
    return float(0.5 * (a[(len(a) - 1) // 2] + a[len(a) // 2]))


def mode(a: FloatArray) -> float:
    """Return the mean of the residuals in the fullest window of 16 m, the lowest of several as full.

    Reflected signals are late, by amounts that differ: those that agree are the direct ones.
    """
    a = np.sort(a)
    ends = np.searchsorted(a, a + 2.0 * MODE_M, side="right")
    first = int(np.argmax(ends - np.arange(len(a))))
    return float(a[first : ends[first]].mean())


@lru_cache(maxsize=512)
def next_layout(
    old: Layout, keys: tuple[str, ...], kinds: tuple[str, ...], inertial: tuple[str, ...] = ()
) -> Layout:
    """Return the layout after `old` with these code rows: constellations stay, satellites come and go.

    `inertial` are the states of an inertial measurement unit, which stand behind the clock's.
    """
    reference = old.names[6].partition(":")[2]
    isb = [n for n in old.names if n.startswith("isb:")]
    seen = dict.fromkeys(f"isb:{system_of(k)}" for k in keys if system_of(k) != reference)
    isb += [n for n in seen if n not in old.index]
    return Layout((*MOTION, f"clk:{reference}", "drift", *inertial, *isb, *error_states(keys, kinds)))


def transition(
    old: Layout, new: Layout, dt: float, noise: NoiseModel, rows: Rows
) -> tuple[FloatArray, FloatArray]:
    """Return the rectangular `F` and the `Q` of a step, but for motion and clock: what is born has its whole
    variance in `Q`.
    """
    to, source, born = survivors(old, new)
    n = len(new)
    step = np.eye(n)
    propagate(step, new, rows, noise, dt)
    lasting = np.zeros((n, n))
    stationary(lasting, new, rows, noise)
    Q = lasting - sandwich(step, lasting)
    F = np.zeros((n, len(old)))
    F[:, source] = step[:, to]
    fresh = np.zeros(n, dtype=bool)
    fresh[born] = True
    F[fresh] = 0.0
    Q[np.ix_(fresh, fresh)] = lasting[np.ix_(fresh, fresh)]
    isb = new.block("isb")
    Q[isb, isb] = np.where(fresh[isb], START_CLOCK_M**2, noise.isb_m**2 * dt)
    return F, Q


def integrated_walk(F: FloatArray, Q: FloatArray, level: int, slope: int, spectral: float, dt: float) -> None:
    """Write the step of a level whose slope walks with a spectral density."""
    F[level, slope] = dt
    Q[level, level] = spectral * dt**3 / 3.0
    Q[level, slope] = Q[slope, level] = spectral * dt**2 / 2.0
    Q[slope, slope] = spectral * dt


def clock_walk(F: FloatArray, Q: FloatArray, dt: float, noise: NoiseModel) -> None:
    """Write the step of clock and drift, which stand behind position and velocity."""
    integrated_walk(F, Q, 6, 7, noise.clock_drift_mps**2, dt)
    Q[6, 6] += noise.clock_m**2 * dt


def clocks(
    mean: FloatArray,
    F: FloatArray,
    Q: FloatArray,
    layout: Layout,
    old: Layout,
    rows: Rows,
    centre: Callable[[FloatArray], float] = median,
) -> tuple[FloatArray, FloatArray, FloatArray, int, tuple[str, ...]]:
    """Set what the data must initialise: inter-system biases of new constellations, the clock after a
    jump. `centre` says where the residuals of a new constellation are.
    """
    consumed, events = 0, []
    residual = rows.y - rows.predicted - mean[6]
    isb = columns(layout, tuple(f"isb:{system_of(k)}" for k in rows.keys))
    born = [i for i in dict.fromkeys(isb.tolist()) if i >= 0 and layout.names[i] not in old.index]
    known = ~np.isin(isb, born) if born else np.ones(len(isb), dtype=bool)
    residual = residual - np.where((isb >= 0) & known, mean[isb], 0.0)
    shift, jumped = _common_shift(residual[known])
    if jumped:
        whole_ms = round(shift / (C_MPS * 1e-3))
        if whole_ms and abs(shift - whole_ms * C_MPS * 1e-3) < CLOCK_JUMP_M:
            shift = whole_ms * C_MPS * 1e-3
            events.append(f"receiver clock jump of {whole_ms} ms removed")
        else:
            F[6], Q[6], Q[:, 6] = 0.0, 0.0, 0.0
            Q[6, 6] = START_CLOCK_M**2
            consumed += 1
            events.append(f"receiver clock jump of {shift:.0f} m: clock started anew")
        mean[6] += shift
        residual = residual - shift
    for i in born:
        mean[i] = centre(residual[isb == i])
        consumed += 1
        events.append(f"first satellites of {layout.names[i][4:]}")
    return mean, F, Q, consumed, tuple(events)


def _common_shift(residual: FloatArray) -> tuple[float, bool]:
    """Return the median of the residuals, and whether most of them share it and it is too large for a clock
    that drifts.
    """
    if len(residual) < 3:
        return 0.0, False
    shift = median(residual)
    shared = np.mean(np.abs(residual - shift) < 0.3 * CLOCK_JUMP_M) > 0.6
    return shift, bool(shared and abs(shift) > CLOCK_JUMP_M)
