"""The exact tail of a quadratic form of normals: what a test with a wrong covariance really does.

``q = sum_i w_i (z_i + d_i)^2`` with independent unit normals ``z``. Its tail is the inversion integral of
Imhof's problem,

    P(q > x) = 1 / (2 pi i)  int  exp(K(s) - s x) / s  ds,

``K`` being the cumulant function and the path any one that passes the real axis between 0 and the first
singularity at ``1 / (2 max w)``. Imhof integrates along the imaginary axis, where the integrand oscillates
and falls slowly. Here the path is a hyperbola through the real saddle point that follows the steepest descent
there and opens to the right: the integrand hardly turns and falls double exponentially, so that the
trapezoidal rule converges geometrically and a tail of 1e-12 keeps its digits.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

__all__ = ["quadratic_tail", "quadratic_threshold"]


def quadratic_tail(value: float, weights: npt.ArrayLike, shift: npt.ArrayLike | None = None) -> float:
    """Return the probability that a weighted sum of squared normals exceeds `value`, to 1e-10 of itself.

    Parameters
    ----------
    value : float
    weights : array_like, shape (n,)
        Weights ``w``, none negative; those below 1e-14 of the largest are dropped.
    shift : array_like, shape (n,), optional
        Means ``d`` of the normals; 0 where not given.

    Raises
    ------
    ValueError
        Where a weight is negative beyond rounding.

    References
    ----------
    Imhof (1961), Biometrika 48, 419-426. Rice (1980), SIAM J. Sci. Stat. Comput. 1, 438-448 (the path).
    """
    w, d2 = _checked(weights, shift)
    if value <= 0.0 or not len(w):
        return 1.0 if value < 0.0 or len(w) else 0.0
    scale = float(w.max())
    w, x = w / scale, value / scale
    c = _saddle(x, w, d2)
    step, slope = _path(c, w, d2)
    before = tail = np.inf
    for points in (32, 64, 128, 256, 512, 1024, 2048, 4096):
        before, tail = tail, _trapezoid(points, c, step, slope, x, w, d2)
        if abs(tail - before) <= 1e-11 * abs(tail):
            break
    return float(np.clip(tail, 0.0, 1.0))


def _checked(weights: npt.ArrayLike, shift: npt.ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    w = np.asarray(weights, dtype=np.float64)
    largest = float(w.max(initial=0.0))
    if (w < -1e-9 * largest).any():
        raise ValueError(f"`weights` must not be negative, but one is {w.min()}")
    keep = w > 1e-14 * largest
    d = np.zeros(len(w)) if shift is None else np.asarray(shift, dtype=np.float64)
    return w[keep], d[keep] ** 2


def _saddle(x: float, w: FloatArray, d2: FloatArray) -> float:
    """Return where ``K(s) - s x - log s`` is least between 0 and 1/2: its slope is increasing there."""
    from scipy.optimize import brentq

    def slope(s: float) -> float:
        rest = 1.0 - 2.0 * s * w
        return float((w / rest + d2 * w / rest**2).sum()) - x - 1.0 / s

    low, high = 1.0, 0.25
    while slope(low := 0.25 * low) > 0.0:
        pass
    while slope(high := 0.5 * (0.5 + high)) < 0.0:
        pass
    return float(brentq(slope, low, high, xtol=1e-300, rtol=1e-12))


def _path(c: float, w: FloatArray, d2: FloatArray) -> tuple[float, float]:
    """Return the unit of length at the saddle, and the slope of the hyperbola of steepest descent."""
    rest = 1.0 - 2.0 * c * w
    second = float((2.0 * w**2 / rest**2 + 4.0 * d2 * w**2 / rest**3).sum()) + 1.0 / c**2
    third = float((8.0 * w**3 / rest**3 + 24.0 * d2 * w**3 / rest**4).sum()) - 2.0 / c**3
    return 1.0 / np.sqrt(second), max(third / (3.0 * second**1.5), 0.05)


def _trapezoid(
    points: int, c: float, step: float, slope: float, x: float, w: FloatArray, d2: FloatArray
) -> float:
    """Return the integral over the upper half of ``s = c + step (slope (cosh u - 1) + i sinh u)``."""
    reach = np.arccosh(
        1.0 + 40.0 / (x * step * slope)
    )  # there exp(-s x) is 1e-17 of what it is at the saddle
    u = (np.arange(points) + 0.5) * (reach / points)
    s = c + step * (slope * (np.cosh(u) - 1.0) + 1j * np.sinh(u))
    height = float(_exponent(np.array([c + 0j]), x, w, d2)[0].real)
    terms = np.exp(_exponent(s, x, w, d2) - height) * step * (slope * np.sinh(u) + 1j * np.cosh(u))
    return float(np.imag(terms).sum() * (reach / points) / np.pi * np.exp(height))


@njit(cache=True, nogil=True)
def _exponent(s: ComplexArray, x: float, w: FloatArray, d2: FloatArray) -> ComplexArray:
    """Return ``K(s) - s x - log s``; the angles of ``1 - 2 s w`` are summed singly: no turn is lost."""
    out = np.empty(len(s), dtype=np.complex128)
    for k in range(len(s)):
        re, im = s[k].real, s[k].imag
        size, logs, angle, shifted = 1.0, 0.0, 0.0, 0.0 + 0.0j
        for i in range(len(w)):
            a, b = 1.0 - 2.0 * re * w[i], -2.0 * im * w[i]
            size *= a * a + b * b
            if size > 1e200 or size < 1e-200:
                logs, size = logs + np.log(size), 1.0
            angle += np.arctan2(b, a)
            if d2[i] > 0.0:
                shifted += d2[i] * w[i] / complex(a, b)
        total = -0.25 * (logs + np.log(size)) - 0.5j * angle + s[k] * shifted
        out[k] = total - s[k] * x - np.log(s[k])
    return out


def quadratic_threshold(p_fa: float, weights: npt.ArrayLike) -> float:
    """Return the value that a weighted sum of squared unit normals exceeds with probability `p_fa`.

    Parameters
    ----------
    p_fa : float
    weights : array_like, shape (n,)
    """
    from scipy.optimize import brentq

    w, _ = _checked(weights, None)

    def excess(log_value: float) -> float:
        return float(np.log(quadratic_tail(np.exp(log_value), w)) - np.log(p_fa))

    # the tail at `high` is below p_fa by Chernoff's bound at s = 1 / (4 max w)
    high = 4.0 * w.max() * (-np.log(p_fa)) - 2.0 * w.max() * np.log1p(-0.5 * w / w.max()).sum()
    low = 1e-3 * high
    while excess(np.log(low)) < 0.0:
        low *= 1e-3
    return float(np.exp(brentq(excess, np.log(low), np.log(high), xtol=1e-12)))
