"""Protection levels: how large an error can be, at a given risk, where solution separation alerts on nothing.

A protection level is the root of a sum of normal tails: that of no fault, and one for each fault mode, times
the mode's probability. The sum falls with the level, so that a bracketed Newton step on its logarithm finds
the root in a few evaluations, to rounding and not to some centimetres.

Symbols: ``e_0`` is the error of the full solution (standard deviation ``sigma0``), ``e_i`` that of the
solution without what mode ``i`` may have spoilt (``sigma``), their difference the separation (``sigma_ss``),
which is tested against a ``threshold``.
"""

from __future__ import annotations

from functools import lru_cache
from math import erfc, exp, inf, isfinite, log, pi, sqrt

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy import special

FloatArray = npt.NDArray[np.float64]

__all__ = [
    "dominant_mode", "false_alert_factor", "largest_threshold", "least_level", "observed_level",
    "protection_level",
]  # fmt: skip

HALF_ROOT = sqrt(0.5)
PEAK = 1.0 / sqrt(2.0 * pi)
#: What a term must be at the least level possible, as a share of the risk, to be looked at.
NEGLIGIBLE = 1e-13
#: Standard deviations below this, m, are taken as this.
SMALLEST = 1e-12
STEPS = 100


@lru_cache(maxsize=1024)
def false_alert_factor(p_fa: float, modes: int) -> float:
    """Return the factor of the standard deviation that a separation exceeds, in any of some modes, with at
    most `p_fa`: ``Q^-1(p_fa / (2 modes))``; inf without modes.

    References
    ----------
    Equation (12) of the PPP-RTK paper; equation (18) of the ARAIM reference algorithm (WG-C, ADD v3.1).
    """
    return float(-special.ndtri(0.5 * p_fa / modes)) if modes else inf


def protection_level(
    risk: float,
    sigma0: float,
    bias0: float,
    p: npt.ArrayLike,
    sigma: npt.ArrayLike,
    bias: npt.ArrayLike,
    threshold: npt.ArrayLike,
) -> float:
    """Return the level that the error of the full solution exceeds, without an alert, with at most `risk`.

    The root of ``risk = 2 Q((PL - bias0) / sigma0) + sum_i p_i Q((PL - threshold_i - bias_i) / sigma_i)``, to
    1e-12 of itself.

    Parameters
    ----------
    risk : float
        Probability for this direction and epoch, that of unmonitored modes already taken off.
    sigma0, bias0 : float
        Standard deviation of the full solution and the largest nominal bias in it, m.
    p : array_like, shape (n,)
        Probabilities of the modes.
    sigma, bias, threshold : array_like, shape (n,)
        Of each mode's solution, m. Where one is not finite the mode is one that nothing detects: its whole
        probability is taken off the risk.

    Returns
    -------
    float
        m; inf where the risk is used up or `sigma0` is not finite.

    Raises
    ------
    ValueError
        Where a probability is not one.

    References
    ----------
    Equation (14) of the PPP-RTK paper. Blanch et al. (2015), Baseline advanced RAIM user algorithm and
    possible improvements, IEEE Trans. Aerosp. Electron. Syst. 51, 713-732.
    """
    reach = _array(threshold) + _array(bias)
    return float(_level(float(risk), float(sigma0), float(bias0), _array(p), _array(sigma), reach))


