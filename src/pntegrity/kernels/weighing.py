"""The compiled steps of `extrapolation`: all that one window does with one update.

Letters as there: `C` ``cov(s)``, `X` ``cov(s, eta)``, `B` the unknown directions, `W` the weight.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.sparse import FloatArray, IntArray, Sparse, folded, left

NO_MORE = 1e-9
"""A direction of which less than this part is left beside those before it is none of its own."""


#: What is carried of a window, in the order of `extrapolation.Passage`.
Carried = tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray
]
#: What all windows need of an update: `F`, `H`, ``H P'``, `S`, `nu`, what was absorbed, ``K nu``, and which
#: states were initialised.
Given = tuple[
    Sparse, Sparse, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray
]  # fmt: skip


@njit(cache=True, nogil=True)
def step_rows(carried: Carried, given: Given, at: IntArray, m: int) -> tuple[Carried, FloatArray]:
    """Take AIME's ``e = nu + H s`` into a window; return it and the weight.

    Parameters
    ----------
    carried, given
        The window and the update.
    at : ndarray of int
        Where the update's rows stand in `eta`.
    m : int
        Rows of `eta` after it.
    """
    _, H, HP, S, nu, absorbed, push, _ = given
    C, X, B, s = drifted(carried, given)
    HC = left(H, C)
    inverse = inverse_of_root(np.linalg.cholesky(S + folded(H, HC)))
    e = nu + left(H, s.reshape(-1, 1)).ravel()
    term = (inverse, HC + HP, left(H, X), left(H, B), e)
    return weighed(carried, (C + absorbed, X, B, s + push), term, at, m)


@njit(cache=True, nogil=True)
def step_states(
    carried: Carried, given: Given, block: IntArray, inverse: FloatArray
) -> tuple[Carried, FloatArray, bool]:
    """Take SRAIME's ``e = T d`` into a window; return it, the weight, and whether that went well.

    Where ``cov(e)`` may be singular and no `inverse` is given, the window is as it was and the covariance
    stands for the weight.

    Parameters
    ----------
    carried, given
        The window and the update.
    block : ndarray of int
        Where the window's states stand in the layout.
    inverse : ndarray, shape (d, d)
        Pseudo-inverse of ``cov(e)``; made here where it is empty.
    """
    _, _, _, _, _, absorbed, push, _ = given
    C, X, B, s = drifted(carried, given)
    moved, d = C + absorbed, s + push
    if len(inverse) != len(block):
        inverse = _regular_inverse(moved[block][:, block])
        if len(inverse) != len(block):
            return carried, moved[block][:, block].copy(), False
    term = (inverse, moved[block], X[block], B[block], d[block])
    after, W = weighed(carried, (moved, X, B, d), term, np.arange(len(block)), len(block))
    return after, W, True


@njit(cache=True, nogil=True)
def drifted(carried: Carried, given: Given) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return `C`, `X`, `B` and `s` before an update."""
    moved, cross, _, _, _, unknown, d, _ = carried
    F, absorbed, born = given[0], given[5], given[7]
    n = len(absorbed)
    if len(moved) == 0:
        none = np.zeros((n, 0))
        return np.zeros((n, n)), np.zeros((n, cross.shape[1])), with_born(none, born), np.zeros(n)
    s = left(F, d.reshape(-1, 1)).ravel()
    return folded(F, left(F, moved)), left(F, cross), with_born(left(F, unknown), born), s


@njit(cache=True, nogil=True)
def with_born(B: FloatArray, born: IntArray) -> FloatArray:
    """Return the columns of `B` that are not zero, and a unit vector for each index of `born`."""
    n, old = B.shape
    out = np.zeros((n, old + len(born)))
    count = 0
    for c in range(old):
        if np.any(B[:, c] != 0.0):
            out[:, count] = B[:, c]
            count += 1
    for i in born:
        out[i, count] = 1.0
        count += 1
    return out[:, :count].copy()


@njit(cache=True, nogil=True)
def inverse_of_root(L: npt.NDArray[Any]) -> FloatArray:
    """Return ``(L L^T)^-1`` of a lower triangular `L`."""
    n = len(L)
    root = np.zeros((n, n))
    out = np.empty((n, n))
    for i in range(n):
        row, d = root[i], 1.0 / L[i, i]
        for k in range(i):
            v, other = L[i, k] * d, root[k]
            for j in range(k + 1):
                row[j] -= v * other[j]
        row[i] = d
    out[:] = np.dot(root.T, root)
    for i in range(n):
        for j in range(i):
            out[j, i] = out[i, j]
    return out


