"""Thresholds and tail probabilities: chi-square, and the maximum of many correlated normals."""

from __future__ import annotations

from functools import lru_cache
from math import erfc, sqrt

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy import special

FloatArray = npt.NDArray[np.float64]


@lru_cache(maxsize=4096)
def chi2_threshold(p_fa: float, dof: int) -> float:
    """Return the value that a chi-square with `dof` degrees of freedom exceeds with probability `p_fa`."""
    return float(2.0 * special.gammainccinv(0.5 * dof, p_fa))


def chi2_tail(value: npt.ArrayLike, dof: npt.ArrayLike) -> FloatArray:
    """Return the probability that a chi-square exceeds `value`."""
    return np.asarray(special.gammaincc(0.5 * np.asarray(dof), 0.5 * np.asarray(value)))


def noncentral_tail(value: float, dof: int, noncentrality: npt.ArrayLike) -> FloatArray:
    """Return the probability that a non-central chi-square exceeds `value` (the power of a quadratic
    test).
    """
    from scipy.stats import ncx2

    lam = np.asarray(noncentrality, dtype=np.float64)
    central = chi2_tail(value, dof)
    return np.where(lam > 0.0, ncx2.sf(value, dof, np.maximum(lam, 1e-12)), central)


def noncentrality_for(power: float, value: float, dof: int) -> float:
    """Return the non-centrality at which a chi-square test with threshold `value` has the given `power`."""
    from scipy.optimize import brentq

    def short(lam: float) -> float:
        return float(noncentral_tail(value, dof, lam)) - power

    high = 4.0 * (value + dof + 10.0)
    while short(high) < 0.0:
        high *= 2.0
    return float(brentq(short, 0.0, high, xtol=1e-9))


def two_sided_tail(h: npt.ArrayLike) -> FloatArray:
    """Return ``P(|u| > h)`` of a unit normal."""
    return np.asarray(special.erfc(np.asarray(h, dtype=np.float64) / np.sqrt(2.0)))


def joint_exceedance(rho: npt.ArrayLike, h: float, nodes: int = 96) -> FloatArray:
    """Return ``P(|b| > h given |a| > h)`` for unit normals of correlation `rho`.

    The conditional tail is integrated over ``a = h + s / h`` by Gauss-Laguerre quadrature, exact enough (1e-6
    relative) for ``h`` from 2 to 12.
    """
    s, w = _laguerre(nodes)
    a = h + s / h
    weight = w * np.exp(-0.5 * (s / h) ** 2)
    weight = weight / weight.sum()
    r = np.minimum(np.abs(np.asarray(rho, dtype=np.float64))[..., None], 1.0 - 1e-12)
    scale = np.sqrt(1.0 - r * r)
    tail = special.ndtr((r * a - h) / scale) + special.ndtr((-r * a - h) / scale)
    return np.asarray((tail * weight).sum(axis=-1))


@lru_cache(maxsize=4)
def _laguerre(nodes: int) -> tuple[FloatArray, FloatArray]:
    s, w = np.polynomial.laguerre.laggauss(nodes)
    return s, w


RHO_GRID = 1.0 - np.linspace(1.0, 0.0, 257) ** 2
H_GRID = np.linspace(2.0, 10.0, 65)


@lru_cache(maxsize=1)
def exceedance_table() -> FloatArray:
    """Return `joint_exceedance` on ``H_GRID x RHO_GRID``, the second axis quadratic in ``1 - rho``."""
    return np.stack([joint_exceedance(RHO_GRID, float(h)) for h in H_GRID])


def effective_tests(rho_parent: FloatArray, h: float) -> float:
    """Return how many independent tests a tree of correlated two-sided tests is worth, at threshold `h`.

    Hunter's bound: for any spanning forest, ``P(union) <= sum P(A_i) - sum P(A_i and A_parent(i))``. Dividing
    by ``P(A)`` leaves ``N - sum kappa(rho_i)``, an upper bound of the ratio.

    Parameters
    ----------
    rho_parent : ndarray, shape (N,)
        Correlation of each test with its parent in the forest, 0 for a root.
    h : float
        Threshold on the absolute value.

    References
    ----------
    Hunter, D. (1976), An upper bound for the probability of a union, J. Appl. Prob. 13, 597-603.
    """
    position = (h - H_GRID[0]) / (H_GRID[1] - H_GRID[0])
    position = min(max(position, 0.0), len(H_GRID) - 1.000001)
    return float(_unlinked(exceedance_table(), rho_parent, position, erfc(h / sqrt(2.0))))


@njit(cache=True, nogil=True)
def _unlinked(table: FloatArray, rho: FloatArray, position: float, independent: float) -> float:
    """Return ``1 + sum (1 - kappa)`` over all tests but one root; `position` is where the threshold stands in
    the table.
    """
    row, cells = int(position), table.shape[1] - 1
    part, total = position - row, independent
    for r in rho:
        if r == 0.0:
            total += 1.0 - independent
            continue
        at = (1.0 - np.sqrt(max(1.0 - abs(r), 0.0))) * cells
        i = min(int(at), cells - 1)
        low = table[row, i] + (at - i) * (table[row, i + 1] - table[row, i])
        high = table[row + 1, i] + (at - i) * (table[row + 1, i + 1] - table[row + 1, i])
        total += 1.0 - low - part * (high - low)
    return total


def max_threshold(rho_parent: FloatArray, p_fa: float) -> float:
    """Return the threshold on ``max |u_i|`` whose false-alarm probability is at most `p_fa` (see
    `effective_tests`).
    """
    if len(rho_parent) == 0:
        return float("inf")
    h = float(np.sqrt(2.0) * special.erfcinv(p_fa / len(rho_parent)))
    for _ in range(4):
        h = float(np.sqrt(2.0) * special.erfcinv(min(p_fa / effective_tests(rho_parent, h), 0.9)))
    return h


def joint_square(residual: FloatArray, cov: FloatArray) -> float:
    """Return ``r^T cov^-1 r``; combinations that have no variance of their own, to rounding, are left out.

    Parameters
    ----------
    residual, cov : ndarray, shapes (k,) and (k, k)
    """
    scale = np.sqrt(np.maximum(np.diagonal(cov), 1e-300))
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    kept = values > 1e-10 * values[-1]
    y = vectors[:, kept].T @ (residual / scale) / np.sqrt(values[kept])
    return float(y @ y)


def deviation_of(square: float, dof: int) -> float:
    """Return the deviation of a unit normal that is as improbable as a chi-square of that value."""
    tail = float(special.gammaincc(0.5 * dof, 0.5 * square))
    return float(-special.ndtri(0.5 * tail)) if tail > 0.0 else float(np.sqrt(square))