def observed_level(
    risk: float,
    sigma0: float,
    bias0: float,
    p: npt.ArrayLike,
    sigma: npt.ArrayLike,
    bias: npt.ArrayLike,
    expected: npt.ArrayLike,
    apart: npt.ArrayLike,
) -> tuple[float, int]:
    """Return the level that the error of the full solution exceeds with at most `risk`, without any test of
    separations, and the mode that makes it as large as it is (-1: no fault does).

    ``PL = L + max_i (|d_i| - c_i)^+``, where ``d_i`` is the separation observed (`apart`), ``c_i`` the one
    `expected`, fixed before the data, and ``L`` the root of ``risk = 2 Q((L - bias0) / sigma0) + 2 sum_i p_i
    Q((L - c_i - bias_i) / sigma_i)``.

    It holds for any faults and separations, however these and the errors are correlated. Where mode ``i``
    happened, ``|e_0| <= |d_i| + |e_i|`` and ``PL - |d_i| >= L - c_i``, so that ``P(|e_0| > PL) <= P(|e_i| >
    L - c_i) <= 2 Q((L - c_i - bias_i) / sigma_i)``. Without a fault ``PL >= L`` gives ``2 Q((L - bias0) /
    sigma0)``. These, times the probabilities of the modes, add up to `risk`. What is expected only moves
    shares of the risk between modes. It must not depend on the data: with ``d_i`` in place of ``c_i`` in the
    sum the error is compared with a limit that knows it (measured: up to twice the risk).

    Parameters
    ----------
    risk, sigma0, bias0, p, sigma, bias
        As for `protection_level`.
    expected, apart : array_like, shape (n,)
        m. Of a mode that nothing detects they do not count.

    Returns
    -------
    level : float
        m; inf where the risk is used up or `sigma0` is not finite.
    mode : int
    """
    parts = (_array(a) for a in (p, sigma, bias, expected, apart))
    level, mode = _observed(float(risk), float(sigma0), float(bias0), *parts)
    return float(level), int(mode)


def least_level(
    risk: float, sigma0: float, p: npt.ArrayLike, sigma_ss: npt.ArrayLike, threshold: npt.ArrayLike
) -> float:
    """Return the level below which the test of separations cannot keep `risk`, whatever formula is used.

    The exact risk at the fault that is worst for each mode. The error of an optimal full solution and a
    separation are independent, and a fault moves both by the same ``b``, so that mode ``i`` adds
    ``p_i max_b [Q((L - b) / sigma0) + Q((L + b) / sigma0)] P(|b + sigma_ss u| <= threshold)``. The level is
    exact for one separation a mode; nominal biases are left out.

    Parameters
    ----------
    risk, sigma0, p, threshold
        As for `protection_level`.
    sigma_ss : array_like, shape (n,)
        Standard deviations of the separations, m: those of the modes' solutions are
        ``sqrt(sigma0^2 + sigma_ss^2)``.

    Returns
    -------
    float
        m; never above `protection_level` of the same modes.
    """
    return float(_least(float(risk), float(sigma0), _array(p), _array(sigma_ss), _array(threshold)))


def dominant_mode(
    level: float,
    sigma0: float,
    bias0: float,
    p: npt.ArrayLike,
    sigma: npt.ArrayLike,
    bias: npt.ArrayLike,
    threshold: npt.ArrayLike,
) -> int:
    """Return the mode that adds most to the risk at a protection level; -1: no fault does.

    Where the level is inf it is the most probable of the modes that nothing detects. Parameters as for
    `protection_level`.
    """
    reach = _array(threshold) + _array(bias)
    return int(_largest(float(level), float(sigma0), float(bias0), _array(p), _array(sigma), reach))


def largest_threshold(p: npt.ArrayLike, threshold: npt.ArrayLike, p_least: float) -> float:
    """Return the effective monitor threshold: the largest of the modes at least as probable as `p_least`; 0
    where there is none.

    References
    ----------
    WG-C, ADD v3.1, section on the effective monitor threshold (there ``p_least`` is 1e-5).
    """
    return float(_array(threshold)[_array(p) >= p_least].max(initial=0.0))


def _array(a: npt.ArrayLike) -> FloatArray:
    return np.ascontiguousarray(a, dtype=np.float64)


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
def _level(risk: float, s0: float, b0: float, p: FloatArray, sigma: FloatArray, reach: FloatArray) -> float:
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
    return _root(left, low, high, s0, b0, p[keep], sigma[keep], reach[keep])


