"""Windowed linear tests: y = sum_j A_j nu_j over the last updates, with its exact covariance.

Under the null hypothesis the innovations are white, so with ``nu_j = L_j n_j`` the vector is ``y = sum_j M_j
n_j``, ``M_j = A_j L_j``, and ``cov(y) = sum_j M_j M_j^T`` exactly, whatever rows and states came and went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.linalg.lapack import dpstrf

from pntegrity.kernels.linear import cholesky, inverse_lower

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Form:
    """A quadratic test of whitened innovations: ``statistic = |metric (sum_j maps_j n_j)|^2``.

    Parameters
    ----------
    maps : sequence of ndarray, shapes (d, m_j)
        ``M_j``, oldest update first.
    metric : ndarray, shape (r, d)
        A root of the inverse covariance that the test believes in: the exact one, or a published one.
    dof : int
        Degrees of freedom of the chi-square that the threshold is taken from.
    """

    maps: Sequence[FloatArray]
    metric: FloatArray
    dof: int

    def statistic(self, white: Sequence[FloatArray]) -> FloatArray:
        """Return the statistic of the whitened innovations, each of shape (m_j,) or (m_j, runs)."""
        y = self.project(white)
        return np.asarray(np.sum(y * y, axis=0))

    def project(self, white: Sequence[FloatArray]) -> FloatArray:
        """Return ``metric y``, shape (r,) or (r, runs)."""
        return np.asarray(self.metric @ sum(M @ n for M, n in zip(self.maps, white, strict=True)))

    def covariance(self) -> FloatArray:
        """Return the exact covariance of ``metric y``: the identity where the metric is the exact one."""
        T = self.stacked()
        return np.asarray(T @ T.T)

    def stacked(self) -> FloatArray:
        """Return ``metric [M_1 ... M_k]``, shape (r, sum of m_j): one matrix for the whole window, oldest
        rows first.
        """
        return np.asarray(self.metric @ np.concatenate(list(self.maps), axis=1))


@dataclass(frozen=True, eq=False)
class QuadraticTest:
    """One epoch of a quadratic monitor, without data: the form over the last updates and what it is held
    against.

    Parameters
    ----------
    form : Form or None
        None where no test is possible.
    threshold, p_fa : float
        Threshold on the statistic, and the false-alarm probability that it is meant for.
    dof : int
        Degrees of freedom of the chi-square behind the threshold.
    reason : str
        Why no test is possible, where none is.
    """

    form: Form | None
    threshold: float = float("inf")
    p_fa: float = 0.0
    dof: int = 0
    reason: str = ""


def inverse_root(cov: FloatArray, rtol: float = 1e-9) -> FloatArray:
    """Return `Omega`, shape (rank, d), with ``Omega^T Omega`` the pseudo-inverse of a covariance.

    Directions whose variance is below `rtol` of the largest, after scaling to unit diagonal, are dropped: the
    rank is the number of degrees of freedom.
    """
    scale = np.sqrt(np.maximum(np.diagonal(cov), 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(cov / np.outer(safe, safe))
    keep = values > rtol * max(values[-1], 0.0) if len(values) else np.zeros(0, dtype=bool)
    return np.ascontiguousarray((vectors[:, keep] / np.sqrt(values[keep])).T / safe)


def pseudo_inverses(covs: FloatArray, rtol: float = 1e-9) -> FloatArray:
    """Return the pseudo-inverse of each covariance of a stack (k, d, d); see `inverse_root` for what is
    dropped.
    """
    scale = np.sqrt(np.maximum(np.diagonal(covs, axis1=1, axis2=2), 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covs / (safe[:, :, None] * safe[:, None, :]))
    keep = values > rtol * np.maximum(values[:, -1:], 0.0)
    roots = (
        vectors
        * np.sqrt(np.where(keep, 1.0 / np.where(keep, values, 1.0), 0.0))[:, None, :]
        / safe[:, :, None]
    )
    return np.asarray(roots @ roots.transpose(0, 2, 1))


def definite_inverse_root(cov: FloatArray) -> FloatArray:
    """Return `Omega` of a covariance that is expected to be positive definite; falls back on
    `inverse_root`.
    """
    try:
        return inverse_lower(cholesky(cov))
    except np.linalg.LinAlgError:
        return inverse_root(cov)


def pivoted_root(cov: FloatArray, scale: FloatArray | None = None, rtol: float = 1e-9) -> FloatArray:
    """Return `Omega`, shape (rank, d), that whitens vectors of a covariance which may be singular.

    By a pivoted Cholesky factor: where the rank is not full, as many components as the rank are whitened, and
    the others, linear in them, are left out. ``|Omega y|^2`` is that of the pseudo-inverse for any `y` that
    the covariance allows. Ten times as fast as `inverse_root`.

    Parameters
    ----------
    cov : ndarray, shape (d, d)
    scale : ndarray, shape (d,), optional
        What the components are divided by first; standard deviations where not given.
    rtol : float
        A component whose variance, given those before it, is below this part of the largest has none.
    """
    if scale is None:
        scale = np.sqrt(np.maximum(np.diagonal(cov), 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    scaled = cov / (safe[:, None] * safe)
    largest = float(np.diagonal(scaled).max(initial=0.0))
    if not largest > 0.0:
        return np.zeros((0, len(cov)))
    upper, pivots, rank, _ = dpstrf(scaled.T, tol=rtol * largest, lower=0)
    kept = pivots[:rank].astype(np.int64) - 1
    return np.asarray(_spread(inverse_lower(upper[:rank, :rank].T), kept, 1.0 / safe))


@njit(cache=True, nogil=True)
def _spread(root: FloatArray, kept: IntArray, by: FloatArray) -> FloatArray:
    """Return the lower triangle of `root` with its columns scaled, where they belong among all."""
    out = np.zeros((len(root), len(by)))
    for i in range(len(root)):
        for k in range(i + 1):
            out[i, kept[k]] = root[i, k] * by[kept[k]]
    return out


def respond(
    E: FloatArray, F: FloatArray, H: FloatArray, K: FloatArray, f: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Take measurement faults one epoch through a filter.

    A fault `f` on the rows moves the mean of the innovation by ``g = f - H F e`` and the error of the state
    from ``e`` to ``F e + K g``.

    Parameters
    ----------
    E : ndarray, shape (n_previous, c)
        State errors after the previous epoch, one column a fault.
    F, H, K : ndarray
        Transition, Jacobian and gain of this epoch.
    f : ndarray, shape (m, c)
        The faults at this epoch.

    Returns
    -------
    g : ndarray, shape (m, c)
        Innovation means.
    E : ndarray, shape (n, c)
        State errors after this epoch.
    """
    prior = F @ E
    g = f - H @ prior
    return g, prior + K @ g
