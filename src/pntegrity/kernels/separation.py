"""A bank of subfilters beside a Kalman filter: each does without some rows, since ever, on the same F, Q, H,
R.

Member `i` is held as ``delta_i = x_i - x_0``, its difference from the filter, and its covariance ``P_i``. Its
innovation is ``nu - H delta'_i``, so nothing but updates is needed. Rows are used a few at a time where `R`
is diagonal. Member 0 uses all rows and is the filter again, with the same rounding as the others, so that
``x_i - x_0`` and ``P_i - P_0`` are exact even where they are small.

A state that no row of a member has ever touched is idle in it: independent of all others, with the variance
that it was born with. It is carried along, since to take it out and put it back costs more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.sparse import Sparse, folded, left, nonzeros

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]

BLOCK = 8
"""Rows that are used together."""

__all__ = ["Subfilters", "advance", "gains", "predicted", "replicate"]


@dataclass(frozen=True, eq=False)
class Subfilters:
    """The members after an epoch; shapes: M members, n states.

    Parameters
    ----------
    delta : ndarray, shape (M, n)
        Mean of each member minus that of member 0.
    P : ndarray, shape (M, n, n)
        Covariances.
    """

    delta: FloatArray
    P: FloatArray

    def take(self, source: IntArray, origin: int = 0) -> Subfilters:
        """Return members in another order or several times, their means relative to that of `origin`."""
        return Subfilters(self.delta[source] - self.delta[origin], self.P[source])


def replicate(P: FloatArray) -> Subfilters:
    """Return a bank of one member that knows what the filter knows."""
    return Subfilters(np.zeros((1, len(P))), P[None].copy())


def advance(
    bank: Subfilters, F: FloatArray, Q: FloatArray, H: FloatArray, R: FloatArray, nu: FloatArray,
    used: BoolArray, source: IntArray | None = None, origin: int = 0,
) -> Subfilters:  # fmt: skip
    """Return the bank after one epoch of the filter.

    Parameters
    ----------
    bank : Subfilters
        Before it, in the states of the posterior before.
    F, Q : ndarray, shapes (n, n_before) and (n, n)
    H, R : ndarray, shapes (m, n) and (m, m)
        Of all rows; `R` may be full.
    nu : ndarray, shape (m,)
        Innovation of the filter.
    used : ndarray of bool, shape (M, m)
        Which rows each member uses.
    source : ndarray of int, shape (M,), optional
        Where each member stood in `bank`, and which member the filter goes on from; see `Subfilters.take`.
    origin : int
    """
    source = np.arange(len(used)) if source is None else source
    if np.count_nonzero(R) > np.count_nonzero(np.diagonal(R)):
        return _advance_dense(bank.take(source, origin), F, Q, H, R, nu, used)
    delta = bank.delta[source] - bank.delta[origin]
    parts, noise, rows = nonzeros(F), nonzeros(Q), nonzeros(H)
    mean, P = _advance(delta, bank.P, source, parts, noise, rows, np.diagonal(R).copy(), nu, used)
    return Subfilters(mean - mean[0], P)


@njit(cache=True, nogil=True)
def _advance(
    delta: FloatArray, P: FloatArray, place: IntArray, F: Sparse, Q: Sparse, H: Sparse, r: FloatArray,
    nu: FloatArray, used: BoolArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    count, n = len(used), len(F[0]) - 1
    delta_new, P_new = np.empty((count, n)), np.empty((count, n, n))
    source, scale = _sources(F, n)
    for i in range(count):
        before, U = P[place[i]], P_new[i]
        if len(source):
            _moved(before, source, scale, U)
        else:
            U[:] = folded(F, left(F, before))
        for a in range(n):
            for s in range(Q[0][a], Q[0][a + 1]):
                U[a, Q[1][s]] += Q[2][s]
        mean = left(F, delta[i].copy().reshape(-1, 1))[:, 0]
        _use_rows(U, mean, H, r, nu, used[i])
        _mirror(U)
        delta_new[i] = mean
    return delta_new, P_new


@njit(cache=True, nogil=True)
def _sources(F: Sparse, n: int) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return where each state comes from and how scaled (0: from nowhere); nothing where one has several
    sources.
    """
    source, scale = np.arange(n), np.zeros(n)
    for a in range(n):
        if F[0][a + 1] - F[0][a] > 1:
            return source[:0], scale[:0]
        if F[0][a + 1] > F[0][a]:
            source[a], scale[a] = F[1][F[0][a]], F[2][F[0][a]]
        else:
            source[a] = -1
    return source, scale


