"""Rows of an epoch tested one by one against all the others and the prior: who does not belong."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.linear import inverse_definite

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

__all__ = ["leave_out"]


def leave_out(nu: FloatArray, S: FloatArray, limit: float, least: int = 0) -> tuple[IntArray, float, float]:
    """Leave out the row that is furthest off, again and again, and take back what belongs after all.

    A row's deviation is that of its innovation from what prior and all other kept rows say of it, in its
    standard deviations. Each pass leaves out the worst above `limit`. Then a row that was left out and
    that those kept do not contradict returns, the best first.

    Parameters
    ----------
    nu, S : ndarray, shapes (m,) and (m, m)
        Innovations and their covariance.
    limit : float
        Standard deviations.
    least : int
        So many rows are kept in any case.

    Returns
    -------
    passes : ndarray of int, shape (m,)
        The pass that left a row out, from 1; 0 for those kept.
    first, last : float
        Largest deviation with all rows, and among those kept.

    References
    ----------
    Baarda (1968), A testing procedure for use in geodetic networks: the w-test.
    """
    if not len(nu):
        return np.zeros(0, dtype=np.int64), 0.0, 0.0
    passes, first, last = _leave_out(
        np.ascontiguousarray(nu), np.ascontiguousarray(S), inverse_definite(S), limit, least
    )
    return passes, float(first), float(last)


@njit(cache=True)
def _leave_out(nu, S, V, limit, least):  # type: ignore[no-untyped-def]
    m = len(nu)
    passes = np.zeros(m, np.int64)
    V = V.copy()
    u = V @ nu
    first, last, n = -1.0, 0.0, 0
    returns = 0
    while True:
        worst, last = -1, 0.0
        for j in range(m):
            if passes[j] == 0:
                deviation = abs(u[j]) / np.sqrt(V[j, j])
                if deviation > last:
                    worst, last = j, deviation
        if first < 0.0:
            first = last
        if last > limit and np.sum(passes == 0) > least:
            n += 1
            passes[worst] = n
            _remove(V, u, worst)
            continue
        best = _belonging(nu, S, V, passes, limit)
        if best < 0 or returns >= m:
            return passes, first, last
        returns += 1
        passes[best] = 0
        V, u = _again(nu, S, passes)


@njit(cache=True)
def _remove(V, u, j):  # type: ignore[no-untyped-def]
    """Take row `j` out of the inverse and of what it makes of the innovations."""
    column, pivot, mine = V[:, j].copy(), V[j, j], u[j]
    for a in range(len(u)):
        u[a] -= column[a] * mine / pivot
        for b in range(len(u)):
            V[a, b] -= column[a] * column[b] / pivot
    V[j, :], V[:, j], u[j] = 0.0, 0.0, 0.0


@njit(cache=True)
def _belonging(nu, S, V, passes, limit):  # type: ignore[no-untyped-def]
    """Return the row left out that those kept contradict least, where that is below the limit; else -1."""
    best, least = -1, limit
    for j in range(len(nu)):
        if passes[j] > 0:
            w = V @ S[j]
            deviation = abs(nu[j] - w @ nu) / np.sqrt(max(S[j, j] - w @ S[j], 1e-300))
            if deviation < least:
                best, least = j, deviation
    return best


@njit(cache=True)
def _again(nu, S, passes):  # type: ignore[no-untyped-def]
    """Return the inverse of the rows kept, zero elsewhere, and what it makes of the innovations."""
    kept = np.flatnonzero(passes == 0)
    part = np.empty((len(kept), len(kept)))
    for a in range(len(kept)):
        for b in range(len(kept)):
            part[a, b] = S[kept[a], kept[b]]
    inverse = np.linalg.inv(part)
    V = np.zeros_like(S)
    for a in range(len(kept)):
        for b in range(len(kept)):
            V[kept[a], kept[b]] = inverse[a, b]
    return V, V @ nu
