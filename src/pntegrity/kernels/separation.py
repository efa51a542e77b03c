"""A bank of subfilters beside a Kalman filter: each does without some rows, since ever, on the same F, Q, H, R.

Member `i` is held as ``delta_i = x_i - x_0``, its difference from the filter, and its covariance ``P_i``. Its
innovation is ``nu - H delta'_i``, so nothing but updates is needed. Rows are used a few at a time
where `R` is diagonal. Member 0 uses all rows: its covariance is that of the filter, with the same rounding as
the others', so that ``P_i - P_0`` is exact even where it is small.

A state that no row of a member has ever touched is dormant in it: independent of all others, with the
variance that it was born with. It costs nothing until a row touches it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.sparse import Sparse, folded, left, nonzeros

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

BLOCK = 8
"""Rows that are used together."""

__all__ = ["Subfilters", "advance", "coupled_states", "gains", "predicted", "replicate"]


@dataclass(frozen=True, eq=False)
class Subfilters:
    """The members after an epoch; shapes: M members, n states.

    Parameters
    ----------
    delta : ndarray, shape (M, n)
        Mean of each member minus that of the filter; that of member 0 is rounding.
    P : ndarray, shape (M, n, n)
        Covariances.
    active : ndarray of bool, shape (M, n)
        States that a row of the member has touched.
    """

    delta: FloatArray
    P: FloatArray
    active: BoolArray

    def take(self, source: npt.NDArray[np.intp], origin: int = 0) -> Subfilters:
        """Return members in another order or several times, their means relative to that of `origin`."""
        return Subfilters(self.delta[source] - self.delta[origin], self.P[source], self.active[source])


def replicate(P: FloatArray, active: bool = True) -> Subfilters:
    """Return a bank of one member that knows what the filter knows; not `active`: no row was used yet."""
    n = len(P)
    return Subfilters(np.zeros((1, n)), P[None].copy(), np.full((1, n), active))


def coupled_states(F: FloatArray, Q: FloatArray) -> BoolArray:
    """Return the states that a step correlates with others, shape (n,)."""
    several = np.count_nonzero(F, axis=1) > 1
    if several.any():  # what feeds them goes on under its own name: a state of one source
        fed = np.flatnonzero(F[several].any(axis=0))
        several = several | F[:, fed].any(axis=1)
    noise = Q != 0.0
    np.fill_diagonal(noise, False)
    return np.asarray(several | noise.any(axis=1))


def advance(
    bank: Subfilters, F: FloatArray, Q: FloatArray, H: FloatArray, R: FloatArray, nu: FloatArray,
    used: BoolArray,
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
    """
    coupled = coupled_states(F, Q)
    if np.count_nonzero(R) > np.count_nonzero(np.diagonal(R)):
        return _advance_dense(bank, F, Q, H, R, nu, used)
    rows = nonzeros(H)
    found = _advance(
        bank.delta, bank.P, bank.active, nonzeros(F), Q, coupled, rows, np.diagonal(R).copy(), nu, used
    )
    return Subfilters(*found)


@njit(cache=True, nogil=True)
def _advance(
    delta: FloatArray, P: FloatArray, active: BoolArray, F: Sparse, Q: FloatArray, coupled: BoolArray,
    H: Sparse, r: FloatArray, nu: FloatArray, used: BoolArray,
) -> tuple[FloatArray, FloatArray, BoolArray]:  # fmt: skip
    count, n = len(used), len(Q)
    delta_new, P_new = np.empty((count, n)), np.zeros((count, n, n))
    active_new = np.zeros((count, n), dtype=np.bool_)
    source, scale = _sources(F, n)
    for i in range(count):
        mean = left(F, delta[i].copy().reshape(-1, 1))[:, 0]
        _wake(F, active[i], coupled, H, used[i], active_new[i])
        at = np.flatnonzero(active_new[i])
        if len(source):
            U = _moved(P[i], Q, source[at], scale[at], at)
        else:
            U = (folded(F, left(F, P[i])) + Q)[at][:, at]
        _use_rows(U, mean, at, H, r, nu, used[i])
        _spread(U, at, P_new[i])
        _rest(F, P[i], Q, active_new[i], P_new[i])
        delta_new[i] = mean
    return delta_new, P_new, active_new


