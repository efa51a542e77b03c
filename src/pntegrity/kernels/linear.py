"""Dense factorisations and the Kalman steps, each a pure function of arrays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf, dpotri, dtrtri

FloatArray = npt.NDArray[np.float64]


def cholesky(S: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of a symmetric positive definite matrix.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where `S` is not positive definite.
    """
    if S.shape[0] == 0:
        return np.zeros((0, 0))
    # LAPACK is column-major: the upper factor of the transpose is the lower factor in row-major order,
    # without a copy
    upper, info = dpotrf(S.T, lower=0, clean=1)
    if info != 0:
        raise np.linalg.LinAlgError(f"covariance is not positive definite (pivot {info} of {S.shape[0]})")
    return np.asarray(upper.T)


def whiten(L: FloatArray, a: FloatArray) -> FloatArray:
    """Return ``L^-1 a`` for a lower triangular `L` and a vector or matrix `a`."""
    return _solve(L, a, 0)


def backsolve(L: FloatArray, a: FloatArray) -> FloatArray:
    """Return ``L^-T a`` for a lower triangular `L` and a vector or matrix `a`."""
    return _solve(L, a, 1)


def _solve(L: FloatArray, a: FloatArray, transposed: int) -> FloatArray:
    if a.size == 0:
        return np.zeros_like(a)
    columns = a.reshape(len(a), -1)
    return np.asarray(dtrsm(1.0, L.T, columns.T, side=1, lower=0, trans_a=transposed).T.reshape(a.shape))


def inverse_definite(cov: FloatArray) -> FloatArray:
    """Return the inverse of a symmetric positive definite matrix, from its Cholesky factor."""
    upper, _ = dpotri(cholesky(cov).T, lower=0)
    return mirrored(upper.T)


def inverse_lower(L: FloatArray) -> FloatArray:
    """Return the inverse of a lower triangular matrix.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where a diagonal element is zero.
    """
    upper, info = dtrtri(L.T, lower=0)
    if info != 0:
        raise np.linalg.LinAlgError(f"triangular matrix is singular (pivot {info} of {len(L)})")
    return np.asarray(upper.T)


@njit(cache=True, nogil=True)
def mirrored(lower: FloatArray) -> FloatArray:
    """Return the symmetric matrix of a lower triangle."""
    n = lower.shape[0]
    out = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            out[i, j] = lower[i, j]
            out[j, i] = lower[i, j]
    return out


def gain(P: FloatArray, H: FloatArray, L: FloatArray) -> FloatArray:
    """Return the Kalman gain ``P H^T S^-1`` with ``S = L L^T``."""
    return np.ascontiguousarray(backsolve(L, whiten(L, H @ P)).T)


def symmetric(P: FloatArray) -> FloatArray:
    """Return the symmetric part."""
    return 0.5 * (P + P.T)


def predict_covariance(F: FloatArray, P: FloatArray, Q: FloatArray) -> FloatArray:
    """Return ``F P F^T + Q`` for any, also rectangular, `F`."""
    return symmetric(F @ P @ F.T + Q)


def correct_covariance(P: FloatArray, H: FloatArray, R: FloatArray, K: FloatArray) -> FloatArray:
    """Return the posterior covariance in Joseph form: symmetric and positive semidefinite for any gain."""
    A = np.eye(P.shape[0]) - K @ H
    diagonal = R.diagonal()
    spread = (K * diagonal) @ K.T if np.count_nonzero(R) == np.count_nonzero(diagonal) else K @ R @ K.T
    return symmetric(A @ P @ A.T + spread)