@njit(cache=True, nogil=True)
def _regular_inverse(cov: FloatArray) -> FloatArray:
    """Return the inverse of a covariance where no direction can be without variance, an empty array where one
    may be.

    With unit diagonal no eigenvalue is above ``d``, none below ``1 / |inverse|``: where that proves them all
    above `NO_MORE` of the largest, the inverse is the pseudo-inverse (`windows.pseudo_inverses`).
    """
    n = len(cov)
    L = np.zeros((n, n))
    none = np.zeros((0, 0))
    scale = np.sqrt(np.maximum(np.diag(cov), 0.0))
    for i in range(n):
        if not scale[i] > 0.0:
            return none
        for j in range(i + 1):
            v = cov[i, j] / (scale[i] * scale[j])
            for k in range(j):
                v -= L[i, k] * L[j, k]
            if i == j:
                if not v > 0.0:
                    return none
                L[i, i] = np.sqrt(v)
            else:
                L[i, j] = v / L[j, j]
    inverse = inverse_of_root(L)
    if n * np.sqrt(np.sum(inverse * inverse)) * NO_MORE >= 1.0:
        return none
    for i in range(n):
        for j in range(n):
            inverse[i, j] /= scale[i] * scale[j]
    return inverse


@njit(cache=True, nogil=True)
def blinded(W: FloatArray, Z: FloatArray) -> FloatArray:
    """Return the weight that is blind to the columns of `Z`: the inverse covariance with their variance made
    infinite, ``W - W Z (Z^T W Z)^+ Z^T W``.
    """
    out, b = W.copy(), Z.shape[1]
    P = np.dot(Z.T.copy(), W)
    gram = np.dot(P, Z)
    whole = np.diag(gram).copy()
    for _ in range(b):
        best, j = NO_MORE, -1
        for k in range(b):
            if whole[k] > 0.0 and gram[k, k] > best * whole[k]:
                best, j = gram[k, k] / whole[k], k
        if j < 0:
            break
        root = np.sqrt(gram[j, j])
        p, c = P[j] / root, gram[j] / root
        for i in range(len(p)):
            if p[i] != 0.0:
                out[i] -= p[i] * p
        for k in range(b):
            P[k] -= c[k] * p
            gram[k] -= c[k] * c
        whole[j] = 0.0
    return out


@njit(cache=True, nogil=True)
def weighed(
    carried: Carried,
    now: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    term: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    at: IntArray,
    m: int,
) -> tuple[Carried, FloatArray]:
    """Return the window with one more term, and the term's weight.

    Parameters
    ----------
    carried : tuple
        The window before.
    now : tuple
        ``cov(d)``, `X`, `B` and `d` of the update.
    term : tuple
        Inverse of ``cov(e)``, ``cov(e, d)``, ``A X``, ``A B`` and `e`.
    at : ndarray of int
        Where the term's rows stand in `eta`.
    m : int
        Rows of `eta` after it.
    """
    _, _, cov, weight, scale, _, _, eta = carried
    moved, X, B, d = now
    inverse, across, AX, Z, e = term
    W = blinded(inverse, Z) if Z.shape[1] else inverse
    if len(eta) == m and len(at) == m and np.all(at == np.arange(m)):
        half = np.dot(W, AX)
        cov, weight = cov + (half + half.T + W), weight + W
        cross = X + np.dot(across.T, W)
    else:
        cov, weight, cross = grown(cov, m, m), grown(weight, m, m), grown(X, len(X), m)
        _scatter(cov, weight, np.dot(W, AX), W, at)
        _add_columns(cross, np.dot(across.T, W), at)
    scale, eta = grown(scale.reshape(-1, 1), m, 1).ravel(), grown(eta.reshape(-1, 1), m, 1).ravel()
    push = np.dot(W, e)
    for i in range(len(at)):
        eta[at[i]] += push[i]
        scale[at[i]] = np.sqrt(scale[at[i]] ** 2 + inverse[i, i])
    return (moved, cross, cov, weight, scale, B, d, eta), W


@njit(cache=True, nogil=True)
def grown(a: FloatArray, rows: int, columns: int) -> FloatArray:
    """Return a copy with zeros for what is new."""
    out = np.zeros((rows, columns))
    out[: a.shape[0], : a.shape[1]] = a
    return out


@njit(cache=True, nogil=True)
def _scatter(cov: FloatArray, weight: FloatArray, half: FloatArray, W: FloatArray, at: IntArray) -> None:
    for i in range(len(at)):
        for k in range(half.shape[1]):
            cov[at[i], k] += half[i, k]
            cov[k, at[i]] += half[i, k]
        for k in range(len(at)):
            cov[at[i], at[k]] += W[i, k]
            weight[at[i], at[k]] += W[i, k]


@njit(cache=True, nogil=True)
def _add_columns(total: FloatArray, part: FloatArray, at: IntArray) -> None:
    for i in range(len(total)):
        for k in range(len(at)):
            total[i, at[k]] += part[i, k]
