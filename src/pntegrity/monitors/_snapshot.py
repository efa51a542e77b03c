"""The pseudoranges of an update as a snapshot: what they say of each other, whatever the prior says."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import cholesky, whiten
from pntegrity.kernels.sparse import sandwich
from pntegrity.records import FloatArray, Update
from pntegrity.states import is_satellite

__all__ = ["code_rows", "covariance", "free_columns", "parity", "without_weights"]

IntArray = npt.NDArray[np.intp]
#: States that a snapshot solves for.
FREE = ("pos", "clk", "isb")
#: Part of the largest singular value below which a direction of the states is not determined.
UNDETERMINED = 1e-9


def code_rows(update: Update) -> IntArray:
    """Return the rows of pseudoranges: observation codes with ``C``; all rows where none is a satellite's."""
    names = [key.partition(":") for key in update.keys]
    if not any(is_satellite(group) for group, _, _ in names):
        return np.arange(len(names))
    return np.array(
        [i for i, (group, _, code) in enumerate(names) if is_satellite(group) and code[:1] == "C"],
        dtype=np.intp,
    )


def free_columns(update: Update, rows: IntArray) -> FloatArray:
    """Return the columns of position, clocks and inter-system biases, shape (k, p)."""
    layout = update.prior.layout
    return np.asarray(update.H[np.ix_(rows, np.concatenate([layout.block(name) for name in FREE]))])


def covariance(update: Update, rows: IntArray) -> FloatArray:
    """Return the covariance of the rows given position and clocks: noise, and what the other states may be.

    Correlations of the other states with position and clocks do not matter: they lie in the columns that a
    snapshot solves for.
    """
    layout = update.prior.layout
    free = np.concatenate([layout.block(name) for name in FREE])
    others = np.setdiff1d(np.arange(len(layout)), free)
    H = np.ascontiguousarray(update.H[np.ix_(rows, others)])
    return np.asarray(sandwich(H, update.prior.P[np.ix_(others, others)]) + update.R[np.ix_(rows, rows)])


def parity(A: FloatArray, C: FloatArray) -> FloatArray:
    """Return the map from rows to unit normals that columns `A` cannot reach, shape (dof, k)."""
    L = cholesky(C)
    left, _ = _ranges(whiten(L, A))
    return np.ascontiguousarray(whiten(L, np.eye(len(L))).T @ left).T


def without_weights(A: FloatArray) -> tuple[FloatArray, int]:
    """Return the map from rows to residuals of least squares without weights, and its degrees of freedom."""
    left, dof = _ranges(A)
    return left @ left.T, dof


def _ranges(A: FloatArray) -> tuple[FloatArray, int]:
    """Return an orthonormal base of what the columns do not reach, shape (k, dof), and its dimension."""
    U, values, _ = np.linalg.svd(A)
    rank = int((values > UNDETERMINED * max(values.max(initial=0.0), 1e-300)).sum())
    return U[:, rank:], A.shape[0] - rank
