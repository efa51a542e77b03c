"""The exact distribution of a quadratic form of normals: what a test's real false-alarm rate and power are.

``q = sum_i w_i (z_i + d_i)^2`` with independent unit normals ``z``; a `kernels.windows.Form` whose metric is not the exact
one has the eigenvalues of its covariance as weights.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pntegrity.records import FloatArray

__all__ = ["quadratic_tail", "quadratic_threshold"]


def quadratic_tail(value: float, weights: npt.ArrayLike, shift: npt.ArrayLike | None = None, nodes: int = 1000) -> float:
    """Return the probability that a weighted sum of squared normals exceeds `value`, to about 1e-9 of itself.

    Parameters
    ----------
    value : float
    weights : array_like, shape (n,)
        Positive weights ``w``.
    shift : array_like, shape (n,), optional
        Means ``d`` of the normals.
    nodes : int
        Points of the trapezoidal rule.

    Notes
    -----
    The tail is ``1/(2 pi i)`` times the integral of ``exp(K(s) - s value) / s`` over a path right of 0, ``K`` being the
    cumulant function. The path starts at the saddle point and bends right around the cut of ``K``, where the integrand
    falls like a Gaussian, so that even 1e-12 is a sum without cancellation.

    References
    ----------
    Lugannani and Rice (1980), Adv. Appl. Prob. 12, 475-490 (the contour); Imhof (1961), Biometrika 48, 419-426 (the form).
    """
    w = np.asarray(weights, dtype=np.float64)
    w = w[w > 0.0]
    d2 = np.zeros_like(w) if shift is None else np.asarray(shift, dtype=np.float64)[np.asarray(weights) > 0.0] ** 2
    if value <= 0.0 or not len(w):
        return 1.0 if value <= 0.0 else 0.0
    scale = w.max()
    w, x = w / scale, value / scale
    c, curvature = _saddle(x, w, d2)
    # width of the saddle along the imaginary axis; the bend keeps the path clear of the cut from 1/2 to the right
    width = min(1.0 / np.sqrt(curvature), 0.5 - c + 0.25)
    bend = 0.25 * width * width / max(0.5 - c, 1e-3)
    reach = np.sqrt(40.0 / (bend * x)) if bend * x > 0.0 else 40.0
    t = (np.arange(nodes) + 0.5) * reach / nodes
    s = c + 1j * width * t + bend * t * t
    ds = 1j * width + 2.0 * bend * t
    exponent = _cumulant(s, w, d2) - s * x
    terms = np.imag(np.exp(exponent) / s * ds)
    return float(np.clip(terms.sum() * (reach / nodes) / np.pi, 0.0, 1.0))


def _cumulant(s: npt.NDArray[np.complex128], w: FloatArray, d2: FloatArray) -> npt.NDArray[np.complex128]:
    rest = 1.0 - 2.0 * np.multiply.outer(s, w)
    return np.asarray((-0.5 * np.log(rest) + d2 * np.multiply.outer(s, w) / rest).sum(axis=-1))


def _saddle(x: float, w: FloatArray, d2: FloatArray) -> tuple[float, float]:
    """Return the real saddle point of ``exp(K(s) - s x) / s`` between 0 and 1/2, and the curvature there."""
    low, high = 0.0, 0.5
    for _ in range(200):
        s = 0.5 * (low + high)
        rest = 1.0 - 2.0 * s * w
        slope = float((w / rest + d2 * w / rest**2).sum()) - x - 1.0 / s
        low, high = (s, high) if slope < 0.0 else (low, s)
    rest = 1.0 - 2.0 * s * w
    return s, float((2.0 * w**2 / rest**2 + 4.0 * d2 * w**2 / rest**3).sum()) + 1.0 / s**2


def quadratic_threshold(p_fa: float, weights: npt.ArrayLike) -> float:
    """Return the value that a weighted sum of squared unit normals exceeds with probability `p_fa`."""
    from scipy.optimize import brentq

    w = np.asarray(weights, dtype=np.float64)

    def excess(log_value: float) -> float:
        return float(np.log(max(quadratic_tail(np.exp(log_value), w), 1e-300)) - np.log(p_fa))

    low, high = np.log(1e-3 * w.sum()), np.log(4.0 * w.sum() + 4.0 * w.max() * -np.log(p_fa))
    return float(np.exp(brentq(excess, low, high, xtol=1e-10)))