@njit(cache=True, nogil=True)
def _sources(F: Sparse, n: int) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return where each state comes from (-1: nowhere) and how scaled; nothing where one has several
    sources.
    """
    source, scale = np.full(n, -1, dtype=np.int64), np.zeros(n)
    for a in range(n):
        if F[0][a + 1] - F[0][a] > 1:
            return source[:0], scale[:0]
        if F[0][a + 1] > F[0][a]:
            source[a], scale[a] = F[1][F[0][a]], F[2][F[0][a]]
    return source, scale


@njit(cache=True, nogil=True)
def _moved(
    P: FloatArray, Q: FloatArray, source: npt.NDArray[np.int64], scale: FloatArray, at: npt.NDArray[np.intp]
) -> FloatArray:
    """Return the upper triangle of the prediction of some states that come from at most one each."""
    n = len(at)
    U = np.empty((n, n))
    for a in range(n):
        noise, row = Q[at[a]], U[a]
        if source[a] < 0:
            for b in range(a, n):
                row[b] = noise[at[b]]
            continue
        before = P[source[a]]
        for b in range(a, n):
            row[b] = noise[at[b]] + (scale[a] * scale[b] * before[source[b]] if source[b] >= 0 else 0.0)
    return U


@njit(cache=True, nogil=True)
def _spread(U: FloatArray, at: npt.NDArray[np.intp], P: FloatArray) -> None:
    """Write an upper triangle of some states into a whole covariance."""
    for a in range(len(at)):
        for b in range(a, len(at)):
            P[at[a], at[b]] = U[a, b]
            P[at[b], at[a]] = U[a, b]


@njit(cache=True, nogil=True)
def _rest(F: Sparse, P: FloatArray, Q: FloatArray, active: BoolArray, out: FloatArray) -> None:
    """Write the variances of states that are dormant: they have at most one source."""
    for a in range(len(active)):
        if not active[a]:
            out[a, a] = Q[a, a]
            for s in range(F[0][a], F[0][a + 1]):
                out[a, a] += F[2][s] ** 2 * P[F[1][s], F[1][s]]


@njit(cache=True, nogil=True)
def _wake(
    F: Sparse, active: BoolArray, coupled: BoolArray, H: Sparse, used: BoolArray, out: BoolArray
) -> None:
    """Write which states are active after the step and with the epoch's rows."""
    for a in range(len(out)):
        out[a] = coupled[a]
        for s in range(F[0][a], F[0][a + 1]):
            out[a] |= active[F[1][s]]
    for k in range(len(used)):
        if used[k]:
            for s in range(H[0][k], H[0][k + 1]):
                out[H[1][s]] = True


@njit(cache=True, nogil=True)
def _use_rows(
    U: FloatArray, mean: FloatArray, at: npt.NDArray[np.intp], H: Sparse, r: FloatArray, nu: FloatArray,
    used: BoolArray,
) -> None:  # fmt: skip
    """Use rows, a few at a time, on the states `at`; `U` (upper triangle) and `mean` are changed in place."""
    n = len(at)
    place = np.full(len(mean), -1, dtype=np.int64)
    place[at] = np.arange(n)
    x, rows = mean[at], np.flatnonzero(used)
    G, residual = np.empty((BLOCK, n)), np.empty(BLOCK)
    for first in range(0, len(rows), BLOCK):
        few = rows[first : first + BLOCK]
        _project(U, x, place, H, nu, few, G, residual)
        _whiten_block(place, H, r, few, G, residual)
        G[len(few) :] = 0.0
        for j in range(len(few)):
            _add(x, residual[j], G[j])
        _take_off(U, G)
    mean[at] = x


@njit(cache=True, nogil=True)
def _project(
    U: FloatArray, x: FloatArray, place: npt.NDArray[np.int64], H: Sparse, nu: FloatArray,
    few: npt.NDArray[np.intp], G: FloatArray, residual: FloatArray,
) -> None:  # fmt: skip
    """Write ``H P`` and the innovations of a few rows; of `U` the upper triangle counts."""
    for j in range(len(few)):
        k, g = few[j], G[j]
        g[:] = 0.0
        residual[j] = nu[k]
        for s in range(H[0][k], H[0][k + 1]):
            c, h = place[H[1][s]], H[2][s]
            residual[j] -= h * x[c]
            for a in range(c):
                g[a] += h * U[a, c]
            _add(g[c:], h, U[c, c:])


@njit(cache=True, nogil=True)
def _add(out: FloatArray, scale: float, a: FloatArray) -> None:
    """Add ``scale a`` to `out`, in place."""
    for i in range(len(out)):
        out[i] += scale * a[i]


@njit(cache=True, nogil=True)
def _whiten_block(
    place: npt.NDArray[np.int64], H: Sparse, r: FloatArray, few: npt.NDArray[np.intp], G: FloatArray,
    residual: FloatArray,
) -> None:  # fmt: skip
    """Turn ``H P`` and the innovations of a few rows into those of their whitened sums, in place."""
    count = len(few)
    L = np.zeros((count, count))
    for j in range(count):
        k = few[j]
        for i in range(j, count):
            for s in range(H[0][k], H[0][k + 1]):
                L[i, j] += H[2][s] * G[i, place[H[1][s]]]
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
    """Subtract ``G^T G`` from the upper triangle of `U`; slices from the diagonal on let it be vectorised."""
    for a in range(len(U)):
        row, g0, g1, g2, g3 = U[a, a:], G[0, a:], G[1, a:], G[2, a:], G[3, a:]
        g4, g5, g6, g7 = G[4, a:], G[5, a:], G[6, a:], G[7, a:]
        p0, p1, p2, p3, p4, p5, p6, p7 = g0[0], g1[0], g2[0], g3[0], g4[0], g5[0], g6[0], g7[0]
        for b in range(len(row)):
            row[b] -= (
                p0 * g0[b] + p1 * g1[b] + p2 * g2[b] + p3 * g3[b]
                + p4 * g4[b] + p5 * g5[b] + p6 * g6[b] + p7 * g7[b]
            )  # fmt: skip


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
    return Subfilters(mean, 0.5 * (P + np.swapaxes(P, 1, 2)), np.ones(mean.shape, dtype=bool))
