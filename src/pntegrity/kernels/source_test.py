"""Which source of several is at fault: rows left out, and what a window says without a source.

Left-out rows of one epoch are what the innovations say of a source when only the prior and the other sources
are believed: with ``z = S^-1 nu`` and ``V = S^-1`` their residual is ``V_oo^-1 z_o``, of covariance
``V_oo^-1``, which is ``R_s + H_s P_c H_s^T`` for the posterior ``P_c`` of the others. For one epoch and one
prior this is all that any separation of that source can show (see `separated`).

Over a window the same is a projection. A unit fault of row ``i`` at epoch ``t`` moves the whitened
innovations of the window by a column of `responses`. What is left of the data outside the columns of a source
is what the filter would have had, had it not used that source since the window began: whatever the fault of
that source is, nothing of it is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.bank import LEAST
from pntegrity.kernels.linear import cholesky, whiten
from pntegrity.kernels.tails import chi2_threshold, max_threshold

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

__all__ = [
    "Courses", "Gains", "LeftOut", "WithoutSource", "courses", "left_out", "literal_separation", "responses",
    "separated",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Rows left out, against the prior and the other rows: residual (k,), root (k, k) of its covariance."""

    residual: FloatArray
    root: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the residual."""
        return self.root @ self.root.T

    @property
    def square(self) -> float:
        """``r^T cov^-1 r``: a chi-square of as many degrees of freedom as rows without a fault."""
        white = whiten(self.root, self.residual)
        return float(white @ white)

    def ratio(self, p_fa: float) -> float:
        """Return the square over its threshold."""
        return self.square / chi2_threshold(p_fa, len(self.residual))


def left_out(nu: FloatArray, S: FloatArray, out: IntArray) -> LeftOut:
    """Return the left-out rows `out` of an epoch.

    Parameters
    ----------
    nu, S : ndarray, shapes (m,) and (m, m)
        Innovations against the shared prior, and their covariance.
    out : ndarray of int, shape (k,)

    References
    ----------
    Chen and Zhao (2023), eqs (1)-(3), on the rows that the combination leaves out.
    """
    order = np.concatenate([np.setdiff1d(np.arange(len(nu)), out), out])
    L = cholesky(S[np.ix_(order, order)])
    k = len(nu) - len(out)
    return LeftOut(L[k:, k:] @ whiten(L, nu[order])[k:], L[k:, k:])


def separated(
    nu: FloatArray, H: FloatArray, R: FloatArray, P: FloatArray, out: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the separation of the full state solution from that without rows `out`, one prior for both, and
    its covariance, shapes (n,) and (n, n).

    Parameters
    ----------
    nu, H, R : ndarray
        Innovations, Jacobian and covariance of all rows.
    P : ndarray, shape (n, n)
        Covariance of the prior.
    out : ndarray of int
    """
    rest = np.setdiff1d(np.arange(len(nu)), out)
    x, after = _solution(nu, H, R, P)
    x_c, after_c = _solution(nu[rest], H[rest], R[np.ix_(rest, rest)], P)
    return x - x_c, after_c - after


