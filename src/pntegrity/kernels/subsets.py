"""Which smallest set of groups, left out, makes an epoch's innovations consistent?

Leaving the rows `J` out of an update lowers ``nu^T S^-1 nu`` by ``z_J^T (V_JJ)^-1 z_J`` with ``z = S^-1 nu``
and ``V = S^-1``, exactly; so every subset is judged without a new filter step.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.linear import backsolve, whiten
from pntegrity.kernels.tails import chi2_threshold

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class SubsetResult:
    """The outcome of a search.

    Parameters
    ----------
    removed : tuple of int
        Indices of the groups to leave out; empty where nothing needs to be or nothing helps.
    passed : bool
        Whether the rest is consistent.
    alternatives : tuple of tuple of int
        Other sets of the same size that explain the data nearly as well: the choice is ambiguous where there
        are any.
    explained : float
        What leaving `removed` out takes from the statistic.
    """

    removed: tuple[int, ...]
    passed: bool
    alternatives: tuple[tuple[int, ...], ...]
    explained: float


def search(
    nu: FloatArray,
    L: FloatArray,
    rows: list[IntArray],
    consumed: int,
    p_fa: float,
    *,
    largest: int = 3,
    most: int = 20_000,
    margin: float = 9.0,
) -> SubsetResult:
    """Find the smallest consistent-making set of at most `largest` groups.

    Parameters
    ----------
    nu : ndarray, shape (m,)
        Innovations, of covariance ``L L^T``.
    L : ndarray, shape (m, m)
    rows : list of index arrays
        The rows of each group.
    consumed : int
        States initialised from these rows.
    p_fa : float
        Probability at which a consistent rest is refused.
    largest : int
        Largest set searched exhaustively; beyond it the best one is returned with ``passed=False``.
    most : int
        Sets of a size are not searched where there are more than this.
    margin : float
        Sets whose explained statistic is less than this below the best are alternatives (log-likelihood ratio
        x 2).
    """
    inverse_root = whiten(L, np.eye(len(nu)))
    V = inverse_root.T @ inverse_root
    z = backsolve(L, whiten(L, nu))
    total = float(nu @ z)
    if _consistent(total, len(nu) - consumed, p_fa):
        return SubsetResult((), True, (), 0.0)
    table = _padded(rows)
    best = SubsetResult((), False, (), 0.0)
    for size in range(1, min(largest, len(rows) - 1) + 1):
        if comb(len(rows), size) > most:
            break
        sets = np.array(list(combinations(range(len(rows)), size)), dtype=np.int64)
        explained = explained_by(z, V, table, sets)
        count = np.array([len(r) for r in rows])[sets].sum(axis=1)
        dof = len(nu) - count - consumed
        explained = np.where(dof > 0, explained, 0.0)
        best = _pick(sets, explained, dof, total, p_fa, margin)
        if best.passed:
            return best
    return best


def _pick(
    sets: IntArray, explained: FloatArray, dof: IntArray, total: float, p_fa: float, margin: float
) -> SubsetResult:
    top = int(np.argmax(explained))
    if explained[top] <= 0.0:
        return SubsetResult((), False, (), 0.0)
    passed = _consistent(total - float(explained[top]), int(dof[top]), p_fa)
    near = [i for i in np.flatnonzero(explained > explained[top] - margin) if i != top]
    alternatives = tuple(tuple(int(g) for g in sets[i]) for i in near[:8])
    return SubsetResult(tuple(int(g) for g in sets[top]), passed, alternatives, float(explained[top]))


def _consistent(statistic: float, dof: int, p_fa: float) -> bool:
    return dof > 0 and statistic <= chi2_threshold(p_fa, dof)


def _padded(rows: list[IntArray]) -> IntArray:
    out = np.full((len(rows), max(len(r) for r in rows)), -1, dtype=np.int64)
    for i, r in enumerate(rows):
        out[i, : len(r)] = r
    return out


@njit(cache=True, nogil=True)
def explained_by(z: FloatArray, V: FloatArray, table: IntArray, sets: IntArray) -> FloatArray:
    """Return ``z_J^T (V_JJ)^-1 z_J`` for every set of groups, shape (sets,)."""
    out = np.zeros(sets.shape[0])
    width = table.shape[1] * sets.shape[1]
    index = np.empty(width, dtype=np.int64)
    A = np.empty((width, width))
    b = np.empty(width)
    for s in range(sets.shape[0]):
        n = 0
        for g in sets[s]:
            for r in table[g]:
                if r >= 0:
                    index[n] = r
                    n += 1
        total = 0.0
        for i in range(n):
            for j in range(i + 1):
                value = V[index[i], index[j]]
                for k in range(j):
                    value -= A[i, k] * A[j, k]
                if i == j:  # a row that nothing else checks explains nothing
                    A[i, i] = np.sqrt(value) if value > 1e-9 * V[index[i], index[i]] else 1e300
                else:
                    A[i, j] = value / A[j, j]
            value = z[index[i]]
            for k in range(i):
                value -= A[i, k] * b[k]
            b[i] = value / A[i, i]
            total += b[i] * b[i]
        out[s] = total
    return out
