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

#: Of a fault's square so much is rounding.
ROUNDING = 1e-11

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
        What each unit fault makes of the whitened innovations; a fault's lie side by side in memory.
    signature, onset : ndarray of int, shape (h,)
        Which signature, and the epoch of the window at which it begins; courses of one signature are
        neighbours.
    """

    means: FloatArray
    signature: IntArray
    onset: IntArray

    def those(self, which: IntArray | npt.NDArray[np.bool_], first: int = 0) -> Courses:
        """Return some of the courses, without the first rows."""
        return Courses(self.means.T[:, first:][which].T, self.signature[which], self.onset[which])

    @cached_property
    def squares(self) -> FloatArray:
        """The square of each unit fault's mean."""
        return np.asarray(np.einsum("hd,hd->h", self.means.T, self.means.T))


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
    slope, level = np.zeros((s, len(A))), np.zeros((s, len(A)))
    at = {k: i for i, k in enumerate(sorted(onsets))}
    means = np.empty((s, len(at), len(A)))
    for k in range(len(touched) - 1, -1, -1):
        (growing, constant), first = touched[k], ends[k]
        response = A[first:, first : ends[k + 1]].T  # nothing before it moves
        grows = growing.T @ response
        slope[:, first:] += grows
        level[:, first:] += constant.T @ response + (t_s[k] - t_s[0]) * grows
        if k in at:
            np.multiply(slope, step_s - (t_s[k] - t_s[0]), out=means[:, at[k]])
            means[:, at[k]] += level
    order = np.array(sorted(at), dtype=np.intp)
    return Courses(means.reshape(-1, len(A)).T, np.repeat(np.arange(s), len(at)), np.tile(order, s))


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
    def _inside(self) -> FloatArray:
        """What of the other rows' faults the rows left out can do as well, shape (h, k)."""
        return self.faults.means.T @ self.base

    @cached_property
    def seen(self) -> FloatArray:
        """The square of what is left of each unit fault of the other rows; 0: nothing that counts."""
        whole = self.faults.squares
        left = whole - np.einsum("hk,hk->h", self._inside, self._inside)
        return np.asarray(np.where(left > np.maximum(LEAST, ROUNDING * whole), left, 0.0))

    def explained(self, white: FloatArray) -> FloatArray:
        """Return what each of the other rows' faults explains of whitened innovations (D,) or (D, runs)."""
        dots = self.faults.means.T @ (white - self.base @ (self.base.T @ white))
        seen = self.seen.reshape((-1,) + (1,) * (dots.ndim - 1))
        return np.asarray(np.divide(dots**2, seen, out=np.zeros_like(dots), where=seen > 0.0))

    def allowed(self, p: float) -> float:
        """Return what the largest exceeds with a probability of at most `p` where nothing else is at
        fault.
        """
        seen = np.flatnonzero(self.seen)
        if not len(seen):
            return float("inf")
        signature = self.faults.signature[seen]
        next_to = np.flatnonzero(signature[1:] == signature[:-1])
        rho = np.zeros(len(seen))
        rho[next_to + 1] = self._correlation(seen[next_to], seen[next_to + 1])
        return max_threshold(np.minimum(rho, 1.0), p) ** 2

    def _correlation(self, one: IntArray, other: IntArray) -> FloatArray:
        """Return how alike faults are in what is left of them, without a sign."""
        means, inside = self.faults.means.T, self._inside
        both = np.einsum("hd,hd->h", means[one], means[other])
        both -= np.einsum("hk,hk->h", inside[one], inside[other])
        return np.asarray(np.abs(both) / np.sqrt(self.seen[one] * self.seen[other]))