def _solution(nu: FloatArray, H: FloatArray, R: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    A = np.eye(len(P)) - K @ H
    return K @ nu, A @ P @ A.T + K @ R @ K.T


def literal_separation(
    nu: FloatArray, H: FloatArray, R: FloatArray, P: FloatArray, out: IntArray
) -> tuple[float, int]:
    """Return the statistic of the paper taken at its word, and its degrees of freedom: all rows, residuals of
    the full solution less those of the combination, covariance ``V + C P_c C^T``.

    The residuals differ by ``H (x_c - x)`` only, whose covariance is far smaller than that: the test never
    fires.

    References
    ----------
    Chen and Zhao (2023), eqs (1)-(3).
    """
    rest = np.setdiff1d(np.arange(len(nu)), out)
    x, _ = _solution(nu, H, R, P)
    x_c, after_c = _solution(nu[rest], H[rest], R[np.ix_(rest, rest)], P)
    r = H @ (x_c - x)
    return float(r @ np.linalg.solve(R + H @ after_c @ H.T, r)), len(nu)


Gains = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""``F, H, L, K`` of one update."""


def responses(window: Sequence[Gains]) -> tuple[FloatArray, FloatArray]:
    """Return what a unit fault of each row of a window, and a unit error of each state before it, does to its
    whitened innovations.

    Parameters
    ----------
    window : sequence of (F, H, L, K)
        Updates, the oldest first.

    Returns
    -------
    A : ndarray, shape (D, D)
        ``D`` rows of the window in order; lower triangular by blocks.
    B : ndarray, shape (D, n)
        Of the states before the window.
    """
    ends = np.cumsum([0] + [len(H) for _, H, _, _ in window])
    A = np.zeros((ends[-1], ends[-1]))
    n = window[0][0].shape[1]
    B, E = np.zeros((ends[-1], n)), np.eye(n)
    for (F, H, L, K), first, last in zip(window, ends, ends[1:], strict=False):
        prior = F @ E
        g = -(H @ prior)
        white = whiten(L, g)
        B[first:last], A[first:last, :first] = white[:, :n], white[:, n:]
        A[first:last, first:last] = whiten(L, np.eye(last - first))
        E = np.concatenate([prior + K @ g, K], axis=1)
    return A, B


@dataclass(frozen=True, eq=False)
class Courses:
    """Faults that begin within a window, each a bias or a ramp of one signature since one onset.

    Parameters
    ----------
    means : ndarray, shape (D, h)
        What each unit fault makes of the whitened innovations.
    signature, onset : ndarray of int, shape (h,)
        Which signature, and the epoch of the window at which it begins; courses of one signature are
        neighbours.
    """

    means: FloatArray
    signature: IntArray
    onset: IntArray


def courses(
    A: FloatArray, touched: Sequence[tuple[FloatArray, FloatArray]], t_s: FloatArray, step_s: float,
    onsets: Sequence[int],
) -> Courses:  # fmt: skip
    """Return the courses of signatures through a window.

    Parameters
    ----------
    A : ndarray, shape (D, D)
        Of `responses`.
    touched : sequence of (ndarray, ndarray), shapes (m_k, s)
        For each epoch the rows that grow with time and those that jump (`signatures.masks`).
    t_s : ndarray
        Times of the epochs, s.
    step_s : float
        A ramp is zero this long before its onset.
    onsets : sequence of int
        Epochs at which faults may begin.
    """
    s, ends = touched[0][0].shape[1], np.cumsum([0] + [len(g) for g, _ in touched])
    slope, level = np.zeros((len(A), s)), np.zeros((len(A), s))
    found, wanted = {}, set(onsets)
    for k in range(len(touched) - 1, -1, -1):
        rows, (growing, constant) = A[:, ends[k] : ends[k + 1]], touched[k]
        grows = rows @ growing
        slope += grows
        level += rows @ constant + (t_s[k] - t_s[0]) * grows
        if k in wanted:
            found[k] = level + (step_s - (t_s[k] - t_s[0])) * slope
    order = sorted(found)
    means = np.stack([found[k] for k in order], axis=2).reshape(len(A), -1)
    return Courses(means, np.repeat(np.arange(s), len(order)), np.tile(np.array(order, dtype=np.intp), s))


@dataclass(frozen=True, eq=False)
class WithoutSource:
    """What a window says when some rows are not believed at all.

    Parameters
    ----------
    faults : Courses
        Of the other rows, as they were before the rows are taken out.
    out : ndarray, shape (D, k)
        What is not believed: columns of the `responses`, of rows and perhaps of the states before the window.
    """

    faults: Courses
    out: FloatArray

    @cached_property
    def base(self) -> FloatArray:
        """An orthonormal base of what the rows left out can do, shape (D, k)."""
        return np.linalg.qr(self.out)[0]

    @cached_property
    def means(self) -> FloatArray:
        """The other rows' faults as far as the rest of the window shows them, unit vectors; 0: not at all."""
        left = self.faults.means - self.base @ (self.base.T @ self.faults.means)
        size = np.linalg.norm(left, axis=0)
        return np.asarray(np.divide(left, size, out=np.zeros_like(left), where=size**2 > LEAST))

    def explained(self, white: FloatArray) -> FloatArray:
        """Return what each of the other rows' faults explains of whitened innovations (D,) or (D, runs)."""
        return np.asarray((self.means.T @ white) ** 2)

    def allowed(self, p: float) -> float:
        """Return what the largest exceeds with a probability of at most `p` where nothing else is at
        fault.
        """
        seen = np.flatnonzero(np.abs(self.means).max(axis=0, initial=0.0) > 0.0)
        if not len(seen):
            return float("inf")
        chosen, signature = self.means[:, seen], self.faults.signature[seen]
        near = np.abs(np.einsum("di,di->i", chosen[:, :-1], chosen[:, 1:]))
        rho = np.append(0.0, np.where(signature[1:] == signature[:-1], near, 0.0))
        return max_threshold(np.minimum(rho, 1.0), p) ** 2