@njit(cache=True, nogil=True)
def _moved(P: FloatArray, source: npt.NDArray[np.int64], scale: FloatArray, out: FloatArray) -> None:
    """Write ``F P F^T`` where every state comes from at most one."""
    n = len(source)
    same = len(P) == n
    for a in range(n):
        same &= source[a] == a or source[a] < 0
    for a in range(n):
        row = out[a]
        if source[a] < 0:
            row[:] = 0.0
        elif same:
            row[:] = scale[a] * P[a] * scale
        else:
            before = P[source[a]]
            for b in range(n):
                row[b] = scale[a] * scale[b] * before[source[b]] if source[b] >= 0 else 0.0


@njit(cache=True, nogil=True)
def _mirror(U: FloatArray) -> None:
    for a in range(len(U)):
        for b in range(a):
            U[a, b] = U[b, a]


@njit(cache=True, nogil=True)
def _use_rows(
    U: FloatArray, x: FloatArray, H: Sparse, r: FloatArray, nu: FloatArray, used: BoolArray
) -> None:
    """Use rows, a few at a time; `U` (upper triangle) and `x` are changed in place."""
    n = len(x)
    rows = np.flatnonzero(used)
    G, residual = np.empty((BLOCK, n)), np.empty(BLOCK)
    C, known = np.empty((n, n)), np.full(n, -1, dtype=np.int64)
    for first in range(0, len(rows), BLOCK):
        few = rows[first : first + BLOCK]
        _project(U, x, H, nu, few, C, known, first, G, residual)
        _whiten_block(H, r, few, G, residual)
        G[len(few) :] = 0.0
        for j in range(len(few)):
            _add(x, residual[j], G[j])
        _take_off(U, G)


@njit(cache=True, nogil=True)
def _project(
    U: FloatArray, x: FloatArray, H: Sparse, nu: FloatArray, few: IntArray, C: FloatArray,
    known: npt.NDArray[np.int64], mark: int, G: FloatArray, residual: FloatArray,
) -> None:  # fmt: skip
    """Write ``H P`` and the innovations of a few rows; of `U` the upper triangle counts.

    A column that several rows need is put together once: in `C`, where `known` has the `mark` of these rows.
    """
    for j in range(len(few)):
        k, g = few[j], G[j]
        g[:] = 0.0
        residual[j] = nu[k]
        for s in range(H[0][k], H[0][k + 1]):
            c, h = H[1][s], H[2][s]
            residual[j] -= h * x[c]
            if known[c] != mark:
                known[c] = mark
                for a in range(c):
                    C[c, a] = U[a, c]
                C[c, c:] = U[c, c:]
            _add(g, h, C[c])


@njit(cache=True, nogil=True)
def _add(out: FloatArray, scale: float, a: FloatArray) -> None:
    """Add ``scale a`` to `out`, in place."""
    for i in range(len(out)):
        out[i] += scale * a[i]


@njit(cache=True, nogil=True)
def _whiten_block(H: Sparse, r: FloatArray, few: IntArray, G: FloatArray, residual: FloatArray) -> None:
    """Turn ``H P`` and the innovations of a few rows into those of their whitened sums, in place."""
    count = len(few)
    L = np.zeros((count, count))
    for j in range(count):
        k = few[j]
        for i in range(j, count):
            for s in range(H[0][k], H[0][k + 1]):
                L[i, j] += H[2][s] * G[i, H[1][s]]
        L[j, j] += r[k]
    for j in range(count):  # the root of S, and at once its use: few rows, so without calls
        for i in range(j):
            pivot = L[j, i]
            for k in range(j, count):
                L[k, j] -= pivot * L[k, i]
            _add(G[j], -pivot, G[i])
            residual[j] -= pivot * residual[i]
        scale = 1.0 / np.sqrt(L[j, j])
        for k in range(j, count):
            L[k, j] *= scale
        G[j] *= scale
        residual[j] *= scale


