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

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.sparse import Sparse, folded, left, nonzeros

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]

BLOCK = 4
"""Rows that are used together."""
WIDTH = 16
"""Matrices at work are this many columns wide, or a multiple: loops that are vectorised then have no rest."""

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
    bias : ndarray, shape (M, c, n)
        Error that each of c nominal biases of rows made.
    """

    delta: FloatArray
    P: FloatArray
    bias: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))

    def __post_init__(self) -> None:
        if not self.bias.size:
            object.__setattr__(self, "bias", np.zeros((len(self.delta), 0, self.delta.shape[1])))

    def take(self, source: IntArray, origin: int = 0) -> Subfilters:
        """Return members in another order or several times, their means relative to that of `origin`."""
        return Subfilters(self.delta[source] - self.delta[origin], self.P[source], self.bias[source])

    def with_biases(self, source: IntArray) -> Subfilters:
        """Return the members with other biases: where each stood, -1 for one that begins."""
        bias = np.concatenate([self.bias, np.zeros((len(self.bias), 1, self.bias.shape[2]))], axis=1)
        return Subfilters(self.delta, self.P, bias[:, source])


def replicate(P: FloatArray) -> Subfilters:
    """Return a bank of one member that knows what the filter knows."""
    return Subfilters(np.zeros((1, len(P))), P[None].copy())


def advance(
    bank: Subfilters, F: FloatArray, Q: FloatArray, H: FloatArray, R: FloatArray, nu: FloatArray,
    used: BoolArray, source: IntArray | None = None, origin: int = 0, biases: FloatArray | None = None,
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
    biases : ndarray, shape (c, m), optional
        What each nominal bias of the bank adds to the rows.
    """
    biases = np.zeros((0, len(nu))) if biases is None else biases
    source = np.arange(len(used)) if source is None else source
    if np.count_nonzero(R) > np.count_nonzero(np.diagonal(R)):
        return _advance_dense(bank.take(source, origin), F, Q, H, R, nu, used, biases)
    delta = bank.delta[source] - bank.delta[origin]
    means = np.concatenate([delta[:, None], bank.bias[source]], axis=1)
    parts, noise, rows, every = nonzeros(F), nonzeros(Q), nonzeros(H), np.concatenate([nu[None], biases])
    means, P = _advance(means, bank.P, source, parts, noise, rows, np.diagonal(R).copy(), every, used)
    return Subfilters(means[:, 0] - means[0, 0], P, means[:, 1:])


