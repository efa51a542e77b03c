"""Dense factorisations and the Kalman steps, each a pure function of arrays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dpotrf, dtrtrs

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
    factor, info = dpotrf(S, lower=1, clean=1)
    if info != 0:
        raise np.linalg.LinAlgError(f"covariance is not positive definite (pivot {info} of {S.shape[0]})")
    return np.ascontiguousarray(factor)


def whiten(L: FloatArray, a: FloatArray) -> FloatArray:
    """Return ``L^-1 a`` for a lower triangular `L`."""
    if a.size == 0:
        return np.zeros_like(a)
    out, _ = dtrtrs(L, a, lower=1)
    return np.ascontiguousarray(out)


def backsolve(L: FloatArray, a: FloatArray) -> FloatArray:
    """Return ``L^-T a`` for a lower triangular `L`."""
    if a.size == 0:
        return np.zeros_like(a)
    out, _ = dtrtrs(L, a, lower=1, trans=1)
    return np.ascontiguousarray(out)


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
    return symmetric(A @ P @ A.T + K @ R @ K.T)