@njit(cache=True, nogil=True, fastmath=True)
def _take_off(U: FloatArray, G: FloatArray) -> None:
    """Subtract ``G^T G`` from the upper triangle of `U`, two rows at a time.

    Slices from the diagonal on let it be vectorised; one element below the diagonal is touched, too.
    """
    n = len(U)
    for a in range(0, n - 1, 2):
        row, next_row = U[a, a:], U[a + 1, a:]
        g0, g1, g2, g3 = G[0, a:], G[1, a:], G[2, a:], G[3, a:]
        g4, g5, g6, g7 = G[4, a:], G[5, a:], G[6, a:], G[7, a:]
        p0, p1, p2, p3, p4, p5, p6, p7 = g0[0], g1[0], g2[0], g3[0], g4[0], g5[0], g6[0], g7[0]
        q0, q1, q2, q3, q4, q5, q6, q7 = g0[1], g1[1], g2[1], g3[1], g4[1], g5[1], g6[1], g7[1]
        for b in range(len(row)):
            x0, x1, x2, x3, x4, x5, x6, x7 = g0[b], g1[b], g2[b], g3[b], g4[b], g5[b], g6[b], g7[b]
            row[b] -= p0 * x0 + p1 * x1 + p2 * x2 + p3 * x3 + p4 * x4 + p5 * x5 + p6 * x6 + p7 * x7
            next_row[b] -= q0 * x0 + q1 * x1 + q2 * x2 + q3 * x3 + q4 * x4 + q5 * x5 + q6 * x6 + q7 * x7
    if n % 2:
        for j in range(BLOCK):
            U[n - 1, n - 1] -= G[j, n - 1] ** 2


def predicted(P: FloatArray, F: FloatArray, Q: FloatArray) -> FloatArray:
    """Return ``F P F^T + Q`` of each member, shape (M, n, n)."""
    return np.asarray(F @ P @ F.T + Q)


def gains(prior: FloatArray, H: FloatArray, R: FloatArray, used: BoolArray) -> FloatArray:
    """Return the gain of each member, zero in the columns of rows that it does not use.

    Parameters
    ----------
    prior : ndarray, shape (M, n, n)
        Predicted covariances.
    H, R : ndarray, shapes (m, n) and (m, m)
    used : ndarray of bool, shape (M, m)

    Returns
    -------
    ndarray, shape (M, n, m)
    """
    mask = used[:, :, None]
    Hu = np.where(mask, H, 0.0)
    spread = Hu @ prior @ np.swapaxes(Hu, 1, 2)
    both = mask & used[:, None, :]
    spread += np.where(both, R, 0.0) + np.eye(len(H)) * ~mask
    return np.asarray(np.swapaxes(np.linalg.solve(spread, Hu @ prior), 1, 2))


def _advance_dense(
    bank: Subfilters, F: FloatArray, Q: FloatArray, H: FloatArray, R: FloatArray, nu: FloatArray,
    used: BoolArray,
) -> Subfilters:  # fmt: skip
    """Return the bank after an epoch whose rows have correlated errors."""
    prior = predicted(bank.P, F, Q)
    K = gains(prior, H, R, used)
    A = np.eye(len(Q)) - K @ H
    P = A @ prior @ np.swapaxes(A, 1, 2) + K @ R @ np.swapaxes(K, 1, 2)
    mean = bank.delta @ F.T
    mean = mean + np.einsum("inm,im->in", K, nu - mean @ H.T)
    return Subfilters(mean - mean[0], 0.5 * (P + np.swapaxes(P, 1, 2)))
