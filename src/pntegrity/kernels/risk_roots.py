"""Sums of normal tails and the levels at which they reach a risk: what `kernels.protection` computes with.

All compiled code is in this file: a compiled function that is kept on disk does not notice that one it calls,
in another file, has changed.
"""

from __future__ import annotations

from collections.abc import Callable
from math import erfc, exp, inf, isfinite, log, pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

__all__ = ["largest_term", "least_root", "level_root", "observed_root"]

HALF_ROOT = sqrt(0.5)
PEAK = 1.0 / sqrt(2.0 * pi)
#: What a term must be at the least level possible, as a share of the risk, to be looked at.
NEGLIGIBLE = 1e-13
#: Standard deviations below this, m, are taken as this.
SMALLEST = 1e-12
STEPS = 100


@njit(cache=True, nogil=True)
def _tail(z: float) -> float:
    """Return Q(z), the probability that a unit normal exceeds z."""
    return 0.5 * erfc(z * HALF_ROOT)


@njit(cache=True, nogil=True)
def _density(z: float) -> float:
    return PEAK * exp(-0.5 * z * z)


@njit(cache=True, nogil=True)
def _hazard(z: float) -> float:
    """Return ``density / tail``, minus the slope of ``log Q``."""
    return z + 1.0 / z - 2.0 / z**3 if z > 30.0 else _density(z) / _tail(z)


@njit(cache=True, nogil=True)
def _quantile(q: float) -> float:
    """Return where Q is `q`; 0 for half and more. ``Q <= exp(-z^2 / 2) / 2``: Newton's steps on the
    logarithm come from above and stay there.
    """
    if q >= 0.5:
        return 0.0
    z = sqrt(-2.0 * log(2.0 * q))
    for _ in range(STEPS):
        tail = _tail(z)
        step = (log(tail) - log(q)) / _hazard(z) if tail > 0.0 else -0.5 * z
        z += step
        if abs(step) <= 1e-14 * z:
            break
    return z


@njit(cache=True, nogil=True)
def _check(p: FloatArray) -> None:
    for value in p:
        if not 0.0 <= value <= 1.0:
            raise ValueError("every `p` must be a probability, from 0 to 1")


@njit(cache=True, nogil=True)
def _seen(p: FloatArray, sigma: FloatArray, reach: FloatArray) -> npt.NDArray[np.bool_]:
    """Return the modes that are detected; of the others the whole probability counts."""
    return (p > 0.0) & np.isfinite(sigma) & np.isfinite(reach)


@njit(cache=True, nogil=True)
def level_root(
    risk: float, s0: float, b0: float, p: FloatArray, sigma: FloatArray, reach: FloatArray
) -> float:
    """Return the level of `protection.protection_level`; `reach` is threshold and bias of each mode, m."""
    _check(p)
    seen = _seen(p, sigma, reach)
    left = risk - p[~seen].sum()
    if not left > 0.0 or not isfinite(s0) or not isfinite(b0):
        return inf
    p, reach, sigma, s0 = p[seen], reach[seen], np.maximum(sigma[seen], SMALLEST), max(s0, SMALLEST)
    low = max(b0 + s0 * _quantile(0.5 * left), 0.0)
    high = max(b0 + s0 * _quantile(0.25 * left), low)
    if len(p):
        high = max(high, (reach + sigma * _quantile(min(0.5 * left / p.sum(), 0.5))).max())
    at_low = np.array([p[i] * _tail((low - reach[i]) / sigma[i]) for i in range(len(p))])
    keep = at_low > NEGLIGIBLE * left / max(len(p), 1)
    terms = (s0, b0, p[keep], sigma[keep], reach[keep])
    return _bracket(_risk_at, terms, left, low, low, high, 1e-13)[1]


