"""Sound rays through layers in which the speed grows in proportion with depth: exact circular arcs.

Symbols: ``p = sin(angle from the vertical) / c`` is the ray parameter, the same all along a ray; ``w =
sqrt(1 - p^2 c^2)`` the cosine of that angle; ``X(p)`` the horizontal way. In a layer of thickness ``dz``
between speeds ``ca`` and ``cb`` with the gradient g: ``X = p (ca + cb) dz / (wa + wb)``, which has no limit
to watch for g = 0 or p = 0. With ``s = tan`` of the angle where the sound is fastest, ``X(s)`` rises and is
concave: its tangents lie above it, and Newton's method, begun at the straight line, comes to the root from
below.
"""

from __future__ import annotations

from math import inf, log1p, nan, sqrt

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

__all__ = ["trace_ray", "trace_rays"]

#: Newton's steps at most, and the step of ``s`` in proportion at which they end.
MOST_STEPS, ENOUGH = 60, 1e-14


@njit(cache=True)
def _speed(z: float, depth: FloatArray, speed: FloatArray) -> float:
    """Return the speed at a depth; beyond the ends theirs holds."""
    return float(np.interp(z, depth, speed))


@njit(cache=True)
def _layers(
    top: float, bottom: float, depth: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return thickness and the speeds at the ends of the layers between two depths."""
    first = int(np.searchsorted(depth, top, side="right"))
    last = int(np.searchsorted(depth, bottom, side="left"))
    n = max(last - first, 0) + 1
    dz, c = np.empty(n), np.empty(n + 1)
    z = top
    c[0] = _speed(top, depth, speed)
    for i in range(n - 1):
        dz[i], z = depth[first + i] - z, depth[first + i]
        c[i + 1] = speed[first + i]
    dz[n - 1], c[n] = bottom - z, _speed(bottom, depth, speed)
    return dz, c[:-1], c[1:]


@njit(cache=True)
def _way(p: float, dz: FloatArray, ca: FloatArray, cb: FloatArray) -> tuple[float, float]:
    """Return the horizontal way ``X`` and ``dX/dp``."""
    x, slope = 0.0, 0.0
    for i in range(len(dz)):
        wa, wb = sqrt(max(1.0 - (p * ca[i]) ** 2, 0.0)), sqrt(max(1.0 - (p * cb[i]) ** 2, 0.0))
        w = wa + wb
        if w == 0.0:
            return inf, inf
        k = (ca[i] + cb[i]) * dz[i] / w
        x += p * k
        bend = inf if wa * wb == 0.0 else p * p * (ca[i] ** 2 / wa + cb[i] ** 2 / wb) / w
        slope += k * (1.0 + bend)
    return x, slope


@njit(cache=True)
def _log_ratio(u: float) -> float:
    """Return ``log(1 + u) / u``."""
    return log1p(u) / u if u != 0.0 else 1.0


@njit(cache=True)
def _time(p: float, dz: FloatArray, ca: FloatArray, cb: FloatArray) -> float:
    """Return the travel time ``log(cb (1 + wa) / (ca (1 + wb))) / g``, without its limits."""
    t = 0.0
    for i in range(len(dz)):
        if dz[i] > 0.0:
            g = (cb[i] - ca[i]) / dz[i]
            wa = sqrt(max(1.0 - (p * ca[i]) ** 2, 0.0))
            wb = sqrt(max(1.0 - (p * cb[i]) ** 2, 0.0))
            q = p * p * dz[i] * (ca[i] + cb[i]) / ((wa + wb) * (1.0 + wb))
            t += dz[i] / ca[i] * _log_ratio(g * dz[i] / ca[i]) + q * _log_ratio(g * q)
    return t


@njit(cache=True)
def _parameter(x: float, dz: FloatArray, ca: FloatArray, cb: FloatArray) -> float:
    """Return the parameter of the ray that goes `x` sideways without turning; nan where there is none."""
    fastest, depth = float(max(ca.max(), cb.max())), float(dz.sum())
    if not depth > 0.0 or not _way(1.0 / fastest, dz, ca, cb)[0] > x:
        return nan
    s = x / depth
    p = nan
    for _ in range(MOST_STEPS):
        root = sqrt(1.0 + s * s)
        p = s / (fastest * root)
        way, slope = _way(p, dz, ca, cb)
        step = (x - way) * fastest * root**3 / slope
        s = max(s + step, 0.0)
        if abs(step) <= ENOUGH * (1.0 + s):
            break
    return s / (fastest * sqrt(1.0 + s * s))


@njit(cache=True)
def trace_ray(
    z1: float, z2: float, x: float, depth: FloatArray, speed: FloatArray
) -> tuple[float, float, float, float, float]:
    """Return one row of `trace_rays`; the same parameters, scalars."""
    top, bottom = min(z1, z2), max(z1, z2)
    if speed.min() == speed.max():
        c, length = speed[0], sqrt((bottom - top) ** 2 + x**2)
        if length == 0.0:
            return 0.0, 0.0, 1.0, 1.0, inf
        w = (bottom - top) / length
        return length / c, x / (length * c), w, w, length * c / w**2 if w > 0.0 else inf
    dz, ca, cb = _layers(top, bottom, depth, speed)
    p = _parameter(x, dz, ca, cb)
    if not p >= 0.0:
        return nan, nan, nan, nan, nan
    c1, c2 = _speed(z1, depth, speed), _speed(z2, depth, speed)
    w1, w2 = sqrt(max(1.0 - (p * c1) ** 2, 0.0)), sqrt(max(1.0 - (p * c2) ** 2, 0.0))
    return _time(p, dz, ca, cb), p, w1, w2, _way(p, dz, ca, cb)[1]


@njit(cache=True)
def trace_rays(
    z1: FloatArray, z2: FloatArray, x: FloatArray, depth: FloatArray, speed: FloatArray
) -> FloatArray:
    """Return the direct rays between pairs of points.

    Parameters
    ----------
    z1, z2 : ndarray, shape (n,)
        Depths of their ends, m, down positive.
    x : ndarray, shape (n,)
        Horizontal distance, m.
    depth, speed : ndarray, shape (k,)
        Profile of the speed of sound, linear in between; beyond its ends theirs holds.

    Returns
    -------
    ndarray, shape (n, 5)
        Travel time (s), ray parameter (s/m), ``w`` at both ends, and ``dX/dp``; nan where no ray arrives
        without turning. A ray between equal depths exists only where the speed is the same there on both
        sides.
    """
    out = np.empty((len(x), 5))
    for i in range(len(x)):
        t, p, w1, w2, spread = trace_ray(z1[i], z2[i], x[i], depth, speed)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = t, p, w1, w2, spread
    return out