@njit(cache=True, nogil=True)
def _observed(
    risk: float, s0: float, b0: float, p: FloatArray, sigma: FloatArray, bias: FloatArray,
    expected: FloatArray, apart: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    reach, over = expected + bias, np.abs(apart) - expected
    kept = np.flatnonzero(_seen(p, sigma, reach + over))
    both = np.concatenate((np.arange(len(p)), kept))  # what is detected has two tails
    level = _level(risk, s0, b0, p[both], sigma[both], reach[both])
    extra, mode = 0.0, -1
    for i in kept:
        if over[i] > extra:
            extra, mode = over[i], int(i)
    if mode >= 0 and isfinite(level):
        return level + extra, mode
    mode = _largest(level, s0, b0, p[both], sigma[both], reach[both])
    return level, both[mode] if mode >= 0 else -1


@njit(cache=True, nogil=True)
def _root(
    risk: float, low: float, high: float, s0: float, b0: float, p: FloatArray, s: FloatArray, c: FloatArray
) -> float:
    x = low
    for _ in range(STEPS):
        total, slope = _risk_at(x, s0, b0, p, s, c)
        after, low, high = _newton(x, low, high, risk, total, slope)
        if abs(after - x) <= 1e-13 * high:
            return after
        x = after
    return high


@njit(cache=True, nogil=True)
def _newton(
    x: float, low: float, high: float, risk: float, total: float, slope: float
) -> tuple[float, float, float]:
    """Return where Newton's step on the logarithm of the risk leads from `x`, or the middle where it leaves
    the bracket, and the bracket after it.
    """
    if total > risk:
        low = x
    else:
        high = x
    step = (log(total) - log(risk)) * total / slope if total > 0.0 and slope > 0.0 else inf
    after = x + step
    return (after if low <= after <= high else 0.5 * (low + high)), low, high


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
def _largest(x: float, s0: float, b0: float, p: FloatArray, sigma: FloatArray, reach: FloatArray) -> int:
    seen = _seen(p, sigma, reach)
    best, most = -1, 2.0 * _tail((x - b0) / max(s0, SMALLEST)) if isfinite(x) else 0.0
    for i in range(len(p)):
        term = p[i] * _tail((x - reach[i]) / max(sigma[i], SMALLEST)) if seen[i] else p[i]
        if term > most:
            best, most = i, term
    return best


@njit(cache=True, nogil=True)
def _least(risk: float, s0: float, p: FloatArray, spread: FloatArray, threshold: FloatArray) -> float:
    """Return the root from `_level` downwards: that one bounds every term from above."""
    sigma = np.sqrt(s0 * s0 + spread * spread)
    x = _level(risk, s0, 0.0, p, sigma, threshold)
    if not isfinite(x):
        return inf
    none, seen = max(1.0 - p.sum(), 0.0), _seen(p, spread, threshold)
    left, s0, p = risk - p[~seen].sum(), max(s0, SMALLEST), p[seen]
    ss, limit = np.maximum(spread[seen], SMALLEST), threshold[seen]
    at_x = np.array([p[i] * _tail((x - limit[i]) / max(sigma[seen][i], s0)) for i in range(len(p))])
    keep = at_x > 1e-9 * left / max(len(p), 1)
    return _least_root(left, x, s0, none, p[keep], ss[keep], limit[keep])


@njit(cache=True, nogil=True)
def _least_root(
    risk: float, high: float, s0: float, none: float, p: FloatArray, ss: FloatArray, limit: FloatArray
) -> float:
    low, x = 0.0, high
    worst = (x * ss**2 + limit * s0**2) / (s0**2 + ss**2)
    for _ in range(STEPS):
        total, slope = _least_at(x, s0, none, p, ss, limit, worst)
        after, low, high = _newton(x, low, high, risk, total, slope)
        if abs(after - x) <= 1e-9 * high:
            return after
        x = after
    return low


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