@njit(cache=True, nogil=True)
def observed_root(
    risk: float, s0: float, b0: float, p: FloatArray, sigma: FloatArray, bias: FloatArray,
    expected: FloatArray, apart: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    """Return the level and the mode of `protection.observed_level`."""
    reach, over = expected + bias, np.abs(apart) - expected
    kept = np.flatnonzero(_seen(p, sigma, reach + over))
    both = np.concatenate((np.arange(len(p)), kept))  # what is detected has two tails
    level = level_root(risk, s0, b0, p[both], sigma[both], reach[both])
    extra, mode = 0.0, -1
    for i in kept:
        if over[i] > extra:
            extra, mode = over[i], int(i)
    if mode >= 0 and isfinite(level):
        return level + extra, mode
    mode = largest_term(level, s0, b0, p[both], sigma[both], reach[both])
    return level, both[mode] if mode >= 0 else -1


@njit(inline="always")  # what is handed a function as a value cannot be kept on disk
def _bracket(
    risk_at: Callable[..., tuple[float, float]], terms: tuple[Any, ...], risk: float,
    x: float, low: float, high: float, tolerance: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the level at which ``risk_at(level, *terms)`` is `risk`, twice; where the steps do not settle,
    to `tolerance` of the upper end, the bracket that is left.

    `risk_at` gives the risk, which falls with the level, and how fast. Newton's steps on its logarithm from
    `x`, or the middle where one leaves the bracket.
    """
    for _ in range(STEPS):
        total, slope = risk_at(x, *terms)
        if total > risk:
            low = x
        else:
            high = x
        step = (log(total) - log(risk)) * total / slope if total > 0.0 and slope > 0.0 else inf
        after = x + step if low <= x + step <= high else 0.5 * (low + high)
        if abs(after - x) <= tolerance * high:
            return after, after
        x = after
    return low, high


@njit(cache=True, nogil=True)
def _risk_at(
    x: float, s0: float, b0: float, p: FloatArray, s: FloatArray, c: FloatArray
) -> tuple[float, float]:
    """Return the sum of the tails at level `x`, and how fast it falls."""
    z = (x - b0) / s0
    total, slope = 2.0 * _tail(z), 2.0 * _density(z) / s0
    for i in range(len(p)):
        z = (x - c[i]) / s[i]
        total += p[i] * _tail(z)
        slope += p[i] * _density(z) / s[i]
    return total, slope


@njit(cache=True, nogil=True)
def largest_term(x: float, s0: float, b0: float, p: FloatArray, sigma: FloatArray, reach: FloatArray) -> int:
    """Return the mode of `protection.dominant_mode` at level `x`."""
    seen = _seen(p, sigma, reach)
    best, most = -1, 2.0 * _tail((x - b0) / max(s0, SMALLEST)) if isfinite(x) else 0.0
    for i in range(len(p)):
        term = p[i] * _tail((x - reach[i]) / max(sigma[i], SMALLEST)) if seen[i] else p[i]
        if term > most:
            best, most = i, term
    return best


@njit(cache=True, nogil=True)
def least_root(risk: float, s0: float, p: FloatArray, spread: FloatArray, threshold: FloatArray) -> float:
    """Return the level of `protection.least_level`: from `level_root` downwards, which bounds every term from
    above.
    """
    sigma = np.sqrt(s0 * s0 + spread * spread)
    x = level_root(risk, s0, 0.0, p, sigma, threshold)
    if not isfinite(x):
        return inf
    none, seen = max(1.0 - p.sum(), 0.0), _seen(p, spread, threshold)
    left, s0, p = risk - p[~seen].sum(), max(s0, SMALLEST), p[seen]
    ss, limit = np.maximum(spread[seen], SMALLEST), threshold[seen]
    at_x = np.array([p[i] * _tail((x - limit[i]) / max(sigma[seen][i], s0)) for i in range(len(p))])
    keep = at_x > 1e-9 * left / max(len(p), 1)
    p, ss, limit = p[keep], ss[keep], limit[keep]
    worst = (x * ss**2 + limit * s0**2) / (s0**2 + ss**2)
    return _bracket(_least_at, (s0, none, p, ss, limit, worst), left, x, 0.0, x, 1e-9)[0]


@njit(cache=True, nogil=True)
def _least_at(
    x: float, s0: float, none: float, p: FloatArray, ss: FloatArray, limit: FloatArray, worst: FloatArray
) -> tuple[float, float]:
    """Return the exact risk at level `x`, and how fast it falls; the worst faults are kept for the next."""
    total, slope = none * 2.0 * _tail(x / s0), none * 2.0 * _density(x / s0) / s0
    for i in range(len(p)):
        worst[i] = _worst_fault(x, s0, ss[i], limit[i], worst[i])
        b, passes = worst[i], _passes(worst[i], ss[i], limit[i])
        still = _passes(0.0, ss[i], limit[i])
        if still * _exceeds(x, 0.0, s0) > passes * _exceeds(x, b, s0):
            b, passes = 0.0, still
        total += p[i] * passes * _exceeds(x, b, s0)
        slope += p[i] * passes * (_density((x - b) / s0) + _density((x + b) / s0)) / s0
    return total, slope


@njit(cache=True, nogil=True)
def _exceeds(x: float, b: float, s0: float) -> float:
    return _tail((x - b) / s0) + _tail((x + b) / s0)


@njit(cache=True, nogil=True)
def _passes(b: float, ss: float, limit: float) -> float:
    return _tail((b - limit) / ss) - _tail((b + limit) / ss)


@njit(cache=True, nogil=True)
def _worst_fault(x: float, s0: float, ss: float, limit: float, b: float) -> float:
    """Return the fault that makes an error above `x` and no alert most probable.

    The logarithm of that probability is concave but for the far tails. Newton's steps on its slope; the
    curvature leaves the far tails out.
    """
    low, high = 0.0, max(x, limit) + 10.0 * (s0 + ss)
    b = min(max(b, 1e-3 * s0), high)
    for _ in range(STEPS):
        rise, bend = _slope_of_log(x, s0, ss, limit, b)
        if rise > 0.0:
            low = b
        else:
            high = b
        after = b + rise / bend if bend > 0.0 else inf
        if not low < after < high:
            after = 0.5 * (low + high)
        if abs(after - b) <= 1e-5 * s0:
            return after
        b = after
    return b


@njit(cache=True, nogil=True)
def _slope_of_log(x: float, s0: float, ss: float, limit: float, b: float) -> tuple[float, float]:
    u, v = (x - b) / s0, (b - limit) / ss
    hu, hv = _hazard(u), _hazard(v)
    rise = hu / s0 - hv / ss
    exceeds, passes = _exceeds(x, b, s0), _passes(b, ss, limit)
    if exceeds > 0.0 and passes > 0.0:
        rise = (_density(u) - _density((x + b) / s0)) / s0 / exceeds
        rise -= (_density(v) - _density((b + limit) / ss)) / ss / passes
    return rise, hu * (hu - u) / s0**2 + hv * (hv - v) / ss**2