@njit(cache=True, nogil=True)
def _advance(
    means: FloatArray, P: FloatArray, place: IntArray, F: Sparse, Q: Sparse, H: Sparse, r: FloatArray,
    nu: FloatArray, used: BoolArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return means, shape (M, 1 + c, n), that of the difference and those of biases, and covariances."""
    count, n, columns = len(used), len(F[0]) - 1, len(nu)
    means_new, P_new = np.empty((count, columns, n)), np.empty((count, n, n))
    source, scale = _sources(F, n)
    width = -(-n // WIDTH) * WIDTH
    U, x, C = np.zeros((width, width)), np.zeros((columns, width)), np.zeros((n, width))
    for i in range(count):
        before = P[place[i]]
        if len(source):
            _moved(before, source, scale, U)
        else:
            U[:n, :n] = folded(F, left(F, before))
        for a in range(n):
            for s in range(Q[0][a], Q[0][a + 1]):
                U[a, Q[1][s]] += Q[2][s]
        x[:, :n] = left(F, means[i].T.copy()).T
        _use_rows(U, x, H, r, nu, used[i], C)
        _mirrored(U, P_new[i])
        means_new[i] = x[:, :n]
    return means_new, P_new


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
        k = source[a]
        if k < 0:
            for b in range(n):
                out[a, b] = 0.0
        elif same:
            for b in range(n):
                out[a, b] = scale[a] * scale[b] * P[a, b]
        else:
            for b in range(n):
                out[a, b] = scale[a] * scale[b] * P[k, source[b]] if source[b] >= 0 else 0.0


@njit(cache=True, nogil=True)
def _mirrored(U: FloatArray, out: FloatArray) -> None:
    """Write the symmetric matrix of which `U` has the upper triangle."""
    for a in range(len(out)):
        for b in range(a, len(out)):
            out[a, b] = U[a, b]
            out[b, a] = U[a, b]


@njit(cache=True, nogil=True)
def _use_rows(
    U: FloatArray, x: FloatArray, H: Sparse, r: FloatArray, nu: FloatArray, used: BoolArray, C: FloatArray
) -> None:
    """Use rows, a few at a time; `U` (upper triangle) and `x` are changed in place."""
    n, width = len(C), x.shape[1]
    rows = np.flatnonzero(used)
    G, residual, L = np.zeros((BLOCK, width)), np.empty((len(x), BLOCK)), np.empty((BLOCK, BLOCK))
    place, mark = np.zeros(n, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    for first in range(0, len(rows), BLOCK):
        few = rows[first : first + BLOCK]
        _project(U, x, H, nu, few, C, place, mark, G, residual)
        _root(H, r, few, G, L)
        _whiten(L, G, residual)
        for c in range(len(x)):
            for j in range(len(few)):
                scaled = residual[c, j]
                if scaled != 0.0:
                    for b in range(width):
                        x[c, b] += scaled * G[j, b]
        _take_off(U, G, -(-n // 4) * 4)


@njit(cache=True, nogil=True)
def _project(
    U: FloatArray, x: FloatArray, H: Sparse, nu: FloatArray, few: IntArray, C: FloatArray,
    place: npt.NDArray[np.int64], mark: npt.NDArray[np.int64], G: FloatArray, residual: FloatArray,
) -> None:  # fmt: skip
    """Write ``H P`` and the innovations of a few rows, those of each bias too, zeros where there are fewer
    than `G` has; of `U` the upper triangle counts.

    A column that several rows need is put together once: in the row `place` of `C`, where `mark` has the
    first of these rows.
    """
    n, count = len(C), 0
    G[len(few) :] = 0.0
    residual[:, :] = 0.0
    for j in range(len(few)):
        k = few[j]
        start, size = H[0][k], H[0][k + 1] - H[0][k]
        for i in range(len(x)):
            v = nu[i, k]
            for s in range(start, start + size):
                v -= H[2][s] * x[i, H[1][s]]
            residual[i, j] = v
        for s in range(start, start + size):
            c = H[1][s]
            if mark[c] != few[0]:
                mark[c], place[c] = few[0], count
                for a in range(c):
                    C[count, a] = U[a, c]
                for a in range(c, n):
                    C[count, a] = U[c, a]
                count += 1
        _combine(H, start, size, C, place, G[j])


@njit(cache=True, nogil=True)
def _combine(
    H: Sparse, start: int, size: int, C: FloatArray, place: npt.NDArray[np.int64], out: FloatArray
) -> None:
    """Write a row of ``H P``: the sum of a few columns, four at a time."""
    n = len(out)
    out[:] = 0.0
    for s in range(start, start + size - 3, 4):
        h0, h1, h2, h3 = H[2][s], H[2][s + 1], H[2][s + 2], H[2][s + 3]
        p0, p1, p2, p3 = place[H[1][s]], place[H[1][s + 1]], place[H[1][s + 2]], place[H[1][s + 3]]
        for b in range(n):
            out[b] += h0 * C[p0, b] + h1 * C[p1, b] + h2 * C[p2, b] + h3 * C[p3, b]
    for s in range(start + size - size % 4, start + size):
        h, p = H[2][s], place[H[1][s]]
        for b in range(n):
            out[b] += h * C[p, b]


@njit(cache=True, nogil=True)
def _root(H: Sparse, r: FloatArray, few: IntArray, G: FloatArray, L: FloatArray) -> None:
    """Write the root of the innovation covariance of a few rows, with the inverse of its diagonal on its
    own; a unit where there are fewer.
    """
    count = len(few)
    for i in range(len(L)):
        for j in range(i + 1):
            L[i, j] = 0.0
        L[i, i] = 1.0
    for j in range(count):
        k = few[j]
        for i in range(j, count):
            v = 0.0
            for s in range(H[0][k], H[0][k + 1]):
                v += H[2][s] * G[i, H[1][s]]
            L[i, j] = v
        L[j, j] += r[k]
    for j in range(count):
        for i in range(j):
            pivot = L[j, i]
            for k in range(j, count):
                L[k, j] -= pivot * L[k, i]
        scale = 1.0 / np.sqrt(L[j, j])
        for k in range(j + 1, count):
            L[k, j] *= scale
        L[j, j] = scale


@njit(cache=True, nogil=True)
def _whiten(L: FloatArray, G: FloatArray, residual: FloatArray) -> None:
    """Turn ``H P`` and innovations into those of the whitened rows, in place."""
    for j in range(len(L)):
        for i in range(j):
            pivot = L[j, i]
            for b in range(G.shape[1]):
                G[j, b] -= pivot * G[i, b]
            for c in range(len(residual)):
                residual[c, j] -= pivot * residual[c, i]
        scale = L[j, j]
        for b in range(G.shape[1]):
            G[j, b] *= scale
        for c in range(len(residual)):
            residual[c, j] *= scale


@njit(cache=True, nogil=True, fastmath=True)
def _take_off(U: FloatArray, G: FloatArray, n: int) -> None:
    """Subtract ``G^T G``, of four rows `G`, from the upper triangle of the first `n` rows and columns of `U`,
    four rows at a time.

    Slices from the diagonal on let it be vectorised; some elements below the diagonal are touched, too.
    """
    for a in range(0, n, 4):
        u0, u1, u2, u3 = U[a, a:n], U[a + 1, a:n], U[a + 2, a:n], U[a + 3, a:n]
        g0, g1, g2, g3 = G[0, a:n], G[1, a:n], G[2, a:n], G[3, a:n]
        p0, p1, p2, p3 = g0[0], g1[0], g2[0], g3[0]
        q0, q1, q2, q3 = g0[1], g1[1], g2[1], g3[1]
        r0, r1, r2, r3 = g0[2], g1[2], g2[2], g3[2]
        s0, s1, s2, s3 = g0[3], g1[3], g2[3], g3[3]
        for b in range(len(u0)):
            x0, x1, x2, x3 = g0[b], g1[b], g2[b], g3[b]
            u0[b] -= p0 * x0 + p1 * x1 + p2 * x2 + p3 * x3
            u1[b] -= q0 * x0 + q1 * x1 + q2 * x2 + q3 * x3
            u2[b] -= r0 * x0 + r1 * x1 + r2 * x2 + r3 * x3
            u3[b] -= s0 * x0 + s1 * x1 + s2 * x2 + s3 * x3


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
    used: BoolArray, biases: FloatArray,
) -> Subfilters:  # fmt: skip
    """Return the bank after an epoch whose rows have correlated errors."""
    prior = predicted(bank.P, F, Q)
    K = gains(prior, H, R, used)
    A = np.eye(len(Q)) - K @ H
    P = A @ prior @ np.swapaxes(A, 1, 2) + K @ R @ np.swapaxes(K, 1, 2)
    mean = np.concatenate([bank.delta[:, None], bank.bias], axis=1) @ F.T
    every = np.concatenate([nu[None], biases])
    mean = mean + (every - mean @ H.T) @ np.swapaxes(K, 1, 2)
    P = 0.5 * (P + np.swapaxes(P, 1, 2))
    return Subfilters(mean[:, 0] - mean[0, 0], P, mean[:, 1:])
